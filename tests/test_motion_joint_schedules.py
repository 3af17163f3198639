from types import SimpleNamespace

import numpy as np
import pytest

from scuhand_bt.motion.joint_schedules import Schedules, ScheduleSearch, jerk_steps, positions
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


def both_legs_s(start, some):
    return legs(some.turns[0] - start, RATES)[2] + legs(some.goals[0] - some.turns[0], RATES)[2]


def test_a_joint_that_turns_back_does_not_come_to_rest_there():
    start, turns, goal = np.zeros(7), np.full((1, 7), 0.5), np.full((1, 7), 0.1)
    shares = np.full((1, 7, 5), 0.2)
    ramp_s = RATES.acceleration / RATES.jerk
    some = Schedules(
        goal, both_legs_s(start, Schedules(goal, np.zeros(1), turns, shares))[:1] - ramp_s[0], turns, shares
    )
    times_s, steps = jerk_steps(start, some, RATES)
    motion = of_jerk_steps(start, times_s[0], steps[0], float(some.durations_s[0]))
    at_s = np.linspace(0, motion.duration_s, 4000)
    assert motion.at(at_s).max(axis=0) == pytest.approx(0.5, abs=0.01)
    assert motion.at(at_s, 2).min(axis=0) == pytest.approx(-RATES.acceleration)
    assert motion.end == pytest.approx(goal[0], abs=1e-9)
    assert RATES.stretch_for(motion) == pytest.approx(1, abs=1e-9)


def test_a_joint_that_goes_on_rests_at_its_turning_point():
    start, turns, goal = np.zeros(7), np.full((1, 7), 0.5), np.full((1, 7), 1.0)
    shares = np.full((1, 7, 5), 0.2)
    needed_s = both_legs_s(start, Schedules(goal, np.zeros(1), turns, shares)).max() + 1e-9
    some = Schedules(goal, np.array([needed_s]), turns, shares)
    times_s, steps = jerk_steps(start, some, RATES)
    motion = of_jerk_steps(start, times_s[0], steps[0], needed_s)
    assert motion.at(np.array([motion.duration_s / 2]), 1)[0] == pytest.approx(np.zeros(7), abs=1e-6)
    assert RATES.stretch_for(motion) <= 1 + 1e-9


@pytest.mark.parametrize("slow", [0.2, 0.9])
@pytest.mark.parametrize("back", [0.02, 0.4, 2.0])
def test_legs_that_overlap_keep_every_limit_however_slow_either_is(slow, back):
    start, turns = np.zeros(7), np.array([[0.01, 0.05, 0.1, 0.3, 0.6, 1.2, 2.5]])
    goal = turns - back
    shares = np.tile([0.0, slow, 0.0, 1 - slow, 0.0], (1, 7, 1))
    longest_s = both_legs_s(start, Schedules(goal, np.zeros(1), turns, shares)).max()
    some = Schedules(goal, np.array([1.3 * longest_s]), turns, shares)
    times_s, steps = jerk_steps(start, some, RATES)
    motion = of_jerk_steps(start, times_s[0], steps[0], float(some.durations_s[0]))
    assert motion.end == pytest.approx(goal[0], abs=1e-9)
    assert RATES.stretch_for(motion) <= 1 + 1e-9


def test_a_schedule_in_step_rests_where_it_turns():
    arm_limits = np.stack([np.full(7, -3.0), np.full(7, 3.0)])
    prover = SimpleNamespace(mount=SimpleNamespace(arm=None, limits_rad=arm_limits))
    level = SimpleNamespace(joints=lambda c: c)  # any turning points will do
    start, goal = np.zeros(7), np.array([0.6, -0.3, 0.5, -0.4, 0.3, 0.2, -0.6])
    bound_s = rest_to_rest_s(goal[None] - start, RATES)
    search = ScheduleSearch(prover, RATES, start, goal[None], bound_s, level)
    some = search._fresh(40, 3 * float(bound_s[0]), 4 * float(bound_s[0]), np.random.default_rng(1))
    times_s, steps = jerk_steps(start, some, RATES)
    slowest = []
    for k in range(20):  # of the first three fifths
        motion = of_jerk_steps(start, times_s[k], steps[k], float(some.durations_s[k]))
        speeds = np.abs(motion.at(np.linspace(0.1, 0.9, 400) * motion.duration_s, 1))
        slowest.append((speeds / speeds.max(axis=0)).max(axis=1).min())
    assert np.median(slowest) < 0.02


def test_legs_overlap_by_the_shorter_ramp_only():
    start, turns, goal = np.zeros(7), np.full((1, 7), 0.6), np.full((1, 7), 0.59)
    shares = np.tile([0.25, 0.25, 0.0, 0.25, 0.25], (1, 7, 1))
    there, back = legs(turns - start, RATES)[0][0], legs(goal - turns, RATES)[0][0]
    needed_s = (there[:, 7] + back[:, 7] - back[:, 1]).max()
    some = Schedules(goal, np.array([needed_s + 1e-9]), turns, shares)
    times_s, steps = jerk_steps(start, some, RATES)
    motion = of_jerk_steps(start, times_s[0], steps[0], needed_s + 1e-9)
    assert motion.at(np.linspace(0, needed_s, 4000)).max(axis=0) == pytest.approx(0.6, abs=0.002)
    assert RATES.stretch_for(motion) <= 1 + 1e-6
