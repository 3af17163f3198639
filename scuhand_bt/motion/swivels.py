"""How the elbow swings along a course of poses: the quickest of all its ways round, by dynamic programming.

    cost(k + 1, j) = min over i near j of  cost(k, i) + max over joints |q(k + 1, j) - q(k, i)| / v

with the ways from where the arm is to the course, and back, at its ends.
A state (k, i) is one of the four branches of the closed form at one swivel angle, at one of the course's poses; those
outside the joints' limits, or in touch with something, are none. The grid's way is evened before it is followed; where
that touches something after all, the states there are given up, and the next way is looked for.

Angles [rad], shapes: n poses, S swivel angles, 4 branches, 7 joints.
"""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.motion.collision import Scene
from scuhand_bt.motion.explain import closest_pair
from scuhand_bt.motion.inverse import along, branches_of, swivel_of, within_limits
from scuhand_bt.motion.kinematics import Floats, Mount

SWIVELS = 72
LOOKED_AT = 32
"""Poses of a course whose configurations are looked at."""
SWING = 4
"""Steps of the swivels' grid from one of these poses to the next, at most."""
JUMP_RAD = 0.6
"""A joint that would turn by more from one of these poses to the next has changed the branch."""
EVENED = 3
"""How many of these poses the swivel is averaged over."""
GIVEN_UP = 2
"""States on both sides of one that is given up."""
NEXT_RAD = 0.3
"""A state so near to the end of a course stands for it."""
TRIES = 8


def courses(
    poses: tuple[Floats, Floats, Floats],
    near: Floats,
    scene: Scene,
    speed: Floats,
    mount: Mount,
    ends: tuple[Floats, Floats] | None = None,
) -> Iterator[Floats]:
    """Configurations (n, 7) of positions, axes and seams (n, 3), free in the scene; the quickest first.

    Each is a course of its own, begun and ended near to `near`; with `ends` all begin and end in those configurations
    (7,), which are of the first and the last pose. SkillFailed arm.unreachable or arm.no_path with the reason, when
    there is no other any more.
    """
    n = len(poses[0])
    at = np.unique(np.linspace(0, n - 1, LOOKED_AT).round().astype(int))
    grid = 2 * math.pi * np.arange(SWIVELS) / SWIVELS + (swivel_of(ends[0], mount) if ends is not None else 0.0)
    positions_m, axes, seams = (part[at] for part in poses)
    q = branches_of(positions_m, axes, seams, grid, mount)
    if q is None or not (within := within_limits(q)).any(axis=(1, 2)).all():
        raise SkillFailed(Code.ARM_UNREACHABLE, "the arm cannot reach all of it")
    free = within.copy()
    free[within] = ~scene.hits(q[within])
    if ends is not None:
        for k, end in zip((0, -1), ends, strict=True):
            free[k] &= np.abs(q[k] - end).max(axis=2) < NEXT_RAD
    if not free.any(axis=(1, 2)).all():
        blocked = int(np.argmin(free.any(axis=(1, 2))))
        raise SkillFailed(Code.ARM_NO_PATH, closest_pair(scene, q[blocked][within[blocked]][0]))
    why = "a joint would jump or leave its limits"
    for _ in range(TRIES):
        found = _quickest(q, free, near, speed)
        if found is None:
            break
        swivels, way = found
        phi = np.interp(np.arange(n), at, grid[0] + swivels * (grid[1] - grid[0]))
        if ends is not None:  # the last swivel of the grid is near to the wanted one
            phi += np.linspace(0.0, math.remainder(swivel_of(ends[1], mount) - phi[-1], 2 * math.pi), n)
        course = along(*poses, _evened(phi, EVENED * n // LOOKED_AT | 1), way[0], mount)
        worst = at[1 + int(np.abs(np.diff(way, axis=0)).max(axis=1).argmax())]
        if course is not None:
            hits = scene.hits(course)
            if not hits.any():
                yield course
            else:
                worst = int(np.argmax(hits))
                why = closest_pair(scene, course[worst])
        k = int(np.argmin(np.abs(at - worst)))
        free[k, np.arange(swivels[k] - GIVEN_UP, swivels[k] + GIVEN_UP + 1) % SWIVELS] = False
    raise SkillFailed(Code.ARM_NO_PATH, why)


def _quickest(
    q: Floats, free: NDArray[np.bool_], near: Floats, speed: Floats
) -> tuple[NDArray[np.int_], Floats] | None:
    """The swivels (k,) of the quickest way through q (k, S, 4, 7), counted on beyond a turn, and the way (k, 7)."""
    steps = np.arange(-SWING, SWING + 1)
    before = (np.arange(SWIVELS)[:, None] - steps) % SWIVELS  # (S, steps)
    cost = np.where(free[0], (np.abs(q[0] - near) / speed).max(axis=2), math.inf)
    came: list[NDArray[np.int_]] = []
    for k in range(1, len(q)):
        turns = np.abs(q[k][:, None, None] - q[k - 1][before][:, :, :, None])  # (S, steps, 4 before, 4, 7)
        total = (turns / speed).max(axis=4) + cost[before][:, :, :, None]
        total[turns.max(axis=4) > JUMP_RAD] = math.inf
        total = total.reshape(SWIVELS, -1, 4)
        came.append(total.argmin(axis=1))
        cost = np.where(free[k], total.min(axis=1), math.inf)
    cost += (np.abs(q[-1] - near) / speed).max(axis=2)
    if not np.isfinite(cost).any():
        return None
    swivel, branch = divmod(int(cost.argmin()), 4)
    swivels, way = [swivel], [q[-1, swivel, branch]]
    for k, choices in zip(reversed(range(len(came))), reversed(came), strict=True):
        step, branch = divmod(int(choices[swivels[-1] % SWIVELS, branch]), 4)
        swivels.append(swivels[-1] - int(steps[step]))
        way.append(q[k, swivels[-1] % SWIVELS, branch])
    return np.array(swivels[::-1]), np.array(way[::-1])


def _evened(phi: Floats, width: int) -> Floats:
    """Averaged twice over so many (an odd number), its ends as they are."""
    kernel = np.full(width, 1 / width)
    for _ in range(2):
        phi = np.convolve(np.pad(phi, width // 2, mode="reflect", reflect_type="odd"), kernel, mode="valid")
    return phi
