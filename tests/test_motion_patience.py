"""Time is a bound for who waits: the best certified by then is the answer, and nothing that others are given."""

from pathlib import Path

import numpy as np
import pytest

from harness.motion_audit import Audit
from harness.motion_layouts import CONTAINER, LAB, Layout, carries, drawn, tasks
from scuhand_bt.motion import ApexPose, MotionPlanner
from scuhand_bt.motion.stopping import StoppableTrajectory

LAYOUT = drawn(305)


def ways_near(layout: Layout, first: str, second: str) -> list[ApexPose]:
    """Poses near one place to which loads go from another."""
    return [near for begin, end, near in carries(layout, 8) if (begin, end) == (first, second) and near is not None]


FIRST, NEAR = "mortar_bay_2", ways_near(LAYOUT, "mortar_bay_2", "waste")[0]
"""A way on which the search for a load finds what is much quicker than the empty cone's motion, slowed."""


def carried(planner: MotionPlanner, limit_deg: float = 31.8) -> StoppableTrajectory:
    return planner.move(planner.standing_at(FIRST), NEAR, spill_limit_deg=limit_deg)


def without_patience(planner: MotionPlanner, patience_s: float = 0.0) -> MotionPlanner:
    planner.patience_s = patience_s
    return planner


@pytest.fixture(scope="module")
def patient() -> bytes:
    """What is found where only counts end a search."""
    return carried(LAYOUT.planner()).coefficients.tobytes()


def test_without_time_the_best_certified_is_the_answer_and_as_sound_as_any() -> None:
    in_time, slower = (carried(without_patience(LAYOUT.planner(), patience_s)) for patience_s in (np.inf, 0.0))
    assert slower.duration_s > 1.01 * in_time.duration_s
    verdict = Audit(LAB.urdf, LAYOUT.cell, LAYOUT.mortars, CONTAINER).of(slower)
    assert verdict.clearance_m > 0.003
    assert verdict.spill_deg <= 31.8
    assert verdict.over_limit < 1e-6


def test_an_answer_that_time_cut_short_is_given_to_nobody_who_has_more(patient: bytes) -> None:
    planner = without_patience(LAYOUT.planner())
    for limit_deg in (10.0, 20.0, 31.8):
        carried(planner, limit_deg)
    without_patience(planner, np.inf)
    assert carried(planner).coefficients.tobytes() == patient


def test_who_has_time_enough_gets_what_counts_alone_would_find(patient: bytes) -> None:
    assert carried(without_patience(LAYOUT.planner(), 3600.0)).coefficients.tobytes() == patient


def test_an_answer_that_time_cut_short_is_not_kept_on_disk(tmp_path: Path) -> None:
    for patience_s in (0.0, np.inf):
        planner = MotionPlanner(LAB.urdf, LAYOUT.cell, LAYOUT.mortars, tmp_path)
        planner.set_geometry(container=CONTAINER)
        for name, pose in LAYOUT.places.items():
            planner.add_place(name, pose)
        found = carried(without_patience(planner, patience_s))
        planner.keep_plans()
    assert found.coefficients.tobytes() == carried(LAYOUT.planner()).coefficients.tobytes()


def test_empty_ways_too_are_answered_by_the_first_that_is_certified() -> None:
    took_s = []
    for patience_s in (np.inf, 0.0):
        planner = without_patience(LAYOUT.planner(), patience_s)
        ways = [(first, near) for first, _, near in tasks(LAYOUT, 20) if near is not None]
        took_s.append([planner.move(planner.standing_at(first), near).duration_s for first, near in ways])
    assert sum(took_s[1]) > sum(took_s[0])
    assert all(one >= other for other, one in zip(*took_s, strict=True))


def test_what_is_not_found_in_time_is_looked_for_to_the_end_of_the_counts() -> None:
    # Of this load neither a straight way nor the empty cone's motion keeps the limit, however slow.
    layout = drawn(304)
    planner = without_patience(layout.planner())
    near = ways_near(layout, "mortar_bay_2", "balance")[0]
    assert planner.move(planner.standing_at("mortar_bay_2"), near, spill_limit_deg=10.0).duration_s > 0
