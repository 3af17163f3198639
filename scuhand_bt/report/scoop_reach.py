"""In which directions the arm can scoop at each mortar station, and why not in the others: `reach --task scoop`."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from scuhand_bt.cell.scooping import planned_stroke
from scuhand_bt.dosing.ladle import Ladle, NoStrokeError
from scuhand_bt.dosing.strokes import across, require_level
from scuhand_bt.dosing.swing import stroke_path
from scuhand_bt.dosing.vessel import Vessel
from scuhand_bt.failures import SkillFailed
from scuhand_bt.lab import Lab
from scuhand_bt.specs import Mortar

if TYPE_CHECKING:
    from scuhand_bt.motion import MotionPlanner

STEP_DEG = 30
TILTS_DEG = (110.0, 75.0)
"""A stroke that takes all of the bed, and one that begins further on."""
BED_SHARE = 0.73
"""Of the bore, the bed that is looked at: a fifth of the mortar's volume."""


@dataclass(frozen=True, slots=True)
class Direction:
    """One direction of a swing at a station, about the vertical from x."""

    station: str
    mortar: str
    heading_deg: float
    tilt_deg: float | None
    """The most that the axis is tilted; None where no stroke is possible."""
    duration_s: float
    why_not: str


def directions(lab: Lab) -> Iterator[Direction]:
    """All directions, `STEP_DEG` apart, at every mortar station, with every mortar of the lab."""
    for station in (one for one in lab.cell.stations.values() if one.kind == "mortar"):
        for mortar in lab.library.mortars.values():
            planner = lab.motion_planner({station.name: mortar})
            for heading_deg in range(0, 360, STEP_DEG):
                yield _looked_at(planner, lab, station.name, mortar, float(heading_deg))


def _looked_at(planner: "MotionPlanner", lab: Lab, station: str, mortar: Mortar, heading_deg: float) -> Direction:
    hand = lab.cell.hand
    widest = across(mortar, BED_SHARE * mortar.bore_mm / 2, hand.sheet_radius_mm)
    why = ""
    for tilt_deg in TILTS_DEG:
        stroke = widest.turned(heading_deg, tilt_deg)
        try:
            require_level(mortar, hand.sheet_radius_mm)
            path = stroke_path(Vessel.of(mortar), stroke, Ladle.of(hand))
            motion = planned_stroke(planner, planner.home(), path, lab.cell, station, mortar)
        except (NoStrokeError, SkillFailed) as error:
            why = why or str(error)
            continue
        return Direction(station, mortar.name, heading_deg, path.most_tilt_deg, motion.duration_s, "")
    return Direction(station, mortar.name, heading_deg, None, 0.0, why)
