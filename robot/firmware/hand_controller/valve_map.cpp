#include "valve_map.h"

namespace hand {

namespace {

// part * whole_b / whole_a, to the nearest. The product fits: all sizes here are below 2^16, and one of them is below 2^13.
int32_t in_proportion(int32_t part, int32_t whole_a, int32_t whole_b) {
  const int32_t twice = 2 * part * whole_b / whole_a;
  return (twice + (twice < 0 ? -1 : 1)) / 2;
}

}  // namespace

bool ValveMap::is_sound() const {
  if (points < 2 || points > kMapPoints || at[0].opening_um != 0 || speed_um_per_s == 0) return false;
  const bool rises = at[1].count > at[0].count;
  for (uint8_t i = 0; i < points; ++i) {
    if (at[i].count < 0 || at[i].count > 4095) return false;
    if (i == 0) continue;
    if (at[i].opening_um <= at[i - 1].opening_um || at[i].count == at[i - 1].count) return false;
    if ((at[i].count > at[i - 1].count) != rises) return false;
  }
  return true;
}

bool ValveMap::operator==(const ValveMap& other) const {
  if (points != other.points || speed_um_per_s != other.speed_um_per_s) return false;
  for (uint8_t i = 0; i < points; ++i) {
    if (at[i].count != other.at[i].count || at[i].opening_um != other.at[i].opening_um) return false;
  }
  return true;
}

int32_t ValveMap::count_of(int32_t opening_um) const {
  uint8_t i = 1;
  while (i + 1 < points && opening_um > at[i].opening_um) ++i;
  const MapPoint& a = at[i - 1];
  const MapPoint& b = at[i];
  return a.count + in_proportion(opening_um - a.opening_um, b.opening_um - a.opening_um, b.count - a.count);
}

int32_t ValveMap::um_of(int32_t count) const {
  if (count < -4096) count = -4096;  // no position of one turn, but a servo may tell it
  if (count > 8191) count = 8191;
  const bool rises = at[1].count > at[0].count;
  uint8_t i = 1;
  while (i + 1 < points && (count > at[i].count) == rises && count != at[i].count) ++i;
  const MapPoint& a = at[i - 1];
  const MapPoint& b = at[i];
  return a.opening_um + in_proportion(count - a.count, b.count - a.count, b.opening_um - a.opening_um);
}

int32_t ValveMap::lowest_count() const {
  return at[0].count < at[points - 1].count ? at[0].count : at[points - 1].count;
}

int32_t ValveMap::highest_count() const {
  return at[0].count < at[points - 1].count ? at[points - 1].count : at[0].count;
}

int32_t ValveMap::counts_per_s() const {
  return in_proportion(speed_um_per_s, max_um(), highest_count() - lowest_count());
}

}  // namespace hand
