"""How far anything can move between two configurations, which makes samples a proof.

Turning joint j by dq_j moves whatever lies beyond it along an arc of radius rho_j at most. On a straight line of the
joints, the way of every point of the arm, seen from the base or from any link before it, is therefore no longer than

    L = sum_j rho_j |dq_j|        rho_j: largest distance [m] of anything beyond joint j from its axis

and every point passes the nearer of two neighbouring samples within L / 2.

Lengths in metres, angles in radians.
"""

import math
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin

from scuhand_bt.motion.decomposed import joint_axes
from scuhand_bt.motion.kinematics import Floats

_RIM_SIDES = 12


class SweptBound:
    """The bound for an arm with these shapes."""

    def __init__(self, shapes: pin.GeometryModel, model: pin.Model) -> None:
        self.reach_m = _reach_m([_Hull.of(thing) for thing in shapes.geometryObjects], model)

    def passed_m(self, q: Floats) -> Floats:
        """The distance within which every point passes the nearer of two neighbouring samples (n, 7): (n - 1,)."""
        passed: Floats = np.abs(q[1:] - q[:-1]) @ self.reach_m / 2
        return passed


@dataclass(frozen=True, slots=True)
class _Hull:
    """An enclosure of a shape: the convex hull of balls of one radius about points in its joint's frame."""

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
        elif not isinstance(shape, coal.Cylinder | coal.Cone):  # a ball, a mesh: by the box around it
            shape.computeLocalAABB()
            corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
            low, high = np.array(shape.aabb_local.min_), np.array(shape.aabb_local.max_)
            points = low + corners * (high - low)
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
    offsets_m = [np.asarray(model.jointPlacements[j + 1].translation) for j in range(model.nq)]
    axes = joint_axes(model)
    reach_m = np.zeros(model.nq)
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
