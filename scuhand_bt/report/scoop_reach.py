"""In which directions the arm can scoop at each mortar station, and why not in the others: `reach --task scoop`."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np

from scuhand_bt.cell.places import over_mortar
from scuhand_bt.dosing.ladle import NoStrokeError, Stroke
from scuhand_bt.failures import SkillFailed
from scuhand_bt.lab import Lab
from scuhand_bt.specs import Mortar, Powder, Source

if TYPE_CHECKING:
    from scuhand_bt.motion import MotionPlanner

FILL_SHARE = 0.2
"""Of what a mortar holds, the bed that its first stroke is looked at in."""
THIN_SHARE = 0.02
"""Of what a jar holds, one of which a stroke takes all that is on its way."""


@dataclass(frozen=True, slots=True)
class Direction:
    """One direction of a swing at a station, about the vertical from x; None where no stroke is possible."""

    station: str
    mortar: str
    heading_deg: float
    first_s: float | None
    """How long the stroke takes that is made first."""
    last_s: float | None
    """And the one that takes the last of the powder."""
    why_not: str


def directions(lab: Lab, powder: Powder) -> Iterator[Direction]:
    """All directions in which a run would look for a stroke, at every mortar station, with every mortar of the lab."""
    for station in (one for one in lab.cell.stations.values() if one.kind == "mortar"):
        for mortar in lab.library.mortars.values():
            yield from _at(lab, station.name, mortar, powder)


def _at(lab: Lab, station: str, mortar: Mortar, powder: Powder) -> Iterator[Direction]:
    from scuhand_bt.motion import ApexPose  # which not every command has to load
    from scuhand_bt.run.stroke_ways import LEAST_BED_MG, headings_deg

    source = Source(name=station, station=station, mortar=mortar, powder=powder, amount_mg=1.0)
    planner = lab.motion_planner({station: mortar})
    above_mm = over_mortar(lab.cell.stations[station], mortar)
    planner.add_place(station, ApexPose(np.array(above_mm) / 1000))
    last_mg = LEAST_BED_MG if mortar.corner_mm is None else THIN_SHARE * source.capacity_mg
    along_deg = sorted(headings_deg(lab.cell, station))
    first = _looked_at(planner, lab, source, FILL_SHARE * source.capacity_mg, along_deg)
    last = _looked_at(planner, lab, source, last_mg, along_deg)
    for heading_deg in along_deg:
        found = first[heading_deg], last[heading_deg]
        first_s, last_s = (one if isinstance(one, float) else None for one in found)
        why_not = next((one for one in found if isinstance(one, str)), "")
        yield Direction(station, mortar.name, heading_deg, first_s, last_s, why_not)


def _looked_at(
    planner: "MotionPlanner", lab: Lab, source: Source, bed_mg: float, along_deg: Sequence[float]
) -> dict[float, float | str]:
    """By direction, how long the stroke takes that is made in such a bed [s], or why it is not possible.

    Of the rims that are tried, the first with which there is one at all, as in a run.
    """
    from scuhand_bt.run.stroke_ways import strokes_along, swing_and_out

    def found(stroke: Stroke) -> float | str:
        try:
            return swing_and_out(planner, lab.cell, source, stroke)
        except (NoStrokeError, SkillFailed) as error:
            return str(error)

    try:
        strokes = strokes_along(lab.cell, source, bed_mg, source.powder.load_limit_mg, along_deg)
    except SkillFailed as error:
        return dict.fromkeys(along_deg, str(error))
    widest = dict[float, float | str]()
    while of_rim := list(islice(strokes, len(along_deg))):
        looked_at = {stroke.heading_deg: found(stroke) for stroke in of_rim}
        if any(isinstance(one, float) for one in looked_at.values()):
            return looked_at
        widest = widest or looked_at
    return widest
