"""The inside of a vessel that powder is scooped from: floor, corner and wall, as one profile turned about the vertical.

    bowl (a cap of a sphere)     floor 0,                 corner R = (a^2 + h^2) / 2h
    beaker or jar (a cylinder)   floor a - corner,        corner as it is moulded

a radius of the bore, h depth [mm]. The profile runs level along the floor, rises along the corner's arc, and goes
straight up the wall to the edge. A place on it is an arc length s [mm] from the lowest point, negative on the far side.

Frame: origin at the vessel's lowest point, z up; lengths in mm.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scuhand_bt.specs import Mortar

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Vessel:
    """A vessel's inside and outer diameter. Raises ValueError where the sizes do not fit each other."""

    bore_mm: float
    """Inner diameter at the edge."""
    depth_mm: float
    """Edge to the lowest point."""
    corner_mm: float
    """Radius of the arc between floor and wall; of the sphere, for a bowl."""
    floor_mm: float
    """Radius of the level floor; 0 for a bowl."""
    outer_mm: float
    """Outer diameter."""

    def __post_init__(self) -> None:
        if not (self.depth_mm > 0 and self.corner_mm > 0 and self.floor_mm >= 0 and self.outer_mm >= self.bore_mm > 0):
            raise ValueError(f"{self} is no vessel: its sizes are above zero, and it has an outside around its inside")
        if abs(self._radius_at_edge_mm - self.bore_mm / 2) > 1e-6:
            raise ValueError(f"{self} is no vessel: its floor, corner and depth do not make its bore")

    @classmethod
    def bowl(cls, bore_mm: float, depth_mm: float, outer_mm: float) -> "Vessel":
        """A cap of a sphere; raises ValueError for more than half a sphere."""
        if depth_mm > bore_mm / 2:
            raise ValueError("a bowl is a cap of a sphere: its depth is at most half its bore")
        radius_mm = ((bore_mm / 2) ** 2 + depth_mm**2) / (2 * depth_mm)
        return cls(bore_mm, depth_mm, radius_mm, 0.0, outer_mm)

    @classmethod
    def cylinder(cls, bore_mm: float, depth_mm: float, outer_mm: float, corner_mm: float = 5.0) -> "Vessel":
        """A level floor and an upright wall; raises ValueError for a corner that does not fit."""
        if not 0 < corner_mm <= min(depth_mm, bore_mm / 2):
            raise ValueError(f"a corner of {corner_mm:g} mm does not fit a bore of {bore_mm:g} and {depth_mm:g} mm")
        return cls(bore_mm, depth_mm, corner_mm, bore_mm / 2 - corner_mm, outer_mm)

    @classmethod
    def of(cls, mortar: Mortar) -> "Vessel":
        """A mortar's bowl, or the level floor and upright wall of one with a corner."""
        if mortar.corner_mm is not None:
            return cls.cylinder(mortar.bore_mm, mortar.depth_mm, mortar.outer_diameter_mm, mortar.corner_mm)
        return cls.bowl(mortar.bore_mm, mortar.depth_mm, mortar.outer_diameter_mm)

    @property
    def _corner_rad(self) -> float:
        """Slope at the end of the corner's arc: upright, or less where the edge cuts it."""
        return math.acos(max(0.0, 1 - self.depth_mm / self.corner_mm))

    @property
    def _radius_at_edge_mm(self) -> float:
        return self.floor_mm + self.corner_mm * math.sin(self._corner_rad)

    @property
    def to_edge_mm(self) -> float:
        """Arc length from the lowest point to the edge."""
        arc_mm = self.corner_mm * self._corner_rad
        return self.floor_mm + arc_mm + max(0.0, self.depth_mm - self.corner_mm)

    def wall(self, s_mm: Floats) -> tuple[Floats, Floats, Floats]:
        """The profile at arc lengths (n,): distance from the axis [mm], height [mm] and slope [rad]; (n,) each."""
        along_mm, side = np.abs(s_mm), np.sign(s_mm)
        steep = np.clip((along_mm - self.floor_mm) / self.corner_mm, 0.0, self._corner_rad)
        straight_mm = np.minimum(along_mm, self.floor_mm)
        upright_mm = np.maximum(0.0, along_mm - self.floor_mm - self.corner_mm * self._corner_rad)
        out_mm = straight_mm + self.corner_mm * np.sin(steep) + upright_mm * np.cos(steep)
        high_mm = self.corner_mm * (1 - np.cos(steep)) + upright_mm * np.sin(steep)
        return side * out_mm, high_mm, side * steep

    def clearance_mm(self, points_mm: Floats) -> Floats:
        """Distance of points (..., 3) from the vessel, negative within its wall: (...).

        Above the edge only the edge and the wall's top count, as nothing else there is near.
        """
        out_mm = np.hypot(points_mm[..., 0], points_mm[..., 1])
        high_mm = points_mm[..., 2]
        to_corner_mm = self.corner_mm - np.hypot(out_mm - self.floor_mm, high_mm - self.corner_mm)
        is_corner = (out_mm > self.floor_mm) & (high_mm < self.corner_mm)
        inside_mm = np.where(is_corner, to_corner_mm, np.minimum(high_mm, self.bore_mm / 2 - out_mm))
        outside_mm = out_mm - self.outer_mm / 2
        beside_mm = np.where(outside_mm > 0, outside_mm, inside_mm)
        across_mm = np.maximum(np.maximum(self.bore_mm / 2 - out_mm, outside_mm), 0.0)
        above_mm = np.hypot(across_mm, high_mm - self.depth_mm)
        clear: Floats = np.where(high_mm > self.depth_mm, above_mm, beside_mm)
        return clear
