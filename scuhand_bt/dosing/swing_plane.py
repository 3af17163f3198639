"""The lip-led swing in its upright plane: the poses of apex and axis, and their clearance (docs/scoop.md, The angles).

For a lip P where the wall has the slope phi:

    generator from apex to lip      inclined by phi - beta, with beta the attack angle between it and the wall
    theta + phi = 90 deg + beta - alpha        theta tilt of the axis from upright, alpha half-angle of the cone
    A = P - L (cos(phi - beta), sin(phi - beta))        the apex, whatever alpha is

The apex stays c clear of a bowl of radius R where

    sin beta >= (L^2 + 2 R c - c^2) / (2 R L)

A flatter attack is possible only while the apex is above the vessel's edge. So the attack is the one asked for, or as
much more as keeps the apex and the rest of the sheet clear.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scuhand_bt.dosing.ladle import Ladle, NoStrokeError, Stroke
from scuhand_bt.dosing.vessel import Vessel

Floats = NDArray[np.float64]

APEX_CLEAR_MM = 3.0
"""Least distance of the apex from the vessel."""
STEP_MM = 1.0
"""Largest step of the lip between two poses."""
STEP_DEG = 1.5
"""Largest turn of the axis between two poses."""
OVER_EDGE_MM = 10.0
"""Height above the vessel's edge at which a stroke begins and ends."""
OVER_VESSEL_MM = 15.0
"""Least distance of the lip within the bore at that height."""
ATTACK_GRID_DEG = 0.25
COARSELY = 8
"""The grid of attacks is searched in steps of so many first."""
STEEPEST_DEG = 88.0
WRIST_RADIUS_MM = 45.0
HANDLE_GAP_MM = 3.0
CLAMP_MM = 10.0
"""Length of the clamp, from the rim towards the apex."""
RISING = 25
"""Poses on the way up out of the vessel."""
ENTRIES = 5
"""Ways in that are tried, from along the first generator to straight down."""
LEVEL_ENTRY = 0.2
"""Sine of the flattest way in."""
AROUND_EDGE = 37
"""Points on half of the vessel's edge, inside and outside each."""
EVENED_MM = 8.0
"""A change of the attack is spread over so much of the lip's way, before and behind."""
ROUNDING_MM = 1e-6
"""Rounding of results for many apexes at once; nearer than this to the limit, an apex is looked at singly."""
SLACK_MM = 0.05
"""The sheet beside the lip may be nearer to the wall than the lip by this."""


def least_attack_deg(bowl_radius_mm: float, slant_mm: float, clear_mm: float = APEX_CLEAR_MM) -> float:
    """The flattest attack that keeps the apex clear within a bowl; raises NoStrokeError where none does."""
    sine = (slant_mm**2 + 2 * bowl_radius_mm * clear_mm - clear_mm**2) / (2 * bowl_radius_mm * slant_mm)
    if sine > 1:
        raise NoStrokeError(f"a sheet of {slant_mm:g} mm is too large for a bowl of {bowl_radius_mm:g} mm radius")
    return math.degrees(math.asin(sine))


def fitting_rim_mm(bowl_radius_mm: float, slant_mm: float, attack_deg: float) -> float:
    """The diameter of a rim that scrapes a bowl's whole width: L sin alpha = R cos(alpha - beta)."""
    beta = math.radians(attack_deg)
    alpha = math.atan2(math.cos(beta), slant_mm / bowl_radius_mm - math.sin(beta))
    return 2 * slant_mm * math.sin(alpha)


@dataclass(frozen=True, slots=True)
class Pose:
    """A pose in the plane of the swing: apex (along the heading, up), tilt, rim diameter, and attack if on the wall."""

    apex_mm: tuple[float, float]
    tilt_rad: float
    rim_mm: float
    attack_rad: float = math.nan

    def lip_mm(self, slant_mm: float) -> tuple[float, float]:
        away = self.tilt_rad + _half_angle_rad(self.rim_mm, slant_mm)
        return self.apex_mm[0] + slant_mm * math.sin(away), self.apex_mm[1] + slant_mm * math.cos(away)

    def risen(self, along_mm: float, up_mm: float) -> "Pose":
        return Pose((self.apex_mm[0] + along_mm, self.apex_mm[1] + up_mm), self.tilt_rad, self.rim_mm)


