// The controller as a library of the host, with hardware that the caller provides: the twin's brain.
#include <string.h>

#include "../hand_controller/controller.h"

namespace {

struct Bench : hand::Hardware {
  int32_t goal_um = 0, opening_um = 0, temperature_c = 25, vibration = 0;
  bool healthy = true, pressed = false;

  void move_valve(int32_t um) override { goal_um = um; }
  int32_t valve_um() override { return opening_um; }
  bool valve_is_healthy() override { return healthy; }
  int32_t valve_temperature_c() override { return temperature_c; }
  void vibrate(int32_t permille) override { vibration = permille; }
  bool emergency_stop_is_pressed() override { return pressed; }
};

struct Brain {
  Bench bench;
  hand::Controller controller{bench, hand::Settings()};
  hand::LineReader reader;
};

}  // namespace

extern "C" {

void* hand_new() { return new Brain; }
void hand_delete(void* brain) { delete static_cast<Brain*>(brain); }

// What the hardware tells.
void hand_sense(void* brain, int32_t opening_um, int32_t temperature_c, bool healthy, bool pressed) {
  Bench& bench = static_cast<Brain*>(brain)->bench;
  bench.opening_um = opening_um;
  bench.temperature_c = temperature_c;
  bench.healthy = healthy;
  bench.pressed = pressed;
}

// What the hardware is told.
int32_t hand_goal_um(void* brain) { return static_cast<Brain*>(brain)->bench.goal_um; }
int32_t hand_vibration(void* brain) { return static_cast<Brain*>(brain)->bench.vibration; }

void hand_tick(void* brain, uint32_t now_ms) { static_cast<Brain*>(brain)->controller.tick(now_ms); }

// One byte of the host; the answer, if there is one, is copied to `reply` (at least 80 bytes) and its
// length returned.
size_t hand_feed(void* brain, char byte, uint32_t now_ms, char* reply) {
  Brain* self = static_cast<Brain*>(brain);
  if (!self->reader.feed(byte)) return 0;
  hand::LineWriter line;
  if (!self->controller.take(self->reader.text(), self->reader.length(), now_ms, &line)) return 0;
  strcpy(reply, line.text());
  return strlen(reply);
}

}  // extern "C"
