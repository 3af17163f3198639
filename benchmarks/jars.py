"""Flat-bottomed vessels: what strokes of a rigid sheet collect of 12 g, by the height field.

    python -m benchmarks.jars

For each bore the rim that brings most in its first stroke, of those with which there is a stroke; then eight strokes
with it, turned from one to the next. Geometry alone: no arm, and no sheet that bends to the floor. The floor's profile
is the benchmark's own, as the height field's is its own beside the stroke's (`scuhand_bt/dosing/vessel.py`).
"""

from dataclasses import dataclass

import numpy as np

from scuhand_bt.dosing.swing import Ladle, NoStrokeError, Stroke, StrokePath, stroke_path
from scuhand_bt.dosing.vessel import Vessel
from scuhand_bt.lab import load_lab, starter_lab
from scuhand_bt.sim.bed import HeightField
from scuhand_bt.specs import Mortar, Powder

BORES_MM = (67.0, 80.0, 95.0, 110.0)
DEPTH_MM, CORNER_MM, THICK_MM = 40.0, 5.0, 3.0
FILL_MG = 12_000.0
RIMS_MM = tuple(range(90, 46, -4))
CLOSES_MM = 12.0
TURNS_DEG = (0.0, 180.0, 90.0, 270.0, 45.0, 225.0, 135.0, 315.0)
BEGINS = (0.75, 0.6, 0.45, 0.3, 0.15)
"""Of the way from the middle to the edge, where the lip meets the floor; the first with which there is a stroke."""


class JarField(HeightField):
    """The height field over a level floor with a rounded corner."""

    def __init__(self, mortar: Mortar, powder: Powder) -> None:
        super().__init__(mortar, powder)
        radius_mm = np.minimum(np.hypot(self._x, self._y), mortar.bore_mm / 2)
        into_mm = np.clip(radius_mm - (mortar.bore_mm / 2 - CORNER_MM), 0.0, CORNER_MM)
        self._wall = CORNER_MM - np.sqrt(CORNER_MM**2 - into_mm**2)
        self._wall[self._outside] = mortar.depth_mm


@dataclass
class Collected:
    """By a stroke after the other, and what went over the edge."""

    strokes_mg: list[float]
    lost_mg: float = 0.0


def path_of(vessel: Vessel, rim_mm: float, heading_deg: float) -> StrokePath | None:
    """A stroke that begins as far behind the middle as one can; None where there is none."""
    for share in BEGINS:
        stroke = Stroke(rim_mm, rim_mm - CLOSES_MM, -share * vessel.to_edge_mm, heading_deg=heading_deg)
        try:
            return stroke_path(vessel, stroke, Ladle())
        except NoStrokeError:
            continue
    return None


def collected(bore_mm: float, powder: Powder, rim_mm: float, turns_deg: tuple[float, ...]) -> Collected | None:
    """Strokes of a rim through a full jar; None where there is none."""
    outer_mm = bore_mm + 2 * THICK_MM
    vessel = Vessel.cylinder(bore_mm, DEPTH_MM, outer_mm, CORNER_MM)
    jar = Mortar.model_construct(
        name="jar", bore_mm=bore_mm, depth_mm=DEPTH_MM, height_mm=DEPTH_MM + THICK_MM, outer_diameter_mm=outer_mm
    )
    field, there_mg, came = JarField(jar, powder), FILL_MG, Collected([])
    for turn_deg in turns_deg:
        path = path_of(vessel, rim_mm, turn_deg)
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
    powders = load_lab(starter_lab()).library.powders
    for bore_mm in BORES_MM:
        for name in ("glass_beads", "monosodium_glutamate"):
            first = {rim: collected(bore_mm, powders[name], rim, TURNS_DEG[:1]) for rim in RIMS_MM}
            brought = {rim: one.strokes_mg[0] for rim, one in first.items() if one is not None}
            if not brought:
                print(f"{bore_mm:g} mm, {name}: no stroke")
                continue
            best = max(brought, key=lambda rim: brought[rim])
            every = collected(bore_mm, powders[name], best, TURNS_DEG)
            assert every is not None
            strokes = ", ".join(f"{mg / 1000:.2f}" for mg in every.strokes_mg)
            share = sum(every.strokes_mg) / FILL_MG
            print(
                f"{bore_mm:g} mm, {name}: rim {best} mm: {strokes} g, {share:.0%} of it; spilled {every.lost_mg:.0f} mg"
            )


if __name__ == "__main__":
    main()
