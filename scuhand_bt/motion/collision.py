"""Collisions of the arm with itself and the cell, and a proof for whole motions (docs/motion.md, "No contact").

*Nothing can touch between two samples* under two conditions. Both keep a clearance of m from everything, and between
them every point of the arm passes within m of its position at one of them (`swept_bound`). A curve over time, sampled
every h seconds, may leave the line between its samples by a h^2/8 per joint (a: its acceleration), which is added.

This module and `arm_model` also contain every trap of the libraries below them:

* Unknown names give no error, so look-ups here raise.
* Data made before a model changed crash the process, so models are complete before their data are made.
* With a security margin of zero coal misses real penetrations, so the margin is never zero.
* Pools copy their models, so a scene is never edited: new geometry needs a new scene.

Positions in metres, configurations in radians, shape (n, 7).
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from scuhand_bt.motion.arm_model import CONE, Arm
from scuhand_bt.motion.kinematics import Floats
from scuhand_bt.motion.near_links import LINKS_APART, turns_on_the_spot
from scuhand_bt.motion.swept_bound import SweptBound
from scuhand_bt.motion.trajectory import JointTrajectory

SMALLEST_MARGIN_M = 1e-4
_FIRST_SAMPLES = 12
_LOOKED_AT_ONCE = 64
_FOREMOST = (CONE, "fore_0")
"""The shapes with most of the hits: the cone where it is widest, and the arm above it."""
_GLANCED_AT = np.array([0.5, 0.25, 0.75, 0.12, 0.37, 0.62, 0.88, 0.06, 0.19, 0.31, 0.44, 0.56, 0.69, 0.81, 0.94])
"""Samples of a curve that are checked first, as shares of it; the likeliest hits come first."""
_WIDE = 4.0
"""Multiple of the margin. A motion that keeps so much from everything is proven with so many times fewer samples."""


CurveAt: TypeAlias = Callable[[Floats], Floats]
"""A motion: times (n,) to configurations (n, 7)."""


@dataclass(frozen=True, slots=True)
class Solid:
    """A solid in the cell, by its centre: a box (x, y, z), an upright cylinder (diameter, length) or a mesh."""

    name: str
    centre_m: tuple[float, float, float]
    box_m: tuple[float, float, float] | None = None
    cylinder_m: tuple[float, float] | None = None
    yaw_rad: float = 0.0
    mesh: coal.BVHModelBase | coal.OcTree | None = None

    def shape(self) -> coal.CollisionGeometry:
        if self.box_m is not None:
            return coal.Box(*self.box_m)
        if self.cylinder_m is not None:
            return coal.Cylinder(self.cylinder_m[0] / 2, self.cylinder_m[1])
        if self.mesh is not None:
            return self.mesh
        raise ValueError(f"{self.name} is neither a box nor a cylinder nor a mesh")

    @property
    def top_m(self) -> float:
        """Height of its top."""
        if self.mesh is not None:
            return self.centre_m[2] + float(self.mesh.aabb_local.max_[2])
        height_m = self.box_m[2] if self.box_m is not None else self.cylinder_m[1] if self.cylinder_m else 0.0
        return self.centre_m[2] + height_m / 2

    def placement(self) -> pin.SE3:
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return pin.SE3(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), np.array(self.centre_m))


class Scene:
    """The arm with one size of cone in one state of the cell; immutable.

    `may_touch` names solids that the sheet may touch (the mortar of a scoop); `around` encloses them. `margin_m` is
    the distance from everything that a configuration must keep to count as free.
    """

    def __init__(
        self,
        arm: Arm,
        shapes: pin.GeometryModel,
        solids: Sequence[Solid],
        margin_m: float,
        may_touch: Iterable[str] = (),
        around: Solid | None = None,
    ) -> None:
        if margin_m < SMALLEST_MARGIN_M:
            raise ValueError("coal misses penetrations when its security margin is zero")
        self.margin_m = margin_m
        self.limits_rad = arm.limits_rad
        self.arm_shapes = arm.shapes.ngeoms
        """How many of `shapes`, from the first, are the URDF's."""
        self.model = arm.model
        self.bound = SweptBound(shapes, arm.model)
        touchable = set(may_touch)
        self.shapes = _among(arm, shapes, solids, touchable)
        others = [solid for solid in solids if solid.name not in touchable]
        self._foremost = _foremost(arm, shapes, others)
        self._enclosed = None if around is None else _among(arm, shapes, [*others, around], {around.name})
        # The models are complete now; data may only be made after that.
        self._data = self.model.createData()

    @cached_property
    def _all(self) -> "_Pairs":
        return _Pairs(self.model, self.shapes)

    @cached_property
    def _first(self) -> "_Pairs":
        return _Pairs(self.model, self._foremost)

    @cached_property
    def _outer(self) -> "_Pairs | None":
        return None if self._enclosed is None else _Pairs(self.model, self._enclosed)

    def hits(self, q: Floats) -> NDArray[np.bool_]:
        """Which configurations (n, 7) are nearer than the margin to anything, or beyond the joints' limits: (n,)
        bool.
        """
        hit = self._outside(q)
        left = ~hit
        if left.any():
            hit[left] = self._nearer(q[left], self.margin_m)
        return hit

    def _nearer(self, q: Floats, margin_m: float, until_first: bool = False) -> NDArray[np.bool_]:
        """As `_Pairs.nearer`. A hollow mortar's 200 solids are checked only if the cylinder around them is near.

        For most configurations of a stroke it is not, and the test takes a seventh of the time.
        """
        if self._outer is None:
            return self._all.nearer(q, margin_m, until_first)
        near = self._outer.nearer(q, margin_m)
        if near.any():
            near[near] = self._all.nearer(q[near], margin_m, until_first)
        return near

    def _outside(self, q: Floats) -> NDArray[np.bool_]:
        outside: NDArray[np.bool_] = ((q < self.limits_rad[0] - 1e-9) | (q > self.limits_rad[1] + 1e-9)).any(axis=1)
        return outside

    def first_hits(self, q: Floats) -> NDArray[np.bool_]:
        """Most of the hits among the configurations (n, 7): cone and fore arm against the tallest solids, (n,) bool.

        Costs a sixth of `hits`, which spends most of its time on updating shapes that rarely matter.
        """
        return self._first.nearer(q, self.margin_m)

    def any_hit(self, q: Floats) -> bool:
        """Whether any configuration of a path (n, 7) is hit."""
        return bool(self._outside(q).any() or self._nearer(q, self.margin_m, until_first=True).any())

    def first_hit(self, q: Floats) -> Floats | None:
        """The first configuration (7,) of a path (n, 7) that is hit, searched a few at a time; None if none is."""
        for begin in range(0, len(q), _LOOKED_AT_ONCE):
            some = q[begin : begin + _LOOKED_AT_ONCE]
            hits = self.hits(some)
            if hits.any():
                first: Floats = some[int(np.argmax(hits))]
                return first
        return None

    def clearance_m(self, q: Floats) -> tuple[float, str]:
        """Exact distance of the closest pair at one configuration, negative inside, and the two names."""
        distances_m = self.distances_m(q)
        nearest = int(np.argmin(distances_m))
        pair = self.shapes.collisionPairs[nearest]
        names = [self.shapes.geometryObjects[k].name.rsplit("_0", 1)[0] for k in (pair.first, pair.second)]
        return float(distances_m[nearest]), " and ".join(names)

    def distances_m(self, q: Floats) -> Floats:
        """Exact distances of all pairs at one configuration, negative inside: (pairs,)."""
        data = self._all.data
        pin.computeDistances(self.model, self._data, self.shapes, data, q)
        return np.array([result.min_distance for result in data.distanceResults])

    def touched(self, q: Floats) -> frozenset[str]:
        """The names of all solids of the cell nearer than the margin at one configuration."""
        near = np.flatnonzero(self.distances_m(q) < self.margin_m)
        seconds = (self.shapes.geometryObjects[self.shapes.collisionPairs[int(k)].second] for k in near)
        return frozenset(thing.name for thing in seconds if thing.parentJoint == 0)

    def line(self, q0: Floats, q1: Floats) -> tuple[Floats, Floats]:
        """Shares (n,) and configurations (n, 7) along the straight joint path, dense enough to prove it."""
        return self.proving_samples(lambda shares: q0 + shares[:, None] * (q1 - q0), 1.0, 0 * q0)

    def line_free(self, q0: Floats, q1: Floats) -> bool:
        """Whether the straight joint path between two configurations is proven free."""
        return self.curve_free(lambda shares: q0 + shares[:, None] * (q1 - q0), 1.0, 0 * q0)

    def curve_free(self, positions_at: CurveAt, duration_s: float, acceleration: Floats) -> bool:
        """Whether a curve over time is proven free; `acceleration` (7,) bounds that of its joints.

        First with a wide margin, which needs few samples; densely only where that margin is not kept.
        """
        wide_m = _WIDE * self.margin_m
        times_s, q = self.proving_samples(positions_at, duration_s, acceleration, wide_m)
        # A curve that is hit is mostly hit at many samples; a few suffice, at a tenth of the cost.
        if self.any_hit(q[(_GLANCED_AT * (len(q) - 1)).astype(int)]):
            return False
        near = self._nearer(q, wide_m)
        if not near.any():
            return True
        if self.any_hit(q[near]):
            return False
        allowed_m = np.where(near[:-1] | near[1:], self.margin_m, wide_m)
        between_s, q = self._closer(positions_at, times_s, q, acceleration, allowed_m)
        return not self.any_hit(q[~np.isin(between_s, times_s)])

    def proves(self, motion: JointTrajectory) -> bool:
        """Whether a motion is proven to touch nothing and to keep the joints' limits throughout."""
        if self._outside(np.stack(motion.span())).any():
            return False
        return self.curve_free(motion.at, motion.duration_s, motion.extremes()[1])

    def proving_samples(
        self, positions_at: CurveAt, duration_s: float, acceleration: Floats, margin_m: float | None = None
    ) -> tuple[Floats, Floats]:
        """Times (n,) and configurations (n, 7) that, if free by the margin, prove the whole curve free."""
        times_s = np.linspace(0.0, duration_s, _FIRST_SAMPLES)
        allowed_m = np.full(len(times_s) - 1, margin_m or self.margin_m)
        return self._closer(positions_at, times_s, positions_at(times_s), acceleration, allowed_m)

    def _passed_m(self, times_s: Floats, q: Floats, acceleration: Floats) -> Floats:
        """The distance within which every point of the arm passes the nearer of two neighbouring samples: (n - 1,)."""
        steps_s = times_s[1:] - times_s[:-1]
        return self.bound.passed_m(q) + float(acceleration @ self.bound.reach_m) / 8 * steps_s * steps_s

    def _closer(
        self, positions_at: CurveAt, times_s: Floats, q: Floats, acceleration: Floats, allowed_m: Floats
    ) -> tuple[Floats, Floats]:
        """Add samples until no point passes its neighbours by more than `allowed_m`."""
        for _ in range(20):
            shares = self._passed_m(times_s, q, acceleration) / allowed_m
            if shares.max() <= 1:
                return times_s, q
            cuts = np.maximum(np.ceil(shares / 0.98), 1).astype(int)
            starts, widths = np.repeat(times_s[:-1], cuts), np.repeat((times_s[1:] - times_s[:-1]) / cuts, cuts)
            within = np.arange(len(starts)) - np.repeat(np.cumsum(cuts) - cuts, cuts)
            times_s, allowed_m = np.append(starts + within * widths, times_s[-1]), np.repeat(allowed_m, cuts)
            q = positions_at(times_s)
        raise ValueError("the curve jumps: no sampling proves it")


