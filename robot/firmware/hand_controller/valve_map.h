// What the valve opens to, by the position of its servo: a calibrated map, straight between its points.
// Plain C++11 without Arduino.
#pragma once

#include <stdint.h>

namespace hand {

constexpr uint8_t kMapPoints = 8;

struct MapPoint {
  int16_t count;       // of the servo, 4096 a turn
  int16_t opening_um;  // of the outlet
};

// The first point is the shut valve, the last one its largest opening; counts all rise or all fall.
struct ValveMap {
  uint8_t points;
  MapPoint at[kMapPoints];
  uint16_t speed_um_per_s;

  // Two points or more, within one turn, from 0 upwards, at a speed.
  bool is_sound() const;
  bool operator==(const ValveMap& other) const;

  int32_t max_um() const { return points ? at[points - 1].opening_um : 0; }
  // An opening of 0 to max_um() as a position, and any position as an opening: past the ends as beside them.
  int32_t count_of(int32_t opening_um) const;
  int32_t um_of(int32_t count) const;
  int32_t lowest_count() const;
  int32_t highest_count() const;
  int32_t counts_per_s() const;
};

}  // namespace hand
