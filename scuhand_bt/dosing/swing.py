"""The lip-led swing: how a cone takes powder out of a vessel, as a ladle does, by geometry alone.

The mouth leads and the *lip*, the rim's lowest point, follows the wall; the apex, which is the valve, touches nothing.
In the upright plane of the swing, for a lip at a place of the wall that is phi steep:

    g inclined by phi - beta        generator from the apex to the lip; beta: attack angle between it and the wall
    theta + phi = 90 deg + beta - alpha        theta tilt of the cone's axis from upright, alpha half-angle of the cone
    A = P - L g                     apex: wherever alpha goes while the sheet closes, it depends on lip and attack alone

The apex stays c clear of a bowl of radius R where

    sin beta >= (L^2 + 2 R c - c^2) / (2 R L)

(from |A - C|^2 = R^2 - 2 R L sin beta + L^2, C the bowl's centre): 34.8 deg for a sheet of 50 mm, 3 mm clear, in a bowl
of 48.75 mm. A flatter attack is possible only as long as the apex is still above the vessel's edge. So the attack is
the one that is asked for, or as much more as keeps the apex and the rest of the sheet clear of the vessel.

A stroke begins tilted over the vessel, enters along its first generator, swings its lip along the wall to the edge,
turns upright about its apex, rising where the handle meets the edge, and rises out. The seam, the slit's generator,
lies opposite the lip, and the handle continues it. docs/scoop.md has the drawings.

Frame: origin at the vessel's lowest point, z up; lengths in mm, angles in deg where a name says so.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from scuhand_bt.cell_spec import HandSpec
from scuhand_bt.dosing.vessel import Vessel

Floats = NDArray[np.float64]

TURN_RAD_PER_S = 1.2
"""Of axis and handle: slower than powder is thrown."""
FREE_MM_PER_S = 150.0
"""Speed of lip and apex at least, where the lip is not on the wall: empty, and then straight up, which tips no load."""
APEX_CLEAR_MM = 3.0
"""The apex is never nearer to the vessel than this."""
LIP_GAP_MM = 0.1
"""Between the lip and the wall of a stroke that takes all there is."""
STEP_MM = 1.0
"""The lip's way between two poses of a path, at most."""
STEP_DEG = 1.5
"""The axis' turn between two poses of a path, at most."""
OVER_EDGE_MM = 10.0
"""How far above the vessel's edge a stroke begins and ends."""
OVER_VESSEL_MM = 15.0
"""And how far its lip is then within the bore, at least."""
ATTACK_GRID_DEG = 0.25
COARSELY = 8
"""Steps of that grid that are taken at once at first."""
STEEPEST_DEG = 88.0
WRIST_TO_FLANGE_MM = 19.0
WRIST_RADIUS_MM = 45.0
HANDLE_GAP_MM = 3.0
CLAMP_MM = 10.0
"""The clamp reaches so far from the rim towards the apex."""
RISING = 25
"""Poses on the way up out of the vessel."""
ENTRIES = 5
"""Ways in that are tried, from the first generator's to straight down."""
LEVEL_ENTRY = 0.2
"""Sine of the flattest way in."""
AROUND_EDGE = 37
"""Points of half of the vessel's edge, inside and outside."""
EVENED_MM = 8.0
"""The lip's way over which a change of the attack is spread, before and behind."""
SLACK_MM = 0.05
"""The sheet beside the lip may be so much nearer to the wall than the lip itself."""


class NoStrokeError(ValueError):
    """No such stroke is possible in this vessel; its words say why."""


