"""Flat-bottomed vessels: what strokes collect of 12 g, by the height field.

    python -m benchmarks.jars

For each bore, powder, end of the stroke and over-travel eight strokes, turned from one to the next. A lip that goes
beyond the floor lies on it along a chord, as the sheet bends up; the force is the skill's estimate. Geometry alone: no
arm, in all directions. The height field's profile is its own beside the stroke's (`scuhand_bt/dosing/vessel.py`).
"""

import itertools
import math
from dataclasses import dataclass

from scuhand_bt.dosing.ladle import Ladle, NoStrokeError, Stroke
from scuhand_bt.dosing.sheet import lip_force_n
from scuhand_bt.dosing.swing import StrokePath, stroke_path
from scuhand_bt.dosing.vessel import Vessel
from scuhand_bt.lab import load_lab, starter_lab
from scuhand_bt.sim.bed import HeightField
from scuhand_bt.specs import Mortar, Powder

DEPTH_MM, CORNER_MM, THICK_MM = 40.0, 5.0, 3.0
FILL_MG = 12_000.0
RIMS_MM = {67.0: 62.0, 80.0: 76.0, 95.0: 88.0, 110.0: 88.0}
"""By bore, the rim whose first two strokes brought most, or nearly, of two or three that were looked at."""
CLOSES_MM = 12.0
OVER_TRAVELS_MM = (0.0, 4.0, 6.0)
ENDS = ("edge", "floor")
"""Where the lip leaves the wall: at its edge, or where the floor ends; there the cone is turned upright."""
TURNS_DEG = (0.0, 180.0, 90.0, 270.0, 45.0, 225.0, 135.0, 315.0)
BEGINS = (0.75, 0.6, 0.45, 0.3, 0.15)
"""Of the way from the middle to the edge, where the lip meets the floor; the first with which there is a stroke."""


@dataclass
class Collected:
    """By a stroke after the other, and what went over the edge."""

    strokes_mg: list[float]
    lost_mg: float = 0.0


@dataclass(frozen=True)
class Kind:
    """A kind of stroke."""

    rim_mm: float
    over_mm: float
    end: str


def path_of(vessel: Vessel, kind: Kind, heading_deg: float) -> StrokePath | None:
    """A stroke that begins as far behind the middle as one can; None where there is none."""
    end_mm = vessel.floor_mm if kind.end == "floor" else math.inf
    rims_mm = (kind.rim_mm, kind.rim_mm - CLOSES_MM)
    for share in BEGINS:
        begin_mm = -share * vessel.to_edge_mm
        stroke = Stroke(*rims_mm, begin_mm, heading_deg=heading_deg, gap_mm=-kind.over_mm, end_mm=end_mm)
        try:
            return stroke_path(vessel, stroke, Ladle())
        except NoStrokeError:
            continue
    return None


def collected(bore_mm: float, powder: Powder, kind: Kind, turns_deg: tuple[float, ...]) -> Collected | None:
    """Strokes of a kind through a full jar; None where there is none."""
    outer_mm = bore_mm + 2 * THICK_MM
    jar = Mortar(
        name="jar",
        bore_mm=bore_mm,
        depth_mm=DEPTH_MM,
        height_mm=DEPTH_MM + THICK_MM,
        outer_diameter_mm=outer_mm,
        corner_mm=CORNER_MM,
    )
    vessel = Vessel.of(jar)
    field, there_mg, came = HeightField(jar, powder), FILL_MG, Collected([])
    for turn_deg in turns_deg:
        path = path_of(vessel, kind, turn_deg)
        if path is None:
            return None
        in_cone_mg = 0.0
        for apex_mm, axis, now_mm in zip(path.apex_mm, path.axis, path.rim_mm, strict=True):
            gained_mg, lost_mg = field.move(apex_mm, axis, float(now_mm), there_mg, in_cone_mg)
            in_cone_mg += gained_mg
            there_mg -= gained_mg + lost_mg
            came.lost_mg += lost_mg
        field.leave()
        came.strokes_mg.append(in_cone_mg)
    return came


def main() -> None:
    lab = load_lab(starter_lab())
    powders, names = lab.library.powders, ("glass_beads", "monosodium_glutamate")
    for bore_mm, name, end, over_mm in itertools.product(RIMS_MM, names, ENDS, OVER_TRAVELS_MM):
        kind, force_n = Kind(RIMS_MM[bore_mm], over_mm, end), lip_force_n(over_mm, lab.cell.hand)
        case = f"{bore_mm:g} mm, {name}, to the {end}, {over_mm:g} mm beyond ({force_n:.1f} N)"
        every = collected(bore_mm, powders[name], kind, TURNS_DEG)
        if every is None:
            print(f"{case}: no stroke", flush=True)
            continue
        strokes = ", ".join(f"{mg / 1000:.2f}" for mg in every.strokes_mg)
        share = sum(every.strokes_mg) / FILL_MG
        print(f"{case}: {strokes} g, {share:.0%} of it; spilled {every.lost_mg:.0f} mg", flush=True)


if __name__ == "__main__":
    main()
