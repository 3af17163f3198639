"""What the arm keeps clear with follows from the hand and the pan: a skill that only morphs has told everything."""

from typing import Any

import numpy as np
import pytest
from running import simulated_bench

from scuhand_bt.clock import Steps
from scuhand_bt.dosing.bracket import Gross
from scuhand_bt.failures import SkillFailed
from scuhand_bt.lab import Lab
from scuhand_bt.motion import ApexPose
from scuhand_bt.run.cell_state import state_of, take_up
from scuhand_bt.run.clock import VirtualClock
from scuhand_bt.specs import Container

BY_THE_SHIELD = ApexPose(np.array([0.330, 0.0535, 0.130]))
"""46.5 mm from the draught shield's left side: a narrow cone has room there, one of 90 mm has not."""
LOW_OVER_THE_PAN = ApexPose(np.array([0.330, 0.0, 0.090]))
"""30 mm above the pan: lower than a crucible's rim."""


class Bench:
    """The starter lab's cell, simulated, with its real planner."""

    def __init__(self, lab: Lab) -> None:
        motion = lab.motion_planner({"mortar_bay": lab.library.mortars["agate_mortar"]})
        self.clock = VirtualClock()
        self.cell, _ = simulated_bench(lab, motion, self.clock)
        motion.add_place("low", LOW_OVER_THE_PAN)
        kind = lab.library.containers["alumina_crucible"]
        self.crucible = Container.model_construct(**{**kind.__dict__, "id": "c1"})

    def do(self, steps: Steps[Any]) -> None:
        for wake in steps:
            self.clock.wait([wake])


@pytest.fixture
def bench(starter: Lab) -> Bench:
    return Bench(starter)


def goes(bench: Bench, pose: ApexPose) -> bool:
    """Whether the arm goes to a pose; it is where it was if not."""
    before = bench.cell.arm.positions
    try:
        bench.do(bench.cell.move_to(pose))
    except SkillFailed:
        assert np.array_equal(bench.cell.arm.positions, before)
        return False
    return True


def test_after_a_morph_alone_a_motion_is_planned_with_the_new_cone(bench: Bench) -> None:
    assert not goes(bench, BY_THE_SHIELD)
    bench.do(bench.cell.hand.morph(60.0))
    assert goes(bench, BY_THE_SHIELD)


def test_a_container_is_in_the_way_from_when_it_is_brought_until_it_is_gone(bench: Bench) -> None:
    believed = bench.cell.believed
    bench.do(bench.cell.move_to(ApexPose(LOW_OVER_THE_PAN.position_m + np.array([0.0, 0.0, 0.06]))))
    assert bench.cell.contact([LOW_OVER_THE_PAN], 40.0, "mortar_bay").duration_s > 1.0
    believed.brought(bench.crucible, from_changer=True)
    with pytest.raises(SkillFailed, match="alumina_crucible on the pan"):
        bench.cell.contact([LOW_OVER_THE_PAN], 40.0, "mortar_bay")
    bare, loaded = Gross(0.0, 0.1, 0.0), Gross(31_000.0, 0.1, 8.0)
    for stands in (lambda: None, lambda: believed.placed(bare, loaded), believed.changing_container):
        stands()
        with pytest.raises(SkillFailed, match="alumina_crucible on the pan"):
            bench.do(bench.cell.move_to(LOW_OVER_THE_PAN))
        with pytest.raises(SkillFailed, match="alumina_crucible on the pan"):
            bench.do(bench.cell.lower_to("low", 60.0, 40.0))
    believed.removed()
    bench.do(bench.cell.lower_to("low", 60.0, 40.0))


def test_a_resumed_run_keeps_clear_of_what_stood_on_the_pan(bench: Bench, starter: Lab) -> None:
    bench.cell.believed.brought(bench.crucible, from_changer=True)
    resumed = Bench(starter)
    take_up(resumed.cell, state_of(bench.cell))
    assert not goes(resumed, LOW_OVER_THE_PAN)


def test_what_a_real_roller_measures_of_one_cone_is_one_cone(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    pose = ApexPose(np.array([0.250, 0.0, 0.200]))
    planned = []
    for measured_mm in (90.0, 89.93, 90.12):
        bench.do(bench.cell.hand.morph(measured_mm))
        steps = bench.cell.move_to(pose)
        monkeypatch.setattr(bench.cell.arm, "follow", lambda trajectory: planned.append(trajectory) or iter(()))
        bench.do(steps)
    assert planned[0] is planned[1] is planned[2]
