"""What a motion's plots show: joint position, speed, acceleration, jerk and the spill angle, with their limits."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scuhand_bt.motion.kinematics import Floats, Mount
from scuhand_bt.motion.spill import apex_motion, spill_angles_deg
from scuhand_bt.motion.timelaw import RateLimits
from scuhand_bt.motion.trajectory import JointTrajectory

COLOURS = ("#d62728", "#1f77b4", "#2ca02c", "#ff7f0e", "#9467bd", "#17a2a8", "#8c564b")
"""One for each joint."""


@dataclass(frozen=True, slots=True)
class Panel:
    """One plot: values (n, k) over times [s] (n,), and the limits with whose they are ("" for everyone's)."""

    name: str
    times_s: Floats
    values: Floats
    limits: list[tuple[float, str]]

    @property
    def span(self) -> tuple[float, float]:
        """The lowest and the highest value to show."""
        limits = [limit for limit, _ in self.limits]
        low, high = min(float(self.values.min()), 0.0, *limits), max(float(self.values.max()), 1e-9, *limits)
        room = 0.06 * (high - low)
        return (low - room if low < 0 else low), high + room


def panels(motion: JointTrajectory, rates: RateLimits, mount: Mount) -> list[Panel]:
    """The five plots of a motion that was planned with these rates."""
    # Jerk jumps at the knots: both its values there are shown.
    grid_s = [np.linspace(0.0, motion.duration_s, 300), motion.knots_s, motion.knots_s[1:] - 1e-9]
    times_s = np.unique(np.concatenate(grid_s))
    q, speed, acceleration, jerk = (motion.at(times_s, k) for k in range(4))
    spill = spill_angles_deg(*apex_motion(q, speed, acceleration, mount))[:, None]
    limits = [] if motion.spill_limit_deg is None else [(motion.spill_limit_deg, "")]
    return [
        Panel("joint position [deg]", times_s, np.degrees(q), _by_value(*np.degrees(mount.limits_rad))),
        Panel("joint speed [rad/s]", times_s, speed, _both_ways(rates.speed)),
        Panel("joint acceleration [rad/s²]", times_s, acceleration, _both_ways(rates.acceleration)),
        Panel("joint jerk [rad/s³]", times_s, jerk, _both_ways(rates.jerk)),
        Panel(
            "spill angle [deg]" + ("" if limits else "; the cone is empty: no limit"),
            times_s,
            spill,
            limits,
        ),
    ]


def _both_ways(limits: Floats) -> list[tuple[float, str]]:
    return _by_value(-limits, limits)


def _by_value(*sides: Floats) -> list[tuple[float, str]]:
    """Limits (7,) of equal value once, each with the joints that have it; rising."""
    found = []
    for side in sides:
        rounded = np.round(side, 3)
        for value in np.unique(rounded):
            whose = [f"j{k + 1}" for k in np.flatnonzero(rounded == value)]
            others = [f"j{k + 1}" for k in np.flatnonzero(rounded != value)]
            names = " ".join(whose) if len(others) > 1 else f"all but {others[0]}" if others else ""
            found.append((float(value), names))
    return sorted(found)


def spread(places: Sequence[float], least: float) -> list[float]:
    """Rising places of labels, moved so far apart that none overlaps the next."""
    moved = list(places)
    for k in range(1, len(moved)):
        moved[k] = max(moved[k], moved[k - 1] + least)
    return moved
