#include "controller.h"

namespace hand {

bool Controller::take(const char* line, size_t length, uint32_t now_ms, LineWriter* reply) {
  Command command;
  if (!parse(line, length, &command)) return false;
  heard_ms_ = now_ms;
  if (command.verb == Verb::kHello) {
    greeted_ = command.well_formed && command.arguments[0] == kProtocolVersion * 1000;
    has_last_ = false;
    make_safe(now_ms);
    if (!greeted_) {
      report(command.sequence, "version", reply);
      return true;
    }
    reply->integer(command.sequence);
    reply->word("hello");
    reply->integer(kProtocolVersion);
    reply->word(kFirmware);
    reply->thousandths(valve_.map().max_um());
    reply->finish();
    return true;
  }
  // A command that comes again was done already; only its answer was lost.
  const bool again = has_last_ && command.sequence == last_sequence_ && command.crc == last_crc_;
  if (!again) {
    last_refusal_ = greeted_ ? obey(command, now_ms) : "hello";
    has_last_ = true;
    last_sequence_ = command.sequence;
    last_crc_ = command.crc;
  }
  report(command.sequence, last_refusal_, reply);
  return true;
}

// Carries out a command; returns why not, or null.
const char* Controller::obey(const Command& command, uint32_t now_ms) {
  const int32_t* argument = command.arguments;
  if (command.verb == Verb::kUnknown) return "verb";
  if (!command.well_formed) return "arguments";
  switch (command.verb) {
    case Verb::kClose:
      make_safe(now_ms);
      return nullptr;
    case Verb::kReset:
      return reset();
    case Verb::kPoint:
      return draft(argument);
    case Verb::kMap:
      return adopt(argument, now_ms);
    case Verb::kOpen:
      if (argument[0] > valve_.map().max_um()) return valve_.map().points ? "range" : "map";
      if (argument[0] > 0 && faults_) return "fault";
      phase_ = Phase::kIdle;
      go_to(argument[0], now_ms);
      return nullptr;
    case Verb::kVibrate:
      if (argument[0] > 1000) return "range";
      if (argument[0] > 0 && faults_) return "fault";
      set_vibration(argument[0]);
      return nullptr;
    case Verb::kStep:
      if (valve_.map().points == 0) return "map";
      if (argument[0] > valve_.map().max_um() || argument[1] > kLongestDwellMs || argument[2] > 1000) return "range";
      if (faults_) return "fault";
      dwell_ms_ = static_cast<uint32_t>(argument[1]);
      go_to(argument[0], now_ms);
      phase_ = Phase::kOpening;
      set_vibration(argument[2]);
      return nullptr;
    default:
      return nullptr;
  }
}

const char* Controller::reset() {
  if (board_.emergency_stop_is_pressed()) return "fault";
  if (!valve_.is_healthy()) valve_.restart();
  faults_ = valve_.is_healthy() ? 0 : static_cast<uint8_t>(kServo);
  return faults_ ? "fault" : nullptr;
}

// One point of a map to come: its index, count and opening.
const char* Controller::draft(const int32_t* argument) {
  if (argument[0] % 1000 != 0 || argument[0] >= 1000 * kMapPoints || argument[1] % 1000 != 0) return "range";
  if (argument[1] > 4095000 || argument[2] > INT16_MAX) return "range";
  draft_.at[argument[0] / 1000] = {static_cast<int16_t>(argument[1] / 1000), static_cast<int16_t>(argument[2])};
  return nullptr;
}

// The points are whole: so many, and the valve's speed. The servo's memory is only written without torque.
const char* Controller::adopt(const int32_t* argument, uint32_t now_ms) {
  if (argument[0] % 1000 != 0 || argument[0] > 1000 * kMapPoints || argument[1] > UINT16_MAX) return "range";
  draft_.points = static_cast<uint8_t>(argument[0] / 1000);
  draft_.speed_um_per_s = static_cast<uint16_t>(argument[1]);
  if (!draft_.is_sound()) return "range";
  if (draft_ == valve_.map()) return nullptr;
  if (!is_told_to_be_safe()) return "busy";
  board_.store(draft_);
  valve_.use(draft_);
  valve_.poll();
  make_safe(now_ms);
  return nullptr;
}

// Switched on, or reset by the watchdog: the valve may be open.
void Controller::start(uint32_t now_ms) {
  started_ = true;
  heard_ms_ = polled_ms_ = now_ms;
  ValveMap map;
  if (board_.load(&map) && map.is_sound()) valve_.use(map);
  valve_.poll();
  make_safe(now_ms);
}

void Controller::tick(uint32_t now_ms) {
  if (!started_) start(now_ms);
  if (now_ms - polled_ms_ >= kServoPeriodMs) {
    polled_ms_ = now_ms;
    valve_.poll();
  }
  uint8_t faults = faults_;
  if (board_.emergency_stop_is_pressed()) faults |= kEmergencyStop;
  if (!valve_.is_healthy()) faults |= kServo;
  if (!is_told_to_be_safe() && now_ms - heard_ms_ >= kDeadManMs) faults |= kDeadMan;
  const int32_t moved_um = valve_.opening_um() - still_um_;
  if (has_arrived() || moved_um > kArrivedUm || moved_um < -kArrivedUm) {
    still_um_ += moved_um;
    still_since_ms_ = now_ms;
  }
  if (now_ms - still_since_ms_ >= kStuckMs) faults |= kStuck;
  if (faults != faults_) {
    faults_ = faults;
    make_safe(now_ms);
  }
  if (phase_ == Phase::kOpening && has_arrived()) {
    phase_ = Phase::kDwelling;
    dwelling_since_ms_ = now_ms;
  }
  if (phase_ == Phase::kDwelling && now_ms - dwelling_since_ms_ >= dwell_ms_) make_safe(now_ms);
}

void Controller::go_to(int32_t opening_um, uint32_t now_ms) {
  if (has_arrived()) still_since_ms_ = now_ms;  // a stream of commands does not give a valve that is stuck more time
  target_um_ = opening_um;
  valve_.go_to(opening_um);
}

void Controller::set_vibration(int32_t permille) {
  vibration_ = permille;
  board_.vibrate(permille);
}

void Controller::make_safe(uint32_t now_ms) {
  phase_ = Phase::kIdle;
  go_to(0, now_ms);
  set_vibration(0);
}

bool Controller::has_arrived() {
  const int32_t off_um = valve_.opening_um() - target_um_;
  return -kArrivedUm <= off_um && off_um <= kArrivedUm;
}

const char* Controller::state() {
  if (phase_ == Phase::kDwelling) return "dwelling";
  if (phase_ == Phase::kOpening) return "opening";
  if (target_um_ == 0) return has_arrived() ? "closed" : "closing";
  return has_arrived() ? "open" : "moving";
}

void Controller::report(uint16_t sequence, const char* refusal, LineWriter* reply) {
  reply->integer(sequence);
  reply->word(refusal ? "no" : "ok");
  if (refusal) reply->word(refusal);
  reply->word(state());
  reply->thousandths(valve_.opening_um());
  reply->thousandths(vibration_);
  char faults[5];
  char* at = faults;
  if (faults_ & kEmergencyStop) *at++ = 'e';
  if (faults_ & kDeadMan) *at++ = 'd';
  if (faults_ & kServo) *at++ = 's';
  if (faults_ & kStuck) *at++ = 't';
  if (at == faults) *at++ = '-';
  *at = '\0';
  reply->word(faults);
  reply->integer(valve_.temperature_c());
  reply->finish();
}

}  // namespace hand
