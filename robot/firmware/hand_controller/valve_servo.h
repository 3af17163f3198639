// The valve's servo, an XC330-T288-T: set up anew whenever it has lost its power, and told to shut the valve then.
// Plain C++11 without Arduino.
#pragma once

#include "dynamixel.h"
#include "valve_map.h"

namespace hand {

constexpr uint8_t kServoId = 1;
constexpr uint32_t kServoBaud = 1000000;
constexpr uint32_t kFactoryBaud = 57600;

class ValveServo {
 public:
  explicit ValveServo(Wire& wire) : wire_(wire), servo_(wire, kServoId) {}

  // Set the valve up by this map, and shut it. Until there is one, nothing is moved.
  void use(const ValveMap& map);
  const ValveMap& map() const { return map_; }

  // Ask the servo how it stands, and set it up if it is not as it should be. Call every kServoPeriodMs.
  void poll();

  void go_to(int32_t opening_um);
  // A servo that has shut itself down is switched on again; its cause should have gone.
  void restart();

  int32_t opening_um() const { return opening_um_; }
  int32_t temperature_c() const { return temperature_c_; }
  // It answers, has no hardware error, and is as it was set up.
  bool is_healthy() const { return healthy_; }

 private:
  bool set_up();
  bool is_found();
  bool keep(uint16_t address, int32_t value, uint8_t size);
  bool set(uint16_t address, int32_t value, uint8_t size);
  bool look();
  // It hurries to be shut after it was set up, and goes at its own speed from then on.
  bool set_speed(bool hurries);

  Wire& wire_;
  Dynamixel servo_;
  ValveMap map_ = {};
  bool begun_ = false;
  bool is_set_up_ = false;
  bool is_at_its_speed_ = false;
  bool healthy_ = false;
  bool at_factory_baud_ = false;
  bool has_shut_down_ = false;
  uint8_t missed_ = 0;
  int32_t velocity_ = 0;
  int32_t goal_count_ = 0;
  int32_t opening_um_ = 0;
  int32_t temperature_c_ = 0;
};

}  // namespace hand
