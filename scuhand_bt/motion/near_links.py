"""Which shapes of neighbouring links (at most two joints apart) can meet, and so must be tested.

The links' own bounding shapes overlap there by construction, or turn on the spot side by side. Shapes that a URDF adds
to them (such as a camera on the fore arm) may be hit by later links. So each pair is measured over all joint windows:

    tested    if its distance changes, is not always below a margin, and is not always far above it

Distances in metres.
"""

from collections.abc import Iterator, Sequence

import coal
import numpy as np
import pinocchio as pin

from scuhand_bt.motion.kinematics import Floats

LINKS_APART = 2
"""Links farther apart than this many joints are always tested."""
_SAMPLES, _SEED = 400, 20
_STEADY_M = 0.0015
"""A distance that changes by less belongs to a shape that turns on the spot."""
_ALWAYS_M, _FAR_M = 0.005, 0.03
_LOOSE = {"upper_0", "fore_0"}
"""Two capsules that bound the CRANE-X7's links loosely: they meet at the strongest bend although the arm does not. For
other arms the cell lists such pairs (`may_touch`)."""


def meeting(
    model: pin.Model, shapes: pin.GeometryModel, pairs: Sequence[tuple[int, int]], limits_rad: Floats
) -> list[tuple[int, int]]:
    """The pairs of shapes that meet in some configurations but not in all."""
    asked = [(first, second) for first, second in pairs if not _is_loose(shapes, first, second)]
    if not asked:
        return []
    measured = pin.GeometryModel(shapes)
    measured.removeAllCollisionPairs()
    for first, second in asked:
        measured.addCollisionPair(pin.CollisionPair(first, second))
    data, shape_data = model.createData(), pin.GeometryData(measured)
    found = []
    for q in np.random.default_rng(_SEED).uniform(limits_rad[0], limits_rad[1], (_SAMPLES, model.nq)):
        pin.computeDistances(model, data, measured, shape_data, q)
        found.append([result.min_distance for result in shape_data.distanceResults])
    least, most = np.min(found, axis=0), np.max(found, axis=0)
    looked_at = (most - least > _STEADY_M) & (most > _ALWAYS_M) & (least < _FAR_M)
    return [pair for pair, is_one in zip(asked, looked_at, strict=True) if is_one]


def neighbours(shapes: pin.GeometryModel, first: range, second: range) -> Iterator[tuple[int, int]]:
    """Pairs, one of each range, of links at most two joints apart; the first is nearer to the base."""
    objects = shapes.geometryObjects
    for one in first:
        for other in second:
            if 1 <= objects[other].parentJoint - objects[one].parentJoint <= LINKS_APART:
                yield one, other


def turns_on_the_spot(thing: pin.GeometryObject) -> bool:
    """Whether a shape is round about its joint's axis z, so that turning the joint leaves it as it is."""
    if not isinstance(thing.geometry, coal.Capsule | coal.Cylinder | coal.Cone):
        return False
    axis, place = thing.placement.rotation[:, 2], thing.placement.translation
    return bool(abs(abs(axis[2]) - 1) < 1e-9 and np.hypot(place[0], place[1]) < 1e-9)


def _is_loose(shapes: pin.GeometryModel, first: int, second: int) -> bool:
    both = [shapes.geometryObjects[k] for k in (first, second)]
    return {one.name for one in both} == _LOOSE and all(isinstance(one.geometry, coal.Capsule) for one in both)