def _half_angle_rad(rim_mm: float, slant_mm: float) -> float:
    return math.asin(rim_mm / (2 * slant_mm))


class Flat:
    """A stroke in the plane of its swing; clearances are those in space."""

    def __init__(self, vessel: Vessel, stroke: Stroke, ladle: Ladle) -> None:
        self._vessel, self._stroke, self._ladle = vessel, stroke, ladle
        around = np.linspace(0.0, math.pi, 13)
        self._down, self._across = np.cos(around), np.sin(around)
        self._shares = np.array([0.25, 0.5, 0.75, 0.9, 1.0])
        self._along_handle_mm = np.linspace(ladle.slant_mm - CLAMP_MM, ladle.handle_mm, 10)
        of_sheet_mm = np.full(len(self._shares) * len(around), min(stroke.gap_mm, 0.0) - SLACK_MM)
        of_handle_mm = np.full(len(self._along_handle_mm), ladle.handle_radius_mm)
        of_handle_mm[-1] = WRIST_RADIUS_MM
        self._kept_mm = np.concatenate([[APEX_CLEAR_MM], of_sheet_mm, of_handle_mm + HANDLE_GAP_MM])
        half = np.linspace(0.0, math.pi, AROUND_EDGE)
        flat = np.stack([np.cos(half), np.sin(half), np.zeros(AROUND_EDGE)], axis=1)
        up = np.array([0.0, 0.0, vessel.depth_mm])
        self._edge_mm = np.concatenate([vessel.bore_mm / 2 * flat + up, vessel.outer_mm / 2 * flat + up])

    # Along the wall ---------------------------------------------------------------------------------

    def scrape(self) -> list[Pose]:
        """The poses with the lip on the wall, up to the stroke's end, the edge, or where the cone is upright."""
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
        # A stroke that cannot begin here begins further on, and is shorter.
        begin = next(
            (k for k, pose in enumerate(poses) if pose.tilt_rad <= max_tilt and self._entry(pose) is not None),
            len(poses),
        )
        poses = poses[begin:]
        if len(poses) < 2:
            raise NoStrokeError(
                f"the lip cannot follow the wall: the axis would have to tilt by more than {stroke.max_tilt_deg:g} "
                "deg, or the hand would touch the vessel"
            )
        return poses

    def _longest(self, poses: list[Pose]) -> list[Pose]:
        """The longest run of poses in which nothing touches and the cone does not tip backwards."""
        runs: list[list[Pose]] = [[]]
        for pose, is_clear in zip(poses, self._clear(poses, with_handle=True), strict=True):
            if pose.tilt_rad >= 0.0 and is_clear:
                runs[-1].append(pose)
            elif runs[-1]:
                runs.append([])
        slant_mm = self._ladle.slant_mm
        return max(runs, key=lambda run: run[-1].lip_mm(slant_mm)[0] - run[0].lip_mm(slant_mm)[0] if run else -1.0)

    def _attacks(self, lips_mm: Floats, steep: Floats, rims_mm: Floats) -> Floats:
        """The attack [rad] at each lip: as asked, or as much more as keeps apex and sheet clear, changing gently.

        Where no attack is clear it is as asked, and the stroke cannot use that pose.
        """
        grid = np.radians(np.arange(self._stroke.attack_deg, STEEPEST_DEG + ATTACK_GRID_DEG, ATTACK_GRID_DEG))
        needed = self._least(lips_mm, steep, rims_mm, grid)
        # The largest nearby, then the mean of these: never less than is needed, and without a jump.
        reach = max(1, round(EVENED_MM / STEP_MM))
        padded = np.pad(needed, 2 * reach, mode="edge")
        window = 2 * reach + 1
        largest = np.lib.stride_tricks.sliding_window_view(padded, window).max(axis=1)
        evened: Floats = np.lib.stride_tricks.sliding_window_view(largest, window).mean(axis=1)
        return evened

    def _least(self, lips_mm: Floats, steep: Floats, rims_mm: Floats, grid: Floats) -> Floats:
        """At each lip, the first attack of a grid [rad] that is clear, or the grid's first if none is.

        All lips are handled at once, as one pose costs hardly less than a hundred.
        """
        # For most attacks that are not clear, the apex alone shows it.
        inclines, slant_mm = steep[:, None] - grid, self._ladle.slant_mm
        along_mm, up_mm = lips_mm[:, :1] - slant_mm * np.cos(inclines), lips_mm[:, 1:] - slant_mm * np.sin(inclines)
        apexes_mm = np.stack([along_mm, np.zeros_like(along_mm), up_mm], axis=-1)
        may_be = self._vessel.clearance_mm(apexes_mm) > APEX_CLEAR_MM - ROUNDING_MM

        def clear(lips: NDArray[np.intp], attacks: NDArray[np.intp]) -> NDArray[np.bool_]:
            """(n,): which of these lips are clear with these attacks of the grid."""
            is_clear = may_be[lips, attacks]
            tried = zip(lips[is_clear], attacks[is_clear], strict=True)
            is_clear[is_clear] = self._clear(
                [self._at(lips_mm[k], float(steep[k]), float(grid[n]), float(rims_mm[k])) for k, n in tried]
            )
            return is_clear

        first = np.zeros(len(steep), dtype=np.intp)
        left = np.arange(len(steep))
        for n in range(0, len(grid), COARSELY):
            found = clear(left, np.full(len(left), n))
            first[left[found]] = n
            left = left[~found]
        left = np.flatnonzero(first)
        for before in range(COARSELY - 1, 0, -1):
            found = clear(left, first[left] - before)
            first[left[found]] -= before
            left = left[~found]
        return grid[first]

    def _at(self, lip_mm: Floats, steep: float, attack: float, rim_mm: float) -> Pose:
        slant_mm = self._ladle.slant_mm
        incline = steep - attack
        apex_mm = (lip_mm[0] - slant_mm * math.cos(incline), lip_mm[1] - slant_mm * math.sin(incline))
        tilt = math.pi / 2 + attack - steep - _half_angle_rad(rim_mm, slant_mm)
        return Pose((float(apex_mm[0]), float(apex_mm[1])), tilt, rim_mm, attack)

    # In and out -------------------------------------------------------------------------------------

    def enter(self, first: Pose) -> list[Pose]:
        """The way down along the first generator, or as much steeper as is needed, from a lip over the vessel.

        What the cone still holds falls into the vessel there.
        """
        entry = self._entry(first)
        assert entry is not None  # the wall's first pose was chosen so
        return entry

    def _entry(self, first: Pose) -> list[Pose] | None:
        lip_mm = first.lip_mm(self._ladle.slant_mm)
        incline = math.atan2(first.apex_mm[1] - lip_mm[1], first.apex_mm[0] - lip_mm[0])
        # 0 if it is above the edge already: a full vessel, and a lip that leaves a thick layer.
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
            if self._clear(poses, with_handle=True).all():
                return poses
        return None

    def leave(self, last: Pose) -> list[Pose]:
        """Turn upright about the apex, rising only where something would touch, and rise out."""
        poses: list[Pose] = []
        along_mm, up_mm = last.apex_mm
        for tilt in np.linspace(last.tilt_rad, 0.0, max(2, math.ceil(math.degrees(last.tilt_rad) / STEP_DEG) + 1)):
            pose = Pose((along_mm, up_mm), float(tilt), last.rim_mm)
            while not self._clear([pose], with_handle=True).all():
                up_mm += STEP_MM
                if up_mm > self._vessel.depth_mm + OVER_EDGE_MM + self._ladle.slant_mm:
                    raise NoStrokeError("the cone cannot be turned upright")
                if poses:
                    poses.append(Pose((along_mm, up_mm), poses[-1].tilt_rad, last.rim_mm))
                pose = Pose((along_mm, up_mm), float(tilt), last.rim_mm)
            poses.append(pose)
        top_mm = max(self._vessel.depth_mm + OVER_EDGE_MM, up_mm)
        for share in np.linspace(0.0, 1.0, RISING)[1:].tolist():
            poses.append(Pose((along_mm, up_mm + (top_mm - up_mm) * share), 0.0, last.rim_mm))
        return poses

    # What is clear ----------------------------------------------------------------------------------

    def _clear(self, poses: Sequence[Pose], *, with_handle: bool = False) -> NDArray[np.bool_]:
        """(n,): whether apex and sheet, and the handle if asked, keep their distances from the vessel."""
        if not poses:
            return np.zeros(0, dtype=bool)
        half_rad = [_half_angle_rad(pose.rim_mm, self._ladle.slant_mm) for pose in poses]
        # Python's functions, as numpy's differ in the last digit with the length of the array.
        turned = np.array(
            [
                (math.sin(pose.tilt_rad), math.cos(pose.tilt_rad), math.sin(alpha), math.cos(alpha), *pose.apex_mm)
                for pose, alpha in zip(poses, half_rad, strict=True)
            ]
        )
        points_mm = self._points_mm(turned, with_handle)
        clear_mm = self._vessel.clearance_mm(points_mm) - self._kept_mm[: points_mm.shape[1]]
        is_clear: NDArray[np.bool_] = clear_mm.min(axis=1) >= 0.0
        if with_handle:
            is_clear &= self._from_edge_mm(turned) >= min(self._stroke.gap_mm, 0.0) - SLACK_MM
        return is_clear

    def _from_edge_mm(self, turned: Floats) -> Floats:
        """(n,): distance of the sheet from the vessel's edge, which its points may straddle; negative within."""
        sine, cosine, sine_half, cosine_half, apex_x_mm, apex_z_mm = turned.T[:, :, None]
        slant_mm = self._ladle.slant_mm
        x_mm, y_mm, z_mm = self._edge_mm[:, 0] - apex_x_mm, self._edge_mm[:, 1], self._edge_mm[:, 2] - apex_z_mm
        along_mm = x_mm * sine + z_mm * cosine
        aside_mm = np.sqrt(np.maximum(x_mm**2 + y_mm**2 + z_mm**2 - along_mm**2, 0.0))
        on_slant_mm = along_mm * cosine_half + aside_mm * sine_half
        off_mm = aside_mm * cosine_half - along_mm * sine_half
        beside = (on_slant_mm > 0.0) & (on_slant_mm < slant_mm) & (along_mm < slant_mm * cosine_half)
        least_mm: Floats = off_mm.min(axis=1, initial=math.inf, where=beside)
        return least_mm

    def _points_mm(self, turned: Floats, with_handle: bool) -> Floats:
        """(n, m, 3): the apex, points of the sheet, and of the handle; y across the swing.

        `turned` (n, 6) has, per pose, sine and cosine of the tilt and of the half-angle, and the apex.
        """
        sine, cosine, sine_half, cosine_half, x_mm, z_mm = turned.T[:, :, None]
        slants_mm = self._ladle.slant_mm * self._shares[:, None]

        def on_sheet_mm(generators: Floats) -> Floats:
            return (slants_mm * generators[:, None, :]).reshape(len(turned), self._shares.size * self._down.size)

        parts = [
            (x_mm, np.zeros_like(x_mm), z_mm),
            (
                x_mm + on_sheet_mm(cosine_half * sine + sine_half * (self._down * cosine)),
                on_sheet_mm(sine_half * self._across),
                z_mm + on_sheet_mm(cosine_half * cosine - sine_half * (self._down * sine)),
            ),
        ]
        if with_handle:
            along_mm = self._along_handle_mm
            handle = (
                x_mm + along_mm * (cosine_half * sine - sine_half * cosine),
                x_mm * np.zeros_like(along_mm),
                z_mm + along_mm * (cosine_half * cosine + sine_half * sine),
            )
            parts.append(handle)
        return np.stack([np.concatenate(of_axis, axis=1) for of_axis in zip(*parts, strict=True)], axis=-1)
