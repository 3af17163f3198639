"""How the cone is emptied: by pulses that the hand takes, or poured, where the arm can; and a lip that cannot press."""

import sys
from types import SimpleNamespace
from typing import Any, cast

import pytest
from wire_helpers import carry_out

from scuhand_bt.bench_spec import Station
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.clock import Steps
from scuhand_bt.devices.interfaces import Operator
from scuhand_bt.dosing.swing import StrokePath
from scuhand_bt.dosing.vessel import Vessel
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.lab import Lab
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.record import Record
from scuhand_bt.run.clock import VirtualClock
from scuhand_bt.sim.cell import simulated_cell
from scuhand_bt.specs import Source

STATIONS = {
    "balance": Station(name="balance", kind="balance", position_mm=(330.0, 0.0, 60.0)),
    "bay": Station(name="bay", kind="mortar", position_mm=(0.0, 300.0, 0.0)),
}


class Bench:
    """A cell whose arm goes wherever it is told to, but plans nothing, and a source of glass beads."""

    def __init__(self, lab: Lab, amount_mg: float = 10_000.0) -> None:
        powder, mortar = lab.library.powders["glass_beads"], lab.library.mortars["agate_mortar"]
        self.source = Source(name="store", station="bay", mortar=mortar, powder=powder, amount_mg=amount_mg)
        self.clock, self.told = VirtualClock(), list[Any]()
        self.cell, self.world = simulated_cell(
            CellSpec(cell="bench", stations=STATIONS),
            {"store": self.source},
            clock=self.clock,
            record=Record(self.told.append),
            motion=cast(MotionPlanner, None),
            operator=cast(Operator, None),
            seed=1,
        )
        self.clock.process = self.world
        self.cell.believed.source_holds("store", amount_mg)
        self.skills = sys.modules[lab.library.skills["scoop"].__module__]
        self.emptying = sys.modules[f"{self.skills.__name__.rpartition('.')[0]}._emptying"]

    def carry_out(self, steps: Steps[Any]) -> None:
        carry_out(steps, cast(Any, self.clock))


def stays(*where: Any) -> Steps[None]:
    """An arm that is there already."""
    yield from ()


def has_no_way(*where: Any) -> Steps[None]:
    """One that has no way."""
    yield from ()
    raise SkillFailed(Code.ARM_NO_PATH, "something is in the way")


@pytest.mark.parametrize(("flow_factor", "pulses"), [(1.0, 1), (0.1, 4)])
def test_a_cone_that_empties_slowly_takes_several_pulses_and_each_is_one_that_the_hand_takes(
    starter: Lab, flow_factor: float, pulses: int
) -> None:
    bench = Bench(starter)
    cell, source = bench.cell, bench.source
    cell.believed.cone_holds(source, 3000.0)
    slow = source.powder.belief.coefficient * flow_factor
    cell.powder_beliefs[source.sheet_key] = source.powder.belief.model_copy(update={"coefficient": slow})
    bench.world.load_cone("store", 3000.0)
    dwells_s: list[float] = []
    pulse = cell.hand.pulse

    def noted(opening_mm: float, dwell_s: float, vibration: float = 0.0) -> Steps[None]:
        dwells_s.append(dwell_s)
        yield from pulse(opening_mm, dwell_s, vibration)

    cell.hand.pulse = noted  # type: ignore[method-assign]
    bench.carry_out(bench.emptying.empty_cone(cell, source))
    assert len(dwells_s) == pulses
    assert dwells_s[:-1] == [cell.hand.longest_dwell_s] * (pulses - 1)
    assert cell.believed.cone_source is None
    assert bench.world.masses_mg["cone"] < 0.05 * 3000.0


def test_a_rest_that_the_arm_cannot_pour_out_is_let_out_before_a_stroke_tips_it(
    starter: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It stayed, and fell beside the mortar as the cone was tilted on its way: 240 mg of 760 mg of titanium dioxide."""
    bench = Bench(starter)
    cell = bench.cell
    monkeypatch.setattr(cell, "move_to", stays)
    monkeypatch.setattr(cell, "touch", has_no_way)
    cell.believed.cone_holds(bench.source, 200.0)
    cell.believed.gave_out(is_short=False)
    assert cell.believed.has_rest
    bench.world.load_cone("store", 200.0)
    bench.carry_out(bench.emptying.pour_rest(cell, bench.source))
    assert bench.world.masses_mg["cone"] < 10.0
    assert not cell.believed.has_rest


def test_where_the_hand_can_nowhere_press_the_lip_follows_the_wall(
    starter: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a mortar with a thin floor the clamp was 0.3 mm too near to the table for it, and the sample was lost."""
    bench = Bench(starter, amount_mg=800.0)
    wall, tried_mm = Vessel.of(bench.source.mortar), list[float]()

    def planned(path: StrokePath, source: Source) -> Any:
        tried_mm.append(float(wall.clearance_mm(path.lip_mm[path.on_wall]).min()))
        if tried_mm[-1] < 0.0:
            raise SkillFailed(Code.ARM_NO_PATH, "cone and table are 0.7 mm apart")
        return SimpleNamespace(duration_s=4.0)

    def made(motion: Any, station: str) -> Steps[float]:
        yield from ()
        return 82.0

    monkeypatch.setattr(bench.cell, "planned", at_once)
    monkeypatch.setattr(bench.cell, "plan_stroke", planned)
    monkeypatch.setattr(bench.cell, "soon_gets_out", lambda motion, source: True)
    monkeypatch.setattr(bench.cell, "make_stroke", made)
    monkeypatch.setattr(bench.cell, "move_to", stays)
    bench.carry_out(starter.library.skills["scoop"](source=bench.source).run(bench.cell))
    assert all(mm < 0.0 for mm in tried_mm[:-1])
    assert len(tried_mm) > 12, "in every direction before"
    assert tried_mm[-1] == pytest.approx(0.1, abs=0.01)
    (scooped,) = bench.told
    assert scooped.gap_mm == 0.1


def at_once(plan: Any) -> Steps[Any]:
    yield from ()
    return plan()
