"""Stops at random moments, of random loads and limits: `python -m benchmarks.motion_stops [--stops N] [--json FILE]`.

In cells that nobody drew (`harness/motion_layouts.py`) the arm goes between places and to poses near them, empty or
with a load whose spill limit is drawn as well, and is told to stop at ten moments of each way: as simulated, and by the
driver on its twin. What each does is seen every period of the driver's loop, from the beginning of the motion to rest,
and judged by differences of these samples alone: the load's spill angle, every joint's acceleration, jerk, window and
torque, whether it rests on the path, and before the motion would have ended.
"""

import argparse
import itertools
import json
import math
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.figures import spread
from harness.arm_stops import TwinArm, off_path_rad, simulated_stop, worst_of
from harness.motion_layouts import LAB, layouts, tasks
from scuhand_bt.devices.dynamixel.axis_group import STOP_LEAD_S
from scuhand_bt.devices.dynamixel.bus import BusError
from scuhand_bt.devices.dynamixel.servo_loop import PERIOD_S
from scuhand_bt.failures import SkillFailed
from scuhand_bt.motion import Mount
from scuhand_bt.motion.arm_model import Arm
from scuhand_bt.motion.kinematics import LIMITS_RAD, Floats
from scuhand_bt.motion.stopping import HARDER, JERKIER, StoppableTrajectory
from scuhand_bt.motion.torque import Torques

SEED = 20261123
WAYS, STOPS = 10, 10
"""Ways per layout, and stops on each."""
LIMITS_DEG = (8.0, 45.0)
"""Between which a load's spill limit is drawn; one way in four is an empty cone's."""
OVER = 1.02
"""A joint is over its limit beyond this: third differences of samples 10 ms apart are not exact."""
OVER_DEG = 0.1
"""And so a load: the stop looks at it 120 times, and not when the driver does."""
ALIKE_RAD = math.radians(0.1)
MOUNT = Mount.of(LAB.cell.hand)


class Measured:
    """What came of all stops."""

    def __init__(self) -> None:
        arm = Arm(LAB.urdf, LAB.cell.arm)
        self._torques = Torques(arm.model)
        self._rates = arm.rates
        self.counts: Counter[str] = Counter()
        self.worst: dict[str, float] = {}
        self.rest_s: list[float] = []
        self.found_ms: list[float] = []

    def judge(self, who: str, motion: StoppableTrajectory, at_s: float, course: Floats) -> None:
        """One stop, by whomever, at a moment of a motion."""
        seen = worst_of(course, MOUNT)
        self._most(f"acceleration over the plan's limit, {who}", seen.acceleration / float(self._rates.acceleration[0]))
        self._most(f"jerk over the plan's limit, {who}", seen.jerk / float(self._rates.jerk[0]))
        beyond_rad = max(float((LIMITS_RAD[0] - course).max()), float((course - LIMITS_RAD[1]).max()))
        speed = np.gradient(course, PERIOD_S, axis=0)
        torques = self._torques.moving(course, speed, np.gradient(speed, PERIOD_S, axis=0))
        share = float((np.abs(torques) / self._torques.stall_nm).max())
        self._most(f"share of the stall torque, {who}", share)
        off_rad = off_path_rad(motion, course[-1])
        self._most(f"rest beside the path, deg, {who}", math.degrees(off_rad))
        late_s = len(course) * PERIOD_S - motion.duration_s
        over = {
            "acceleration": seen.acceleration > OVER * HARDER * self._rates.acceleration[0],
            "jerk": seen.jerk > OVER * JERKIER * self._rates.jerk[0],
            "window": beyond_rad > 1e-6,
            "torque": share > 1.0,
            "path": off_rad > 1e-3,
            "later than its own end": late_s > 2 * PERIOD_S,
        }
        if motion.spill_limit_deg is not None:
            self._most(f"spill angle beyond the load's limit, deg, {who}", seen.spill_deg - motion.spill_limit_deg)
            over["spilled"] = seen.spill_deg > motion.spill_limit_deg + OVER_DEG
        self.counts[f"stops, {who}"] += 1
        for what, is_over in over.items():
            self.counts[f"over: {what}, {who}"] += int(is_over)

    def alike(self, simulated: Floats, driven: Floats, at_s: float, *, heard: bool) -> None:
        """Whether simulation and driver rest at the same place; and the twin where the driver sent it."""
        self.counts["twin elsewhere"] += int(not heard)
        self._most("simulation and driver at rest apart, deg", math.degrees(np.abs(simulated[-1] - driven[-1]).max()))
        self.counts["rest apart"] += bool(np.abs(simulated[-1] - driven[-1]).max() > ALIKE_RAD)
        self.rest_s.append(len(driven) * PERIOD_S - at_s)

    def _most(self, what: str, value: float) -> None:
        self.worst[what] = max(self.worst.get(what, -math.inf), value)

    def figures(self) -> dict[str, Any]:
        """All of it by name."""
        found: dict[str, Any] = dict(sorted(self.counts.items()))
        found |= {f"most: {what}": round(value, 4) for what, value in sorted(self.worst.items())}
        return found | {
            "from being told to rest": spread(self.rest_s, "s"),
            "CPU to find a stop": spread(self.found_ms, "ms"),
        }


def ways(rng: np.random.Generator) -> Iterator[StoppableTrajectory]:
    """Motions in one layout after another, for as long as they are asked for."""
    for first in itertools.count(900):
        for layout in layouts(1, first):
            if layout.seed != first:
                continue
            planner = layout.planner()
            for k, (start, end, near) in enumerate(tasks(layout, WAYS)):
                limit_deg = None if k % 4 == 0 else float(rng.uniform(*LIMITS_DEG))
                try:
                    motion = planner.move(planner.standing_at(start), near or end, spill_limit_deg=limit_deg)
                except SkillFailed:
                    continue
                if motion.duration_s > 0.2:
                    yield motion


def on_the_twin(motion: StoppableTrajectory, moments_s: Sequence[float]) -> list[tuple[Floats, bool]]:
    """What the driver sends, stopped at each moment, and whether the twin heard it; again if this computer paused."""
    while True:
        with suppress(BusError), TwinArm(motion.start).stepped() as arm:
            return [(arm.stopped(motion, at_s), arm.twin_heard()) for at_s in moments_s]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.motion_stops", description=__doc__)
    parser.add_argument("--stops", type=int, default=1000)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    measured, rng, begun_s = Measured(), np.random.default_rng(SEED), time.process_time()
    motions = ways(rng)
    for left in range(given.stops, 0, -STOPS):
        motion = next(motions)
        moments_s = np.round(rng.uniform(0.0, motion.duration_s - STOP_LEAD_S, min(STOPS, left)), 2).tolist()
        for at_s, (driven, heard) in zip(moments_s, on_the_twin(motion, moments_s), strict=True):
            begin_s = time.thread_time()
            motion.stopped_from(at_s)
            measured.found_ms.append(1e3 * (time.thread_time() - begin_s))
            # The driver finds its stop for a moment that is still to come.
            simulated = simulated_stop(motion, at_s + STOP_LEAD_S, MOUNT)
            measured.judge("simulation", motion, at_s, simulated)
            measured.judge("driver on its twin", motion, at_s, driven)
            measured.alike(simulated, driven, at_s, heard=heard)
    figures = measured.figures() | {"CPU of all, s": round(time.process_time() - begun_s)}
    for key, value in figures.items():
        print(f"{key:60} {value}")
    if given.json:
        given.json.write_text(json.dumps({"stops": given.stops, **figures}, indent=1) + "\n")


if __name__ == "__main__":
    main()
