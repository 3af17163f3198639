"""A cone's pose, and the height of its sheet above every column of a grid (the lower side of a leaning cone).

On the vertical through (x, y), with q its offset from the apex, c = q . u along the axis u, and zeta the height above
the apex, the sheet (half-angle a, height h) is where

    zeta^2 (cos^2 a - u_z^2) - 2 c u_z zeta + q^2 cos^2 a - c^2 = 0,     0 <= c + u_z zeta <= h

Lengths in mm.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class ConePose:
    """A cone: apex (3,), axis (3,) (unit vector from the apex out of the mouth), the rim's diameter and the slant."""

    apex_mm: Floats
    axis: Floats
    rim_mm: float
    slant_mm: float

    @property
    def height_mm(self) -> float:
        return math.sqrt(self.slant_mm**2 - (self.rim_mm / 2) ** 2)

    def along_mm(self, points: Floats) -> Floats:
        """(m, 3) to (m,): the coordinate of points along the axis, from the apex."""
        along: Floats = (points - self.apex_mm) @ self.axis
        return along

    def moved_to(self, there: "ConePose", points: Floats) -> Floats:
        """(m, 3): where points of the cone are after it has moved there; linearised, so the rotation must be small."""
        from_apex = points - self.apex_mm
        x, y, z = cross(self.axis, there.axis)
        moved: Floats = there.apex_mm + from_apex @ np.array([[1.0, z, -y], [-z, 1.0, x], [y, -x, 1.0]])
        return moved

    def normals(self, points: Floats) -> Floats:
        """(m, 3): inward unit normals of the sheet at points on it; the axis at the apex."""
        along = self.along_mm(points)[:, None]
        inwards = self.apex_mm + along / (self.height_mm / self.slant_mm) ** 2 * self.axis - points
        size = np.linalg.norm(inwards, axis=1, keepdims=True)
        unit: Floats = np.where(size > 1e-6, inwards / np.maximum(size, 1e-6), self.axis)
        return unit

    def outline_mm(self, points: int = 24) -> Floats:
        """(points + 1, 3): points of its rim, and its apex."""
        axis = self.axis.tolist()
        aside = cross(axis, (1.0, 0.0, 0.0) if abs(axis[0]) < 0.7 else (0.0, 1.0, 0.0))
        size = math.hypot(*aside)
        aside = (aside[0] / size, aside[1] / size, aside[2] / size)
        outline = np.empty((points + 1, 3))
        outline[:-1] = self.rim_mm / 2 * (_circle(points) @ np.array([aside, cross(axis, aside)]))
        outline[:-1] += self.apex_mm + self.height_mm * self.axis
        outline[-1] = self.apex_mm
        return outline

    @property
    def lip_mm(self) -> Floats:
        """(3,): the lowest point of the rim, over which powder pours; of an upright cone, the middle of its mouth."""
        down = self.axis[2] * self.axis - (0.0, 0.0, 1.0)
        size = float(np.linalg.norm(down))
        lip: Floats = self.apex_mm + self.height_mm * self.axis + self.rim_mm / 2 * down / max(size, 1e-9)
        return lip

    @property
    def lowest_mm(self) -> float:
        """The height of its lowest point, of the apex and the rim."""
        apex_mm, up = float(self.apex_mm[2]), float(self.axis[2])
        drop_mm = self.rim_mm / 2 * math.sqrt(max(0.0, 1.0 - up * up))
        return min(apex_mm, apex_mm + self.height_mm * up - drop_mm)

    def way_mm(self, there: "ConePose") -> float:
        """How far the cone moves: the larger way of its apex and of its mouth's centre, plus the growth of the rim."""
        shift = there.apex_mm - self.apex_mm
        turned_mm = there.height_mm * there.axis - self.height_mm * self.axis
        leads_mm = max(float(np.linalg.norm(shift)), float(np.linalg.norm(shift + turned_mm)))
        return leads_mm + abs(there.rim_mm - self.rim_mm) / 2

    def towards(self, there: "ConePose", share: float) -> "ConePose":
        """The pose at this share of the way there."""
        axis = self.axis + share * (there.axis - self.axis)
        return ConePose(
            self.apex_mm + share * (there.apex_mm - self.apex_mm),
            axis / np.linalg.norm(axis),
            self.rim_mm + share * (there.rim_mm - self.rim_mm),
            self.slant_mm,
        )


@cache
def _circle(points: int) -> Floats:
    """(points, 2): cosines and sines."""
    angles = np.linspace(0.0, 2 * math.pi, points, endpoint=False)
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


def cross(a: Sequence[float] | Floats, b: Sequence[float] | Floats) -> tuple[float, float, float]:
    """The cross product of two single vectors; numpy's takes ten times as long."""
    (ax, ay, az), (bx, by, bz) = a, b
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


class ConeOver:
    """A cone above the columns of a grid."""

    def __init__(self, pose: ConePose, x_mm: Floats, y_mm: Floats) -> None:
        self.pose = pose
        dx, dy = x_mm - pose.apex_mm[0], y_mm - pose.apex_mm[1]
        u_z = float(pose.axis[2])
        across = dx * pose.axis[0] + dy * pose.axis[1]
        cosine2 = (pose.height_mm / pose.slant_mm) ** 2
        square = cosine2 - u_z**2
        if abs(square) < 1e-9:
            square = 1e-9
        constant = (dx * dx + dy * dy) * cosine2 - across * across
        under_root = (across * u_z) ** 2 - square * constant
        above = (across * u_z - np.sqrt(np.maximum(under_root, 0.0))) / square
        along = across + u_z * above
        self.over: Mask = (under_root >= 0.0) & (along >= 0.0) & (along <= pose.height_mm)
        """Where the sheet is the first thing met from below."""
        self.sheet_mm: Floats = pose.apex_mm[2] + above
        """The sheet's height; valid only where `over`."""
        self.level_mm: Floats = across - u_z * pose.apex_mm[2]
        """The coordinate along the axis at z = 0."""
