"""What stands on a cell's bench: its stations and obstacles, and the frames that they were measured in."""

import math
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from scuhand_bt.quantity import NOT_WRITTEN, Degrees, Millimetres
from scuhand_bt.specs import Spec

Point = Annotated[tuple[Millimetres, Millimetres, Millimetres], Field(description="x, y, z in the base frame")]


class Frame(Spec):
    """What stands on the bench as one thing, moved from where the file's other figures have it; measured by touching.

    A point p of it really is at  pivot + shift + Rz(yaw) (p - pivot).
    """

    pivot_mm: Point = (0.0, 0.0, 0.0)
    """About which it is turned."""
    shift_mm: Point = (0.0, 0.0, 0.0)
    yaw_deg: Annotated[Degrees, Field(ge=-180, le=180)] = 0.0
    landmarks_mm: tuple[Point, Point, Point] | None = None
    """Three points of it that the apex can touch, by the same figures as the others; not on one line."""

    def moved_mm(self, point_mm: Point) -> Point:
        """Where a point of it really is."""
        yaw_rad = math.radians(self.yaw_deg)
        x, y, z = (p - pivot for p, pivot in zip(point_mm, self.pivot_mm, strict=True))
        x, y, z = (sum(parts) for parts in zip(self.pivot_mm, self.shift_mm, (*turned(x, y, yaw_rad), z), strict=True))
        return x, y, z

    def written_mm(self, point_mm: Point) -> Point:
        """The figures of a point that really is there: what `moved_mm` moves to it."""
        zipped = zip(point_mm, self.pivot_mm, self.shift_mm, strict=True)
        x, y, z = (p - pivot - shift for p, pivot, shift in zipped)
        x, y = turned(x, y, -math.radians(self.yaw_deg))
        x, y, z = (p + pivot for p, pivot in zip((x, y, z), self.pivot_mm, strict=True))
        return x, y, z


def turned(x: float, y: float, yaw_rad: float) -> tuple[float, float]:
    """A point, turned about the origin against the clock seen from above."""
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    return x * cos - y * sin, x * sin + y * cos


class Station(Spec):
    """A named place of the cell. `position` is the table point of a mortar, the pan's centre, …"""

    name: str
    kind: Literal["mortar", "balance", "waste", "service", "park"]
    position_mm: Point
    frame: str | None = None
    """What it belongs to, of `frames`; None once `position_mm` is where it really is."""
    of_frame: Annotated[Frame | None, Field(json_schema_extra=NOT_WRITTEN)] = None
    """That frame itself, from then on: in its figures the file has to be written."""


Size = Annotated[Millimetres, Field(gt=0)]


class Obstacle(Spec):
    """A box or an upright cylinder, by its centre, or a mesh, by its origin, that the arm must not touch."""

    name: str
    at_mm: Point
    box_mm: tuple[Size, Size, Size] | None = None
    cylinder_mm: tuple[Size, Size] | None = None
    """Diameter and length."""
    mesh: str | None = None
    """An STL or OBJ file, beside cell.yaml; its z is up. An absolute path once the lab is loaded."""
    mesh_unit_mm: Size = 1.0
    """What one unit of the file is."""
    mesh_digest: Annotated[str, Field(json_schema_extra=NOT_WRITTEN)] = ""
    """Of the file's bytes, once the lab is loaded."""
    yaw_deg: Annotated[Degrees, Field(ge=-180, le=180)] = 0.0
    """By how much a box or a mesh is turned about its upright axis, against the clock seen from above."""
    frame: str | None = None
    """As a station's."""

    @model_validator(mode="after")
    def _has_one_shape(self) -> Self:
        if (self.box_mm, self.cylinder_mm, self.mesh).count(None) != 2:
            raise ValueError("it has one shape: a box, a cylinder, or a mesh")
        return self
