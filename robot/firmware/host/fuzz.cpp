// Feeds standard input to the controller, with time passing, and checks what must always hold.
// Built with the address and undefined-behaviour sanitizers by tests/test_firmware.py.
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../hand_controller/controller.h"

namespace {

struct Bench : hand::Hardware {
  int32_t goal_um = 0, vibration = 0;
  bool pressed = false;

  void move_valve(int32_t um) override { goal_um = um; }
  int32_t valve_um() override { return goal_um; }
  bool valve_is_healthy() override { return true; }
  int32_t valve_temperature_c() override { return -1; }
  void vibrate(int32_t permille) override { vibration = permille; }
  bool emergency_stop_is_pressed() override { return pressed; }
};

void check(bool holds, const char* what) {
  if (holds) return;
  fprintf(stderr, "%s\n", what);
  abort();
}

}  // namespace

int main() {
  Bench bench;
  const hand::Settings settings;
  hand::Controller controller(bench, settings);
  hand::LineReader reader;
  uint32_t now_ms = 0xFFFF0000;  // wraps around on the way
  unsigned long answers = 0;
  for (int byte = getchar(); byte != EOF; byte = getchar()) {
    now_ms += byte == 0xFE ? 400 : 1;  // a byte of the input makes a silence
    bench.pressed = byte == 0xFD;
    if (reader.feed(static_cast<char>(byte))) {
      hand::LineWriter reply;
      if (controller.take(reader.text(), reader.length(), now_ms, &reply)) {
        ++answers;
        const char* text = reply.text();
        check(strlen(text) > 6 && text[strlen(text) - 1] == '\n', "an answer is a whole line");
      }
    }
    controller.tick(now_ms);
    check(bench.goal_um >= 0 && bench.goal_um <= settings.max_opening_um, "the opening is within its limits");
    check(bench.vibration >= 0 && bench.vibration <= 1000, "so is the vibration");
    if (byte == 0xFD || byte == 0xFE) {
      check(bench.goal_um == 0 && bench.vibration == 0, "stopped, or left alone, the hand is safe");
    }
  }
  printf("%lu\n", answers);
  return 0;
}
