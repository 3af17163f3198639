from itertools import pairwise

import numpy as np
import pytest

from scuhand_bt.motion.axes import at_times, of_arm, of_roller
from scuhand_bt.motion.timelaw import RateLimits, TimeLaw, cubics, rest_to_rest_s
from scuhand_bt.motion.trajectory import beside, standing, through

RATES = RateLimits(np.array([4.8, 3.1, 4.8, 4.8, 4.8, 4.8, 4.8]), np.full(7, 4.4), np.full(7, 44.0))
LAW = TimeLaw(RATES)


def direct(q0, q1):
    return cubics(LAW.pieces(np.array([q0, q1]), np.zeros((2, 7))))


def ends(seed, reach=1.5):
    return np.random.default_rng(seed).uniform(-reach, reach, (2, 7))


@pytest.mark.parametrize("reach", [0.01, 0.3, 3.0])
def test_the_closed_form_of_the_optimum_is_what_ruckig_finds(reach):
    for seed in range(20):
        q0, q1 = ends(seed, reach)
        assert rest_to_rest_s(q1 - q0, RATES) == pytest.approx(direct(q0, q1).duration_s, rel=1e-9)


def test_a_motion_begins_and_ends_at_rest_where_it_should_and_keeps_every_limit():
    q0, q1 = ends(1)
    motion = direct(q0, q1)
    ends_s = np.array([0.0, motion.duration_s])
    assert motion.start == pytest.approx(q0, abs=1e-9)
    assert motion.end == pytest.approx(q1, abs=1e-9)
    assert motion.at(ends_s, 1) == pytest.approx(np.zeros((2, 7)), abs=1e-7)
    assert motion.at(ends_s, 2) == pytest.approx(np.zeros((2, 7)), abs=1e-6)
    assert RATES.stretch_for(motion) <= 1 + 1e-6


def test_a_motion_passes_its_via_point_with_its_speed_without_a_jump():
    q0, q1 = ends(2)
    points, speeds = np.array([q0, (q0 + q1) / 2 + 0.2, q1]), np.zeros((3, 7))
    speeds[1] = 0.5
    pieces = LAW.pieces(points, speeds)
    motion = cubics(pieces)
    via_s = pieces[0].duration
    assert motion.sample(via_s) == pytest.approx(points[1], abs=1e-6)
    assert motion.at(np.array([via_s - 1e-9, via_s + 1e-9]), 1) == pytest.approx(np.full((2, 7), 0.5), abs=1e-5)
    for time_s in np.linspace(0, via_s, 9):
        assert motion.sample(time_s) == pytest.approx(np.array(pieces[0].at_time(time_s)[0]), abs=1e-7)


def test_pieces_meet_exactly_though_ruckig_ends_one_beside_its_target():
    # From a motion that the audit told of: Ruckig ends its second joint 7e-9 rad from the target.
    law = TimeLaw(
        RateLimits(np.array([4.817, 3.142, 4.817, 4.817, 4.817, 4.817, 4.817]), RATES.acceleration, RATES.jerk)
    )
    points, speeds = np.zeros((3, 7)), np.zeros((3, 7))
    points[0] = 0.08144189, 0.76555396, 0.0, -2.44601379, 0.0, -0.34136331, 0.0
    points[1] = 0.39347461, 0.75512561, -0.42226998, -1.92763029, -0.19402949, -0.19558013, -0.59903613
    speeds[1] = -0.12725889, -0.01121631, 0.20706206, 0.11890664, -0.33581379, 0.02218909, -0.04262292
    points[2] = points[1] + 0.3
    motion = cubics(law.pieces(points, speeds))
    h = np.diff(motion.knots_s)[:-1, None]
    c0, c1, c2, c3 = motion.coefficients[:, :-1]
    assert c0 + h * (c1 + h * (c2 + h * c3)) == pytest.approx(motion.coefficients[0, 1:], abs=1e-13)
    jerks = np.diff(motion.at(np.arange(0.0, motion.duration_s, 1e-3)), 3, axis=0) / 1e-9
    assert (np.abs(jerks).max(axis=0) <= 1.0001 * RATES.jerk).all()
    assert motion.end == pytest.approx(points[2], abs=3e-8)


