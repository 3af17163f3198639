"""The strokes that are judged, as the skill chooses them and arm and roller make them: poses over time.

In two mortars with three fills each, through two kinds of beads, all that lies there at once, as the skill does it that
is told how coarse the beads are; such that leave a layer, of smaller beads, each of which stands for four grains of the
powder that the skill is told of; and the stroke of the first version, which lifts nothing.
"""

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scuhand_bt.cell.scooping import planned_stroke
from scuhand_bt.dosing.beds import bed_for, expected_mg, layer_left, strokes_in
from scuhand_bt.dosing.cone import Cone
from scuhand_bt.dosing.ladle import LIP_GAP_MM, Ladle, Stroke
from scuhand_bt.dosing.strokes import GRAINS_CLEAR
from scuhand_bt.dosing.swing import stroke_path
from scuhand_bt.dosing.vessel import Vessel
from scuhand_bt.failures import SkillFailed
from scuhand_bt.lab import Lab, load_lab, starter_lab
from scuhand_bt.motion import MotionPlanner, Mount, apex
from scuhand_bt.sim.bed import nipped_mm
from scuhand_bt.specs import Mortar, Powder

SLANT_MM = 50.0
GRAIN_MM = 3.0
FINE_GRAINS_MM = (1.5, 2.0)
"""Where a layer of some millimetres is left: larger ones would not pass under the lip."""
GRAIN_DENSITY = 2.5
"""Of glass, in mg/mm^3."""
FRICTIONS_DEG = ((25.0, 18.0), (37.0, 24.0))
"""Grain on grain, grain on wall."""
MORTARS = (
    Mortar(name="agate_mortar", bore_mm=90.0, depth_mm=30.0, height_mm=45.0, outer_diameter_mm=115.0),
    Mortar(name="small_agate_mortar", bore_mm=65.0, depth_mm=22.0, height_mm=36.0, outer_diameter_mm=85.0),
)
JARS = tuple(
    Mortar(
        name=f"jar_{bore_mm:g}",
        bore_mm=bore_mm,
        depth_mm=40.0,
        height_mm=height_mm,
        outer_diameter_mm=bore_mm + 8.0,
        corner_mm=5.0,
    )
    for bore_mm, height_mm in ((95.0, 55.0), (110.0, 65.0))
)
BOWL = Mortar(name="wide_bowl", bore_mm=110.0, depth_mm=50.0, height_mm=62.0, outer_diameter_mm=130.0)
WIDEST = Stroke(92.0, 80.0, -32.0)
"""What goes into that bowl: the handle meets its edge halfway."""
OTHER_FILL_MG = 12_000.0
STATIONS = {"agate_mortar": "mortar_bay", "small_agate_mortar": "mortar_bay_2"} | {
    one.name: "mortar_bay" for one in (*JARS, BOWL)
}
FILLS_MG = {"agate_mortar": (4000.0, 8000.0, 12_000.0), "small_agate_mortar": (1000.0, 2000.0, 3000.0)}
"""Of what the skill scoops at once: of more in the small mortar it leaves a layer, thinner than these grains."""
REPOSE_DEG = {25.0: 22.0, 37.0: 25.0}
"""Of grains that roll, by the friction between them: nearly as steep with much of it as with little."""
BULK_DENSITY = 1.48
"""Of these grains as they lie, in mg/mm^3."""
LOAD_MG = 4750.0
"""What the skill aims at with beads, unless less is wanted."""
LITTLE_MG = 1500.0
HEADINGS_DEG = (90.0, 270.0, 120.0, 240.0, 60.0, 300.0)
"""From straight out from the arm's base, as the skill goes through them, without those in which the arm has no way."""
LOOKED_S = 0.03
"""Between two poses that are kept of a motion."""
ON_WALL_MM = 0.3
"""Nearer to its gap than that the lip is along the wall."""
DECIMALS = 4
"""Of poses, as they are run and as they are kept beside what they came to."""

Floats = NDArray[np.float64]


Way = dict[str, Any]
"""Poses of a cone: times_s (n,), apex_mm (n, 3), axis (n, 3), rim_mm (n,), on_wall (n,), as lists."""


@dataclass(frozen=True)
class Case:
    """What is run, as the discrete elements' program reads it, and what it is called."""

    name: str
    mortar: Mortar
    fill_mg: float
    friction_deg: float
    wall_friction_deg: float
    strokes: tuple[Way, ...]
    picture_times_s: tuple[float, ...] = ()
    grain_mm: float = GRAIN_MM
    gap_mm: float = LIP_GAP_MM
    """At which the lip of its first stroke follows the wall."""

    @property
    def jams(self) -> bool:
        """Whether a layer is to be left that is too thin for these grains to pass under the lip."""
        return LIP_GAP_MM < self.gap_mm < nipped_mm(self.grain_mm, self.wall_friction_deg)

    def written(self) -> dict[str, Any]:
        return {
            "mortar": self.mortar.model_dump(include={"bore_mm", "depth_mm", "corner_mm"}, exclude_none=True),
            "fill_mg": self.fill_mg,
            "grain": {"radius_mm": self.grain_mm / 2, "density_mg_per_mm3": GRAIN_DENSITY},
            "friction_deg": self.friction_deg,
            "wall_friction_deg": self.wall_friction_deg,
            "sheet_radius_mm": SLANT_MM,
            "strokes": list(self.strokes),
            "picture_times_s": list(self.picture_times_s),
        }