@dataclass(frozen=True, slots=True)
class Stroke:
    """What is asked of one swing. The rim goes from `open_mm` to `closed_mm` evenly with the lip's way along the wall.

    The lip meets the wall at the arc length `begin_mm` from the lowest point, negative behind it, or later where the
    axis would have to be tilted more than `max_tilt_deg`. `heading_deg` is the direction of the swing about the
    vertical. The lip follows the wall at `gap_mm`; less than 0 presses it into the wall. It leaves the wall at the arc
    length `end_mm`, or at the edge, if that is nearer.
    """

    open_mm: float
    closed_mm: float
    begin_mm: float
    attack_deg: float = 22.0
    heading_deg: float = 0.0
    gap_mm: float = LIP_GAP_MM
    max_tilt_deg: float = 110.0
    lip_speed_mm_per_s: float = 60.0
    end_mm: float = math.inf

    def turned(self, heading_deg: float, max_tilt_deg: float) -> "Stroke":
        """The same in another direction, with another limit of the tilt."""
        return replace(self, heading_deg=heading_deg, max_tilt_deg=max_tilt_deg)


@dataclass(frozen=True, slots=True)
class Ladle:
    """The hand as far as a stroke depends on it."""

    slant_mm: float = 50.0
    """The sheet's radius."""
    handle_radius_mm: float = 18.0
    """Of the clamp at the rim, and of what continues the seam from there."""
    handle_mm: float = 139.0
    """From the apex along the seam to the wrist's middle."""
    edge_speed_mm_per_s: float = 20.0
    """Of the sheet's edge along the rim: how fast the cone closes."""
    rim_limits_mm: tuple[float, float] = (30.0, 95.0)
    """What the roller makes."""

    @classmethod
    def of(cls, hand: HandSpec) -> "Ladle":
        """A cell's hand."""
        return cls(
            hand.sheet_radius_mm,
            hand.mount.clamp_radius_mm,
            hand.apex_offset_mm + WRIST_TO_FLANGE_MM,
            hand.morph_speed_mm_per_s,
            hand.rim_limits_mm,
        )


@dataclass(frozen=True, slots=True)
class StrokePath:
    """The poses of a stroke, n of them, in the vessel's frame."""

    times_s: Floats
    """(n,): at an even pace of lip, axis and rim; a planner of the arm makes its own."""
    apex_mm: Floats
    """(n, 3)"""
    axis: Floats
    """(n, 3): unit vectors from the apex up out of the mouth."""
    seam: Floats
    """(n, 3): unit vectors from the apex along the slit's edge, opposite the lip; the handle goes on that way."""
    rim_mm: Floats
    """(n,): diameters."""
    lip_mm: Floats
    """(n, 3): the rim's point that leads."""
    attack_deg: Floats
    """(n,): between the lip's generator and the wall; only where the lip is on the wall."""
    on_wall: NDArray[np.bool_]
    """(n,): where the lip follows the wall."""

    @property
    def most_tilt_deg(self) -> float:
        """The most that the axis is tilted from upright."""
        return math.degrees(math.acos(float(self.axis[:, 2].min())))

    @property
    def rests(self) -> NDArray[np.bool_]:
        """(n,): where it is to come to rest: at its ends, and where the lip comes to the wall and where it leaves."""
        changes = np.flatnonzero(np.diff(self.on_wall))
        rests = np.zeros(len(self.times_s), dtype=bool)
        rests[0] = rests[-1] = True
        # Before the wall the last free pose is a step away: the first on the wall it is, and the last.
        rests[[k if self.on_wall[k] else k + 1 for k in changes]] = True
        return rests


def least_attack_deg(bowl_radius_mm: float, slant_mm: float, clear_mm: float = APEX_CLEAR_MM) -> float:
    """The flattest attack in a bowl that keeps the apex clear while it is inside; NoStrokeError where none does."""
    sine = (slant_mm**2 + 2 * bowl_radius_mm * clear_mm - clear_mm**2) / (2 * bowl_radius_mm * slant_mm)
    if sine > 1:
        raise NoStrokeError(f"a sheet of {slant_mm:g} mm is too large for a bowl of {bowl_radius_mm:g} mm radius")
    return math.degrees(math.asin(sine))


