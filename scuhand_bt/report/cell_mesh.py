"""The arm's and the cell's solids as triangles, for whatever draws them in 3D.

Every collision shape is convex: points on its surface are enough, their convex hull has the triangles and the edges.
Lengths in metres.
"""

from dataclasses import dataclass
from typing import TypeAlias

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from scuhand_bt.motion.collision import Scene
from scuhand_bt.motion.kinematics import Floats

Indices: TypeAlias = NDArray[np.intp]

_AROUND = 24
_RINGS = 4
"""Rings of points on each half of a capsule's ends."""
_SHARP = 0.7
"""Two faces meet in an edge where the cosine between them is below this."""


@dataclass(frozen=True, slots=True)
class Mesh:
    """A solid: points (n, 3) in the base frame, triangles (m, 3) seen counter-clockwise, and sharp edges (k, 2)."""

    name: str
    points_m: Floats
    triangles: Indices
    edges: Indices


class CellMeshes:
    """The solids of a scene: those that stand still, and the arm's at any configuration."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._data = scene.model.createData(), pin.GeometryData(scene.shapes)
        things = list(scene.shapes.geometryObjects)
        meshes = [shape_mesh(thing) for thing in things]
        # The arm's own shapes come first; the sheet's two follow them, on the last joint.
        is_arm = [k < scene.arm_shapes or thing.parentJoint > 0 for k, thing in enumerate(things)]
        self._arm = [(k, mesh) for k, (mesh, arm) in enumerate(zip(meshes, is_arm, strict=True)) if arm]
        self.standing = [
            Mesh(mesh.name, _placed(thing.placement, mesh.points_m), mesh.triangles, mesh.edges)
            for thing, mesh, arm in zip(things, meshes, is_arm, strict=True)
            if not arm and mesh.name != "table"
        ]

    def arm(self, q: Floats) -> list[Mesh]:
        """The arm's shapes and the cone at a configuration (7,); the same triangles at every one."""
        data, shapes = self._data
        pin.updateGeometryPlacements(self._scene.model, data, self._scene.shapes, shapes, q)
        return [
            Mesh(mesh.name, _placed(shapes.oMg[k], mesh.points_m), mesh.triangles, mesh.edges) for k, mesh in self._arm
        ]


def _placed(placement: pin.SE3, points_m: Floats) -> Floats:
    placed: Floats = points_m @ placement.rotation.T + placement.translation
    return placed


def shape_mesh(thing: pin.GeometryObject) -> Mesh:
    """A shape in its own frame."""
    points_m = _surface_points_m(thing.geometry)
    hull = ConvexHull(points_m)
    outward = hull.equations[:, :3]
    a, b, c = (points_m[hull.simplices[:, k]] for k in range(3))
    inside_out = (np.cross(b - a, c - a) * outward).sum(axis=1) < 0
    triangles = np.where(inside_out[:, None], hull.simplices[:, ::-1], hull.simplices)
    # Side k of a triangle is opposite its corner k, where its neighbour k lies; of two neighbours one tells it.
    sides = np.sort(hull.simplices[:, [[1, 2], [0, 2], [0, 1]]], axis=2)
    cosines = (outward[:, None] * outward[hull.neighbors]).sum(axis=2)
    is_first = np.arange(len(hull.simplices))[:, None] < hull.neighbors
    return Mesh(thing.name, points_m, triangles, sides[is_first & (cosines < _SHARP)])


def _surface_points_m(shape: coal.CollisionGeometry) -> Floats:
    if isinstance(shape, coal.Box):
        corners: Floats = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * shape.halfSide
        return corners
    if isinstance(shape, coal.Sphere):
        return _rings(
            [(shape.radius * np.cos(a), shape.radius * np.sin(a)) for a in np.linspace(-1.5, 1.5, 2 * _RINGS)]
        )
    if isinstance(shape, coal.BVHModelBase):
        return np.array([shape.vertex(k) for k in range(shape.num_vertices)])
    half_m = shape.halfLength
    if isinstance(shape, coal.Cylinder):
        return _rings([(shape.radius, -half_m), (shape.radius, half_m)])
    if isinstance(shape, coal.Cone):
        return np.vstack([_rings([(shape.radius, -half_m)]), [[0.0, 0.0, half_m]]])
    turns = np.linspace(0.0, np.pi / 2, _RINGS + 1)[:-1]
    ends = [(side * np.sin(turn), np.cos(turn), side) for turn in turns for side in (-1, 1)]
    rings = [(shape.radius * wide, side * half_m + shape.radius * beyond) for beyond, wide, side in ends]
    tips = [[0.0, 0.0, side * (half_m + shape.radius)] for side in (-1, 1)]
    return np.vstack([_rings(rings), tips])


def _rings(rings: list[tuple[float, float]]) -> Floats:
    """Points on circles of these radii at these heights: (n, 3)."""
    angles = np.arange(_AROUND) * 2 * np.pi / _AROUND
    return np.vstack([np.column_stack([r * np.cos(angles), r * np.sin(angles), np.full(_AROUND, z)]) for r, z in rings])
