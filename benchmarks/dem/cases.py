"""The strokes that are judged: in two mortars with three fills each, through two kinds of beads; and the old one."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scuhand_bt.dosing.swing import Ladle, Stroke, headings_deg, stroke_path
from scuhand_bt.dosing.vessel import Vessel
from scuhand_bt.specs import Mortar

SLANT_MM = 50.0
GRAIN_MM = 3.0
GRAIN_DENSITY = 2.5
"""Of glass, in mg/mm^3."""
FRICTIONS_DEG = ((25.0, 18.0), (37.0, 24.0))
"""Grain on grain, grain on wall."""
RAMP_S = 0.2
"""A stroke begins, and ends, within so much from rest."""
FREE_PACE = 2.0
"""Times as fast where the lip is not on the wall: the way in, and out."""
MORTARS = (
    Mortar(name="agate_mortar", bore_mm=90.0, depth_mm=30.0, height_mm=45.0, outer_diameter_mm=115.0),
    Mortar(name="small_agate_mortar", bore_mm=65.0, depth_mm=22.0, height_mm=36.0, outer_diameter_mm=85.0),
)
FILLS_MG = {"agate_mortar": (4000.0, 8000.0, 12_000.0), "small_agate_mortar": (2000.0, 4000.0, 8000.0)}
BULK_DENSITY = 1.48
"""Of these grains as they lie, in mg/mm^3."""
STROKES_MM = {
    ("agate_mortar", 4000.0): (82.0, 70.0, -24.0),
    ("agate_mortar", 8000.0): (82.0, 70.0, -2.0),
    ("agate_mortar", 12_000.0): (82.0, 70.0, 4.0),
    ("small_agate_mortar", 2000.0): (60.0, 48.0, -20.0),
    ("small_agate_mortar", 4000.0): (60.0, 48.0, -24.0),
    ("small_agate_mortar", 8000.0): (60.0, 48.0, -2.0),
}
"""Rims at the beginning and the end, and where the lip comes to the wall: for the 4.75 g that the skill aims at."""
ALL_MM = (82.0, 70.0, -32.0)
IN_TURN_MM = ((82.0, 70.0, 4.0), (82.0, 70.0, -2.0), (82.0, 70.0, -24.0), (82.0, 70.0, -16.0))
"""For 12 g of which each stroke is expected to leave less."""
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

    def written(self) -> dict[str, Any]:
        return {
            "mortar": {"bore_mm": self.mortar.bore_mm, "depth_mm": self.mortar.depth_mm},
            "fill_mg": self.fill_mg,
            "grain": {"radius_mm": GRAIN_MM / 2, "density_mg_per_mm3": GRAIN_DENSITY},
            "friction_deg": self.friction_deg,
            "wall_friction_deg": self.wall_friction_deg,
            "sheet_radius_mm": SLANT_MM,
            "strokes": list(self.strokes),
            "picture_times_s": list(self.picture_times_s),
        }


def cases() -> Iterator[Case]:
    """The control, all at once, what four strokes do, and the twelve of the height field."""
    agate = MORTARS[0]
    beads = FRICTIONS_DEG[0]
    yield Case("upright control", agate, 12_000.0, *beads, (upright(agate),), (0.05, 1.0, 2.0, 3.0))
    everything = lip_led(agate, *ALL_MM)
    yield Case("all at once", agate, 12_000.0, *beads, (everything,), moments(everything))
    turned = tuple(
        lip_led(agate, *rims, heading_deg) for rims, heading_deg in zip(IN_TURN_MM, headings_deg(4), strict=True)
    )
    yield Case("four strokes", agate, 12_000.0, *beads, turned)
    for friction in FRICTIONS_DEG:
        for mortar in MORTARS:
            for fill_mg in FILLS_MG[mortar.name]:
                stroke = lip_led(mortar, *STROKES_MM[mortar.name, fill_mg])
                name = f"{mortar.name}, {fill_mg / 1000:g} g, {friction[0]:g} deg"
                pictures = moments(stroke) if (fill_mg, friction) == (12_000.0, beads) else ()
                yield Case(name, mortar, fill_mg, *friction, (stroke,), pictures)


def lip_led(mortar: Mortar, open_mm: float, closed_mm: float, begin_mm: float, heading_deg: float = 0.0) -> Way:
    """A planned stroke."""
    stroke = Stroke(open_mm, closed_mm, begin_mm, heading_deg=heading_deg)
    path = stroke_path(Vessel.of(mortar), stroke, Ladle())
    paces = np.where(path.on_wall[1:] | path.on_wall[:-1], 1.0, FREE_PACE)
    times_s = np.concatenate([[0.0], np.cumsum(np.diff(path.times_s) / paces)])
    return _written(_from_rest(times_s), path.apex_mm, path.axis, path.rim_mm, path.on_wall)


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


def moments(stroke: Way) -> tuple[float, ...]:
    """Of the pictures: four along the wall, and the end."""
    times_s = np.array(stroke["times_s"])[stroke["on_wall"]]
    along = times_s[0] + (times_s[-1] - times_s[0]) * np.array([0.1, 0.35, 0.6, 0.9])
    return (*along.tolist(), stroke["times_s"][-1])


def _from_rest(times_s: Floats) -> Floats:
    """The same way, whose pace grows evenly from rest, and falls to it."""
    end_s = times_s[-1] - times_s

    def late(since_s: Floats) -> Floats:
        near = np.minimum(since_s, RAMP_S / 2)
        lag: Floats = np.sqrt(2 * RAMP_S * near) - near
        return lag

    return times_s + late(times_s) + float(late(end_s)[0]) - late(end_s)


def _written(times_s: Floats, apex_mm: Floats, axis: Floats, rim_mm: Floats, on_wall: Any) -> Way:
    fields = {"times_s": times_s, "apex_mm": apex_mm, "axis": axis, "rim_mm": rim_mm, "on_wall": on_wall}
    rounded = {name: value if value.dtype == bool else np.round(value, DECIMALS) for name, value in fields.items()}
    return {name: value.tolist() for name, value in rounded.items()}
