import numpy as np
import pytest

from scuhand_bt.motion.joint_schedules import Schedules, jerk_steps, positions
from scuhand_bt.motion.timelaw import RateLimits, TimeLaw, cubics, legs, rest_to_rest_s
from scuhand_bt.motion.trajectory import of_jerk_steps

RATES = RateLimits(np.array([4.8, 3.1, 4.8, 4.8, 4.8, 4.8, 4.8]), np.full(7, 4.4), np.full(7, 44.0))


def schedule(seed, longer):
    """One schedule, `longer` times the optimum of its goal, with turning points on every other joint."""
    rng = np.random.default_rng(seed)
    start, goal = rng.uniform(-1, 1, (2, 7))
    turns = np.where(np.arange(7) % 2, goal + 0.1, goal)
    shares = rng.exponential(size=(1, 7, 5))
    shares /= shares.sum(axis=2, keepdims=True)
    duration_s = longer * rest_to_rest_s(goal - start, RATES)
    return start, Schedules(goal[None], np.array([duration_s]), turns[None], shares)


@pytest.mark.parametrize("reach", [0.01, 0.3, 3.0])
def test_a_leg_is_as_long_as_the_closed_form_and_as_ruckig_says(reach):
    q0, q1 = np.random.default_rng(3).uniform(-reach, reach, (2, 7))
    _, _, durations_s = legs(q1 - q0, RATES)
    assert durations_s.max() == pytest.approx(rest_to_rest_s(q1 - q0, RATES))
    ruckig = cubics(TimeLaw(RATES).pieces(np.array([q0, q1]), np.zeros((2, 7))))
    assert durations_s.max() == pytest.approx(ruckig.duration_s, rel=1e-9)


@pytest.mark.parametrize("longer", [1.0, 1.05, 2.0])
@pytest.mark.parametrize("seed", range(5))
def test_a_schedule_ends_at_rest_at_its_goal_and_keeps_every_limit(seed, longer):
    start, some = schedule(seed, longer)
    times_s, steps = jerk_steps(start, some, RATES)
    motion = of_jerk_steps(start, times_s[0], steps[0], float(some.durations_s[0]))
    end_s = np.array([motion.duration_s])
    assert motion.start == pytest.approx(start)
    assert motion.end == pytest.approx(some.goals[0], abs=1e-9)
    assert motion.at(end_s, 1)[0] == pytest.approx(np.zeros(7), abs=1e-7)
    assert RATES.stretch_for(motion) <= 1 + 1e-9


def test_schedules_are_looked_at_where_their_motions_are():
    start, some = schedule(1, 1.5)
    times_s, steps = jerk_steps(start, some, RATES)
    motion = of_jerk_steps(start, times_s[0], steps[0], float(some.durations_s[0]))
    at_s = np.linspace(0, motion.duration_s, 50)
    assert positions(start, times_s, steps, at_s[None])[0] == pytest.approx(motion.at(at_s), abs=1e-9)


def test_a_joint_goes_by_its_turning_point_where_it_has_the_time():
    start, some = schedule(2, 4.0)
    times_s, steps = jerk_steps(start, some, RATES)
    q = positions(start, times_s, steps, np.linspace(0, some.durations_s[0], 4000)[None])[0]
    assert np.abs(q - some.turns[0]).min(axis=0).max() < 2e-3
