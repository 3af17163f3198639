"""What a carried load feels: the acceleration of its cone, however often and how coarsely that is looked at."""

import math

import numpy as np
import pytest

from scuhand_bt.sim.cone_over import ConePose
from scuhand_bt.sim.spilling import GRAVITY_MM_PER_S2, Carried

RATE_MM_PER_S2 = 1500.0
UP = np.array([0.0, 0.0, 1.0])


def leans_deg(every_s: float, step_mm: float) -> list[float]:
    """Of an upright cone that is sped up evenly along x, seen so often, and only in steps of that length."""
    carried, found = Carried(), []
    for time_s in np.arange(0.0, 0.6, every_s):
        x_mm = round(RATE_MM_PER_S2 * time_s**2 / 2 / step_mm) * step_mm
        pose = ConePose(np.array([x_mm, 0.0, 0.0]), UP, 70.0, 50.0)
        found.append(math.degrees(carried.lean(float(time_s), pose)))
    return found[len(found) // 2 :]


@pytest.mark.parametrize(("every_s", "step_mm"), [(0.02, 1e-6), (0.05, 1e-6), (0.007, 0.5), (0.003, 0.5), (0.02, 0.5)])
def test_the_steps_of_servos_and_of_looks_are_not_felt(every_s: float, step_mm: float) -> None:
    true_deg = math.degrees(math.atan2(RATE_MM_PER_S2, GRAVITY_MM_PER_S2))
    assert leans_deg(every_s, step_mm) == pytest.approx([true_deg] * len(leans_deg(every_s, step_mm)), abs=3.5)


def test_a_cone_that_has_come_to_rest_feels_gravity_alone() -> None:
    carried, pose = Carried(), ConePose(np.zeros(3), UP, 70.0, 50.0)
    carried.lean(0.0, ConePose(np.array([50.0, 0.0, 0.0]), UP, 70.0, 50.0))
    carried.lean(0.1, pose)
    carried.rest()
    assert carried.lean(0.2, pose) == 0.0
