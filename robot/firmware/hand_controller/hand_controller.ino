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

  // The servo is asked at a steady rate, so that no command waits for the bus.
  void poll(uint32_t now_ms) {
    if (polled_ && now_ms - polled_ms_ < kServoPeriodMs) return;
    polled_ = true;
    polled_ms_ = now_ms;
    healthy_ = bus_.ping(kServo) && bus_.readControlTableItem(ControlTableItem::HARDWARE_ERROR_STATUS, kServo) == 0;
    if (!healthy_) return;
    const int32_t count = bus_.readControlTableItem(ControlTableItem::PRESENT_POSITION, kServo);
    opening_um_ = (count - kClosedCount) * (90 * kSettings.um_per_degree) / 1024;
    temperature_c_ = bus_.readControlTableItem(ControlTableItem::PRESENT_TEMPERATURE, kServo);
  }

  void move_valve(int32_t opening_um) override {
    const int32_t count = kClosedCount + opening_um * 1024 / (90 * kSettings.um_per_degree);
    bus_.setGoalPosition(kServo, static_cast<float>(count));
  }
  int32_t valve_um() override { return opening_um_; }
  bool valve_is_healthy() override { return healthy_; }
  int32_t valve_temperature_c() override { return temperature_c_; }
  void vibrate(int32_t permille) override { analogWrite(kVibrationPin, static_cast<int>(permille * 255 / 1000)); }
  bool emergency_stop_is_pressed() override { return digitalRead(kEmergencyStopPin) == HIGH; }

 private:
  Dynamixel2Arduino bus_;
  bool polled_ = false;
  bool healthy_ = false;
  uint32_t polled_ms_ = 0;
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
