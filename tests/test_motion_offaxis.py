import numpy as np
import pytest

from scuhand_bt.lab import load_lab, starter_lab
from scuhand_bt.motion.collision import Arm
from scuhand_bt.motion.kinematics import LIMITS_RAD, ApexPose, apex
from scuhand_bt.motion.offaxis import off_axis_apex, off_axis_solutions

MODEL = Arm(load_lab(starter_lab()).urdf).model
BESIDE_M = np.array([0.03, -0.01, 0.12])


def test_an_apex_on_the_axis_is_where_the_closed_form_has_it():
    for q in np.random.default_rng(1).uniform(LIMITS_RAD[0], LIMITS_RAD[1], (20, 7)):
        one, two = off_axis_apex(MODEL, np.array([0.0, 0.0, 0.12]), q), apex(q, 0.12)
        assert one.position_m == pytest.approx(two.position_m, abs=1e-9)
        assert one.axis == pytest.approx(two.axis, abs=1e-9)


@pytest.mark.parametrize("y_m", [-0.2, 0.0, 0.2])
def test_poses_over_the_cell_are_reached_within_the_joints_limits(y_m):
    pose = ApexPose(np.array([0.25, y_m, 0.1]))
    found = off_axis_solutions(MODEL, BESIDE_M, pose)
    assert len(found) >= 2
    assert ((found >= LIMITS_RAD[0]) & (found <= LIMITS_RAD[1])).all()
    for q in found:
        reached = off_axis_apex(MODEL, BESIDE_M, q)
        assert reached.position_m == pytest.approx(pose.position_m, abs=1e-8)
        assert reached.axis == pytest.approx(pose.axis, abs=1e-8)
    assert (found == off_axis_solutions(MODEL, BESIDE_M, pose)).all()


def test_out_of_reach_nothing_is_found_and_an_apex_that_is_no_place_is_refused():
    assert len(off_axis_solutions(MODEL, BESIDE_M, ApexPose(np.array([0.9, 0.0, 0.1])))) == 0
    with pytest.raises(ValueError, match="three finite lengths"):
        off_axis_solutions(MODEL, np.array([0.0, np.nan, 0.1]), ApexPose(np.array([0.25, 0.0, 0.1])))
