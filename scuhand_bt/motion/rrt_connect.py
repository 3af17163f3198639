"""RRT-Connect: a collision-free polyline from the start to any of the goals, on certified edges.

Two trees grow towards random points and towards each other (Kuffner and LaValle, "RRT-Connect", ICRA 2000). An edge is
a free line (`free_space`), and grows as far as it is free. Afterwards parts of the polyline are replaced by single
edges where these are free and quicker from rest to rest.

Planning coordinates c have the shape (7,), polylines (m, 7). Budgets are iterations; the caller provides the random
generator.
"""

from collections.abc import Callable

import numpy as np

from scuhand_bt.motion.free_space import Space
from scuhand_bt.motion.kinematics import Floats
from scuhand_bt.motion.timelaw import rest_to_rest_s

_REACH_M = 0.6
"""The longest edge grown at once, by the bound on motion."""


class _Tree:
    def __init__(self, roots: Floats, weights: Floats) -> None:
        self._nodes = np.empty((256, roots.shape[1]))
        self._nodes[: len(roots)] = roots
        self._parents = [-1] * len(roots)
        self._weights = weights

    def nearest(self, c: Floats) -> int:
        away = (self._nodes[: len(self._parents)] - c) * self._weights
        return int(np.argmin((away * away).sum(axis=1)))

    def node(self, k: int) -> Floats:
        node: Floats = self._nodes[k]
        return node

    def add(self, c: Floats, parent: int) -> int:
        if len(self._parents) == len(self._nodes):
            self._nodes = np.concatenate([self._nodes, np.empty_like(self._nodes)])
        self._nodes[len(self._parents)] = c
        self._parents.append(parent)
        return len(self._parents) - 1

    def to_root(self, k: int) -> list[Floats]:
        branch = []
        while k >= 0:
            branch.append(self._nodes[k].copy())
            k = self._parents[k]
        return branch


def connect(
    space: Space,
    start: Floats,
    goals: Floats,
    rng: np.random.Generator,
    iterations: int,
    ends: Callable[[], bool] = lambda: False,
) -> Floats | None:
    """A free polyline (m, 7) from start (7,) to one of the goals (n, 7); None if not found, or ended by `ends`."""
    weights = space.scene.bound.reach_m
    if len(goals) > 128:
        raise ValueError("choose among the goals first: at most 128 root a tree")
    ours, theirs = _Tree(start[None, :], weights), _Tree(goals, weights)
    forward = True
    for _ in range(iterations):
        if ends():
            break
        target = space.coordinates.draw(rng)
        near = ours.nearest(target)
        origin = ours.node(near).copy()
        length_m = float(np.abs(target - origin) @ weights)
        new, _ = space.advance(origin, origin + min(1.0, _REACH_M / length_m) * (target - origin))
        if not np.array_equal(new, origin):
            added = ours.add(new, near)
            other = theirs.nearest(new)
            met, whole = space.advance(theirs.node(other).copy(), new)
            if whole:
                one, two = ours.to_root(added), theirs.to_root(other)
                path = one[::-1] + two if forward else two[::-1] + one
                return np.array(path)
            if not np.array_equal(met, theirs.node(other)):
                theirs.add(met, other)
        ours, theirs, forward = theirs, ours, not forward
    return None


def shortened(space: Space, path: Floats, rng: np.random.Generator, tries: int) -> Floats:
    """The polyline with parts replaced by single edges where that is free and quicker."""
    limits = space.coordinates.rates
    points = list(path)
    for _ in range(tries):
        if len(points) < 3:
            break
        i, j = sorted(rng.choice(len(points) - 1, size=2, replace=len(points) == 3))
        if i == j:
            continue
        first = points[i] + rng.uniform() * (points[i + 1] - points[i]) if rng.uniform() < 0.6 else points[i]
        last = points[j] + rng.uniform() * (points[j + 1] - points[j]) if rng.uniform() < 0.6 else points[j + 1]
        now_s = rest_to_rest_s(np.diff(np.array([first, *points[i + 1 : j + 1], last]), axis=0), limits).sum()
        if rest_to_rest_s(last - first, limits) < now_s and space.free(first, last):
            points = [*points[: i + 1], first, last, *points[j + 1 :]]
            points = [p for k, p in enumerate(points) if k == 0 or not np.array_equal(p, points[k - 1])]
    return np.array(points)
