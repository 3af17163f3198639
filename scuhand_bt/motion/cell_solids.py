"""What stands in the cell, as solids: the bench's geometry, the mortars, the container on the pan.

A mortar is a full cylinder, except while its powder is scooped: then it is hollow, made of rings of boxes. They
surround the spherical bowl of radius R = (a^2 + h^2) / 2h (a: half the bore, h: depth), or the floor, corner and
upright wall of a jar. Each ring is as wide inside as the vessel is at the ring's lower edge, so that the boxes never
leave part of the wall uncovered.

Metres and radians, base frame.
"""

import math
from collections.abc import Iterable

import coal

from scuhand_bt.bench_spec import Obstacle, Station
from scuhand_bt.motion.collision import SMALLEST_MARGIN_M, Solid
from scuhand_bt.motion.meshes import read_mesh
from scuhand_bt.specs import ContainerKind, Mortar

_RINGS = 8
_SIDES = 24
_CONTAINER_WALL_MM = 3.0
_AROUND_M = 1e-3


def solids_of(obstacles: Iterable[Obstacle]) -> list[Solid]:
    """The obstacles of `robot/cell.yaml` as solids. ValueError for one without exactly one shape, or a bad mesh."""
    solids = []
    for obstacle in obstacles:
        if (obstacle.box_mm, obstacle.cylinder_mm, obstacle.mesh).count(None) != 2:
            raise ValueError(f"the obstacle {obstacle.name} needs one shape: a box, a cylinder, or a mesh")
        x, y, z = obstacle.at_mm
        centre_m = (x / 1e3, y / 1e3, z / 1e3)
        if obstacle.box_mm is not None:
            a, b, c = obstacle.box_mm
            yaw_rad = math.radians(obstacle.yaw_deg)
            solids.append(Solid(obstacle.name, centre_m, box_m=(a / 1e3, b / 1e3, c / 1e3), yaw_rad=yaw_rad))
        elif obstacle.cylinder_mm is not None:
            diameter, length = obstacle.cylinder_mm
            solids.append(Solid(obstacle.name, centre_m, cylinder_m=(diameter / 1e3, length / 1e3)))
        elif obstacle.mesh is not None:
            try:
                surface = read_mesh(obstacle.mesh, obstacle.mesh_unit_mm / 1e3, obstacle.mesh_digest)
            except ValueError as error:
                raise ValueError(f"the mesh of the obstacle {obstacle.name}: {error}") from None
            solids.append(Solid(obstacle.name, centre_m, mesh=surface, yaw_rad=math.radians(obstacle.yaw_deg)))
    return solids


def full_mortar(station: Station, mortar: Mortar) -> Solid:
    """The mortar as one cylinder that nothing may enter."""
    x, y, z = (value / 1e3 for value in station.position_mm)
    height_m = mortar.height_mm / 1e3
    return Solid(station.name, (x, y, z + height_m / 2), cylinder_m=(mortar.outer_diameter_mm / 1e3, height_m))


def around(station: Station, mortar: Mortar) -> Solid:
    """A cylinder that encloses all parts of a hollow mortar, corners included, with a millimetre to spare."""
    x, y, z = (value / 1e3 for value in station.position_mm)
    wide_m, height_m = mortar.outer_diameter_mm / 1e3 / math.cos(math.pi / _SIDES), mortar.height_mm / 1e3
    size_m = (wide_m + 2 * _AROUND_M, height_m + 2 * _AROUND_M)
    return Solid(f"{station.name} around", (x, y, z + height_m / 2), cylinder_m=size_m)


def hollow_mortar(station: Station, mortar: Mortar) -> list[Solid]:
    """The mortar, open at the top."""
    x, y, z = (value / 1e3 for value in station.position_mm)
    outer_m = mortar.outer_diameter_mm / 2e3
    height_m, depth_m = mortar.height_mm / 1e3, mortar.depth_mm / 1e3
    floor_m = height_m - depth_m
    solids = [Solid(f"{station.name} floor", (x, y, z + floor_m / 2), cylinder_m=(2 * outer_m, max(floor_m, 1e-3)))]
    ring_m = depth_m / _RINGS
    for ring in range(_RINGS):
        low_m = ring * ring_m
        inner_m = _inside_m(mortar, low_m) * math.cos(math.pi / _SIDES)
        middle_m, thick_m = (outer_m + inner_m) / 2, outer_m - inner_m
        side_m = 2 * outer_m * math.tan(math.pi / _SIDES)
        for k in range(_SIDES):
            yaw = 2 * math.pi * k / _SIDES
            centre_m = (x + middle_m * math.cos(yaw), y + middle_m * math.sin(yaw), z + floor_m + low_m + ring_m / 2)
            name = f"{station.name} wall {ring}.{k}"
            solids.append(Solid(name, centre_m, box_m=(thick_m, side_m, ring_m), yaw_rad=yaw))
    return solids


def _inside_m(mortar: Mortar, high_m: float) -> float:
    """Inner radius of a mortar at a height above its lowest point."""
    if mortar.corner_mm is None:
        radius_m = mortar.bowl_radius_mm / 1e3
        return math.sqrt(max(0.0, radius_m**2 - (radius_m - high_m) ** 2))
    corner_m = mortar.corner_mm / 1e3
    below_m = max(0.0, corner_m - high_m)
    return mortar.bore_mm / 2e3 - corner_m + math.sqrt(corner_m**2 - below_m**2)


def are_in_each_other(first: Solid, second: Solid) -> bool:
    """Whether two solids overlap. Of a mesh only the surface counts, so a solid wholly inside one is not noticed."""
    found, asked = coal.CollisionResult(), coal.CollisionRequest()
    asked.security_margin = SMALLEST_MARGIN_M
    places = [coal.Transform3s(at.rotation, at.translation) for at in (first.placement(), second.placement())]
    coal.collide(first.shape(), places[0], second.shape(), places[1], asked, found)
    return bool(found.isCollision())


def container(station: Station, kind: ContainerKind) -> Solid:
    """What stands on the pan, as one cylinder: dispensing happens above its mouth, never inside."""
    x, y, z = (value / 1e3 for value in station.position_mm)
    height_m = kind.height_mm / 1e3
    diameter_m = (kind.mouth_mm + 2 * _CONTAINER_WALL_MM) / 1e3
    return Solid(f"{kind.name} on the pan", (x, y, z + height_m / 2), cylinder_m=(diameter_m, height_m))