def fitting_rim_mm(bowl_radius_mm: float, slant_mm: float, attack_deg: float) -> float:
    """The rim that scrapes a bowl's whole width: L sin alpha = R cos(alpha - beta), as wide as the wall's section."""
    beta = math.radians(attack_deg)
    alpha = math.atan2(math.cos(beta), slant_mm / bowl_radius_mm - math.sin(beta))
    return 2 * slant_mm * math.sin(alpha)


def stroke_path(vessel: Vessel, stroke: Stroke, ladle: Ladle) -> StrokePath:
    """The stroke's poses; NoStrokeError with the reason where the vessel, the sheet or the handle allow none.

    ValueError for rims that the sheet cannot make.
    """
    rims_mm = (stroke.open_mm, stroke.closed_mm)
    if not 0 < min(rims_mm) <= max(rims_mm) < 2 * ladle.slant_mm:
        raise ValueError(
            f"a sheet of {ladle.slant_mm:g} mm makes no rims of {', '.join(f'{rim_mm:g}' for rim_mm in rims_mm)}"
        )
    narrowest_mm, widest_mm = ladle.rim_limits_mm
    if min(rims_mm) < narrowest_mm or max(rims_mm) > widest_mm:
        asked = f"a rim of {stroke.open_mm:g} mm that closes to {stroke.closed_mm:g} mm"
        raise NoStrokeError(f"{asked} is beyond the roller's, {narrowest_mm:g} to {widest_mm:g} mm")
    if stroke.open_mm > vessel.bore_mm - 2 * LIP_GAP_MM:
        raise NoStrokeError(f"a rim of {stroke.open_mm:g} mm does not go into a bore of {vessel.bore_mm:g} mm")
    return _in_space(_poses(vessel, replace(stroke, heading_deg=0.0), ladle), stroke, ladle)


@lru_cache(maxsize=64)
def _poses(vessel: Vessel, stroke: Stroke, ladle: Ladle) -> "tuple[_Pose, ...]":
    """In the plane of the swing, the same whatever its heading."""
    flat = _Flat(vessel, stroke, ladle)
    scrape = flat.scrape()
    return (*flat.enter(scrape[0]), *scrape, *flat.leave(scrape[-1]))


@dataclass(frozen=True, slots=True)
class _Pose:
    """One pose in the plane of the swing: the apex (along the heading, up), tilt, rim, and attack while on the wall."""

    apex_mm: tuple[float, float]
    tilt_rad: float
    rim_mm: float
    attack_rad: float = math.nan

    def lip_mm(self, slant_mm: float) -> tuple[float, float]:
        away = self.tilt_rad + _half_angle_rad(self.rim_mm, slant_mm)
        return self.apex_mm[0] + slant_mm * math.sin(away), self.apex_mm[1] + slant_mm * math.cos(away)

    def risen(self, along_mm: float, up_mm: float) -> "_Pose":
        return _Pose((self.apex_mm[0] + along_mm, self.apex_mm[1] + up_mm), self.tilt_rad, self.rim_mm)


def _half_angle_rad(rim_mm: float, slant_mm: float) -> float:
    return math.asin(rim_mm / (2 * slant_mm))


