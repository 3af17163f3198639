"""The cone is emptied by pulses, of which none is longer than the hand takes."""

import sys
from typing import Any, cast

import pytest
from wire_helpers import carry_out

from scuhand_bt.bench_spec import Station
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.clock import Steps
from scuhand_bt.devices.interfaces import Operator
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


@pytest.mark.parametrize(("flow_factor", "pulses"), [(1.0, 1), (0.1, 4)])
def test_a_cone_that_empties_slowly_takes_several_pulses_and_each_is_one_that_the_hand_takes(
    starter: Lab, flow_factor: float, pulses: int
) -> None:
    powder = starter.library.powders["glass_beads"]
    mortar = starter.library.mortars["agate_mortar"]
    source = Source(name="store", station="bay", mortar=mortar, powder=powder, amount_mg=10_000.0)
    clock = VirtualClock()
    cell, world = simulated_cell(
        CellSpec(cell="bench", stations=STATIONS),
        {"store": source},
        clock=clock,
        record=Record(),
        motion=cast(MotionPlanner, None),
        operator=cast(Operator, None),
        seed=1,
    )
    clock.process = world
    cell.believed.cone_holds(source, 3000.0)
    slow = powder.belief.coefficient * flow_factor
    cell.powder_beliefs[source.sheet_key] = powder.belief.model_copy(update={"coefficient": slow})
    world.load_cone("store", 3000.0)
    dwells_s: list[float] = []
    pulse = cell.hand.pulse

    def noted(opening_mm: float, dwell_s: float, vibration: float = 0.0) -> Steps[None]:
        dwells_s.append(dwell_s)
        yield from pulse(opening_mm, dwell_s, vibration)

    cell.hand.pulse = noted  # type: ignore[method-assign]
    skill: Any = starter.library.skills["return_leftover"]
    emptying = sys.modules[f"{skill.__module__.rpartition('.')[0]}._emptying"]
    carry_out(emptying.empty_cone(cell), cast(Any, clock))
    assert len(dwells_s) == pulses
    assert dwells_s[:-1] == [cell.hand.longest_dwell_s] * (pulses - 1)
    assert cell.believed.cone_source is None
    assert world.masses_mg["cone"] < 0.05 * 3000.0
