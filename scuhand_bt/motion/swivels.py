"""How the elbow swings along a course of poses: the quickest of all its ways, by dynamic programming.

    cost(k + 1, j) = min over i near j of  cost(k, i) + max over joints |q(k + 1, j) - q(k, i)| / v

plus the ways from the arm's position to the course and back. A state (k, i) is one of the four branches of the closed
form at one swivel angle, at one of the course's poses, within the joints' limits. Nine of ten touch nothing, so
contact is tested late. The grid's way is smoothed. Where the resulting course touches something, all states of the
poses there are tested, and the next way is searched. If they were tested before, the states near the way are given up.

Angles [rad], shapes: n poses, S swivel angles, 4 branches, 7 joints.
"""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.motion.collision import Scene
from scuhand_bt.motion.explain import closest_pair
from scuhand_bt.motion.inverse import along, branches_of, swivel_grid, swivel_of, within_limits
from scuhand_bt.motion.kinematics import Floats, Mount

LOOKED_AT = 32
"""How many poses of a course have states."""
SWING = 4
"""Largest step of the swivel from one of these poses to the next, in grid steps."""
JUMP_RAD = 0.6
"""A joint that would turn by more from one of these poses to the next has changed its branch."""
EVENED = 3
"""Over how many of these poses the swivel is averaged."""
GIVEN_UP = 2
"""How many states on both sides of one are given up with it."""
NEXT_RAD = 0.3
"""A state this close to a prescribed end may stand for it."""
TRIES = 8
"""How many ways are tried."""


def courses(
    poses: tuple[Floats, Floats, Floats],
    near: Floats,
    scene: Scene,
    speed: Floats,
    mount: Mount,
    ends: tuple[Floats, Floats] | None = None,
) -> Iterator[Floats]:
    """Configurations (n, 7) for positions, axes and seams (n, 3), free in the scene; the quickest first.

    Each is another course, begun and ended near `near`. With `ends`, all begin and end in those configurations (7,),
    which must belong to the first and the last pose. Raises SkillFailed arm.unreachable or arm.no_path, with the
    reason, when there are no more.
    """
    n = len(poses[0])
    at = np.unique(np.linspace(0, n - 1, LOOKED_AT).round().astype(int))
    grid = swivel_grid(mount, swivel_of(ends[0], mount) if ends is not None else 0.0)
    positions_m, axes, seams = (part[at] for part in poses)
    q = branches_of(positions_m, axes, seams, grid, mount)
    if q is None or not (open_ := within_limits(q, mount)).any(axis=(1, 2)).all():
        raise SkillFailed(Code.ARM_UNREACHABLE, "the arm cannot reach every pose of this motion")
    if mount.arm is not None and ends is None:
        open_[-1] &= mount.arm.is_bent_alike(q[-1], near, mount)
    if ends is not None:
        for k, end in zip((0, -1), ends, strict=True):
            open_[k] &= np.abs(q[k] - end).max(axis=2) < NEXT_RAD
    looked_at = np.zeros(len(at), dtype=bool)
    why, tries = "a joint would jump or leave its limits", TRIES
    while tries and (found := _quickest(q, open_, near, speed)) is not None:
        swivels, way = found
        phi = np.interp(np.arange(n), at, grid[0] + swivels * (2 * math.pi / len(grid)))
        if ends is not None:  # the grid's last swivel is only near the wanted one
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
                touched = np.unique(np.abs(at - np.flatnonzero(hits)[:, None]).argmin(axis=1))
                if not looked_at[touched].all():
                    _look(scene, q, open_, touched[~looked_at[touched]])
                    looked_at[touched] = True
                    continue
        k = int(np.argmin(np.abs(at - worst)))
        open_[k, np.arange(swivels[k] - GIVEN_UP, swivels[k] + GIVEN_UP + 1) % len(grid)] = False
        tries -= 1
    raise SkillFailed(Code.ARM_NO_PATH, why)


def _look(scene: Scene, q: Floats, open_: NDArray[np.bool_], poses: NDArray[np.int_]) -> None:
    """Close the states that touch something at these poses. Raises SkillFailed arm.no_path if that leaves none."""
    for k in poses:
        states = q[k][open_[k]]
        hits = scene.hits(states)
        if hits.all():
            raise SkillFailed(Code.ARM_NO_PATH, closest_pair(scene, states[0]))
        open_[k][open_[k]] = ~hits


def _quickest(
    q: Floats, open_: NDArray[np.bool_], near: Floats, speed: Floats
) -> tuple[NDArray[np.int_], Floats] | None:
    """The swivels (k,) of the quickest way through q (k, S, 4, 7), counted beyond a turn, and the way (k, 7)."""
    states = [q[k][open_[k]] for k in range(len(q))]
    swivels = [np.nonzero(open_[k])[0] for k in range(len(q))]
    cost, around = (np.abs(states[0] - near) / speed).max(axis=1), q.shape[1]
    came: list[NDArray[np.int_]] = []
    for k in range(1, len(q)):
        to, of = np.nonzero(np.abs(_steps(swivels[k][:, None] - swivels[k - 1], around)) <= SWING)
        turns = np.abs(states[k][to] - states[k - 1][of])
        total = np.full((len(states[k]), len(states[k - 1])), math.inf)
        total[to, of] = np.where((turns <= JUMP_RAD).all(axis=1), (turns / speed).max(axis=1) + cost[of], math.inf)
        if not total.size:
            return None
        came.append(total.argmin(axis=1))
        cost = total.min(axis=1)
    cost = cost + (np.abs(states[-1] - near) / speed).max(axis=1)
    if not np.isfinite(cost).any():
        return None
    way = [int(cost.argmin())]
    for choices in reversed(came):
        way.append(int(choices[way[-1]]))
    way.reverse()
    chosen = np.array([swivels[k][i] for k, i in enumerate(way)])
    chosen[1:] = chosen[0] + np.cumsum(_steps(np.diff(chosen), around))
    return chosen, np.array([states[k][i] for k, i in enumerate(way)])


def _steps(apart: NDArray[np.int_], around: int) -> NDArray[np.int_]:
    """Signed number of steps between swivels on a circle of `around` steps, the shorter way."""
    return (apart + around // 2) % around - around // 2


def _evened(phi: Floats, width: int) -> Floats:
    """Averaged twice over `width` (odd) samples, with the ends unchanged."""
    kernel = np.full(width, 1 / width)
    for _ in range(2):
        phi = np.convolve(np.pad(phi, width // 2, mode="reflect", reflect_type="odd"), kernel, mode="valid")
    return phi
