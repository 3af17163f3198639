"""A collision-free polyline from the start to any of the goals: RRT-Connect on certified edges.

Two trees grow towards random points and towards each other [Kuffner and LaValle, "RRT-Connect", ICRA
2000]. An edge is a straight line of the chart, sampled so closely that nothing can touch in between
(`collision`), and grows as far as it is free. Shortcuts then replace pieces of the polyline by one
edge wherever that is free and quicker from rest to rest.

Chart coordinates c shape (7,); polylines (m, 7). Budgets are iterations; randomness is the caller's.
"""

from collections.abc import Callable

import numpy as np

from scuhand_bt.motion.collision import Scene
from scuhand_bt.motion.coordinates import Chart, JointChart
from scuhand_bt.motion.kinematics import Floats, apex_positions_m
from scuhand_bt.motion.timelaw import rest_to_rest_s

_BATCH = 48
_GLANCES = ((0.5,), (0.25, 0.75), (0.12, 0.37, 0.62, 0.88))
"""Where lines are glanced at, as shares: those that are hit drop out early."""
_MOST_SAMPLES = 400
_REACH_M = 0.6
"""The longest edge grown at once, by the bound on motion."""


class Space:
    """What is free: configurations of a chart that the scene does not hit and that keep the cone upright."""

    def __init__(self, chart: Chart, scene: Scene, tilt_limit_deg: float | None = None) -> None:
        self.chart = chart
        self.scene = scene
        self._upright = None if tilt_limit_deg is None else float(np.cos(np.radians(tilt_limit_deg)))

    def edge(self, c0: Floats, c1: Floats) -> tuple[Floats, Floats]:
        """Shares (n,) and joints (n, 7) along the line, as close together as its proof needs."""
        if isinstance(self.chart, JointChart):
            return self.scene.line(c0, c1)
        count = 12
        for _ in range(3):
            shares = np.linspace(0.0, 1.0, count)
            q = self.chart.joints(c0 + shares[:, None] * (c1 - c0))
            passed_m = float(self.scene.bound.passed_m(q).max())
            if passed_m <= self.scene.margin_m:
                break
            # A wrist that turns fast past its singularity would ask for thousands; its motion is proven later, or not.
            count = min(int((count - 1) * passed_m / (0.98 * self.scene.margin_m)) + 2, _MOST_SAMPLES)
        return shares, q

    def blocked(self, q: Floats) -> np.ndarray:
        """Which configurations (n, 7) are not free: (n,)."""
        return self._seen(q, self.scene.hits)

    def first_look(self, q: Floats) -> np.ndarray:
        """Most of those that are not free, at a fraction of the price: (n,)."""
        return self._seen(q, self.scene.first_hits)

    def _seen(self, q: Floats, hits: Callable[[Floats], np.ndarray]) -> np.ndarray:
        if self._upright is None:
            return hits(q)
        blocked = self._leans(q)
        if not blocked.all():
            blocked[~blocked] = hits(q[~blocked])
        return blocked

    def _leans(self, q: Floats) -> np.ndarray:
        leans: np.ndarray = apex_positions_m(q, 0.0)[1][:, 2] < (self._upright or -1.0)
        return leans

    def glance(self, first: Floats, last: Floats) -> np.ndarray:
        """Which of the lines from (n, 7) to (n, 7) look free at a few samples, all looked at in one go: (n,)."""
        left = np.arange(len(first))
        for look in _GLANCES:
            shares = np.array(look)[:, None, None]
            lines = first[left] + shares * (last[left] - first[left])
            blocked = self.first_look(self.chart.joints(lines.reshape(-1, lines.shape[2])))
            left = left[~blocked.reshape(len(look), -1).any(axis=0)]
            if not len(left):
                break
        free = np.zeros(len(first), dtype=bool)
        free[left] = True
        return free

    def advance(self, c0: Floats, c1: Floats) -> tuple[Floats, bool]:
        """How far the line from c0 to c1 is free, and whether that is all of it."""
        shares, q = self.edge(c0, c1)
        for begin in range(0, len(q), _BATCH):
            blocked = self.blocked(q[begin : begin + _BATCH])
            if blocked.any():
                last = begin + int(np.argmax(blocked)) - 1
                return c0 + max(shares[max(last, 0)], 0.0) * (c1 - c0), False
        return c1, True

    def free(self, c0: Floats, c1: Floats) -> bool:
        """Whether all of the line is free."""
        if isinstance(self.chart, JointChart) and self._upright is None:
            return self.scene.line_free(c0, c1)
        _, q = self.edge(c0, c1)
        if self._upright is not None and self._leans(q).any():
            return False
        return not self.scene.any_hit(q)


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


def connect(space: Space, start: Floats, goals: Floats, rng: np.random.Generator, iterations: int) -> Floats | None:
    """A free polyline (m, 7) from start (7,) to one of goals (n, 7), or None within the iterations."""
    weights = space.scene.bound.reach_m
    if len(goals) > 128:
        raise ValueError("choose among the goals first: at most 128 root a tree")
    ours, theirs = _Tree(start[None, :], weights), _Tree(goals, weights)
    forward = True
    for _ in range(iterations):
        target = space.chart.draw(rng)
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
    """The polyline with pieces replaced by single edges where that is free and quicker."""
    limits = space.chart.rates
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
