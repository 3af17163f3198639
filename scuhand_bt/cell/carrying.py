"""How a load is carried: how far the cone may tilt, and how a cone that leans more comes upright again."""

import math
from contextlib import suppress
from typing import TYPE_CHECKING

from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.devices.interfaces import Trajectory
from scuhand_bt.dosing.cone import Cone
from scuhand_bt.failures import SkillFailed
from scuhand_bt.motion import ApexPose, spill_limit_deg
from scuhand_bt.motion.pouring import turned_back
from scuhand_bt.specs import Powder

if TYPE_CHECKING:
    from scuhand_bt.cell.cell import Cell

RIGHTED_MM_PER_S, RIGHTED_STEP_RAD = 100.0, math.radians(20.0)
"""As in pouring: between two such steps the lip, about which the cone turns, strays by some millimetres."""
LOAD_STEP_MM3 = 2000.0
LIMIT_STEP_DEG = 0.1


def carrying_limit_deg(spec: CellSpec, powder: Powder, load_mg: float, cone_diameter_mm: float) -> float:
    """The spill angle [deg] within which a cone of this rim carries a load of a powder in this cell."""
    cone = Cone(cone_diameter_mm, spec.hand.sheet_radius_mm)
    load_mm3 = min(load_mg / powder.bulk_density_mg_per_mm3, 0.9 * cone.volume_mm3)
    # In steps of load, so that the same few limits recur and their plans are known already. At least one step, as
    # nobody knows how large a rest is.
    load_mm3 = max(1, math.ceil(load_mm3 / LOAD_STEP_MM3)) * LOAD_STEP_MM3
    limit_deg = spill_limit_deg(
        cone.half_angle_deg, cone.diameter_mm / 2, load_mm3, powder.repose_deg, powder.wall_friction_deg
    )
    # Rounded down, as the cone's measured size varies by a servo's counts.
    return min(math.floor(limit_deg / LIMIT_STEP_DEG) * LIMIT_STEP_DEG, spec.arm.gentle_deg)


def spill_limit_of(cell: "Cell") -> float | None:
    """The spill angle [deg] of what is believed to be in the cone; None if that is empty and may tilt freely."""
    believed = cell.believed
    source = cell.sources.get(believed.cone_source or "")
    if source is None and believed.has_rest:
        source = next((one for one in cell.sources.values() if one.sheet_key == believed.sheet), None)
    if source is None:
        return None
    return carrying_limit_deg(cell.spec, source.powder, believed.cone_mg, cell.hand.cone_diameter_mm)


def upright_again(cell: "Cell") -> Trajectory | None:
    """Upright on the spot, for a cone that leans more than its load allows: whatever slides has slid.

    It turns about its lip, so that what still falls does so where it was poured, or else about its apex. None for a
    cone that leans less, and where the arm can do neither: then nothing moves.
    """
    limit_deg, now = spill_limit_of(cell), cell.apex()
    if limit_deg is None or now.tilt_deg <= limit_deg:
        return None
    slant_mm = cell.spec.hand.sheet_radius_mm
    half_rad = math.radians(Cone(cell.hand.cone_diameter_mm, slant_mm).half_angle_deg)
    for way in (turned_back(now, RIGHTED_STEP_RAD, slant_mm / 1000, half_rad), [ApexPose(now.position_m)]):
        with suppress(SkillFailed):
            return cell.contact(way, RIGHTED_MM_PER_S, None)
    return None
