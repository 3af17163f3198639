"""Free space: which configurations, and which straight lines of the planning coordinates (`coordinates`), are free.

A configuration is free if the scene does not hit it and, for a load, the cone's tilt is within a limit. A line is free
if its samples are, close enough together that nothing can touch in between (`swept_bound`).

Planning coordinates c have the shape (7,), lines are given by their ends; joints [rad] (n, 7).
"""

from collections.abc import Callable

import numpy as np

from scuhand_bt.motion.collision import Scene
from scuhand_bt.motion.coordinates import Coordinates, JointCoordinates
from scuhand_bt.motion.kinematics import Floats, Mount, axis_heights

_BATCH = 48
_GLANCES = ((0.5,), (0.25, 0.75), (0.12, 0.37, 0.62, 0.88))
"""Where lines are sampled first, as shares, in stages: lines that are hit drop out early."""
_MOST_SAMPLES = 400
"""Most samples of one line in level coordinates."""


class Space:
    """Free space in one system of coordinates: not hit by the scene, and within the tilt limit."""

    def __init__(
        self, coordinates: Coordinates, scene: Scene, mount: Mount, tilt_limit_deg: float | None = None
    ) -> None:
        self.coordinates = coordinates
        self.scene = scene
        self._mount = mount
        self._upright = None if tilt_limit_deg is None else float(np.cos(np.radians(tilt_limit_deg)))

    def edge(self, c0: Floats, c1: Floats) -> tuple[Floats, Floats]:
        """Shares (n,) and joints (n, 7) along the line, as dense as its proof needs."""
        if isinstance(self.coordinates, JointCoordinates):
            return self.scene.line(c0, c1)
        count = 12
        for _ in range(3):
            shares = np.linspace(0.0, 1.0, count)
            q = self.coordinates.joints(c0 + shares[:, None] * (c1 - c0))
            passed_m = float(self.scene.bound.passed_m(q).max())
            if passed_m <= self.scene.margin_m:
                break
            # A wrist passing its singularity would need thousands of samples. Its motion is proven later anyway.
            count = min(int((count - 1) * passed_m / (0.98 * self.scene.margin_m)) + 2, _MOST_SAMPLES)
        return shares, q

    def blocked(self, q: Floats) -> np.ndarray:
        """Which configurations (n, 7) are not free: (n,)."""
        return self._seen(q, self.scene.hits)

    def any_blocked(self, q: Floats) -> bool:
        """Whether any of the configurations (n, 7) is not free."""
        return bool(self._upright is not None and self._leans(q).any()) or self.scene.any_hit(q)

    def first_look(self, q: Floats) -> np.ndarray:
        """Most of those that are not free, at a fraction of the cost: (n,)."""
        return self._seen(q, self.scene.first_hits)

    def _seen(self, q: Floats, hits: Callable[[Floats], np.ndarray]) -> np.ndarray:
        if self._upright is None:
            return hits(q)
        blocked = self._leans(q)
        if not blocked.all():
            blocked[~blocked] = hits(q[~blocked])
        return blocked

    def _leans(self, q: Floats) -> np.ndarray:
        leans: np.ndarray = axis_heights(q, self._mount) < (self._upright or -1.0)
        return leans

    def glance(self, first: Floats, last: Floats) -> np.ndarray:
        """Which of the lines from (n, 7) to (n, 7) look free at a few samples, all tested at once: (n,)."""
        left = np.arange(len(first))
        for look in _GLANCES:
            shares = np.array(look)[:, None, None]
            lines = first[left] + shares * (last[left] - first[left])
            blocked = self.first_look(self.coordinates.joints(lines.reshape(-1, lines.shape[2])))
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
            some = q[begin : begin + _BATCH]
            free = self._free_ones(some)
            if free < len(some):
                last = begin + free - 1
                return c0 + max(shares[max(last, 0)], 0.0) * (c1 - c0), False
        return c1, True

    def _free_ones(self, q: Floats) -> int:
        """How many of the configurations (n, 7) are free before the first that is not."""
        for look in (self.first_look, self.blocked):
            blocked = look(q)
            if blocked.any():
                q = q[: int(np.argmax(blocked))]
        return len(q)

    def free(self, c0: Floats, c1: Floats) -> bool:
        """Whether the whole line is free."""
        if isinstance(self.coordinates, JointCoordinates) and self._upright is None:
            return self.scene.line_free(c0, c1)
        return not self.any_blocked(self.edge(c0, c1)[1])
