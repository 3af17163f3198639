"""Whether the cone is in the space that the carousel sweeps on its way to the pan.

It knows of no lease and no skill, so that a dry run shows what these have let happen.
"""

import math

import numpy as np

from scuhand_bt.bench_spec import Obstacle
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.sim.cone_over import ConePose, Floats, Mask


class Sweep:
    """The zones of a cell that contain the pan."""

    def __init__(self, spec: CellSpec) -> None:
        pan_mm = np.array([spec.station_of_kind("balance").position_mm])
        self._zones = [zone for zone in spec.zones if _from_above(zone, pan_mm).any()]

    def meets(self, cone: ConePose) -> bool:
        """Whether a point of the cone's outline is in one of them."""
        x_mm, y_mm, _ = cone.apex_mm.tolist()
        near = [zone for zone in self._zones if _aside_mm(zone, x_mm, y_mm) < cone.slant_mm]
        if not near:
            return False
        outline_mm = cone.outline_mm()
        return any(bool((_from_above(zone, outline_mm) & _at_height(zone, outline_mm)).any()) for zone in near)


def _aside_mm(zone: Obstacle, x_mm: float, y_mm: float) -> float:
    """A point's horizontal distance from the zone, or less; 0 or negative within it."""
    x_mm, y_mm = x_mm - zone.at_mm[0], y_mm - zone.at_mm[1]
    if zone.box_mm is None:
        diameter_mm, _ = zone.cylinder_mm or (0.0, 0.0)
        return math.hypot(x_mm, y_mm) - diameter_mm / 2
    cosine, sine = math.cos(math.radians(zone.yaw_deg)), math.sin(math.radians(zone.yaw_deg))
    length_mm, width_mm, _ = zone.box_mm
    along_mm, across_mm = cosine * x_mm + sine * y_mm, cosine * y_mm - sine * x_mm
    return max(abs(along_mm) - length_mm / 2, abs(across_mm) - width_mm / 2)


def _at_height(zone: Obstacle, points_mm: Floats) -> Mask:
    """(m,): which of the points (m, 3) are within the zone's height."""
    *_, height_mm = zone.box_mm or zone.cylinder_mm or (0.0,)
    at_height: Mask = np.abs(points_mm[:, 2] - zone.at_mm[2]) < height_mm / 2
    return at_height


def _from_above(zone: Obstacle, points_mm: Floats) -> Mask:
    """(m,): which of the points (m, 3) are within the zone as seen from above."""
    aside_mm = (points_mm[:, :2] - zone.at_mm[:2]) @ (1.0, 1j)
    if zone.box_mm is None:
        diameter_mm, _ = zone.cylinder_mm or (0.0, 0.0)
        in_circle: Mask = np.abs(aside_mm) < diameter_mm / 2
        return in_circle
    turned = aside_mm * np.exp(-1j * np.radians(zone.yaw_deg))
    in_box: Mask = (np.abs(turned.real) < zone.box_mm[0] / 2) & (np.abs(turned.imag) < zone.box_mm[1] / 2)
    return in_box
