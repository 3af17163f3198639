// As much of Arduino as the hand controller's sketch uses, on a clock and a serial line that a test moves.
#pragma once

#include <stddef.h>
#include <stdint.h>
#include <string.h>

enum { INPUT_PULLUP = 2, OUTPUT = 1, LOW = 0, HIGH = 1 };

struct HardwareSerial {
  char in[256] = {}, out[256] = {};
  size_t in_at = 0, in_end = 0, out_end = 0;

  void begin(unsigned long) {}
  int available() { return static_cast<int>(in_end - in_at); }
  int read() { return in[in_at++]; }
  void print(const char* text) {
    for (; *text && out_end < sizeof(out) - 1; ++text) out[out_end++] = *text;
  }
};

extern HardwareSerial Serial, Serial1;
extern int pwm, stop_pin;
unsigned long millis();
inline void pinMode(uint8_t, uint8_t) {}
inline void analogWrite(uint8_t, int value) { pwm = value; }
inline int digitalRead(uint8_t) { return stop_pin; }
