"""What is polished goes downhill from a schedule, and stays free, within its limits, and to where it was to end."""

from dataclasses import replace

import numpy as np
import pytest

from harness.motion_audit import Audit
from harness.motion_layouts import CONTAINER, LAB, drawn
from scuhand_bt.motion import Mount, apex
from scuhand_bt.motion.clearances import Clearances
from scuhand_bt.motion.timelaw import rest_to_rest_s
from scuhand_bt.motion.transfer import POLISHED

LAYOUT = drawn(9714)
MOUNT = Mount.of(LAB.cell.hand)
NOT_DOWNHILL = replace(POLISHED, changes=0)


@pytest.fixture(scope="module")
def planner():
    return LAYOUT.planner()


@pytest.fixture(scope="module")
def motions(planner):
    """From a mortar to over the pan: searched for only, and downhill from there."""
    start, goal = planner.standing_at("mortar_bay"), LAYOUT.places["balance"]
    return [planner.move(start, goal, effort=effort) for effort in (NOT_DOWNHILL, POLISHED)]


def test_downhill_a_motion_is_quicker_and_its_audit_as_good(planner, motions):
    searched, polished = motions
    assert polished.duration_s < 0.98 * searched.duration_s
    verdict = Audit(LAB.urdf, LAYOUT.cell, LAYOUT.mortars, CONTAINER).of(polished)
    assert verdict.clearance_m > 0.003
    assert verdict.over_limit < 1e-6
    assert planner.rates.stretch_for(polished) <= 1 + 1e-9


def test_an_end_that_moved_along_the_arms_own_motion_is_still_at_the_pose(motions):
    pose, end = LAYOUT.places["balance"], motions[1].end
    assert apex(end, MOUNT).position_m == pytest.approx(pose.position_m, abs=1e-9)
    assert apex(end, MOUNT).axis == pytest.approx(pose.axis, abs=1e-9)
    assert motions[1].at(np.array([motions[1].duration_s]), 1)[0] == pytest.approx(np.zeros(7), abs=1e-7)


def test_what_goes_between_two_configurations_ends_in_the_one_that_was_asked_for(planner):
    motion = planner.move(planner.standing_at("mortar_bay"), "balance")
    assert motion.end == pytest.approx(planner.standing_at("balance"), abs=1e-9)


def test_a_pose_of_one_configuration_is_that_configuration_from_either_side(monkeypatch):
    planner = LAYOUT.planner()
    resolved = planner._resolved
    for here, there in (("mortar_bay_2", "balance"), ("balance", "mortar_bay_2")):
        start, only = planner.standing_at(here), planner.standing_at(there)
        monkeypatch.setattr(planner, "_resolved", lambda *asked, only=only: (resolved(*asked)[0], only[None], None))
        motion = planner.move(start, LAYOUT.places[there], effort=POLISHED)
        assert motion.start == pytest.approx(start, abs=1e-9)
        assert motion.end == pytest.approx(only, abs=1e-9)


def test_downhill_is_the_same_way_every_time(motions):
    again = LAYOUT.planner().move(motions[1].start, LAYOUT.places["balance"], effort=POLISHED)
    assert again.coefficients.tobytes() == motions[1].coefficients.tobytes()


def test_a_load_that_may_lean_begins_from_the_empty_cones_way(planner):
    # No schedule of its own is found here: by level ways and via points it took three times as long.
    start = planner.standing_at("mortar_bay_2")
    empty, load = planner.move(start, "balance"), planner.move(start, "balance", spill_limit_deg=20.0)
    assert load.duration_s < 1.3 * empty.duration_s
    verdict = Audit(LAB.urdf, LAYOUT.cell, LAYOUT.mortars, CONTAINER).of(load)
    assert verdict.spill_deg <= 20.0
    assert verdict.clearance_m > 0.003
    assert verdict.over_limit < 1e-6


def test_distances_change_as_their_gradients_say(planner):
    step = 1e-4  # distances are that of coal, to a micrometre
    clearances, q = Clearances(planner.scene()), planner.standing_at("balance")[None, :] + 0.1
    watched = clearances.watched(q)
    near = clearances.near(q, watched)
    assert len(near.at) > 3
    for joint, one in enumerate(np.eye(7)):
        more, less = (clearances.near(q + sign * step * one, watched).distances_m for sign in (1, -1))
        assert (more - less) / (2 * step) == pytest.approx(near.gradients[:, joint], abs=2e-3)


def test_where_a_fresh_sheet_is_put_in_the_arm_stands_as_it_comes_and_goes_quickest(planner):
    posture = planner.standing_at("sheet_swap")
    pose = LAYOUT.places["sheet_swap"]
    assert apex(posture, MOUNT).position_m == pytest.approx(pose.position_m, abs=1e-9)
    ways = posture - np.stack([planner.standing_at(name) for name in ("waste", "mortar_bay", "mortar_bay_2", "park")])
    assert rest_to_rest_s(ways, planner.rates).max() < 1.4
