"""Powder in a mortar as a height field, and what a cone that moves through it takes in.

    s = floor + t,      |s_i - s_j| <= d tan(repose)        t thickness, s surface, i and j neighbours d apart [mm]

Powder stands in columns on a square grid. Where the cone is above a column, the column has two layers: a sheltered one
on the wall, and one on the inside of the sheet. The uppermost layers of all columns form one surface. It flows until
nowhere steeper than the angle of repose (thin layers: the angle of wall friction). Powder flows over the rim in both
directions, never through the sheet.

Each step of the cone's motion:

* where the rim has passed over a column, the powder above the rim is now on the sheet;
* where the outside of the sheet meets powder, it pushes the powder aside;
* powder on the sheet moves with the sheet;
* then the surface flows.

So a cone that closes upright takes nothing, and a lip that moves along the wall takes the powder in front of it. The
model knows nothing of what a skill expects. It leaves out inertia and most of the sheet's softness (`GIVES_MM`).

Height fields of granular beds: Li & Moshell, Modeling soil, SIGGRAPH 1993; Sumner, O'Brien & Hodgins, Animating sand,
mud, and snow, Computer Graphics Forum 18, 1999. Ours adds the second layer, on the sheet.

Frame: origin at the bowl's lowest point, z up, lengths in mm.
"""

import math
import zlib
from base64 import b64decode, b64encode

import numpy as np
from numpy.typing import NDArray

from scuhand_bt.sim import avalanche
from scuhand_bt.sim.cone_over import ConeOver, ConePose, Floats, Mask
from scuhand_bt.specs import Mortar, Powder

CELL_MM = 3.0
BESIDE_MM = 15.0
"""How far the field extends beyond the bore. The cone may be there; powder that comes there is lost."""
STEP_MM = 2.0
"""The cone's motion between two updates of the powder is at least this, and less than twice this."""
SWEEPS = 8
"""Sweeps of the flow after every step; `SETTLING` sweeps once the cone has left."""
SETTLING = 60
CHECKED = 5
AT_REST_MM = 1e-3
"""The powder is at rest if no column changes by more in a sweep; tested every `CHECKED` sweeps."""
POURED_MG = 1e-3
"""The least gain of the mortar since the cone was last in it that counts as poured powder; less is rounding."""
ROOM_MM = 1.0
"""A column under the sheet with less room is full."""
GIVES_MM = 0.5
"""How far the lip of a sheet of 0.2 mm gives way; assumed, not measured."""
GRIP = 0.3
"""The share of the sheet's motion along its own surface that its load follows."""
GRAINS_THICK = 1.5
"""A layer of fewer grains slides on the wall as a whole."""

ONE_LAYER = 0.94
"""The thickness of one closely packed layer of spheres at bulk density, in grain diameters: it covers 0.85 of the
area, and the packing fraction is 0.6."""


def wall_mm(mortar: Mortar, radius_mm: Floats) -> Floats:
    """The height of the wall of a bowl, or of a jar, at distances from its axis; outside it, that of the edge."""
    a, h = mortar.bore_mm / 2, mortar.depth_mm
    if (corner := mortar.corner_mm) is not None:
        into_mm = np.clip(radius_mm - (a - corner), 0.0, corner)
        return np.where(radius_mm > a, h, corner - np.sqrt(corner**2 - into_mm**2))
    sphere_mm = max(a, (a * a + h * h) / (2 * h))  # of half a sphere rounding makes less
    height: Floats = sphere_mm - np.sqrt(sphere_mm**2 - np.minimum(radius_mm, a) ** 2)
    return height


def nipped_mm(grain_mm: float, wall_friction_deg: float) -> float:
    """The least gap under a lip at which the lip passes over a grain; in a narrower gap it pushes the grain along.

    The nip angle of rolls: two walls hold a grain if they enclose at most twice the angle of friction. The edge of a
    lip touches a grain of diameter D on a wall at the height g of the gap; the angle there is arccos(2 g / D - 1). So
    g = D cos^2(delta).
    """
    return grain_mm * math.cos(math.radians(wall_friction_deg)) ** 2


def passing_mm(gap_mm: Floats, grain_mm: float, loose_grains: float) -> Floats:
    """The powder that passes under a lip at a gap, as its thickness at bulk density.

    The lip takes along the grains whose tops are above it, and a layer is looser beside a wall. So the top of a layer
    is `loose_grains` higher than its mass suggests: 0.7 in beds of beads of 1.5 and 2 mm, 5 and 8 mm thick, by the
    discrete element method (voids of spheres beside a wall: Benenati & Brosilow, AIChE J. 8, 1962). It has not been
    measured for other powders. One layer of grains passes a gap that passes one grain.
    """
    passing: Floats = np.minimum(gap_mm, np.maximum(gap_mm - loose_grains * grain_mm, ONE_LAYER * grain_mm))
    return passing


