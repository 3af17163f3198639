"""The same strokes through the simulation's height field, as a dry run has it: of grains as coarse as the judge's."""

from dataclasses import dataclass

import numpy as np

from benchmarks.dem.cases import SLANT_MM, Case, powder
from scuhand_bt.sim.bed import HeightField
from scuhand_bt.specs import Powder, PowderFlowSpec


@dataclass(frozen=True)
class Collected:
    """What strokes one after another came to."""

    collected_mg: list[float]
    spilled_mg: float


def material(case: Case) -> Powder:
    """The case's grains, as the simulation has them."""
    grains = PowderFlowSpec(grain_mm=case.grain_mm, film_mm=0.0)
    return powder((case.friction_deg, case.wall_friction_deg), case.grain_mm).model_copy(update={"simulation": grains})


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
