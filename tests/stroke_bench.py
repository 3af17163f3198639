"""Mortars, powders and a ladle for strokes, and what the height field makes of one."""

from dose_bench import shipped_powders
from hypothesis import strategies as st

from scuhand_bt.dosing.ladle import Ladle, Stroke
from scuhand_bt.dosing.swing import stroke_path
from scuhand_bt.dosing.vessel import Vessel
from scuhand_bt.sim.bed import HeightField
from scuhand_bt.specs import Mortar

MORTAR = Mortar(name="agate", bore_mm=90.0, depth_mm=30.0, height_mm=45.0, outer_diameter_mm=115.0)
SMALL = Mortar(name="small", bore_mm=65.0, depth_mm=22.0, height_mm=36.0, outer_diameter_mm=85.0)
SHEET_MM = 50.0
LADLE = Ladle(SHEET_MM)
POWDERS = shipped_powders()
BEADS = POWDERS["glass_beads"]
ACROSS_DEG = (90.0, 270.0, 120.0, 240.0)


def through(stroke: Stroke, field: HeightField, in_mortar_mg: float, mortar: Mortar) -> tuple[float, float]:
    """What a stroke collects, and what goes over the edge, by the height field."""
    path = stroke_path(Vessel.of(mortar), stroke, Ladle())
    in_cone_mg = spilled_mg = 0.0
    for apex_mm, axis, rim_mm in zip(path.apex_mm, path.axis, path.rim_mm, strict=True):
        left_mg = in_mortar_mg - in_cone_mg - spilled_mg
        gained_mg, lost_mg = field.move(apex_mm, axis, float(rim_mm), left_mg, in_cone_mg)
        in_cone_mg += gained_mg
        spilled_mg += lost_mg
    return in_cone_mg, spilled_mg + field.leave()


masses_mg = st.floats(200.0, 30_000.0)
