"""A cone that is turned about its lip."""

import itertools
import math

import numpy as np
import pytest

from scuhand_bt.motion import ApexPose
from scuhand_bt.motion.pouring import about_lip, turned_back

LIP_M, OUT = np.array([0.2, 0.24, 0.1]), np.array([0.6, 0.8, 0.0])
SHEET_M, HALF_RAD = 0.05, math.radians(50.0)


def lip_m(pose: ApexPose) -> np.ndarray:
    """Of a cone that leans in the plane of OUT."""
    angle_rad = math.radians(pose.tilt_deg) + HALF_RAD
    lip: np.ndarray = pose.position_m + SHEET_M * (
        math.sin(angle_rad) * OUT + math.cos(angle_rad) * np.array([0, 0, 1])
    )
    return lip


@pytest.mark.parametrize("tilt_deg", [15.0, 80.0, 110.0])
def test_a_cone_that_leans_is_turned_upright_step_by_step_and_its_lip_stands_still(tilt_deg: float) -> None:
    (leaning,) = about_lip(LIP_M, OUT, [math.radians(tilt_deg)], SHEET_M, HALF_RAD)
    assert leaning.tilt_deg == pytest.approx(tilt_deg)
    back = turned_back(leaning, math.radians(20.0), SHEET_M, HALF_RAD)
    tilts_deg = [tilt_deg, *(pose.tilt_deg for pose in back)]
    assert tilts_deg[-1] == pytest.approx(0.0, abs=1e-6)
    assert all(0.0 < before - after <= 20.0 + 1e-6 for before, after in itertools.pairwise(tilts_deg))
    for pose in (leaning, *back):
        assert lip_m(pose) == pytest.approx(LIP_M)
