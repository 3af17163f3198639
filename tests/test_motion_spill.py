import math

import numpy as np
import pytest

from scuhand_bt.device_specs.hand import HandSpec
from scuhand_bt.motion.kinematics import LIMITS_RAD, Mount, apex
from scuhand_bt.motion.spill import (
    apex_motion,
    liquid_spill_deg,
    spill_angles_deg,
    spill_limit_deg,
    spill_stretch,
    worst_spill_deg,
)
from scuhand_bt.motion.timelaw import RateLimits, TimeLaw, cubics

MOUNT = Mount.of(HandSpec())
LEVEL = np.array([0.0, 0.0, 0.0, -2.2, 0.0, 2.2 - (math.pi - MOUNT.lean_rad), 0.0])
"""The handle straight out from the base and the cone upright."""


def direct(law, q0, q1):
    return cubics(law.pieces(np.array([q0, q1]), np.zeros((2, 7))))


def liquid_left_mm3(half_angle_deg, rim_mm, tilt_deg, cells=120):
    """Volume of liquid in a cone tilted to its rim, counted in little cubes."""
    depth_mm = rim_mm / math.tan(math.radians(half_angle_deg))
    x, y, z = np.meshgrid(*[np.linspace(-rim_mm, rim_mm, cells)] * 2, np.linspace(0, depth_mm, cells), indexing="ij")
    inside = np.hypot(x, y) <= z * math.tan(math.radians(half_angle_deg))
    tilt = math.radians(tilt_deg)
    up = x * math.sin(tilt) + z * math.cos(tilt)
    rim_up = -rim_mm * math.sin(tilt) + depth_mm * math.cos(tilt)
    cell_mm3 = (2 * rim_mm / (cells - 1)) ** 2 * depth_mm / (cells - 1)
    return float((inside & (up <= rim_up)).sum() * cell_mm3)


@pytest.mark.parametrize(("half_angle_deg", "tilt_deg"), [(64.2, 8.0), (64.2, 16.0), (50.0, 20.0), (30.0, 35.0)])
def test_the_liquid_angle_agrees_with_the_counted_volume_of_the_tilted_cone(half_angle_deg, tilt_deg):
    volume_mm3 = liquid_left_mm3(half_angle_deg, 45.0, tilt_deg)
    assert liquid_spill_deg(half_angle_deg, 45.0, volume_mm3) == pytest.approx(tilt_deg, abs=0.4)


def test_a_full_cone_spills_at_once_and_an_empty_one_when_its_wall_is_level():
    full_mm3 = math.pi * 45**3 / (3 * math.tan(math.radians(64)))
    assert liquid_spill_deg(64, 45, full_mm3) == pytest.approx(0.0, abs=1e-9)
    assert liquid_spill_deg(64, 45, 0.0) == pytest.approx(26.0)


def test_five_grams_of_beads_may_lean_by_their_liquid_angle_and_wall_friction_less_the_margin():
    limit_deg = spill_limit_deg(64.16, 45.0, 5000 / 1.5, repose_deg=25.0, wall_friction_deg=18.0, margin_deg=5.0)
    assert limit_deg == pytest.approx(18.85 + 18.0 - 5.0, abs=0.1)


def test_a_load_that_does_not_fit_is_refused():
    with pytest.raises(ValueError, match="cannot carry"):
        spill_limit_deg(64, 45, 60_000, 25, 18)
    with pytest.raises(ValueError, match="margin"):
        spill_limit_deg(64, 45, 46_000, 3, 18)


def test_apex_acceleration_is_the_second_difference_of_the_apex():
    law = TimeLaw(RateLimits(np.full(7, 3.0), np.full(7, 4.0), np.full(7, 40.0)))
    motion = direct(law, LIMITS_RAD[0] * 0.3, LIMITS_RAD[1] * 0.3 - 0.5)
    h = 1e-4
    for time_s in (0.21, 0.4, 0.7):
        times_s = np.array([time_s])
        axes, found = apex_motion(motion.at(times_s), motion.at(times_s, 1), motion.at(times_s, 2), MOUNT)
        before, now, after = (apex(motion.sample(time_s + k * h), MOUNT) for k in (-1, 0, 1))
        expected = (before.position_m - 2 * now.position_m + after.position_m) / h**2
        assert found[0] == pytest.approx(expected, abs=1e-3)
        assert axes[0] == pytest.approx(now.axis)


def test_the_spill_angle_of_a_level_cone_is_what_acceleration_makes_of_gravity():
    up = np.array([[0.0, 0.0, 1.0]] * 2)
    push = np.array([[9.81, 0.0, 0.0]] * 2)
    assert spill_angles_deg(up, push) == pytest.approx([45.0, 45.0])
    assert worst_spill_deg(up, push) == pytest.approx(45.0)


def test_slowing_keeps_the_spill_limit_and_tilt_alone_cannot_be_slowed_away():
    law = TimeLaw(RateLimits(np.full(7, 3.0), np.full(7, 4.0), np.full(7, 40.0)))
    level = LEVEL
    turned = level + np.array([1.0, 0, 0, 0, 0, 0, 0])
    motion = direct(law, level, turned)
    tilt_deg = apex(level, MOUNT).tilt_deg
    factor = spill_stretch(motion, MOUNT, tilt_deg + 3.0)
    assert factor > 1.2
    assert spill_stretch(motion.stretched(factor), MOUNT, tilt_deg + 3.0) == pytest.approx(1.0, abs=0.01)
    assert spill_stretch(motion, MOUNT, max(tilt_deg - 1.0, 0.0)) is None


