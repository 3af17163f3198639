"""One motion of the arm to look at: `scuhand-bt show-move A B`, as a page (`move_page`) and a picture (`move_picture`).

The arm moving in 3D among the cell's solids, and the joints' position, speed, acceleration and jerk and the cone's
spill angle over time, each with its limits.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from scuhand_bt.cell.carrying import carrying_limit_deg
from scuhand_bt.cell.places import at_station, over_balance, over_mortar
from scuhand_bt.dosing.cone import Cone
from scuhand_bt.lab import Lab
from scuhand_bt.motion import ApexPose, MotionPlanner
from scuhand_bt.motion.collision import Scene
from scuhand_bt.motion.kinematics import Floats, Mount, apex_positions_m
from scuhand_bt.motion.scenes import CONE_DIAMETER_M
from scuhand_bt.motion.timelaw import RateLimits
from scuhand_bt.motion.trajectory import JointTrajectory
from scuhand_bt.quantity import format_mass
from scuhand_bt.report.motion_panels import Panel, panels
from scuhand_bt.report.scene3d import scene_values

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


def shown_move(
    lab: Lab,
    start: str,
    goal: str,
    container: str | None = None,
    load_mg: float | None = None,
    powder: str | None = None,
    gentle_deg: float | None = None,
) -> ShownMove:
    """The motion from one station of a lab to another, by their names, as a run would make it.

    `container` is a kind that stands on the pan; the cone carries `load_mg` of a `powder`, if any, and is tilted by no
    more than `gentle_deg`. Raises ValueError for a load or an angle that cannot be, SkillFailed where there is no way.
    """
    limit_deg = _carrying_deg(lab, load_mg, powder, gentle_deg)
    planner, places_m = _planner(lab, container)
    motion = planner.move(planner.move(planner.home(), start).end, goal, spill_limit_deg=limit_deg)
    title = f"{start} to {goal}"
    if limit_deg is not None:
        carried = f"{format_mass(load_mg)} of {powder}" if load_mg is not None else "a load"
        title += f" with {carried}, spill angle up to {motion.spill_limit_deg:.0f}°"
    on_pan = [lab.library.containers[container]] if container is not None else []
    drawn = scene_values(planner, lab.cell.hand.apex_offset_mm / 1000, [1000 * CONE_DIAMETER_M], places_m, on_pan)
    mount = planner.mount()
    return ShownMove(title, motion, planner.scene(), planner.rates, mount, places_m, drawn, container)


def _carrying_deg(lab: Lab, load_mg: float | None, powder: str | None, gentle_deg: float | None) -> float | None:
    """What a run would carry a load of a powder within, and no more than that; None for an empty cone."""
    limits_deg = []
    if gentle_deg is not None:
        if gentle_deg <= 0:
            raise ValueError("--gentle must be an angle above zero")
        limits_deg.append(gentle_deg)
    if load_mg is not None and powder is not None:
        kind, rim_mm = lab.library.powders[powder], 1000 * CONE_DIAMETER_M
        full_mg = kind.bulk_density_mg_per_mm3 * Cone(rim_mm, lab.cell.hand.sheet_radius_mm).volume_mm3
        if not 0 < load_mg < full_mg:
            raise ValueError(f"--load must be more than nothing and less than the full cone's {full_mg / 1000:.1f} g")
        limits_deg.append(carrying_limit_deg(lab.cell, kind, load_mg, rim_mm))
    return min(limits_deg, default=None)


def _planner(lab: Lab, container: str | None) -> tuple[MotionPlanner, dict[str, Floats]]:
    """The lab's cell with a mortar at every mortar station; and the apex positions [m] (3,) of all stations."""
    kind = lab.library.containers.get(container or "")
    largest = max(lab.library.mortars.values(), key=lambda mortar: mortar.outer_diameter_mm)
    stations = lab.cell.stations.values()
    planner = lab.motion_planner({s.name: largest for s in stations if s.kind == "mortar"})
    planner.set_geometry(container=kind)
    places_m: dict[str, Floats] = {}
    for station in stations:
        if station.kind == "mortar":
            position_mm = over_mortar(station, largest)
        elif station.kind == "balance":
            shortest = min(lab.library.containers.values(), key=lambda one: one.height_mm)
            position_mm = over_balance(lab.cell, kind or shortest)[1]
        else:
            position_mm = at_station(station)
        places_m[station.name] = np.array(position_mm) / 1000
        planner.add_place(station.name, ApexPose(places_m[station.name]))
    return planner, places_m