class _Flat:
    """The stroke in the plane of its swing, its clearances in space."""

    def __init__(self, vessel: Vessel, stroke: Stroke, ladle: Ladle) -> None:
        self._vessel, self._stroke, self._ladle = vessel, stroke, ladle
        around = np.linspace(0.0, math.pi, 13)
        self._around = np.stack([np.cos(around), np.sin(around)], axis=1)
        self._shares = np.array([0.25, 0.5, 0.75, 0.9, 1.0])
        half = np.linspace(0.0, math.pi, AROUND_EDGE)
        flat = np.stack([np.cos(half), np.sin(half), np.zeros(AROUND_EDGE)], axis=1)
        up = np.array([0.0, 0.0, vessel.depth_mm])
        self._edge_mm = np.concatenate([vessel.bore_mm / 2 * flat + up, vessel.outer_mm / 2 * flat + up])

    # Along the wall ---------------------------------------------------------------------------------

    def scrape(self) -> list[_Pose]:
        """The lip along the wall, from its beginning to its end or the edge, or to where the cone is upright."""
        stroke, vessel = self._stroke, self._vessel
        end_mm = min(stroke.end_mm, vessel.to_edge_mm)
        count = math.ceil((end_mm - stroke.begin_mm) / STEP_MM) + 1
        s_mm = np.linspace(stroke.begin_mm, end_mm, max(count, 2))
        shares = (s_mm - s_mm[0]) / (s_mm[-1] - s_mm[0])
        rims_mm = stroke.open_mm + (stroke.closed_mm - stroke.open_mm) * shares
        out_mm, high_mm, steep = vessel.wall(s_mm)
        lips_mm = np.stack(
            [out_mm - self._stroke.gap_mm * np.sin(steep), high_mm + self._stroke.gap_mm * np.cos(steep)], axis=1
        )
        poses = [
            self._at(lip_mm, phi, float(beta), float(rim_mm))
            for lip_mm, phi, beta, rim_mm in zip(
                lips_mm, steep, self._attacks(lips_mm, steep, rims_mm), rims_mm, strict=True
            )
        ]
        poses = self._longest(poses)
        max_tilt = math.radians(stroke.max_tilt_deg)
        # Where it cannot begin, it begins further on: a shorter stroke, but still one.
        begin = next(
            (k for k, pose in enumerate(poses) if pose.tilt_rad <= max_tilt and self._entry(pose) is not None),
            len(poses),
        )
        poses = poses[begin:]
        if len(poses) < 2:
            raise NoStrokeError(
                f"the lip has no way along the wall: the axis would have to be tilted more than "
                f"{stroke.max_tilt_deg:g} deg, or something of the hand would touch the vessel"
            )
        return poses

    def _longest(self, poses: list[_Pose]) -> list[_Pose]:
        """The run of poses across most of the vessel in which nothing touches and the cone is not tipped backwards."""
        runs: list[list[_Pose]] = [[]]
        for pose in poses:
            if pose.tilt_rad >= 0.0 and self._clear(pose, with_handle=True):
                runs[-1].append(pose)
            elif runs[-1]:
                runs.append([])
        slant_mm = self._ladle.slant_mm
        return max(runs, key=lambda run: run[-1].lip_mm(slant_mm)[0] - run[0].lip_mm(slant_mm)[0] if run else -1.0)

    def _attacks(self, lips_mm: Floats, steep: Floats, rims_mm: Floats) -> Floats:
        """The attack [rad] at each lip: as asked, or as much more as keeps apex and sheet clear; it changes gently.

        Where none does, it is as asked, and the pose is none that the stroke can use.
        """
        grid = np.radians(np.arange(self._stroke.attack_deg, STEEPEST_DEG + ATTACK_GRID_DEG, ATTACK_GRID_DEG))
        needed = np.array(
            [
                self._least(lip_mm, float(phi), float(rim_mm), grid)
                for lip_mm, phi, rim_mm in zip(lips_mm, steep, rims_mm, strict=True)
            ]
        )
        # The largest nearby, and then the mean of those: never less than is needed, and without a jump.
        reach = max(1, round(EVENED_MM / STEP_MM))
        padded = np.pad(needed, 2 * reach, mode="edge")
        window = 2 * reach + 1
        largest = np.lib.stride_tricks.sliding_window_view(padded, window).max(axis=1)
        evened: Floats = np.lib.stride_tricks.sliding_window_view(largest, window).mean(axis=1)
        return evened

    def _least(self, lip_mm: Floats, steep: float, rim_mm: float, grid: Floats) -> float:
        """The first attack of a grid [rad] that is clear, looked for roughly before exactly; or its first."""

        def is_clear(n: int) -> bool:
            return self._clear(self._at(lip_mm, steep, float(grid[n]), rim_mm))

        near = next((n for n in range(0, len(grid), COARSELY) if is_clear(n)), 0)
        return float(grid[next(n for n in range(max(0, near - COARSELY + 1), near + 1) if n == near or is_clear(n))])

    def _at(self, lip_mm: Floats, steep: float, attack: float, rim_mm: float) -> _Pose:
        slant_mm = self._ladle.slant_mm
        incline = steep - attack
        apex_mm = (lip_mm[0] - slant_mm * math.cos(incline), lip_mm[1] - slant_mm * math.sin(incline))
        tilt = math.pi / 2 + attack - steep - _half_angle_rad(rim_mm, slant_mm)
        return _Pose((float(apex_mm[0]), float(apex_mm[1])), tilt, rim_mm, attack)

    # In and out -------------------------------------------------------------------------------------

    def enter(self, first: _Pose) -> list[_Pose]:
        """Down along the first generator, or as much steeper as it must be, from where the lip is over the vessel.

        There what the cone still held falls into it.
        """
        entry = self._entry(first)
        assert entry is not None  # as the wall's first pose is one that can be entered
        return entry

    def _entry(self, first: _Pose) -> list[_Pose] | None:
        lip_mm = first.lip_mm(self._ladle.slant_mm)
        incline = math.atan2(first.apex_mm[1] - lip_mm[1], first.apex_mm[0] - lip_mm[0])
        # Not at all where it is there already: above a full vessel's edge, with a lip that leaves a thick layer.
        up_mm = max(0.0, self._vessel.depth_mm + OVER_EDGE_MM - min(lip_mm[1], first.apex_mm[1]))
        for back in np.linspace(incline, math.pi / 2, ENTRIES).tolist():
            if math.sin(back) < LEVEL_ENTRY:
                continue
            way_mm = up_mm / math.sin(back)
            aside_mm = max(0.0, OVER_VESSEL_MM - self._vessel.bore_mm / 2 - lip_mm[0] - way_mm * math.cos(back))
            poses = [
                first.risen(way_mm * math.cos(back) + aside_mm * share, way_mm * math.sin(back))
                for share in np.linspace(1.0, 0.0, math.ceil(aside_mm / STEP_MM), endpoint=False).tolist()
            ] + [
                first.risen(way_mm * share * math.cos(back), way_mm * share * math.sin(back))
                for share in np.linspace(1.0, 0.0, math.ceil(way_mm / STEP_MM), endpoint=False).tolist()
            ]
            if all(self._clear(pose, with_handle=True) for pose in poses):
                return poses
        return None

    def leave(self, last: _Pose) -> list[_Pose]:
        """Upright about the apex, rising where something would touch, and out."""
        poses: list[_Pose] = []
        along_mm, up_mm = last.apex_mm
        for tilt in np.linspace(last.tilt_rad, 0.0, max(2, math.ceil(math.degrees(last.tilt_rad) / STEP_DEG) + 1)):
            pose = _Pose((along_mm, up_mm), float(tilt), last.rim_mm)
            while not self._clear(pose, with_handle=True):
                up_mm += STEP_MM
                if up_mm > self._vessel.depth_mm + OVER_EDGE_MM + self._ladle.slant_mm:
                    raise NoStrokeError("the cone cannot be turned upright")
                if poses:
                    poses.append(_Pose((along_mm, up_mm), poses[-1].tilt_rad, last.rim_mm))
                pose = _Pose((along_mm, up_mm), float(tilt), last.rim_mm)
            poses.append(pose)
        top_mm = max(self._vessel.depth_mm + OVER_EDGE_MM, up_mm)
        for share in np.linspace(0.0, 1.0, RISING)[1:].tolist():
            poses.append(_Pose((along_mm, up_mm + (top_mm - up_mm) * share), 0.0, last.rim_mm))
        return poses

    # What is clear ----------------------------------------------------------------------------------

    def _clear(self, pose: _Pose, *, with_handle: bool = False) -> bool:
        """Whether apex and sheet, and the handle, keep from the vessel what they are to keep."""
        points, kept_mm = self._points(pose, with_handle)
        if not (self._vessel.clearance_mm(points) >= kept_mm).all():
            return False
        return not with_handle or self._from_edge_mm(pose) >= min(self._stroke.gap_mm, 0.0) - SLACK_MM

    def _from_edge_mm(self, pose: _Pose) -> float:
        """How far the sheet is from the vessel's edge, which may come between its points; negative within the cone."""
        slant_mm, alpha = self._ladle.slant_mm, _half_angle_rad(pose.rim_mm, self._ladle.slant_mm)
        from_apex_mm = self._edge_mm - np.array([pose.apex_mm[0], 0.0, pose.apex_mm[1]])
        along_mm = from_apex_mm @ np.array([math.sin(pose.tilt_rad), 0.0, math.cos(pose.tilt_rad)])
        aside_mm = np.sqrt(np.maximum((from_apex_mm**2).sum(axis=1) - along_mm**2, 0.0))
        on_slant_mm = along_mm * math.cos(alpha) + aside_mm * math.sin(alpha)
        off_mm = aside_mm * math.cos(alpha) - along_mm * math.sin(alpha)
        beside = (on_slant_mm > 0.0) & (on_slant_mm < slant_mm) & (along_mm < slant_mm * math.cos(alpha))
        return float(off_mm[beside].min(initial=math.inf))

    def _points(self, pose: _Pose, with_handle: bool) -> tuple[Floats, Floats]:
        """Points of cone and handle (m, 3), y across the swing, and how far each is to be from the vessel (m,)."""
        slant_mm, alpha = self._ladle.slant_mm, _half_angle_rad(pose.rim_mm, self._ladle.slant_mm)
        sine, cosine = math.sin(pose.tilt_rad), math.cos(pose.tilt_rad)
        axis, down, across = np.array([sine, 0.0, cosine]), np.array([cosine, 0.0, -sine]), np.array([0.0, 1.0, 0.0])
        generators = math.cos(alpha) * axis + math.sin(alpha) * (
            self._around[:, :1] * down + self._around[:, 1:] * across
        )
        apex_mm = np.array([pose.apex_mm[0], 0.0, pose.apex_mm[1]])
        sheet_mm = apex_mm + slant_mm * (self._shares[:, None, None] * generators).reshape(-1, 3)
        points = [apex_mm[None, :], sheet_mm]
        kept = [np.array([APEX_CLEAR_MM]), np.full(len(sheet_mm), min(self._stroke.gap_mm, 0.0) - SLACK_MM)]
        if with_handle:
            along_mm = np.linspace(slant_mm - CLAMP_MM, self._ladle.handle_mm, 10)
            points.append(apex_mm + along_mm[:, None] * (math.cos(alpha) * axis - math.sin(alpha) * down))
            handle_mm = np.full(len(along_mm), self._ladle.handle_radius_mm)
            handle_mm[-1] = WRIST_RADIUS_MM
            kept.append(handle_mm + HANDLE_GAP_MM)
        return np.concatenate(points), np.concatenate(kept)


def _in_space(poses: Sequence[_Pose], stroke: Stroke, ladle: Ladle) -> StrokePath:
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


def _times_s(poses: Sequence[_Pose], lip_mm: Floats, stroke: Stroke, ladle: Ladle) -> Floats:
    """Each step as quick as the slowest of lip, apex, axis, and the sheet's edge."""
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
    """The headings of several strokes turned about the vertical: each as far from those before it as it can be."""
    for k in range(count):
        bits = f"{k:b}"[::-1]
        yield (first_deg + 360.0 * sum(int(bit) / 2 ** (place + 1) for place, bit in enumerate(bits))) % 360.0
