"""The same strokes through the simulation's height field, as a dry run has it: of grains as coarse as the judge's."""

from dataclasses import dataclass

import numpy as np

from benchmarks.dem.cases import BULK_DENSITY, SLANT_MM, Case
from scuhand_bt.sim.bed import HeightField
from scuhand_bt.specs import Powder, PowderFlowSpec

REPOSE_DEG = {25.0: 22.0, 37.0: 25.0}
"""Of grains that roll, by the friction between them: nearly as steep with much of it as with little."""


@dataclass(frozen=True)
class Collected:
    """What strokes one after another came to."""

    collected_mg: list[float]
    spilled_mg: float


def material(case: Case) -> Powder:
    """The case's grains, as a powder of the lab's."""
    return Powder(
        name="coarse_beads",
        bulk_density_mg_per_mm3=BULK_DENSITY,
        repose_deg=REPOSE_DEG[case.friction_deg],
        wall_friction_deg=case.wall_friction_deg,
        load_limit_mg=50_000.0,
        simulation=PowderFlowSpec(grain_mm=case.grain_mm, film_mm=0.0),
    )


def collected_mg(case: Case, fill_mg: float) -> Collected:
    """Every stroke of a case through one bed."""
    bed = HeightField(case.mortar, material(case), SLANT_MM, gives_mm=0.0)
    in_mortar_mg, collected, spilled_mg = fill_mg, [], 0.0
    for stroke in case.strokes:
        in_cone_mg = 0.0
        for apex_mm, axis, rim_mm in zip(stroke["apex_mm"], stroke["axis"], stroke["rim_mm"], strict=True):
            gained_mg, lost_mg = bed.move(np.array(apex_mm), np.array(axis), rim_mm, in_mortar_mg, in_cone_mg)
            in_cone_mg += gained_mg
            in_mortar_mg -= gained_mg + lost_mg
            spilled_mg += lost_mg
        bed.leave()
        collected.append(in_cone_mg)
    return Collected(collected, spilled_mg)
