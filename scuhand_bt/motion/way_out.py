"""Moves the arm slowly out of what it touches (docs/motion.md, "Out of a collision").

A start that is hit, in the model, has no proven motion. If the overlap is small, as after the arm has sunk or was
pushed, the way out is the direction in which the signed distance d(q) grows most for the motion of any point:

    dq_j  ~  (dd/dq_j) / rho_j^2,      sum_j rho_j |dq_j| = 0.5 mm        (rho: `swept_bound`)

step by step, until nothing is nearer than 2 mm. The motion through these steps is then checked just as densely. What
was touched must never overlap more. What was free must keep 2 mm, or the smaller distance that it had, so nothing free
is touched in between either. No point of the arm moves faster than 10 mm/s.

Configurations [rad] (n,), distances [m], times [s].
"""

from collections.abc import Collection, Iterator
from collections.abc import Set as AbstractSet

import numpy as np

from scuhand_bt.failures import SkillFailed
from scuhand_bt.motion.collision import Scene
from scuhand_bt.motion.explain import closest_pair, start_in_collision
from scuhand_bt.motion.kinematics import Floats, Mount
from scuhand_bt.motion.spill import spill_stretch
from scuhand_bt.motion.timelaw import RateLimits
from scuhand_bt.motion.trajectory import JointTrajectory, through

CLEAR_M = 0.002
"""Clearance at the end of the way out: twice the planner's least margin."""
DEEPEST_M = 0.03
"""With a deeper overlap the cell is not as modelled, and no direction is known to lead out."""
SPEED_M_PER_S = 0.01
"""The fastest that any point of the arm moves."""
_STEP_M = 0.0005
_MOST_STEPS = 160
_TURN_RAD = 1e-4
"""Step of finite differences of the distances."""
_ROUNDING_M = 2e-5
_GRID_S = 0.05
_PEAK = 1.875
"""Largest slope of s(x) = 10 x^3 - 15 x^4 + 6 x^5."""


BY_HAND = "hold the arm, switch its supply off and on, lead it clear by hand, and resume"


class _NoWayOutError(Exception):
    """Why there is no way out, as text."""


def way_out(
    scene: Scene,
    begin: Floats,
    rates: RateLimits,
    mount: Mount,
    kept_in: Collection[str],
    spill_limit_deg: float | None,
) -> JointTrajectory:
    """From a configuration that is hit to one that is not, rest to rest; a load is kept within its spill angle.

    Raises SkillFailed arm.start_in_collision if there is no way, or if it touches a body in `kept_in`, which must not
    be left like this.
    """
    try:
        motion = _out(scene, begin, rates, scene.touched(begin) & set(kept_in))
        if spill_limit_deg is None:
            return motion
        if spill_stretch(motion, mount, spill_limit_deg) != 1.0:
            raise _NoWayOutError("on the way out the load would spill")
        return motion.keeping(spill_limit_deg)
    except _NoWayOutError as error:
        failure = start_in_collision(scene, begin)
        raise SkillFailed(failure.code, f"{failure.detail}; {error}; {BY_HAND}") from None


def _out(scene: Scene, begin: Floats, rates: RateLimits, held: AbstractSet[str]) -> JointTrajectory:
    if held:
        mortars = ", ".join(sorted(held))
        raise _NoWayOutError(
            f"the cone leaves {mortars} by `withdraw`; a workflow that goes on after a scoop must call it first"
        )
    if not scene.hits(begin[None, :])[0]:
        raise _NoWayOutError("this is not a collision")
    distances_m = scene.distances_m(begin)
    if distances_m.min() < -DEEPEST_M:
        raise _NoWayOutError(f"a way out is looked for only up to an overlap of {1e3 * DEEPEST_M:g} mm")
    motion = _slowly(scene, np.array(_steps(scene, begin, distances_m)))
    motion = motion.stretched(max(1.0, rates.stretch_for(motion)))
    _require_out(scene, motion)
    return motion


def _steps(scene: Scene, begin: Floats, began_m: Floats) -> list[Floats]:
    path = [begin]
    for _ in range(_MOST_STEPS):
        q = path[-1]
        now_m = scene.distances_m(q)
        if now_m.min() >= CLEAR_M:
            return path
        for direction in _directions(scene, q, now_m):
            after = np.clip(q + _STEP_M * direction, *scene.limits_rad)
            after_m = scene.distances_m(after)
            if after_m.min() > now_m.min() and _gets_freer(began_m, now_m, after_m):
                path.append(after)
                break
        else:
            break
    raise _NoWayOutError(f"no way out was found; after {len(path) - 1} steps {closest_pair(scene, path[-1])}")


def _directions(scene: Scene, q: Floats, now_m: Floats) -> Iterator[Floats]:
    """Steps per metre of motion: one increases the smallest distance, the others those of all pairs that are too
    near.
    """
    reach_m = scene.bound.reach_m
    turnable = reach_m > 0
    turns = _TURN_RAD * np.eye(len(q))[turnable]
    slopes = np.zeros((len(q), len(now_m)))
    slopes[turnable] = [(scene.distances_m(q + one) - scene.distances_m(q - one)) / (2 * _TURN_RAD) for one in turns]
    squares = np.where(turnable, reach_m, 1.0)[:, None] ** 2
    steps = slopes / squares * turnable[:, None]
    moved_m = np.maximum(np.abs(steps).T @ reach_m, 1e-9)
    steps /= moved_m
    near = np.flatnonzero(now_m < CLEAR_M)
    nearest = int(np.argmin(now_m))
    for share in (0.0, 0.5, 1.0, 2.0):
        step = steps[:, nearest] + share * steps[:, near].sum(axis=1)
        length_m = float(np.abs(step) @ reach_m)
        if length_m > 1e-9:
            yield step / length_m


def _gets_freer(began_m: Floats, now_m: Floats, after_m: Floats) -> bool:
    """Whether pairs that were too near at the start overlap no more than before, and all others keep their
    clearance.
    """
    was_near = began_m < CLEAR_M
    kept_m = np.where(was_near, np.minimum(now_m, CLEAR_M), CLEAR_M) - _ROUNDING_M
    return bool((after_m >= kept_m).all())


def _slowly(scene: Scene, path: Floats) -> JointTrajectory:
    """Along the steps (m, n), starting and ending gently."""
    along_m = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(path, axis=0)) @ scene.bound.reach_m)])
    duration_s = max(_PEAK * along_m[-1] / SPEED_M_PER_S, 4 * _GRID_S)
    times_s = np.linspace(0.0, duration_s, int(duration_s / _GRID_S) + 2)
    x = times_s / duration_s
    at_m = along_m[-1] * x**3 * (10 - 15 * x + 6 * x * x)
    return through(times_s, np.column_stack([np.interp(at_m, along_m, joint) for joint in path.T]))


def _require_out(scene: Scene, motion: JointTrajectory) -> None:
    """Check the motion so densely that no point passes its samples by more than a quarter of a step."""
    count = 2 + int(2 * SPEED_M_PER_S * motion.duration_s / _STEP_M)
    samples = motion.at(np.linspace(0.0, motion.duration_s, count))
    began_m = now_m = scene.distances_m(samples[0])
    for q in samples[1:]:
        after_m = scene.distances_m(q)
        if not _gets_freer(began_m, now_m, after_m):
            raise _NoWayOutError(f"the way out would come near something else: {closest_pair(scene, q)}")
        now_m = np.maximum(now_m, after_m)
    if scene.hits(samples[-1:])[0]:
        raise _NoWayOutError(f"no way out was found; at its end {closest_pair(scene, samples[-1])}")
