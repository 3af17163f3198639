"""The lip-led swing: how a cone takes powder out of a vessel, by geometry alone (docs/scoop.md, A stroke).

The mouth leads. The *lip*, the rim's lowest point, follows the wall; the apex, which is the valve, touches nothing. The
seam (the slit's generator) lies opposite the lip, and the handle continues it.

Frame: origin at the vessel's lowest point, z up; lengths in mm, angles in deg where a name says so.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from scuhand_bt.dosing.ladle import LIP_GAP_MM, Ladle, NoStrokeError, Stroke
from scuhand_bt.dosing.swing_plane import Flat, Floats, Pose
from scuhand_bt.dosing.vessel import Vessel

TURN_RAD_PER_S = 1.2
"""Turning speed of axis and handle; slow enough to throw no powder."""
FREE_MM_PER_S = 150.0
"""Least speed of lip and apex with the lip off the wall: the cone is empty, or rises straight up."""


@dataclass(frozen=True, slots=True)
class StrokePath:
    """The n poses of a stroke in the vessel's frame."""

    times_s: Floats
    """(n,): at an even pace of lip, axis and rim. The arm's planner makes its own time law."""
    apex_mm: Floats
    """(n, 3)"""
    axis: Floats
    """(n, 3): unit vectors from the apex up out of the mouth."""
    seam: Floats
    """(n, 3): unit vectors from the apex along the slit's edge, opposite the lip; the handle continues it."""
    rim_mm: Floats
    """(n,): diameters."""
    lip_mm: Floats
    """(n, 3): the rim's leading point."""
    attack_deg: Floats
    """(n,): angle between the lip's generator and the wall; nan with the lip off the wall."""
    on_wall: NDArray[np.bool_]
    """(n,): where the lip follows the wall."""

    @property
    def rests(self) -> NDArray[np.bool_]:
        """(n,): where the stroke comes to rest: at both ends, where the lip meets the wall and where it leaves it."""
        changes = np.flatnonzero(np.diff(self.on_wall))
        rests = np.zeros(len(self.times_s), dtype=bool)
        rests[0] = rests[-1] = True
        # The last free pose is one step off the wall, so the rest is at the first pose on the wall, and at the last.
        rests[[k if self.on_wall[k] else k + 1 for k in changes]] = True
        return rests


def stroke_path(vessel: Vessel, stroke: Stroke, ladle: Ladle) -> StrokePath:
    """The poses of a stroke.

    Raises NoStrokeError, with the reason, where vessel, sheet or handle allow none, and ValueError for rims that the
    sheet cannot make.
    """
    rims_mm = (stroke.open_mm, stroke.closed_mm)
    if not 0 < min(rims_mm) <= max(rims_mm) < 2 * ladle.slant_mm:
        raise ValueError(
            f"a sheet of {ladle.slant_mm:g} mm radius cannot make rims of "
            f"{', '.join(f'{rim_mm:g}' for rim_mm in rims_mm)}"
        )
    narrowest_mm, widest_mm = ladle.rim_limits_mm
    if min(rims_mm) < narrowest_mm or max(rims_mm) > widest_mm:
        asked = f"a rim of {stroke.open_mm:g} mm that closes to {stroke.closed_mm:g} mm"
        raise NoStrokeError(f"{asked} is outside the roller's range of {narrowest_mm:g} to {widest_mm:g} mm")
    if stroke.open_mm > vessel.bore_mm - 2 * LIP_GAP_MM:
        raise NoStrokeError(f"a rim of {stroke.open_mm:g} mm does not fit into a bore of {vessel.bore_mm:g} mm")
    return _in_space(_poses(vessel, replace(stroke, heading_deg=0.0), ladle), stroke, ladle)


@lru_cache(maxsize=64)
def _poses(vessel: Vessel, stroke: Stroke, ladle: Ladle) -> tuple[Pose, ...]:
    """The poses in the plane of the swing, the same for each heading."""
    flat = Flat(vessel, stroke, ladle)
    scrape = flat.scrape()
    return (*flat.enter(scrape[0]), *scrape, *flat.leave(scrape[-1]))


def _in_space(poses: Sequence[Pose], stroke: Stroke, ladle: Ladle) -> StrokePath:
    heading = math.radians(stroke.heading_deg)
    ahead, up = np.array([math.cos(heading), math.sin(heading), 0.0]), np.array([0.0, 0.0, 1.0])
    tilt = np.array([pose.tilt_rad for pose in poses])[:, None]
    rim_mm = np.array([pose.rim_mm for pose in poses])
    apex_mm = np.array([pose.apex_mm for pose in poses]) @ np.stack([ahead, up])
    alpha = np.arcsin(rim_mm / (2 * ladle.slant_mm))[:, None]
    axis = np.sin(tilt) * ahead + np.cos(tilt) * up
    down = np.cos(tilt) * ahead - np.sin(tilt) * up
    attack_deg = np.degrees([pose.attack_rad for pose in poses])
    lip_mm = apex_mm + ladle.slant_mm * (np.cos(alpha) * axis + np.sin(alpha) * down)
    return StrokePath(
        times_s=_times_s(poses, lip_mm, stroke, ladle),
        apex_mm=apex_mm,
        axis=axis,
        seam=np.cos(alpha) * axis - np.sin(alpha) * down,
        rim_mm=rim_mm,
        lip_mm=lip_mm,
        attack_deg=attack_deg,
        on_wall=~np.isnan(attack_deg),
    )


def _times_s(poses: Sequence[Pose], lip_mm: Floats, stroke: Stroke, ladle: Ladle) -> Floats:
    """Times of the poses: each step takes as long as the slowest of lip, apex, axis and the sheet's edge."""
    apex_mm = np.array([pose.apex_mm for pose in poses])
    rims_mm = np.array([pose.rim_mm for pose in poses])
    half_rad = np.arcsin(rims_mm / (2 * ladle.slant_mm))
    tilts_rad = np.array([pose.tilt_rad for pose in poses])
    ways_mm = np.maximum(
        np.linalg.norm(np.diff(lip_mm, axis=0), axis=1), np.linalg.norm(np.diff(apex_mm, axis=0), axis=1)
    )
    turns_rad = np.maximum(np.abs(np.diff(tilts_rad)), np.abs(np.diff(tilts_rad - half_rad)))
    edge_mm = math.pi * np.abs(np.diff(rims_mm))
    on_wall = ~np.isnan([pose.attack_rad for pose in poses])
    speeds_mm_per_s = np.where(
        on_wall[1:] & on_wall[:-1], stroke.lip_speed_mm_per_s, max(stroke.lip_speed_mm_per_s, FREE_MM_PER_S)
    )
    steps_s = np.maximum.reduce(
        [ways_mm / speeds_mm_per_s, turns_rad / TURN_RAD_PER_S, edge_mm / ladle.edge_speed_mm_per_s]
    )
    return np.concatenate([[0.0], np.cumsum(np.maximum(steps_s, 1e-3))])


def headings_deg(count: int, first_deg: float = 0.0) -> Iterator[float]:
    """Headings of successive strokes, each as far from those before it as possible."""
    for k in range(count):
        bits = f"{k:b}"[::-1]
        yield (first_deg + 360.0 * sum(int(bit) / 2 ** (place + 1) for place, bit in enumerate(bits))) % 360.0
