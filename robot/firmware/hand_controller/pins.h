// Where things are on the board; `-D` of the compiler may say otherwise.
#pragma once

#include <stdint.h>

#ifndef SCUHAND_DIRECTION_PIN
#define SCUHAND_DIRECTION_PIN 2  // high while the board speaks to the servo: the DYNAMIXEL Shield's own
#endif
#ifndef SCUHAND_VIBRATION_PIN
#define SCUHAND_VIBRATION_PIN 9  // PWM, to the gate of the motor's MOSFET
#endif
#ifndef SCUHAND_EMERGENCY_STOP_PIN
#define SCUHAND_EMERGENCY_STOP_PIN 7  // a normally closed contact to ground: a broken wire stops too
#endif

constexpr uint8_t kDirectionPin = SCUHAND_DIRECTION_PIN;
constexpr uint8_t kVibrationPin = SCUHAND_VIBRATION_PIN;
constexpr uint8_t kEmergencyStopPin = SCUHAND_EMERGENCY_STOP_PIN;
