"""A bench whose simulated world lives in a file, to be taken up after an outage."""

import itertools
from pathlib import Path
from typing import Any, cast

import numpy as np
from dose_bench import BAY, DISH, MORTAR, PAN, shipped_powders

from scuhand_bt.cell.cell import Cell
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.clock import Steps, Wake
from scuhand_bt.devices.interfaces import Joints, Operator
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.motion.kinematics import ApexPose
from scuhand_bt.record import Record
from scuhand_bt.run.clock import VirtualClock
from scuhand_bt.sim import cell as cell_module
from scuhand_bt.sim.world import World
from scuhand_bt.specs import Container, Source

BEADS = shipped_powders()["glass_beads"]
ALL_MG = 10_000.0
OVER_PAN_M = (0.330, 0.0, 0.140)
IN_MORTAR_M = (0.0, 0.300, 0.012)


class Line:
    """A motion of the arm of this bench, whose first three joints are the apex's position [m]."""

    def __init__(self, begin: Joints, apex_m: tuple[float, float, float], duration_s: float) -> None:
        self.duration_s = duration_s
        self._begin, self._end = begin, np.array([*apex_m, 0.0, 0.0, 0.0, 0.0])

    def sample(self, time_s: float) -> Joints:
        share = min(1.0, max(0.0, time_s / self.duration_s))
        joints: Joints = self._begin + share * (self._end - self._begin)
        return joints

    def stopped_from(self, at_s: float) -> "Line":
        raise AssertionError("nobody stops it")


class Bench:
    """A cell of a mortar, a carousel and a balance."""

    def __init__(self) -> None:
        spec = CellSpec(cell="bench", stations={"balance": PAN, "bay": BAY})
        self.clock = VirtualClock()
        self.cell: Cell
        self.world: World
        self.told: list[str] = []
        self.cell, self.world = cell_module.simulated_cell(
            spec,
            {"store": Source(name="store", station="bay", mortar=MORTAR, powder=BEADS, amount_mg=ALL_MG)},
            clock=self.clock,
            record=Record(),
            motion=cast(MotionPlanner, None),
            operator=cast(Operator, None),
            seed=1,
            joints=np.array([*OVER_PAN_M, 0.0, 0.0, 0.0, 0.0]),
            apex_of=lambda joints: ApexPose(joints[:3]),
        )
        self.clock.process = self.world

    @classmethod
    def with_powder(cls, path: Path) -> "Bench":
        """Living in a file, with a dish under a loaded cone, and all at rest."""
        bench = cls()
        bench.world.keep_in(path, bench.told.append)
        bench.world.place(DISH)
        bench.world.load_cone("store", 5000.0)
        bench.let_pass(2.0)
        return bench

    @classmethod
    def taken_up(cls, path: Path) -> "Bench":
        """After the outage of the world in a file."""
        bench = cls()
        bench.clock.go_on_from(bench.world.restore(path, bench.told.append))
        return bench

    def let_pass(self, duration_s: float) -> None:
        end_s = self.clock.now_s + duration_s
        while self.clock.now_s < end_s:
            self.clock.wait([Wake(end_s)])

    def drive(self, steps: Steps[Any]) -> Any:
        while True:
            try:
                wake = next(steps)
            except StopIteration as done:
                return done.value
            self.clock.wait([wake])

    def work(self) -> Steps[None]:
        """Scoop, carry, stream and pulse into one container after the other, without an end."""
        cell, hand = self.cell, self.cell.hand
        for number in itertools.count():
            self.world.begin_sample(f"s{number}", 1)
            yield from cell.changer.bring(dish(f"dish {number}"))
            yield from cell.arm.follow(Line(cell.arm.positions, IN_MORTAR_M, 1.0))
            yield from hand.morph(80.0)
            yield from hand.morph(76.0)
            yield from cell.arm.follow(Line(cell.arm.positions, OVER_PAN_M, 1.5))
            hand.set_vibration(0.5)
            for opening_mm in (0.6, 1.2, 0.9, 0.0):
                hand.set_opening(opening_mm)
                for _ in range(8):
                    yield from cell.balance.next_reading()
            yield from hand.pulse(1.0, 0.3, 1.0)
            yield from cell.balance.stable_mean()
            yield from cell.changer.take_away()
            self.world.swap_sheet()


def dish(name: str) -> Container:
    return DISH.model_copy(update={"id": name})
