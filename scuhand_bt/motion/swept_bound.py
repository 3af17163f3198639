"""How far anything can move between two configurations: what makes samples a proof.

Everything beyond the shoulder lies around one of three segments: shoulder to elbow, elbow to wrist,
wrist to the tip of the hand. Seen from any link a before it, a point of such a segment moves no farther
than the farther of the segment's two ends, and what lies a distance r beside it by r times the turn
more. So on a straight line of the joints every point of the arm passes its neighbouring samples within

    d = 1/2 (max_a |change of elbow, wrist, tip| + r sum_j |dq_j|)  +  1/8 (sum_j |dq_j|) L
    L = sum_j rho_j |dq_j|        rho_j: largest distance [m] of anything beyond joint j from its axis

The last term is what the point's own path bulges over its chord: its second derivative by the line's
parameter is at most sum_ij rho |dq_i| |dq_j|. The maximum over the links a holds for parts of the arm
against each other, the one with a = 0, the base, for parts against the cell.

Lengths in metres, angles in radians.
"""

import math
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin

from scuhand_bt.motion.kinematics import JOINTS, LINK_M, SHOULDER_Z_M, WRIST_TO_FLANGE_M, Floats

_RIM_SIDES = 12


class MotionBound:
    """The bound for an arm of these shapes."""

    def __init__(self, shapes: pin.GeometryModel, model: pin.Model) -> None:
        hulls = [_Hull.of(thing) for thing in shapes.geometryObjects]
        self.reach_m = _reach_m(hulls, model)
        self._hand_m = WRIST_TO_FLANGE_M + max(hull.points[:, 2].max() for hull in hulls if hull.joint == JOINTS)
        self._beside_m = _beside_m(hulls, model, self._hand_m)

    def passed_m(self, q: Floats) -> Floats:
        """Within what distance every point passes the nearer of two neighbouring samples (n, 7): (n - 1,)."""
        turns = np.abs(q[1:] - q[:-1])
        turned = turns.sum(axis=1)
        ends_m = self._ends_m(q)
        dx, dy, dz = ends_m[:, :, 1:] - ends_m[:, :, :-1]
        moved_m = np.sqrt((dx * dx + dy * dy + dz * dz).max(axis=0))
        passed: Floats = (moved_m + self._beside_m * turned) / 2 + turned * (turns @ self.reach_m) / 8
        return passed

    def _ends_m(self, q: Floats) -> Floats:
        """The segments' ends, up to constants, as every link before them sees them: (3, 11, n)."""
        c, s = np.cos(q.T), np.sin(q.T)
        at = np.empty((3, 11, len(q)))
        x, y, z = at
        # The hand's tip seen from the fore arm's root; a turn about z follows one about -y.
        across_m = -self._hand_m * s[5]
        x[0], y[0], z[0] = c[4] * across_m, s[4] * across_m, self._hand_m * c[5] + LINK_M
        # Tip and wrist seen from the upper arm, and from its root.
        x[1], y[1], z[1] = c[3] * x[0] - s[3] * z[0], y[0], s[3] * x[0] + c[3] * z[0]
        x[2], y[2], z[2] = -s[3] * LINK_M, 0.0, c[3] * LINK_M
        x[3:5], y[3:5], z[3:5] = c[2] * x[1:3] - s[2] * y[1:3], s[2] * x[1:3] + c[2] * y[1:3], z[1:3] + LINK_M
        # Tip, wrist and elbow seen from the shoulder, and from the base.
        x[5:7], y[5:7], z[5:7] = c[1] * x[3:5] - s[1] * z[3:5], y[3:5], s[1] * x[3:5] + c[1] * z[3:5]
        x[7], y[7], z[7] = -s[1] * LINK_M, 0.0, c[1] * LINK_M
        x[8:], y[8:], z[8:] = c[0] * x[5:8] - s[0] * y[5:8], s[0] * x[5:8] + c[0] * y[5:8], z[5:8]
        return at


@dataclass(frozen=True, slots=True)
class _Hull:
    """A shape enclosed: balls of one radius around points in its joint's frame, and all between them."""

    joint: int
    points: Floats
    radius_m: float

    @classmethod
    def of(cls, thing: pin.GeometryObject) -> "_Hull":
        shape, radius_m = thing.geometry, 0.0
        if isinstance(shape, coal.Box):
            points = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * shape.halfSide
        elif isinstance(shape, coal.Capsule):
            points, radius_m = np.array([[0.0, 0.0, -shape.halfLength], [0.0, 0.0, shape.halfLength]]), shape.radius
        else:
            angles = np.arange(_RIM_SIDES) * 2 * math.pi / _RIM_SIDES
            outer_m = shape.radius / math.cos(math.pi / _RIM_SIDES)
            rim = np.stack([np.cos(angles) * outer_m, np.sin(angles) * outer_m], axis=1)
            low, high = (np.column_stack([rim, np.full(_RIM_SIDES, z)]) for z in (-shape.halfLength, shape.halfLength))
            points = np.vstack([low, high[:1] * (0, 0, 1) if isinstance(shape, coal.Cone) else high])
        placement = thing.placement
        return cls(thing.parentJoint, points @ placement.rotation.T + placement.translation, radius_m)


def _reach_m(hulls: list[_Hull], model: pin.Model) -> Floats:
    """rho_j of every joint: the farthest point beyond it from its axis, over all configurations."""
    offsets_m = [np.asarray(model.jointPlacements[j].translation) for j in range(1, JOINTS + 1)]
    axes = [np.array([0.0, 0.0, 1.0]) if j % 2 == 0 else np.array([0.0, 1.0, 0.0]) for j in range(JOINTS)]
    reach_m = np.zeros(JOINTS)
    for hull in hulls:
        for j in range(hull.joint):
            here = hull.points if hull.joint == j + 1 else offsets_m[j + 1][None, :]
            off_axis = here - (here @ axes[j])[:, None] * axes[j]
            distance_m = float(np.linalg.norm(off_axis, axis=1).max()) + hull.radius_m
            for k in range(j + 2, hull.joint):
                distance_m += float(np.linalg.norm(offsets_m[k]))
            if hull.joint > j + 1:
                distance_m += float(np.linalg.norm(hull.points, axis=1).max())
            reach_m[j] = max(reach_m[j], distance_m)
    return reach_m


def _beside_m(hulls: list[_Hull], model: pin.Model, hand_m: float) -> float:
    """How far anything that moves lies beside its link's segment at most."""
    origins_m = np.cumsum([model.jointPlacements[j].translation[2] for j in range(1, JOINTS + 1)])
    elbow_m, wrist_m = SHOULDER_Z_M + LINK_M, SHOULDER_Z_M + 2 * LINK_M
    segments_m = {2: (SHOULDER_Z_M, elbow_m), 4: (elbow_m, wrist_m), 6: (wrist_m, wrist_m + hand_m)}
    beside_m = 0.0
    for hull in hulls:
        # Base and shoulder stand or turn on the spot: nothing is proven of them.
        if hull.joint >= 2:
            low_m, high_m = (end_m - origins_m[hull.joint - 1] for end_m in segments_m[hull.joint - hull.joint % 2])
            off = hull.points.copy()
            off[:, 2] -= np.clip(off[:, 2], low_m, high_m)
            beside_m = max(beside_m, float(np.linalg.norm(off, axis=1).max()) + hull.radius_m)
    return beside_m
