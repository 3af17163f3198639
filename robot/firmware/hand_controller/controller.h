// The hand controller's state machine: valve, vibration, emergency stop and dead-man.
// Plain C++11 without Arduino; time comes in as milliseconds that may wrap around.
#pragma once

#include "protocol.h"
#include "valve_servo.h"

namespace hand {

#ifndef HAND_FIRMWARE
#define HAND_FIRMWARE "2.0"
#endif
constexpr const char* kFirmware = HAND_FIRMWARE;  // a twin is built with another one, by which it is known
// Silence after which the valve closes and vibration stops. It must begin to move within 300 ms, and takes
// 60 ms to begin; the host is heard every 30 ms.
constexpr uint32_t kDeadManMs = 220;
constexpr uint32_t kStuckMs = 2500;        // a valve that stands still so long before it arrives is stuck
constexpr int32_t kArrivedUm = 30;         // the valve counts as arrived this near
constexpr int32_t kLongestDwellMs = 60000;
constexpr uint32_t kServoPeriodMs = 10;

// The board below.
class Board {
 public:
  virtual void vibrate(int32_t permille) = 0;
  virtual bool emergency_stop_is_pressed() = 0;
  // The valve's map, in memory that outlives the power: a board that starts must know where the valve is shut.
  virtual bool load(ValveMap* map) = 0;  // false if none was stored
  virtual void store(const ValveMap& map) = 0;

 protected:
  ~Board() = default;
};

enum Fault : uint8_t { kEmergencyStop = 1, kDeadMan = 2, kServo = 4, kStuck = 8 };

class Controller {
 public:
  Controller(Board& board, Wire& wire) : board_(board), valve_(wire) {}

  // Take one line of the host (without its end). True if `reply` now holds the answer.
  bool take(const char* line, size_t length, uint32_t now_ms, LineWriter* reply);

  // Call at least every 20 ms.
  void tick(uint32_t now_ms);

 private:
  enum class Phase : uint8_t { kIdle, kOpening, kDwelling };

  const char* obey(const Command& command, uint32_t now_ms);
  const char* reset();
  const char* draft(const int32_t* argument);
  const char* adopt(const int32_t* argument, uint32_t now_ms);
  void start(uint32_t now_ms);
  void go_to(int32_t opening_um, uint32_t now_ms);
  void set_vibration(int32_t permille);
  void make_safe(uint32_t now_ms);
  bool is_told_to_be_safe() const { return target_um_ == 0 && vibration_ == 0; }
  bool has_arrived();
  const char* state();
  void report(uint16_t sequence, const char* refusal, LineWriter* reply);

  Board& board_;
  ValveServo valve_;
  ValveMap draft_ = {};  // of the host, until it says that it is whole
  bool started_ = false;
  bool greeted_ = false;
  bool has_last_ = false;
  uint16_t last_sequence_ = 0;
  uint16_t last_crc_ = 0;
  const char* last_refusal_ = nullptr;
  uint8_t faults_ = 0;
  Phase phase_ = Phase::kIdle;
  int32_t target_um_ = 0;
  int32_t vibration_ = 0;
  uint32_t dwell_ms_ = 0;
  int32_t still_um_ = 0;
  uint32_t still_since_ms_ = 0;
  uint32_t dwelling_since_ms_ = 0;
  uint32_t heard_ms_ = 0;
  uint32_t polled_ms_ = 0;
};

}  // namespace hand
