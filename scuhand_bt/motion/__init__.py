"""Motion of the arm: collision-free, jerk-limited and spill-safe, planned in milliseconds and proven (docs/motion.md).

`kinematics` and `inverse` need only numpy. `MotionPlanner` is imported on first use, because Pinocchio, coal and
Ruckig take half a second to load and checking a recipe does not need them.
"""

from typing import TYPE_CHECKING

from scuhand_bt.motion.inverse import solutions, unreachable_reason
from scuhand_bt.motion.kinematics import ApexPose, Mount, apex
from scuhand_bt.motion.spill import spill_limit_deg

if TYPE_CHECKING:
    from scuhand_bt.motion.planner import MotionPlanner

__all__ = ["ApexPose", "MotionPlanner", "Mount", "apex", "solutions", "spill_limit_deg", "unreachable_reason"]


def __getattr__(name: str) -> "type[MotionPlanner]":
    if name == "MotionPlanner":
        from scuhand_bt.motion.planner import MotionPlanner

        return MotionPlanner
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
