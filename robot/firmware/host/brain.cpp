// The controller as a library of the host, with a line and pins that the caller provides: the twin's brain.
#include <string.h>

#include <new>

#include "../hand_controller/controller.h"

namespace {

// Sends a packet at a baud rate; returns the length of what came back, at most 128 bytes.
typedef size_t (*Exchange)(uint32_t baud, const uint8_t* packet, size_t length, uint8_t* answer);

struct Line : hand::Wire {
  Exchange exchange;
  uint32_t baud = 0;
  uint8_t answer[128];
  size_t at = 0, end = 0;

  explicit Line(Exchange servo) : exchange(servo) {}
  void begin(uint32_t rate) override { baud = rate; }
  void send(const uint8_t* packet, size_t length, size_t) override {
    at = 0;
    end = exchange(baud, packet, length, answer);
  }
  bool receive(uint8_t* byte) override {
    if (at == end) return false;
    *byte = answer[at++];
    return true;
  }
};

struct Pins : hand::Board {
  int32_t vibration = 0;
  bool pressed = false;
  bool has_map = false;
  hand::ValveMap stored = {};

  void vibrate(int32_t permille) override { vibration = permille; }
  bool emergency_stop_is_pressed() override { return pressed; }
  bool load(hand::ValveMap* map) override {
    *map = stored;
    return has_map;
  }
  void store(const hand::ValveMap& map) override {
    stored = map;
    has_map = true;
  }
};

struct Brain {
  Line line;
  Pins pins;
  hand::Controller controller{pins, line};
  hand::LineReader reader;

  explicit Brain(Exchange servo) : line(servo) {}
};

}  // namespace

extern "C" {

void* hand_new(Exchange servo) { return new Brain(servo); }
void hand_delete(void* brain) { delete static_cast<Brain*>(brain); }

// The board's reset: everything is forgotten but what is in its lasting memory.
void hand_reset(void* brain) {
  Brain* self = static_cast<Brain*>(brain);
  self->pins.vibration = 0;
  self->controller.~Controller();
  new (&self->controller) hand::Controller(self->pins, self->line);
  self->reader = hand::LineReader();
}

void hand_press(void* brain, bool pressed) { static_cast<Brain*>(brain)->pins.pressed = pressed; }
int32_t hand_vibration(void* brain) { return static_cast<Brain*>(brain)->pins.vibration; }

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
