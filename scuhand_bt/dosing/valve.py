"""Where the valve is, by dead reckoning from its commands: a dead time, then constant speed.

    D(t) -> D_target at v [mm/s], from `dead_time_s` after the command;    phi(D) = max(0, D - D0)^n

The flow is q = k phi(D), with the powder's threshold D0 [mm] and exponent n (Beverloo's law has n = 2.5). The integral
of phi while the valve shuts is the tail of every prediction.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np

GRAIN_S = 0.02
"""Step of the numerical integral of phi."""


@dataclass(frozen=True, slots=True)
class FlowShape:
    """phi(D) of a powder."""

    threshold_mm: float
    exponent: float

    def value(self, opening_mm: float) -> float:
        """phi [mm^n]."""
        gap_mm = opening_mm - self.threshold_mm
        return float(gap_mm**self.exponent) if gap_mm > 0.0 and opening_mm > 0.0 else 0.0

    def slope(self, opening_mm: float) -> float:
        """phi's derivative [mm^(n-1)]."""
        gap_mm = opening_mm - self.threshold_mm
        return self.exponent * self.value(opening_mm) / gap_mm if gap_mm > 0.0 else 0.0

    def opening_mm(self, value: float) -> float:
        """The opening [mm] with this phi."""
        return self.threshold_mm + float(max(value, 0.0) ** (1.0 / self.exponent))

    def swept(self, from_mm: float, to_mm: float) -> tuple[float, float]:
        """The integrals of phi [mm^(n+1)] and of its slope [mm^n] over the openings between two."""
        low_mm, high_mm = (max(end_mm - self.threshold_mm, 0.0) for end_mm in sorted((from_mm, to_mm)))
        more = self.exponent + 1.0
        return (high_mm**more - low_mm**more) / more, high_mm**self.exponent - low_mm**self.exponent

    def closing(self, opening_mm: float, dead_time_s: float, speed_mm_per_s: float) -> float:
        """The integral of phi [mm^n s] from the command to shut until the valve is shut."""
        more = self.exponent + 1.0
        ramp = max(opening_mm - self.threshold_mm, 0.0) ** more / (more * speed_mm_per_s)
        return float(self.value(opening_mm) * dead_time_s + ramp)


class ValvePath:
    """The valve's servo, by dead reckoning from its commands."""

    def __init__(self, shape: FlowShape, dead_time_s: float, speed_mm_per_s: float) -> None:
        self.opening_mm = 0.0
        self.target_mm = 0.0
        self.shape = shape
        self._dead_time_s = dead_time_s
        self._speed_mm_per_s = speed_mm_per_s
        self._commands: deque[tuple[float, float]] = deque()
        self._going_to = 0.0

    def command(self, time_s: float, opening_mm: float) -> None:
        """Note a command given at this time."""
        if opening_mm != self.target_mm:
            self.target_mm = opening_mm
            self._commands.append((time_s + self._dead_time_s, opening_mm))

    def advance(self, from_s: float, to_s: float) -> tuple[float, float]:
        """Move on to `to_s`; returns the integrals of phi [mm^n s] and of its slope [mm^(n-1) s] over that time."""
        moves = bool(self._commands) or self.opening_mm != self._going_to
        pieces = max(1, round((to_s - from_s) / GRAIN_S)) if moves else 1
        dt_s = (to_s - from_s) / pieces
        phi_s = slope_s = 0.0
        for piece in range(pieces):
            end_s = from_s + (piece + 1) * dt_s
            while self._commands and self._commands[0][0] <= end_s - dt_s / 2.0:
                self._going_to = self._commands.popleft()[1]
            way_mm = self._going_to - self.opening_mm
            step_mm = self._speed_mm_per_s * dt_s
            before_mm = self.opening_mm
            self.opening_mm += min(max(way_mm, -step_mm), step_mm)
            middle_mm = (before_mm + self.opening_mm) / 2.0
            phi_s += self.shape.value(middle_mm) * dt_s
            slope_s += self.shape.slope(middle_mm) * dt_s
        return phi_s, slope_s

    def passes(self, opening_mm: float, open_s: float) -> float:
        """The integral of phi [mm^n s] over an opening: open for `open_s`, then told to shut, until it is shut."""
        tail_s = self.shape.closing(opening_mm, self._dead_time_s, self._speed_mm_per_s)
        return self.shape.value(opening_mm) * open_s + tail_s

    def passing(self, shape: FlowShape, opening_mm: float, open_s: float) -> tuple[float, float]:
        """The integrals of phi and its slope if told to open so wide now and to shut after `open_s`, until it is shut.

        The valve may have to turn round on its way.
        """
        reach_mm = self._speed_mm_per_s * open_s
        top_mm = min(max(opening_mm, self.opening_mm - reach_mm), self.opening_mm + reach_mm)
        stays_s = open_s - abs(top_mm - self.opening_mm) / self._speed_mm_per_s
        ways = np.add(shape.swept(self.opening_mm, top_mm), shape.swept(0.0, top_mm)) / self._speed_mm_per_s
        held = [self._dead_time_s * phi(self.opening_mm) + stays_s * phi(top_mm) for phi in (shape.value, shape.slope)]
        phi_s, slope_s = (ways + held).tolist()
        return phi_s, slope_s

    def closing(self, wait_s: float) -> tuple[float, float]:
        """The integrals of phi and its slope if told to shut in `wait_s`, until it is shut."""
        phi, slope = self.shape.value(self.opening_mm), self.shape.slope(self.opening_mm)
        slope_s = slope * (self._dead_time_s + wait_s) + phi / self._speed_mm_per_s
        return self.passes(self.opening_mm, wait_s), slope_s