class _Pairs:
    """The pairs of one model, tested with any margin. Each pair takes 6 kB, so they exist only once."""

    def __init__(self, model: pin.Model, shapes: pin.GeometryModel) -> None:
        self._pool = pin.TreeBroadPhaseManagerPool_DynamicAABBTreeCollisionManager(model, shapes, 1)
        self.data: pin.GeometryData = self._pool.getGeometryDatas()[0]
        self._requests = list(self.data.collisionRequests)
        self._margin_m = 0.0

    def nearer(self, q: Floats, margin_m: float, until_first: bool = False) -> NDArray[np.bool_]:
        """Which configurations (n, 7) have a pair nearer than this: (n,) bool. `until_first`: only whether any has."""
        if margin_m != self._margin_m:
            for request in self._requests:
                request.security_margin = margin_m
            self._margin_m = margin_m
        columns = np.ascontiguousarray(q.T)
        return np.asarray(pin.computeCollisionsInParallel(1, self._pool, columns, True, until_first), dtype=bool)


def _among(arm: Arm, shapes: pin.GeometryModel, solids: Sequence[Solid], touchable: set[str]) -> pin.GeometryModel:
    """The arm's shapes and the solids, with all pairs that must not touch."""
    model = pin.GeometryModel(shapes)
    moving = model.ngeoms
    for solid in solids:
        model.addGeometryObject(pin.GeometryObject(solid.name, 0, solid.placement(), solid.shape()))
    for first, second in [*_pairs(model, moving, touchable), *arm.near_pairs(shapes)]:
        if not arm.may_touch or arm.is_looked_at(*(model.geometryObjects[k].name for k in (first, second))):
            model.addCollisionPair(pin.CollisionPair(first, second))
    return model


