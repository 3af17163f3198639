// The SCU-Hand-SV's controller: an Arduino-class board with a DYNAMIXEL shield.
//
// Valve: XC330-T288-T on the shield's half-duplex TTL bus, id 1, 1 Mbaud (library Dynamixel2Arduino).
// Vibration: N20 motor through a MOSFET on a PWM pin. Emergency stop: a normally closed contact to
// ground, so that a broken wire stops too. The host speaks through USB at 115200 baud.
// Nothing here but pins and the servo: protocol and behaviour are in controller.cpp and protocol.cpp.
#include <Dynamixel2Arduino.h>

#include "controller.h"

namespace {

constexpr uint8_t kDirectionPin = 2;
constexpr uint8_t kVibrationPin = 9;
constexpr uint8_t kEmergencyStopPin = 7;
constexpr uint8_t kServo = 1;
constexpr uint32_t kServoBaud = 1000000;
constexpr int32_t kClosedCount = 2048;  // calibrated: the servo's position with the valve just shut
constexpr uint32_t kServoPeriodMs = 10;
constexpr uint32_t kServoAnswerMs = 5;  // the servo is waited for no longer: the loop must go on

// Of the XC330's control table (ROBOTIS e-manual); one read takes all from the error to the temperature.
constexpr uint16_t kGoalPosition = 116;
constexpr uint16_t kHardwareError = 70;
constexpr uint16_t kPresentPosition = 132;
constexpr uint16_t kPresentTemperature = 146;
constexpr uint16_t kStatusSize = kPresentTemperature - kHardwareError + 1;

const hand::Settings kSettings;

class Board : public hand::Hardware {
 public:
  explicit Board(HardwareSerial& port) : bus_(port, kDirectionPin) {}

  void begin() {
    pinMode(kVibrationPin, OUTPUT);
    analogWrite(kVibrationPin, 0);
    pinMode(kEmergencyStopPin, INPUT_PULLUP);
    bus_.begin(kServoBaud);
    bus_.setPortProtocolVersion(2.0);
    bus_.torqueOff(kServo);
    bus_.setOperatingMode(kServo, OP_EXTENDED_POSITION);
    bus_.torqueOn(kServo);
    poll(millis());
  }

  // The servo is asked at a steady rate, so that no command waits for the bus. The library's calls by item
  // give 0 where no answer came, which would be a healthy servo; `read` tells how many bytes it got.
  void poll(uint32_t now_ms) {
    if (polled_ && now_ms - polled_ms_ < kServoPeriodMs) return;
    polled_ = true;
    polled_ms_ = now_ms;
    uint8_t status[kStatusSize];
    const int32_t got = bus_.read(kServo, kHardwareError, kStatusSize, status, kStatusSize, kServoAnswerMs);
    healthy_ = got == kStatusSize && status[0] == 0;
    if (!healthy_) return;
    uint32_t count = 0;
    for (int i = 3; i >= 0; --i) count = count << 8 | status[kPresentPosition - kHardwareError + i];
    opening_um_ = (static_cast<int32_t>(count) - kClosedCount) * (90 * kSettings.um_per_degree) / 1024;
    temperature_c_ = status[kPresentTemperature - kHardwareError];
    if (!told_) tell();
  }

  void move_valve(int32_t opening_um) override {
    goal_count_ = kClosedCount + opening_um * 1024 / (90 * kSettings.um_per_degree);
    tell();
  }
  int32_t valve_um() override { return opening_um_; }
  bool valve_is_healthy() override { return healthy_; }
  int32_t valve_temperature_c() override { return temperature_c_; }
  void vibrate(int32_t permille) override { analogWrite(kVibrationPin, static_cast<int>(permille * 255 / 1000)); }
  bool emergency_stop_is_pressed() override { return digitalRead(kEmergencyStopPin) == HIGH; }

 private:
  // A goal that was not acknowledged is told again with the next poll.
  void tell() {
    uint8_t goal[4];
    for (int i = 0; i < 4; ++i) goal[i] = static_cast<uint8_t>(static_cast<uint32_t>(goal_count_) >> 8 * i);
    told_ = bus_.write(kServo, kGoalPosition, goal, sizeof(goal), kServoAnswerMs);
  }

  Dynamixel2Arduino bus_;
  bool polled_ = false;
  bool healthy_ = false;
  bool told_ = true;
  uint32_t polled_ms_ = 0;
  int32_t goal_count_ = kClosedCount;
  int32_t opening_um_ = 0;
  int32_t temperature_c_ = 0;
};

Board board(Serial1);
hand::Controller controller(board, kSettings);
hand::LineReader reader;

}  // namespace

void setup() {
  Serial.begin(115200);
  board.begin();
}

void loop() {
  const uint32_t now_ms = millis();
  board.poll(now_ms);
  while (Serial.available() > 0) {
    if (!reader.feed(static_cast<char>(Serial.read()))) continue;
    hand::LineWriter reply;
    if (controller.take(reader.text(), reader.length(), now_ms, &reply)) Serial.print(reply.text());
  }
  controller.tick(now_ms);
}