class HeightField:
    """The powder of one mortar, and that in the cone while the cone is in the mortar.

    It remembers where the powder lies. With every motion the caller gives the masses.
    """

    def __init__(self, mortar: Mortar, powder: Powder, slant_mm: float = 50.0, gives_mm: float = GIVES_MM) -> None:
        """`gives_mm` is the widest gap under its lip that the sheet closes by bending down; 0 for a rigid sheet."""
        self._mortar, self._slant_mm, self._gives_mm = mortar, slant_mm, gives_mm
        figures = powder.simulation
        self._mg_per_mm = CELL_MM**2 * powder.bulk_density_mg_per_mm3
        self._film_mm, self._grain_mm, self._loose = figures.film_mm, figures.grain_mm, figures.loose_grains
        self._steep = math.tan(math.radians(powder.repose_deg))
        self._slick = min(self._steep, math.tan(math.radians(powder.wall_friction_deg)))
        self._nipped_mm = nipped_mm(self._grain_mm, powder.wall_friction_deg)
        reach = math.ceil((mortar.bore_mm / 2 + BESIDE_MM) / CELL_MM)
        line = CELL_MM * np.arange(-reach, reach + 1)
        self._x, self._y = np.meshgrid(line, line, indexing="ij")
        radius = np.hypot(self._x, self._y)
        self._wall = wall_mm(mortar, radius)
        self._outside = radius > mortar.bore_mm / 2
        self._border = np.abs(self._x) + CELL_MM > line[-1]
        self._border |= self._border.T
        self._on_wall = np.zeros_like(self._wall)
        self._on_sheet = np.zeros_like(self._wall)
        self._lost_mm = 0.0  # over the edge, since `_told_mg` was last called
        self._cone: ConeOver | None = None
        self._ways, self._nowhere = _ways(len(line)), np.zeros(radius.size, bool)
        self._written: str | None = None

    @property
    def in_mortar_mg(self) -> float:
        return float(self._on_wall.sum()) * self._mg_per_mm

    @property
    def in_cone_mg(self) -> float:
        return float(self._on_sheet.sum()) * self._mg_per_mm

    def surface_mm(self) -> Floats:
        """(n, n): the height of the uppermost powder, or of the floor where there is none."""
        floor, top = self._uppermost()
        return floor + top

    def move(
        self, apex_mm: Floats, axis: Floats, rim_mm: float, in_mortar_mg: float, in_cone_mg: float
    ) -> tuple[float, float]:
        """Move the cone here; returns the mass [mg] that it gained (negative: lost), and the mass gone over the edge.

        Apex (3,) from the bowl's lowest point, z up; axis (3,), unit vector from the apex out of the mouth; `rim_mm`
        is the rim's diameter. `in_mortar_mg` and `in_cone_mg` are the masses before this motion. Motions below
        `STEP_MM` add up.
        """
        there = ConePose(np.asarray(apex_mm, float), np.asarray(axis, float), rim_mm, self._slant_mm)
        self._agree(there, in_mortar_mg, in_cone_mg)
        here = self._cone.pose if self._cone is not None else there
        steps = int(here.way_mm(there) / STEP_MM) if self._cone is not None else 1
        for share in np.linspace(0.0, 1.0, steps + 1)[1:]:
            self._step(here.towards(there, float(share)))
        return self.in_cone_mg - in_cone_mg, self._told_mg()

    def leave(self) -> float:
        """The cone has left the mortar with its load; returns the mass [mg] that goes over the edge until the bed is
        at rest.
        """
        self._on_sheet[:] = 0.0
        self._cone = self._written = None
        self._flow(SETTLING)
        return self._told_mg()

    def _told_mg(self) -> float:
        """The mass that has gone over the edge since the last call."""
        lost_mg, self._lost_mm = self._lost_mm * self._mg_per_mm, 0.0
        return lost_mg

    @property
    def kept(self) -> tuple[str, list[float]]:
        """Both layers (float32, row by row, compressed, base64), and the cone's apex, axis and rim if it is inside."""
        if self._written is None:
            layers = np.stack([self._on_wall, self._on_sheet]).astype("<f4")
            self._written = b64encode(zlib.compress(layers.tobytes(), 1)).decode()
        pose = self._cone.pose if self._cone is not None else None
        return self._written, [*pose.apex_mm.tolist(), *pose.axis.tolist(), pose.rim_mm] if pose is not None else []

    @kept.setter
    def kept(self, written: tuple[str, list[float]]) -> None:
        text, cone = written
        layers = np.frombuffer(zlib.decompress(b64decode(text)), "<f4").reshape(2, *self._wall.shape)
        self._on_wall, self._on_sheet = layers.astype(float)
        if cone:
            pose = ConePose(np.array(cone[:3]), np.array(cone[3:6]), cone[6], self._slant_mm)
            self._cone = ConeOver(pose, self._x, self._y)

    def _agree(self, pose: ConePose, in_mortar_mg: float, in_cone_mg: float) -> None:
        """Adjust the layers to these masses: added powder forms a heap; of a loss, every column takes the same share.

        The first powder of a mortar was filled in by a person, and lies level.
        """
        there_mg = self.in_mortar_mg
        more_mg = in_mortar_mg - there_mg
        if more_mg > POURED_MG and there_mg <= POURED_MG:
            self._on_wall += self._filled(np.where(self._outside, math.inf, self._wall), more_mg)
            self._written = None
        elif more_mg > POURED_MG:
            self._pour(more_mg)
        elif more_mg:
            self._on_wall *= in_mortar_mg / max(there_mg, 1e-300)
            self._written = None
        if self.in_cone_mg > 0.0:
            self._on_sheet *= in_cone_mg / self.in_cone_mg
        elif in_cone_mg > 0.0:
            self._lay(pose, in_cone_mg)

    def _pour(self, mass_mg: float) -> None:
        """Pour powder onto the middle: it forms a heap."""
        below = self._steep * np.hypot(self._x, self._y) + self._wall + self._on_wall
        self._on_wall += self._filled(np.where(self._outside, math.inf, below), mass_mg)
        self._flow(SETTLING)

    def _lay(self, pose: ConePose, mass_mg: float) -> None:
        """The cone enters with a load: it lies level until it flows."""
        cone = ConeOver(pose, self._x, self._y)
        if cone.over.any():
            self._on_sheet = self._filled(np.where(cone.over, cone.sheet_mm, math.inf), mass_mg)

    def _filled(self, floor_mm: Floats, mass_mg: float) -> Floats:
        """The thickness of this mass on a floor, filled up to one level."""
        low_mm, high_mm = float(floor_mm.min()), float(floor_mm.min()) + 1000.0
        while high_mm - low_mm > 1e-4:
            level_mm = (low_mm + high_mm) / 2
            is_low = float(np.maximum(level_mm - floor_mm, 0.0).sum()) * self._mg_per_mm < mass_mg
            low_mm, high_mm = (level_mm, high_mm) if is_low else (low_mm, level_mm)
        thickness = np.maximum(high_mm - floor_mm, 0.0)
        return thickness * (mass_mg / self._mg_per_mm / float(thickness.sum()))

    # --- a step

    def _step(self, pose: ConePose) -> None:
        before, self._cone = self._cone, ConeOver(pose, self._x, self._y)
        over = self._cone.over
        if before is not None:
            self._ride(before, pose)
        moved = self._carry(over)
        if before is not None:
            moved |= self._cut(over & ~before.over, before.pose, pose)
        moved |= self._push(over)
        if moved or self._on_sheet.any():
            self._flow(SWEEPS)

    def _ride(self, before: ConeOver, now: ConePose) -> None:
        """The powder on the sheet moves with the sheet; each column's mass is shared by four."""
        loaded = self._on_sheet > 0.0
        if not loaded.any():
            return
        thick = self._on_sheet[loaded]
        points = np.stack([self._x[loaded], self._y[loaded], before.sheet_mm[loaded]], axis=1)
        way = before.pose.moved_to(now, points) - points
        normal = before.pose.normals(points)
        across = (way * normal).sum(axis=1, keepdims=True) * normal
        place = (points + across + GRIP * (way - across) - self._x[0, 0])[:, :2] / CELL_MM
        corner = np.clip(np.floor(place).astype(int), 0, len(self._x) - 2)
        share = np.clip(place - corner, 0.0, 1.0)
        self._on_sheet[:] = 0.0
        for i, part_i in enumerate((1.0 - share[:, 0], share[:, 0])):
            for j, part_j in enumerate((1.0 - share[:, 1], share[:, 1])):
                np.add.at(self._on_sheet, (corner[:, 0] + i, corner[:, 1] + j), thick * part_i * part_j)

    def _carry(self, over: Mask) -> bool:
        """Powder of columns that the sheet no longer covers has moved along with the sheet."""
        left = ~over & (self._on_sheet > 0.0)
        if not left.any():
            return False
        moved = self._on_sheet[left]
        self._on_sheet[left] = 0.0
        if over.any():
            self._add_nearest(self._on_sheet, over, left, moved)
        else:
            self._on_wall[left] += moved
        return True

    def _cut(self, entered: Mask, before: ConePose, now: ConePose) -> bool:
        """The powder that the rim has passed under is now on the sheet."""
        entered = entered & (self._on_wall > 0.0)
        if not entered.any():
            return False
        x, y = self._x[entered], self._y[entered]
        wall, thick = self._wall[entered], self._on_wall[entered]
        assert self._cone is not None
        # The rim's point on the same generator left a layer as thick as its gap to the wall.
        points = np.stack([x, y, self._cone.sheet_mm[entered]], axis=1)
        rim = now.apex_mm + (points - now.apex_mm) * (now.height_mm / np.maximum(now.along_mm(points), 1e-6))[:, None]
        gap = rim[:, 2] - wall_mm(self._mortar, np.hypot(rim[:, 0], rim[:, 1]))
        gap = np.maximum(gap - self._gives_mm, 0.0)
        gap = np.where(gap >= self._nipped_mm, passing_mm(gap, self._grain_mm, self._loose), 0.0)
        left = np.minimum(thick, np.maximum(gap, self._film_mm))
        middle = np.stack([x, y, wall + (left + thick) / 2], axis=1)
        through_mouth = before.along_mm(middle) >= before.height_mm - STEP_MM / 4
        taken = np.where(through_mouth, thick - left, 0.0)
        self._on_wall[entered] -= taken
        self._on_sheet[entered] += taken
        return bool(taken.any())

    def _push(self, over: Mask) -> bool:
        """Powder that the outside of the sheet meets goes to the nearest column that has room, under the sheet or
        not.
        """
        assert self._cone is not None
        room = np.where(over, np.maximum(self._cone.sheet_mm - self._wall, 0.0), math.inf) - self._on_wall
        pushed = room < 0.0
        target = (room > ROOM_MM) & ~self._outside
        if not pushed.any() or not target.any():
            return False
        met = -room[pushed]
        self._on_wall[pushed] -= met
        self._add_nearest(self._on_wall, target, pushed, met)
        return True

    def _add_nearest(self, layer: Floats, targets: Mask, sources: Mask, thickness: Floats) -> None:
        to = np.argwhere(targets)
        gone = np.argwhere(sources)
        nearest = to[((gone[:, None, :] - to[None, :, :]) ** 2).sum(axis=2).argmin(axis=1)]
        np.add.at(layer, (nearest[:, 0], nearest[:, 1]), thickness)

    # --- flow

    def _uppermost(self) -> tuple[Floats, Floats]:
        """Floor and thickness of the uppermost layer of each column."""
        if self._cone is None:
            return self._wall, self._on_wall
        over = self._cone.over
        return np.where(over, self._cone.sheet_mm, self._wall), np.where(over, self._on_sheet, self._on_wall)

    def _flow(self, sweeps: int) -> None:
        self._written = None
        floor, top = self._uppermost()
        top = top.copy()
        over = self._cone.over if self._cone is not None else None
        film = self._film_mm if over is None else np.where(over, 0.0, self._film_mm)
        top -= (kept := np.minimum(top, film))
        surface = floor + kept + top
        slope = np.where(top > GRAINS_THICK * self._grain_mm, self._steep, self._slick)
        cone = self._cone
        if cone is None:
            sheet = self._nowhere, np.zeros(top.size), 0.0, 0.0
        else:
            sheet = cone.over.reshape(-1), cone.level_mm.reshape(-1), float(cone.pose.axis[2]), cone.pose.height_mm
        surface, slope = surface.reshape(-1), slope.reshape(-1)
        avalanche.flow(surface, top.reshape(-1), slope, *sheet, *self._ways, sweeps, CHECKED, AT_REST_MM)
        lost = self._outside if over is None else (self._outside & ~over) | self._border
        self._lost_mm += float(top[lost].sum())
        top[lost] = 0.0
        top += kept
        if over is None:
            self._on_wall = top
        else:
            self._on_sheet = np.where(over, top, self._on_sheet)
            self._on_wall = np.where(over, self._on_wall, top)


def _ways(n: int) -> tuple[NDArray[np.int64], Floats, NDArray[np.bool_]]:
    """The directions to a column's neighbours: offset in the row of all columns, distance [mm], and the first columns
    of the pairs, in two sets such that no column is in two pairs of a set and a direction.
    """
    i, j = np.indices((n, n))
    below, beside = i < n - 1, j < n - 1
    may = np.array([below, beside, below & beside, below & (j > 0)])
    odd = np.array([i, j, i, i]) % 2 == 1
    firsts = np.array([may & ~odd, may & odd]).reshape(2, len(may), n * n)
    return np.array([n, 1, n + 1, n - 1]), CELL_MM * np.sqrt([1.0, 1.0, 2.0, 2.0]), firsts
