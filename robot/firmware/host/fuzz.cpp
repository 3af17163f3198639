// Feeds standard input to the controller, with time passing, and checks what must always hold.
// Built with the address and undefined-behaviour sanitizers by tests/test_firmware.py.
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <vector>

#include "../hand_controller/controller.h"

namespace {

void check(bool holds, const char* what) {
  if (holds) return;
  fprintf(stderr, "%s\n", what);
  abort();
}

uint16_t crc(const std::vector<uint8_t>& data) {
  uint16_t sum = 0;
  for (uint8_t byte : data) {
    sum = static_cast<uint16_t>(sum ^ byte << 8);
    for (int bit = 0; bit < 8; ++bit) sum = static_cast<uint16_t>(sum & 0x8000 ? sum << 1 ^ 0x8005 : sum << 1);
  }
  return sum;
}

// A servo that is at its goal at once, on a line that sometimes garbles an answer.
struct Servo : hand::Wire {
  uint8_t table[160] = {0xC4, 0x04};
  std::vector<uint8_t> answer;
  size_t at = 0;
  uint32_t asked = 0;
  bool garbles = false;

  void begin(uint32_t) override {}
  void send(const uint8_t* packet, size_t length, size_t) override {
    const uint8_t* parameters = packet + 8;
    const unsigned address = length > 10 ? parameters[0] : 0;
    std::vector<uint8_t> data;
    if (packet[7] == 1) data.assign(table, table + 3);
    if (packet[7] == 2) data.assign(table + address, table + address + parameters[2]);
    if (packet[7] == 3) memcpy(table + address, parameters + 2, length - 12);
    memcpy(table + 132, table + 116, 4);
    answer = {0xFF, 0xFF, 0xFD, 0x00, packet[4], static_cast<uint8_t>(data.size() + 4), 0, 0x55, 0};
    answer.insert(answer.end(), data.begin(), data.end());
    const uint16_t sum = crc(answer);
    answer.push_back(static_cast<uint8_t>(sum));
    answer.push_back(static_cast<uint8_t>(sum >> 8));
    at = 0;
    if (garbles && ++asked % 61 == 0) answer[asked % answer.size()] ^= static_cast<uint8_t>(1 << asked % 7);
  }
  bool receive(uint8_t* byte) override {
    if (at == answer.size()) return false;
    *byte = answer[at++];
    return true;
  }
  int32_t goal() const { return hand::value_of(table + 116, 4); }
};

struct Pins : hand::Board {
  int32_t vibration = 0;
  bool pressed = false;
  hand::ValveMap map = {2, {{2048, 0}, {2308, 2400}}, 4000};

  void vibrate(int32_t permille) override { vibration = permille; }
  bool emergency_stop_is_pressed() override { return pressed; }
  bool load(hand::ValveMap* stored) override {
    *stored = map;
    return true;
  }
  void store(const hand::ValveMap& stored) override {
    check(stored.is_sound(), "a map that is kept is sound");
    map = stored;
  }
};

}  // namespace

int main() {
  Servo servo;
  Pins pins;
  hand::Controller controller(pins, servo);
  hand::LineReader reader;
  uint32_t now_ms = 0xFFFF0000;  // wraps around on the way
  unsigned long answers = 0;
  bool opened = false;
  controller.tick(now_ms);
  servo.garbles = true;
  for (int byte = getchar(); byte != EOF; byte = getchar()) {
    now_ms += byte == 0xFE ? 400 : 1;  // a byte of the input makes a silence
    pins.pressed = byte == 0xFD;
    if (reader.feed(static_cast<char>(byte))) {
      hand::LineWriter reply;
      if (controller.take(reader.text(), reader.length(), now_ms, &reply)) {
        ++answers;
        const char* text = reply.text();
        check(strlen(text) > 6 && text[strlen(text) - 1] == '\n', "an answer is a whole line");
      }
    }
    controller.tick(now_ms);
    const int32_t goal = servo.goal(), shut = pins.map.at[0].count;
    check(goal >= pins.map.lowest_count() && goal <= pins.map.highest_count(), "the opening is within its limits");
    check(pins.vibration >= 0 && pins.vibration <= 1000, "so is the vibration");
    opened = opened || goal != shut;
    if (byte == 0xFD || byte == 0xFE) check(pins.vibration == 0, "stopped, or left alone, the motor is off");
  }
  for (int i = 0; i < 400; ++i) controller.tick(++now_ms);
  check(servo.goal() == pins.map.at[0].count, "left alone, the valve is shut, whatever was garbled");
  check(opened, "it was open before");
  printf("%lu\n", answers);
  return 0;
}