def cases() -> Iterator[Case]:
    """The control, all at once, the twelve of the height field, those that leave a layer, jars, and a wide bowl with
    a control of its own: loads as the skill's.
    """
    agate, small = MORTARS
    beads = FRICTIONS_DEG[0]
    yield Case("upright control", agate, 12_000.0, *beads, (upright(agate),), (0.05, 1.0, 2.0, 3.0))
    for friction in FRICTIONS_DEG:
        for mortar in MORTARS:
            for fill_mg in FILLS_MG[mortar.name]:
                gap_mm, strokes = lip_led(mortar, fill_mg, math.inf, friction, GRAIN_MM)
                name = f"{mortar.name}, {fill_mg / 1000:g} g, {friction[0]:g} deg"
                is_shown = friction == beads and fill_mg == max(FILLS_MG[mortar.name])
                shown_s = moments(strokes[0]) if is_shown else ()
                yield Case(name, mortar, fill_mg, *friction, strokes, shown_s, gap_mm=gap_mm)
    fine_mm, medium_mm = FINE_GRAINS_MM
    for mortar, fill_mg, wanted_mg, grain_mm, count, name in (
        (agate, 8000.0, LOAD_MG, fine_mm, 1, f"agate_mortar, 8 g, {LOAD_MG / 1000:g} g wanted"),
        (small, 8000.0, LITTLE_MG, medium_mm, 1, f"{small.name}, 8 g, {LITTLE_MG / 1000:g} g wanted"),
        (agate, 12_000.0, LOAD_MG, medium_mm, 4, "four strokes"),
    ):
        gap_mm, strokes = lip_led(mortar, fill_mg, wanted_mg, beads, grain_mm / GRAINS_CLEAR, count)
        yield Case(name, mortar, fill_mg, *beads, strokes, grain_mm=grain_mm, gap_mm=gap_mm)
    for jar in JARS:
        gap_mm, strokes = lip_led(jar, OTHER_FILL_MG, LOAD_MG, beads, GRAIN_MM)
        shown_s = moments(strokes[0]) if jar is JARS[0] else ()
        yield Case(
            f"{jar.name}, {OTHER_FILL_MG / 1000:g} g", jar, OTHER_FILL_MG, *beads, strokes, shown_s, gap_mm=gap_mm
        )
    gap_mm, strokes = lip_led(BOWL, OTHER_FILL_MG, OTHER_FILL_MG, beads, GRAIN_MM)
    yield Case(f"{BOWL.name}, {OTHER_FILL_MG / 1000:g} g", BOWL, OTHER_FILL_MG, *beads, strokes, gap_mm=gap_mm)
    yield Case(f"{BOWL.name}, widest rim", BOWL, OTHER_FILL_MG, *beads, (without_arm(BOWL, WIDEST),))


def lip_led(
    mortar: Mortar,
    fill_mg: float,
    wanted_mg: float,
    friction_deg: tuple[float, float],
    grain_mm: float,
    count: int = 1,
) -> tuple[float, tuple[Way, ...]]:
    """Strokes one after another, as the skill chooses them where each brings what it is expected to; the first's gap.

    `grain_mm` is what the skill takes the powder's to be. Turned about the vertical so that the first goes along x.
    """
    layer, left_mg, gaps_mm, ways = None, fill_mg, list[float](), list[Way]()
    headings_deg = HEADINGS_DEG
    for _ in range(count):
        bed = bed_for(mortar, left_mg, powder(friction_deg, grain_mm), Ladle(SLANT_MM), layer)
        for stroke in strokes_in(bed, Ladle(SLANT_MM), wanted_mg, headings_deg):
            with suppress(SkillFailed):
                ways.append(_planned(mortar, stroke, stroke.heading_deg, stroke.heading_deg - HEADINGS_DEG[0]))
                break
        headings_deg = headings_deg[headings_deg.index(stroke.heading_deg) + 1 :]
        gaps_mm.append(stroke.gap_mm)
        left_mg -= expected_mg(stroke, bed, SLANT_MM)
        layer = layer_left(stroke, bed, SLANT_MM)
    return gaps_mm[0], tuple(ways)