def test_a_load_keeps_a_margin_of_five_degrees_unless_told_otherwise():
    liquid_deg = liquid_spill_deg(64.0, 45.0, 3000.0)
    assert spill_limit_deg(64.0, 45.0, 3000.0, 25.0, 18.0) == pytest.approx(liquid_deg + 18.0 - 5.0)
    assert spill_limit_deg(64.0, 45.0, 3000.0, 12.0, 18.0) == pytest.approx(liquid_deg + 12.0 - 5.0)


def test_a_load_that_needs_the_whole_margin_is_refused_and_one_with_half_a_degree_left_is_not():
    full_mm3 = math.pi * 45**3 / (3 * math.tan(math.radians(64)))
    with pytest.raises(ValueError, match="within the margin of 5 deg"):
        spill_limit_deg(64, 45, full_mm3, 5.0, 18.0)
    assert spill_limit_deg(64, 45, full_mm3, 5.5, 18.0) == pytest.approx(0.5)


class Shove:
    """A motion that begins with a level cone, at rest, and is shoved evenly about the base; where it is looked at."""

    duration_s = 0.9995

    def __init__(self, acceleration):
        self.acceleration = acceleration
        self.looked_s = None

    def states(self, times_s):
        self.looked_s = times_s
        values = LEVEL, [0.0] * 7, [self.acceleration, *[0.0] * 6]
        return tuple(np.tile(value, (len(times_s), 1)) for value in values)

    def worst_deg(self, share):
        times_s = np.linspace(0.0, self.duration_s, 7)
        axes, accelerations = apex_motion(*self.states(times_s), MOUNT)
        return worst_spill_deg(axes, share * accelerations)


def test_a_motion_is_looked_at_every_five_milliseconds_from_its_begin_to_its_end():
    shove = Shove(0.1)
    spill_stretch(shove, MOUNT, 30.0)
    assert (shove.looked_s[0], shove.looked_s[-1]) == (0.0, shove.duration_s)
    assert len(shove.looked_s) == 201
    assert np.diff(shove.looked_s).max() <= 0.005


def test_a_motion_at_its_very_limit_is_not_slowed_and_beyond_it_by_the_root_of_its_share_of_acceleration():
    shove = Shove(3.0)
    assert spill_stretch(shove, MOUNT, shove.worst_deg(1.0)) == 1.0
    assert spill_stretch(shove, MOUNT, shove.worst_deg(0.5)) == pytest.approx(math.sqrt(2))
    for share in (0.5, 0.3005, 0.01):
        expected = math.sqrt(1024 / math.floor(1024 * share))
        assert spill_stretch(shove, MOUNT, shove.worst_deg(share) + 1e-9) == pytest.approx(expected)


def test_a_cone_whose_tilt_is_its_limit_is_not_moved_and_less_than_a_thousandth_is_no_motion():
    shove = Shove(1000.0)
    assert spill_stretch(shove, MOUNT, shove.worst_deg(0.0)) is None
    assert spill_stretch(shove, MOUNT, shove.worst_deg(1.5 / 1024)) is None
    assert spill_stretch(shove, MOUNT, shove.worst_deg(2.5 / 1024)) == pytest.approx(math.sqrt(1024 / 2))


def test_between_two_samples_half_of_both_steps_and_a_tenth_more_may_come_on_top():
    def leaning(*degrees):
        angles = np.radians(degrees)
        return np.stack([np.sin(angles), np.zeros_like(angles), np.cos(angles)], axis=1)

    still = np.zeros((3, 3))
    assert worst_spill_deg(leaning(10.0, 12.0, 11.0), still) == pytest.approx(12.0 + 0.55 * 2.0)
    pushed = 9.81 * np.tan(np.radians([[10.0], [14.0], [14.0]])) * np.array([[-1.0, 0.0, 0.0]])
    assert worst_spill_deg(leaning(0.0, 0.0, 0.0), pushed) == pytest.approx(14.0 + 0.55 * 4.0)
    assert worst_spill_deg(leaning(0.0, 2.0, 2.0), pushed) == pytest.approx(16.0 + 0.55 * (2.0 + 4.0))


def test_opposite_directions_are_half_a_turn_apart():
    down = np.array([[0.0, 0.0, -1.0]])
    assert spill_angles_deg(down, np.zeros((1, 3))) == pytest.approx([180.0])
    almost = np.array([[0.0, 1e-9, -(1.0 + 1e-12)]])
    assert spill_angles_deg(almost, np.zeros((1, 3))) == pytest.approx([180.0])


def test_volumes_below_nothing_and_beyond_the_full_cone_are_refused_and_the_bounds_are_not():
    full_mm3 = math.pi * 45**3 / (3 * math.tan(math.radians(64)))
    for load_mm3 in (-1e-9, full_mm3 * (1 + 1e-12)):
        with pytest.raises(ValueError, match="cannot carry"):
            liquid_spill_deg(64, 45, load_mm3)
