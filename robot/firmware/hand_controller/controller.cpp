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
    reply->thousandths(settings_.max_opening_um);
    reply->thousandths(settings_.um_per_degree);
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
    case Verb::kOpen:
      if (argument[0] > settings_.max_opening_um) return "range";
      if (argument[0] > 0 && faults_) return "fault";
      phase_ = Phase::kIdle;
      go_to(argument[0], now_ms);
      return nullptr;
    case Verb::kVibrate:
      if (argument[0] > 1000) return "range";
      if (argument[0] > 0 && faults_) return "fault";
      set_vibration(argument[0]);
      return nullptr;
    case Verb::kStep: {
      // 999.999 degrees and 105 um each fit in 32 bits after the division by 10.
      const int32_t opening_um = (argument[0] / 10) * settings_.um_per_degree / 100;
      if (opening_um > settings_.max_opening_um || argument[1] > kLongestDwellMs || argument[2] > 1000) return "range";
      if (faults_) return "fault";
      dwell_ms_ = static_cast<uint32_t>(argument[1]);
      go_to(opening_um, now_ms);
      phase_ = Phase::kOpening;
      set_vibration(argument[2]);
      return nullptr;
    }
    default:
      return nullptr;
  }
}

const char* Controller::reset() {
  if (hardware_.emergency_stop_is_pressed()) return "fault";
  faults_ = hardware_.valve_is_healthy() ? 0 : static_cast<uint8_t>(kServo);
  return faults_ ? "fault" : nullptr;
}

void Controller::tick(uint32_t now_ms) {
  if (!started_) {  // switched on, perhaps with the valve open
    started_ = true;
    heard_ms_ = now_ms;
    make_safe(now_ms);
  }
  uint8_t faults = faults_;
  if (hardware_.emergency_stop_is_pressed()) faults |= kEmergencyStop;
  if (!hardware_.valve_is_healthy()) faults |= kServo;
  const bool is_safe = target_um_ == 0 && vibration_ == 0;
  if (!is_safe && now_ms - heard_ms_ >= kDeadManMs) faults |= kDeadMan;
  const int32_t moved_um = hardware_.valve_um() - still_um_;
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
  hardware_.move_valve(opening_um);
}

void Controller::set_vibration(int32_t permille) {
  vibration_ = permille;
  hardware_.vibrate(permille);
}

void Controller::make_safe(uint32_t now_ms) {
  phase_ = Phase::kIdle;
  go_to(0, now_ms);
  set_vibration(0);
}

bool Controller::has_arrived() {
  const int32_t off_um = hardware_.valve_um() - target_um_;
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
  reply->thousandths(hardware_.valve_um());
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
  reply->integer(hardware_.valve_temperature_c());
  reply->finish();
}

}  // namespace hand