def powder(friction_deg: tuple[float, float], grain_mm: float) -> Powder:
    """Beads of such frictions and of this size, as the skill knows them."""
    repose_deg, wall_friction_deg = REPOSE_DEG[friction_deg[0]], friction_deg[1]
    return Powder(
        name="beads",
        bulk_density_mg_per_mm3=BULK_DENSITY,
        repose_deg=repose_deg,
        wall_friction_deg=wall_friction_deg,
        grain_mm=grain_mm,
        load_limit_mg=50_000.0,
    )


@cache
def _lab() -> Lab:
    return load_lab(starter_lab())


@cache
def _planner(mortar: Mortar) -> MotionPlanner:
    return _lab().motion_planner({STATIONS[mortar.name]: mortar})


def _planned(mortar: Mortar, stroke: Stroke, outward_deg: float, shown_deg: float) -> Way:
    """What arm and roller make of a stroke, by their own kinematics, turned to a heading of `shown_deg`."""
    cell, planner, station = _lab().cell, _planner(mortar), STATIONS[mortar.name]
    x_mm, y_mm, z_mm = cell.stations[station].position_mm
    at_mm = np.array([x_mm, y_mm, z_mm + mortar.height_mm - mortar.depth_mm])
    heading_deg = math.degrees(math.atan2(y_mm, x_mm)) + outward_deg
    path = stroke_path(Vessel.of(mortar), replace(stroke, heading_deg=heading_deg), Ladle.of(cell.hand))
    motion = planned_stroke(planner, planner.home(), path, cell, station, mortar)
    times_s = np.linspace(0.0, motion.duration_s, math.ceil(motion.duration_s / LOOKED_S) + 1)
    q = motion.at(times_s)
    rim_mm = np.array([Cone.from_roller(math.degrees(turned), cell.hand).diameter_mm for turned in q[:, 7]])
    poses = [apex(row[:7], Mount.of(cell.hand, rim)) for row, rim in zip(q, rim_mm, strict=True)]
    turn = math.radians(shown_deg - heading_deg)
    about_z = np.array([[math.cos(turn), -math.sin(turn), 0], [math.sin(turn), math.cos(turn), 0], [0, 0, 1]])
    apex_mm = np.array([1e3 * pose.position_m - at_mm for pose in poses]) @ about_z.T
    axis, seam = (np.array([getattr(pose, name) for pose in poses]) @ about_z.T for name in ("axis", "seam"))
    height_mm = np.sqrt(SLANT_MM**2 - (rim_mm / 2) ** 2)
    lip_mm = apex_mm + 2 * height_mm[:, None] * axis - SLANT_MM * seam
    off_mm = Vessel.of(mortar).clearance_mm(lip_mm) - stroke.gap_mm
    return _written(times_s, apex_mm, axis, rim_mm, np.abs(off_mm) < ON_WALL_MM)


def upright(mortar: Mortar, open_mm: float = 66.0, closed_mm: float = 42.0) -> Way:
    """The stroke of the first version: down until the apex is at the bottom, closed upright, and up."""
    count = 40
    clear_mm, still = 0.6, np.full(count, 0.6)
    down = np.linspace(mortar.depth_mm + 10.0, clear_mm, count)
    apex_mm = np.zeros((3 * count, 3))
    apex_mm[:, 2] = np.concatenate([down, still, down[::-1]])
    rims = np.concatenate([np.full(count, open_mm), np.linspace(open_mm, closed_mm, count), np.full(count, closed_mm)])
    axis = np.tile([0.0, 0.0, 1.0], (3 * count, 1))
    on_wall = np.repeat([False, True, False], count)
    return _written(np.linspace(0.0, 3.0, 3 * count), apex_mm, axis, rims, on_wall)


def without_arm(mortar: Mortar, stroke: Stroke) -> Way:
    """A stroke as geometry has it."""
    path = stroke_path(Vessel.of(mortar), stroke, Ladle())
    return _written(path.times_s, path.apex_mm, path.axis, path.rim_mm, path.on_wall)


def moments(stroke: Way) -> tuple[float, ...]:
    """Of the pictures: four along the wall, and the end."""
    times_s = np.array(stroke["times_s"])[stroke["on_wall"]]
    along = times_s[0] + (times_s[-1] - times_s[0]) * np.array([0.1, 0.35, 0.6, 0.9])
    return (*along.tolist(), stroke["times_s"][-1])


def _written(times_s: Floats, apex_mm: Floats, axis: Floats, rim_mm: Floats, on_wall: Any) -> Way:
    fields = {"times_s": times_s, "apex_mm": apex_mm, "axis": axis, "rim_mm": rim_mm, "on_wall": on_wall}
    rounded = {name: value if value.dtype == bool else np.round(value, DECIMALS) for name, value in fields.items()}
    return {name: value.tolist() for name, value in rounded.items()}
