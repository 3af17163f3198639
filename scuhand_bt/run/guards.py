"""Guards: conditions that must never occur in a run, checked at every reading and whenever a device reports.

A guard that trips halts the job at once and ends the run safe; it does not judge doses. Besides the devices' own
faults there are two that only readings show (docs/run-behaviour.md, "The guards"):

* runaway: far more than the target has arrived, and the valve is still open;
* leak: the valve is shut, and the pan under the cone gains mass at a steady rate.
"""

import math
from collections import deque
from itertools import pairwise

from scuhand_bt.cell.cell import Cell
from scuhand_bt.cell_spec import DEVICES
from scuhand_bt.clock import Wake
from scuhand_bt.devices.interfaces import Device, Reading
from scuhand_bt.dosing.identification import swing_s
from scuhand_bt.failures import Code, SkillFailed

BEYOND_TARGET_MG = 100.0
"""More than an ordinary overshoot: the worst of 24 000 simulated doses (lumpy powder, by pulses) was 96 mg too much."""
BEYOND_TARGET = 0.2
"""The same as a share of the target; the larger of both counts."""
RUNAWAY_S = 2.0
"""How long the valve must have stayed open since then [s]: even a slow valve has shut by then after its command."""
SHUT_MM = 0.05
"""A valve that reports no more than this is shut; its servo's zero is no more exact."""
SETTLED_LAGS = 4.0
"""For so many of the balance's lags, readings still follow the valve's shutting or the container's arrival."""
LEAK_MG_PER_S = 1.0
"""Least steady rise that counts as a leak: twice the drift of a balance in bad need of service."""
BLOCK_S = 0.5
"""Readings are averaged over this time [s], or 0.75 of the balance's lag or three of its periods if longer."""
SWING_SHARE = 1.0 / 3.0
"""The same as a share of the time for which a filter that rings rises. Averages of more than a quarter of it are no
`RISES` steady ones; one that rings longer than its kind is believed to, damped by 0.3, rises for half as long again."""
RISES, RISES_AT_ONCE = 4, 8
"""How many averages in a row must rise. A push or a step raises at most two. What an opening let out may raise four
steadily if the balance was set slower meanwhile, so a rise that goes on ever since has to last twice as long."""
STEADY = 0.5
"""The smallest of these rises relative to the largest. Mere settling slows down faster."""
CERTAIN = 3.0
"""A rise counts if it is more than this many standard errors of an average, so that noise does not."""
OVER_PAN_MM = 60.0
"""The apex counts as over the pan within this distance of its centre."""


