#include "valve_servo.h"

namespace hand {

namespace {

constexpr uint16_t kModel = 1220;  // XC330-T288-T
constexpr uint8_t kMissedLimit = 3;

// Of the XC330's control table (ROBOTIS e-manual). Below 64: kept without power, and locked while torque is on.
constexpr uint16_t kBaudRate = 8, kDriveMode = 10, kOperatingMode = 11, kHomingOffset = 20;
constexpr uint16_t kMaxPosition = 48, kMinPosition = 52;
constexpr uint16_t kTorqueEnable = 64, kHardwareError = 70, kGainD = 80, kGainI = 82, kGainP = 84, kGoalPwm = 100;
constexpr uint16_t kProfileAcceleration = 108, kProfileVelocity = 112, kGoalPosition = 116, kPresentPosition = 132;
constexpr uint16_t kPresentTemperature = 146;
constexpr int32_t kBaud1M = 3, kPositionMode = 3;

// The servo alone, at its factory gains, stands off its goal by its gears' friction: the integral takes that away.
constexpr int32_t kP = 800, kI = 400, kD = 0;
// 60 % of full power: enough for the rack, and a valve that is blocked does not burn its servo.
constexpr int32_t kPwm = 531;
// 214.577 rpm per minute each: at full speed after some 20 ms.
constexpr int32_t kAcceleration = 100;
// 0.229 rpm is 15.633 counts a second.
constexpr int32_t kMilliCountsPerSecond = 15633;
constexpr int32_t kFastest = 320;  // its own limit
// A valve that is found somewhere is shut this many times as fast as it moves in a dose: nobody doses by that.
constexpr int32_t kHurry = 3;
constexpr int32_t kShutCounts = 4;

}  // namespace

void ValveServo::use(const ValveMap& map) {
  map_ = map;
  const int32_t counts_per_s = map.counts_per_s();
  velocity_ = kFastest;
  if (counts_per_s < kFastest * kMilliCountsPerSecond / 1000) velocity_ = counts_per_s * 1000 / kMilliCountsPerSecond;
  if (velocity_ == 0) velocity_ = 1;  // 0 would be its full speed
  goal_count_ = map.at[0].count;
  is_set_up_ = healthy_ = false;
}

void ValveServo::go_to(int32_t opening_um) {
  if (map_.points == 0) return;
  goal_count_ = map_.count_of(opening_um);
  if (opening_um > 0 && !is_at_its_speed_ && is_set_up_) is_set_up_ = set_speed(false);
  // One that is not acknowledged is told again with the next look.
  if (is_set_up_) servo_.write(kGoalPosition, goal_count_, 4);
}

void ValveServo::poll() {
  if (map_.points == 0) return;
  if (!begun_) {
    wire_.begin(kServoBaud);
    begun_ = true;
  }
  if (!is_set_up_) {
    is_set_up_ = set_up();
    missed_ = is_set_up_ ? 0 : kMissedLimit;
  }
  if (is_set_up_ && look()) {
    healthy_ = true;
    missed_ = 0;
  } else if (!is_set_up_ || ++missed_ >= kMissedLimit) {  // a disturbed answer or two are forgiven
    is_set_up_ = healthy_ = false;
  }
}

void ValveServo::restart() {
  if (has_shut_down_) servo_.reboot();
}

// A new servo speaks at 57600 baud: it is moved to ours, once.
bool ValveServo::is_found() {
  uint16_t model = 0;
  const bool answers = servo_.ping(&model) && model == kModel;
  if (answers && !at_factory_baud_) return true;
  if (answers && servo_.write(kTorqueEnable, 0, 1)) servo_.write(kBaudRate, kBaud1M, 1);
  at_factory_baud_ = !at_factory_baud_;
  wire_.begin(at_factory_baud_ ? kFactoryBaud : kServoBaud);
  return false;
}

bool ValveServo::set_up() {
  uint8_t error;
  if (!is_found() || !servo_.read(kHardwareError, &error, 1)) return false;
  has_shut_down_ = error != 0;
  if (has_shut_down_) return false;
  return keep(kDriveMode, 0, 1) && keep(kOperatingMode, kPositionMode, 1) && keep(kHomingOffset, 0, 4) &&
         keep(kMaxPosition, map_.highest_count(), 4) && keep(kMinPosition, map_.lowest_count(), 4) &&
         set(kGainD, kD, 2) && set(kGainI, kI, 2) && set(kGainP, kP, 2) && set(kGoalPwm, kPwm, 2) &&
         set(kProfileAcceleration, kAcceleration, 4) && set_speed(goal_count_ == map_.at[0].count) &&
         set(kTorqueEnable, 1, 1) && set(kGoalPosition, goal_count_, 4);
}

bool ValveServo::set_speed(bool hurries) {
  const int32_t quick = velocity_ * kHurry < kFastest ? velocity_ * kHurry : kFastest;
  const bool is_set = set(kProfileVelocity, hurries ? quick : velocity_, 4);
  is_at_its_speed_ = is_set && !hurries;
  return is_set;
}

// A value of the memory that wears out: written only where it differs.
bool ValveServo::keep(uint16_t address, int32_t value, uint8_t size) {
  uint8_t data[4];
  if (!servo_.read(address, data, size)) return false;
  if (value_of(data, size) == value) return true;
  return servo_.write(kTorqueEnable, 0, 1) && set(address, value, size);
}

// Written, and read back.
bool ValveServo::set(uint16_t address, int32_t value, uint8_t size) {
  uint8_t data[4];
  return servo_.write(address, value, size) && servo_.read(address, data, size) && value_of(data, size) == value;
}

// False where the servo did not answer, or is not as it was set up: one that was without power has no torque.
bool ValveServo::look() {
  uint8_t state[kHardwareError - kTorqueEnable + 1];
  uint8_t motion[kPresentTemperature - kGoalPosition + 1];
  if (!servo_.read(kTorqueEnable, state, sizeof(state))) return false;
  if (!servo_.read(kGoalPosition, motion, sizeof(motion))) return false;
  const int32_t count = value_of(motion + kPresentPosition - kGoalPosition, 4);
  opening_um_ = map_.um_of(count);
  temperature_c_ = motion[kPresentTemperature - kGoalPosition];
  const int32_t off = count - map_.at[0].count;
  if (!is_at_its_speed_ && -kShutCounts <= off && off <= kShutCounts) set_speed(false);
  const bool is_as_set_up = state[0] == 1 && state[kHardwareError - kTorqueEnable] == 0;
  if (!is_as_set_up) {
    is_set_up_ = false;
  } else if (value_of(motion, 4) != goal_count_) {
    servo_.write(kGoalPosition, goal_count_, 4);
  }
  return is_as_set_up;
}

}  // namespace hand
