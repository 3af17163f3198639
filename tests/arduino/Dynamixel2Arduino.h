// The calls of ROBOTIS' library Dynamixel2Arduino (0.5 and later) that the sketch uses, on one servo in memory.
// Signatures: ROBOTIS-GIT/Dynamixel2Arduino, src/Dynamixel2Arduino.h and src/utility/master.h (Apache-2.0).
#pragma once

#include "Arduino.h"

enum OperatingMode { OP_POSITION = 0, OP_EXTENDED_POSITION };

struct Servo {
  uint8_t table[160] = {};
  bool answers = true;
};
extern Servo servo;

class Dynamixel2Arduino {
 public:
  Dynamixel2Arduino(HardwareSerial&, int) {}
  void begin(unsigned long) {}
  bool setPortProtocolVersion(float) { return true; }
  bool torqueOff(uint8_t) { return servo.answers; }
  bool torqueOn(uint8_t) { return servo.answers; }
  bool setOperatingMode(uint8_t, uint8_t) { return servo.answers; }
  int32_t read(uint8_t, uint16_t address, uint16_t length, uint8_t* data, uint16_t, uint32_t = 10) {
    if (!servo.answers) return 0;
    memcpy(data, servo.table + address, length);
    return length;
  }
  bool write(uint8_t, uint16_t address, const uint8_t* data, uint16_t length, uint32_t = 10) {
    if (servo.answers) memcpy(servo.table + address, data, length);
    return servo.answers;
  }
};
