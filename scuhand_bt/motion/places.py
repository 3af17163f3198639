"""The named poses between which a cell moves, and the one configuration (posture) that the arm takes at each.

The posture is the configuration nearest to an arm that reaches straight out, over its elbow, in one upright plane.
Exactly in that plane joints 2 and 6 may pass through zero; a little beside it, joints about one line would have to
turn far. At places where only an empty cone comes the cone need not be level on its way; there it is the posture that
is reached and left most quickly (docs/motion.md, "Places").

Configurations [rad] (7,).
"""

from collections.abc import Iterator, Mapping
from contextlib import suppress

import numpy as np

from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.device_specs.hand import HandSpec
from scuhand_bt.failures import SkillFailed
from scuhand_bt.motion.decomposed import DecomposedArm
from scuhand_bt.motion.explain import goal_blocked, require_reachable
from scuhand_bt.motion.inverse import solutions
from scuhand_bt.motion.kinematics import COUNT_RAD, ApexPose, Floats, Mount, apex
from scuhand_bt.motion.recent import Recent
from scuhand_bt.motion.scenes import Geometry, Scenes
from scuhand_bt.motion.timelaw import RateLimits, rest_to_rest_s

RELAXED_RAD = (0.0, -0.2, 0.0, -1.9, 0.0, 0.0, 0.0)
"""The CRANE-X7's postures are chosen near this one, with j1 turned towards the place. For another arm the cell
has it."""
SETTLED_RAD = 2 * COUNT_RAD
"""How far an arm at rest may report to be from where it was sent."""
POSTURES_KEPT = 128
BESIDE_M = 0.02
"""An apex within this distance may be at a place."""


class Places:
    """Places by name, and their postures."""

    def __init__(
        self,
        scenes: Scenes,
        hand: HandSpec,
        arm: DecomposedArm | None,
        rates: RateLimits,
        visits_rad: Mapping[str, Floats],
    ) -> None:
        self._scenes, self._hand, self._arm, self._rates = scenes, hand, arm, rates
        self._visits_rad = visits_rad
        """For places where only an empty cone comes: the directions from which the arm comes and to which it goes."""
        self._relaxed_rad = RELAXED_RAD if arm is None else arm.relaxed_rad
        self._poses: dict[str, ApexPose] = {}
        self._postures: Recent[tuple[str, Geometry], Floats | SkillFailed] = Recent(POSTURES_KEPT)

    @property
    def names(self) -> list[str]:
        return list(self._poses)

    def add(self, name: str, pose: ApexPose) -> None:
        """Name a pose, or change it. Raises SkillFailed arm.unreachable if the arm cannot reach it."""
        require_reachable(pose, name, Mount.of(self._hand, arm=self._arm), self._scenes.of(Geometry()))
        self._poses[name] = pose
        self._postures = Recent(POSTURES_KEPT)

    def posture(self, name: str, geometry: Geometry) -> Floats:
        """The configuration in which the arm stands at a place; another one only if the geometry blocks it.

        Raises KeyError for an unknown name, SkillFailed arm.no_path if the arm cannot stand there at all.
        """
        if name not in self._poses:
            raise KeyError(f"there is no place {name!r}; there are: {', '.join(self._poses) or 'none'}")

        def made() -> Floats | SkillFailed:
            try:
                if geometry != geometry.usual:
                    usual = self.posture(name, geometry.usual)
                    if not self._scenes.of(geometry).hits(usual[None, :])[0]:
                        return usual
                return self._canonical(name, geometry)
            except SkillFailed as failure:  # kept, as a skill that waits for a zone asks again and again
                return failure.with_traceback(None)

        found = self._postures.of((name, geometry), made)
        if isinstance(found, SkillFailed):
            raise SkillFailed(found.code, found.detail)
        return found

    def is_posture(self, q: Floats, geometry: Geometry) -> bool:
        """Whether a configuration is one that the arm takes at a place, regardless of earlier requests."""
        return any(np.array_equal(posture, q) for posture in self._postures_at(q, geometry))

    def settled(self, q: Floats, geometry: Geometry) -> Floats:
        """The posture that the arm was sent to, if the reported one is within the arm's own error of it."""
        near = (one for one in self._postures_at(q, geometry) if np.abs(one - q).max() <= SETTLED_RAD)
        return next(near, q)

    def _postures_at(self, q: Floats, geometry: Geometry) -> Iterator[Floats]:
        """The postures of places near which the apex of a configuration is."""
        at_m = apex(q, Mount.of(self._hand, 1e3 * geometry.cone_diameter_m, self._arm)).position_m
        for name, pose in self._poses.items():
            if np.abs(pose.position_m - at_m).max() <= BESIDE_M:
                with suppress(SkillFailed):
                    yield self.posture(name, geometry)

    def _canonical(self, name: str, geometry: Geometry) -> Floats:
        pose, scene = self._poses[name], self._scenes.of(geometry)
        mount, visits_rad = Mount.of(self._hand, 1e3 * geometry.cone_diameter_m, self._arm), self._visits_rad.get(name)
        for looked_at in (reaching_out(pose, mount), pose) if visits_rad is None else (pose,):
            q = solutions(looked_at, mount, scene.limits_rad)
            free = q[~scene.hits(q)]
            if len(free):
                break
        else:
            raise goal_blocked(scene, name, q)
        if visits_rad is not None:
            ways = free[:, None] - self._relaxed(visits_rad)
            quickest: Floats = free[np.argmin(rest_to_rest_s(ways, self._rates).mean(axis=1))]
            return quickest
        relaxed = self._relaxed(np.arctan2(pose.position_m[1:2], pose.position_m[:1]))
        chosen: Floats = free[np.argmin(np.linalg.norm(free - relaxed, axis=1))]
        return chosen

    def _relaxed(self, azimuths_rad: Floats) -> Floats:
        """The arm reaching out in these directions (n,): (n, 7)."""
        relaxed = np.tile(np.array(self._relaxed_rad), (len(azimuths_rad), 1))
        relaxed[:, 0] += azimuths_rad
        return relaxed


def reaching_out(pose: ApexPose, mount: Mount) -> ApexPose:
    """The pose with the handle straight out from the arm's base. Between such postures mostly joint 1 moves."""
    out = np.array([pose.position_m[0], pose.position_m[1], 0.0])
    back = -(out - (out @ pose.axis) * pose.axis)
    length_m = float(np.linalg.norm(back))
    if pose.seam is not None or length_m < 1e-6:
        return pose
    seam = np.cos(mount.lean_rad) * pose.axis + np.sin(mount.lean_rad) * back / length_m
    return ApexPose(pose.position_m, pose.axis, seam)


def visits_rad(cell: CellSpec) -> dict[str, Floats]:
    """For stations where only an empty cone comes: the directions from which the arm comes and to which it goes."""
    from_and_to = [one.position_mm for one in cell.stations.values() if one.kind in ("mortar", "waste", "park")]
    directions_rad = np.array([np.arctan2(y, x) for x, y, _ in from_and_to])
    return {name: directions_rad for name, one in cell.stations.items() if one.kind == "service"}