class Guards:
    """The guards of one run on a cell."""

    def __init__(self, cell: Cell) -> None:
        self._cell = cell
        self._devices: list[Device] = [cell.device(name) for name in DEVICES]
        signals = {id(device.news): device.news for device in self._devices}.values()
        self._wakes = [Wake.on(signal) for signal in signals]
        self._seen: Reading | None = None
        self._beyond_since_s: float | None = None
        self._still_since_s: float | None = None
        self._rise = _Rise(BLOCK_S, 0.0)

    def wakes(self) -> list[Wake]:
        """When to look again, counted from now."""
        for number, (_, signal, seen) in enumerate(self._wakes):
            if signal is not None and signal.count != seen:
                self._wakes[number] = Wake.on(signal)
        return self._wakes.copy()

    def look(self) -> SkillFailed | None:
        """What has gone wrong, if anything; cheap enough for every reading."""
        for device in self._devices:
            if (fault := device.fault) is not None:
                return fault
        reading, is_open = self._cell.balance.latest, self._cell.hand.opening_mm > SHUT_MM
        if is_open:  # even for less than one reading
            self._still_since_s = None
        if reading is None or reading is self._seen:
            return None
        self._seen = reading
        if is_open:
            return self._runaway(reading)
        self._beyond_since_s = None
        return self._leak(reading)

    def _runaway(self, reading: Reading) -> SkillFailed | None:
        believed = self._cell.believed
        target_mg, empty_mg = believed.dosing.target_mg, believed.pan_empty_mg
        if target_mg is None or empty_mg is None:
            self._beyond_since_s = None
            return None
        net_mg = reading.value_mg - empty_mg
        is_beyond = net_mg > target_mg + max(BEYOND_TARGET_MG, BEYOND_TARGET * target_mg)
        if not is_beyond or self._beyond_since_s is None:
            self._beyond_since_s = reading.time_s if is_beyond else None
            return None
        if reading.time_s - self._beyond_since_s < RUNAWAY_S:
            return None
        valve = f"the valve is open by {self._cell.hand.opening_mm:.2f} mm"
        return SkillFailed(
            Code.DOSE_RUNAWAY, f"the container holds {net_mg:.0f} mg, the target is {target_mg:g} mg, and {valve}"
        )

    def _leak(self, reading: Reading) -> SkillFailed | None:
        if self._cell.believed.pan_gross_mg is None:
            self._still_since_s = None
            return None
        if self._still_since_s is None:
            self._still_since_s = self._begin_watch(reading.time_s)
        if reading.time_s < self._still_since_s or (rate := self._rise.add(reading)) is None:
            return None
        if not self._is_over_pan():
            return None
        return SkillFailed(Code.HAND_LEAK, f"the valve is shut, but the pan below it gains {rate:.1f} mg/s")

    def _begin_watch(self, now_s: float) -> float:
        """Restart; returns the time from which readings are settled if nothing falls [s]."""
        balance, belief = self._cell.spec.balance, self._cell.balance_belief
        lag_s = belief.lag_s
        block_s = max(BLOCK_S, 0.75 * lag_s, 3.0 * balance.period_s, SWING_SHARE * swing_s(belief, self._cell.came))
        self._rise = _Rise(block_s, max(LEAK_MG_PER_S * block_s, balance.readability_mg / 2.0))
        return now_s + SETTLED_LAGS * lag_s

    def _is_over_pan(self) -> bool:
        pan_mm = self._cell.spec.station_of_kind("balance").position_mm
        return math.dist(self._cell.apex_mm()[:2], pan_mm[:2]) <= OVER_PAN_MM


class _Rise:
    """Averages readings in blocks, to see whether they rise steadily, each by `least_mg` or more."""

    def __init__(self, block_s: float, least_mg: float) -> None:
        self._block_s, self._least_mg = block_s, least_mg
        self._ends_s: float | None = None
        self._zero_mg = self._sum = self._squares = 0.0
        self._count = 0
        self._means: deque[float] = deque(maxlen=RISES_AT_ONCE + 1)
        self._needed = RISES_AT_ONCE

    def add(self, reading: Reading) -> float | None:
        """The rate [mg/s] of a steady rise, if a block ends here that shows one."""
        if self._ends_s is None:
            self._ends_s, self._zero_mg = reading.time_s + self._block_s, reading.value_mg
        rate = self._block_ended(reading.time_s) if reading.time_s > self._ends_s - 1e-6 else None
        value_mg = reading.value_mg - self._zero_mg
        self._sum += value_mg
        self._squares += value_mg * value_mg
        self._count += 1
        return rate

    def _block_ended(self, now_s: float) -> float | None:
        mean_mg = self._sum / self._count
        error_mg = math.sqrt(max(0.0, self._squares / self._count - mean_mg * mean_mg) / self._count)
        self._ends_s, self._sum, self._squares, self._count = now_s + self._block_s, 0.0, 0.0, 0
        means = self._means
        if means and mean_mg - means[-1] < max(self._least_mg, CERTAIN * error_mg):
            means.clear()
            self._needed = RISES
        means.append(mean_mg)
        rises = [after - before for before, after in pairwise(means)][-self._needed :]
        if len(rises) < self._needed or min(rises) < STEADY * max(rises):
            return None
        return sum(rises) / (len(rises) * self._block_s)
