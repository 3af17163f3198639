"""The motion of arm and roller along a stroke at a mortar's place, and the way out with its load."""

from typing import TYPE_CHECKING

import numpy as np

from scuhand_bt.cell.carrying import carrying_limit_deg
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.devices.interfaces import Joints
from scuhand_bt.dosing.cone import Cone
from scuhand_bt.dosing.swing import StrokePath
from scuhand_bt.specs import Mortar, Source

if TYPE_CHECKING:
    from scuhand_bt.motion import MotionPlanner
    from scuhand_bt.motion.stopping import StoppableTrajectory


def planned_stroke(
    planner: "MotionPlanner", near: Joints, path: StrokePath, cell: CellSpec, station: str, mortar: Mortar
) -> "StoppableTrajectory":
    """The motion of arm and roller along a stroke in the mortar at a station, begun as near to `near` as possible.

    Raises SkillFailed arm.no_path, arm.unreachable.
    """
    from scuhand_bt.motion.stroke import StrokePoses  # deferred: loads what planning needs

    x_mm, y_mm, z_mm = cell.stations[station].position_mm
    bottom_mm = np.array([x_mm, y_mm, z_mm + mortar.height_mm - mortar.depth_mm])
    hand = cell.hand
    roller_deg = [Cone(rim_mm, hand.sheet_radius_mm).roller_deg(hand) for rim_mm in path.rim_mm.tolist()]
    poses = StrokePoses(
        path.times_s, (bottom_mm + path.apex_mm) / 1000, path.axis, path.seam, np.radians(roller_deg), path.rests
    )
    least_mm, most_mm = float(path.rim_mm.min()), float(path.rim_mm.max())
    rims_mm = [float(path.rim_mm[0]), (least_mm + most_mm) / 2, least_mm]
    return planner.stroke(near, poses, rims_mm, station)


def planned_out(
    planner: "MotionPlanner",
    swing: "StoppableTrajectory",
    cell: CellSpec,
    source: Source,
    rim_mm: float,
    *,
    is_brief: bool,
) -> "StoppableTrajectory":
    """The way out of the mortar from a stroke's end, with such a rim and the heaviest load of its source.

    `is_brief`: do not search for long. Raises SkillFailed arm.* where there is no way.
    """
    from scuhand_bt.motion.transfer import BRIEF, LIVE  # deferred, as above

    limit_deg = carrying_limit_deg(cell, source.powder, source.powder.load_limit_mg, rim_mm)
    effort = BRIEF if is_brief else LIVE
    return planner.move(swing.end[:-1], source.station, spill_limit_deg=limit_deg, effort=effort)