@pytest.mark.parametrize("seed", range(20))
def test_a_motions_span_is_exactly_what_it_passes(seed):
    rng = np.random.default_rng(seed)
    motion = through(np.concatenate([[0.0], np.cumsum(rng.uniform(0.05, 1.0, 6))]), rng.normal(size=(7, 7)))
    low, high = motion.span()
    q = motion.at(np.linspace(0.0, motion.duration_s, 5000))
    assert (low <= q.min(axis=0) + 1e-12).all()
    assert (high >= q.max(axis=0) - 1e-12).all()
    assert low == pytest.approx(q.min(axis=0), abs=1e-3)
    assert high == pytest.approx(q.max(axis=0), abs=1e-3)


def test_extremes_are_no_less_than_any_sample():
    motion = direct(*ends(3))
    times_s = np.linspace(0, motion.duration_s, 4000)
    for k, most in enumerate(motion.extremes(), start=1):
        sampled = np.abs(motion.at(times_s, k)).max(axis=0)
        assert (sampled <= most + 1e-9).all()
        assert sampled == pytest.approx(most, rel=1e-2)


def test_stretching_and_reversing_keep_the_path():
    motion = direct(*ends(4))
    slow, back = motion.stretched(2.0), motion.reversed()
    for time_s in np.linspace(0, motion.duration_s, 11):
        assert slow.sample(2 * time_s) == pytest.approx(motion.sample(time_s))
        assert back.sample(motion.duration_s - time_s) == pytest.approx(motion.sample(time_s), abs=1e-8)


def test_samples_outside_a_motion_are_its_ends():
    motion = direct(*ends(5))
    assert (motion.sample(-1.0) == motion.start).all()
    assert (motion.sample(99.0) == motion.end).all()


def test_many_times_at_once_are_the_same_positions_as_one_by_one_to_the_last_bit():
    motion = direct(*ends(6))
    times_s = np.linspace(-0.1, motion.duration_s + 0.1, 200)
    for course in (motion, of_arm(motion), of_roller(motion).counted_from(0.3)):
        one_by_one = np.array([course.sample(time_s) for time_s in times_s])
        assert (at_times(course, times_s) == one_by_one).all()


def test_straight_legs_leave_the_polyline_nowhere():
    polyline = np.array([*ends(6), ends(7)[0]])
    motion = LAW.straight(polyline)
    q = motion.at(np.linspace(0, motion.duration_s, 500))
    off = np.inf
    for first, last in pairwise(polyline):
        share = np.clip((q - first) @ (last - first) / ((last - first) @ (last - first)), 0, 1)[:, None]
        off = np.minimum(off, np.abs(q - first - share * (last - first)).max(axis=1))
    assert off.max() < 1e-9
    assert RATES.stretch_for(motion) <= 1 + 1e-6


def test_cubics_through_samples_pass_them_and_rest_at_both_ends():
    times_s = np.linspace(0, 1, 21)
    positions = (3 * times_s**2 - 2 * times_s**3)[:, None] * np.ones(7)
    motion = through(times_s, positions)
    assert motion.at(times_s) == pytest.approx(positions)
    assert motion.at(np.array([0.0, 1.0]), 1) == pytest.approx(np.zeros((2, 7)), abs=1e-9)


def test_standing_still_is_a_motion():
    assert (standing(np.ones(7)).sample(0.5) == 1).all()


def test_a_state_of_the_wrong_length_never_reaches_ruckig():
    with pytest.raises(ValueError, match="7 coordinates"):
        LAW.solve(np.zeros(6), np.zeros(7), np.zeros(7), np.zeros(7))


@pytest.mark.parametrize("reach", [0.2, 3.0])
def test_of_two_motions_at_once_each_keeps_its_way_and_the_shorter_is_slowed(reach):
    arm, law = direct(*ends(3)), TimeLaw(RateLimits(np.array([4.0]), np.array([20.0]), np.array([400.0])))
    roller = law.straight(np.array([[1.0], [1.0 + 4 * reach]]))
    both = beside(arm, roller)
    lasts_s = max(arm.duration_s, roller.duration_s)
    assert both.duration_s == pytest.approx(lasts_s)
    shares = np.linspace(0.0, 1.0, 200)
    for part, columns in ((arm, slice(0, 7)), (roller, slice(7, 8))):
        assert both.at(shares * lasts_s)[:, columns] == pytest.approx(part.at(shares * part.duration_s), abs=1e-9)
    assert np.abs(both.at(np.array([0.0, lasts_s]), 1)).max() < 1e-6
