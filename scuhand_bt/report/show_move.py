"""One motion of the arm to look at: `scuhand-bt show-move A B`, as a page (`move_page`) and a picture (`move_picture`).

The arm moving in 3D among the cell's solids, and the joints' position, speed, acceleration and jerk and the cone's
spill angle over time, each with its limits.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from scuhand_bt.motion.collision import Scene
from scuhand_bt.motion.kinematics import Floats, Mount, apex_positions_m
from scuhand_bt.motion.timelaw import RateLimits
from scuhand_bt.motion.trajectory import JointTrajectory
from scuhand_bt.report.motion_panels import Panel, panels

ARM_COLOUR, STANDING_COLOUR = "#7a98c4", "#8aa0b6"
HAND_COLOURS = {"clamp": "#d6b280", "cone": "#ff961e"}
PATH_COLOUR, STATION_COLOUR = "#d6402f", "#2b9a4b"


@dataclass(frozen=True, slots=True)
class ShownMove:
    """A motion with all that is shown beside it; `places_m` are the stations' apex positions (3,) by name."""

    title: str
    motion: JointTrajectory
    scene: Scene
    rates: RateLimits
    mount: Mount
    places_m: Mapping[str, Floats]
    drawn: Mapping[str, Any]
    """The scene as the 3D viewer takes it (`scene3d.scene_values`)."""
    container: str | None = None
    """What stands on the pan."""

    def panels(self) -> list[Panel]:
        return panels(self.motion, self.rates, self.mount)

    def path_m(self, times_s: Floats) -> Floats:
        """Where the apex is: (n, 3)."""
        return apex_positions_m(self.motion.at(times_s), self.mount)[0]
