"""Requests for motions: start, goals, geometry, the load's limit, and the effort.

A request is the key under which a plan is kept, in memory and on disk, and seeds its search. So it has the same answer
on every machine with the same versions. Joints [rad] are kept as the bytes of (n,) and (m, n).
"""

import hashlib
from dataclasses import dataclass

import numpy as np

from scuhand_bt.motion.kinematics import Floats
from scuhand_bt.motion.scenes import Geometry
from scuhand_bt.motion.trajectory import JointTrajectory
from scuhand_bt.motion.transfer import Effort

SAME_RAD = 1e-9
"""Tolerance for rounding of a plan's ends."""


@dataclass(frozen=True, slots=True)
class Request:
    """One requested motion; `spill_limit_deg` is None for an empty cone."""

    begin: bytes
    goals: bytes
    geometry: Geometry
    spill_limit_deg: float | None
    effort: Effort

    @classmethod
    def of(
        cls, begin: Floats, goals: Floats, geometry: Geometry, spill_limit_deg: float | None, effort: Effort
    ) -> "Request":
        """From a start (n,) to any of the goals (m, n)."""
        return cls(begin.tobytes(), goals.tobytes(), geometry, spill_limit_deg, effort)

    @property
    def seed(self) -> int:
        """The seed of its search; the same for any effort."""
        geometry, kind = self.geometry, ""
        if geometry.container is not None:
            kind = geometry.container.name
        words = " ".join([f"{geometry.cone_diameter_m} {kind} {self.spill_limit_deg}", *sorted(geometry.closed)])
        return int.from_bytes(hashlib.blake2b(self.begin + self.goals + words.encode(), digest_size=16).digest(), "big")

    @property
    def written(self) -> str:
        """A text that is the same in every process."""
        seen = f"{self.geometry.cone_diameter_m} {self.geometry.container!r} {sorted(self.geometry.closed)}"
        return f"{self.begin!r} {self.goals!r} {seen} {self.spill_limit_deg} {self.effort!r}"

    def has_ends_of(self, motion: JointTrajectory) -> bool:
        """Whether a motion leads from its start to one of its goals."""
        begin = np.frombuffer(self.begin)
        ends = np.frombuffer(self.goals).reshape(-1, len(begin)) - motion.end
        return bool(max(np.abs(begin - motion.start).max(), np.abs(ends).max(axis=1).min()) <= SAME_RAD)