def _foremost(arm: Arm, shapes: pin.GeometryModel, solids: Sequence[Solid]) -> pin.GeometryModel:
    """Only the foremost shapes and the tallest solids, which are the walls around the balance."""
    few = pin.GeometryModel()
    for thing in shapes.geometryObjects:
        if thing.name in _FOREMOST:
            few.addGeometryObject(pin.GeometryObject(thing))
    moving, tallest_m = few.ngeoms, max((solid.top_m for solid in solids), default=0.0)
    for solid in solids:
        if solid.top_m > tallest_m / 2:
            few.addGeometryObject(pin.GeometryObject(solid.name, 0, solid.placement(), solid.shape()))
    for first in range(moving):
        for second in range(moving, few.ngeoms):
            if arm.is_looked_at(few.geometryObjects[first].name, few.geometryObjects[second].name):
                few.addCollisionPair(pin.CollisionPair(first, second))
    return few


def _pairs(shapes: pin.GeometryModel, moving: int, touchable: set[str]) -> Iterable[tuple[int, int]]:
    objects = shapes.geometryObjects
    for first in range(moving):
        joint = objects[first].parentJoint
        for second in range(first + 1, moving):
            if objects[second].parentJoint - joint > LINKS_APART:  # for nearer links, see `near_links`
                yield first, second
        for second in range(moving, shapes.ngeoms):
            # The cell is built around the base, which stands still, and the shoulder, which turns on the spot.
            moves = joint > 1 or (joint == 1 and not turns_on_the_spot(objects[first]))
            if moves and not (objects[first].name.startswith(CONE) and objects[second].name in touchable):
                yield first, second
