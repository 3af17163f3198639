"""What is around the cone's apex: what powder falls onto, the mortar it is in, the bowl it presses on."""

import math
from collections.abc import Mapping

import numpy as np

from scuhand_bt.cell_spec import CellSpec, Station
from scuhand_bt.dosing.cone import Cone
from scuhand_bt.sim.arm import Pose
from scuhand_bt.sim.mass_ledger import BALANCE, PAN, RETURNED, SPILLED, WASTE, Compartment, in_source
from scuhand_bt.specs import Source

GRAVITY_MM_PER_S2 = 9810.0
PAN_RADIUS_MM = 60.0
WASTE_RADIUS_MM = 50.0
RIM_POINTS = 16


class Surroundings:
    """The stations of a cell and the mortars that stand on them."""

    def __init__(self, spec: CellSpec, sources: Mapping[str, Source]) -> None:
        self._stations, self._sources = spec.stations, sources
        self._station_of = {name: spec.stations[source.station] for name, source in sources.items()}
        self._pan = spec.station_of_kind("balance")

    def below(self, pose: Pose, mouth_mm: float, cone_source: str | None) -> tuple[Compartment, float]:
        """What lies under the apex, and the fall time to it [s].

        `mouth_mm` is that container's, 0 without one; `cone_source` names the mortar that its powder goes back to.
        """
        x_mm, y_mm, z_mm = (1000.0 * float(value) for value in pose.position_m)

        def aside_mm(station: Station) -> float:
            return math.hypot(x_mm - station.position_mm[0], y_mm - station.position_mm[1])

        def fall_s(floor_mm: float) -> float:
            return math.sqrt(2.0 * max(1.0, z_mm - floor_mm) / GRAVITY_MM_PER_S2)

        off_centre_mm = aside_mm(self._pan)
        if off_centre_mm <= PAN_RADIUS_MM:
            inside = mouth_mm > 0.0 and off_centre_mm <= mouth_mm / 2.0
            return BALANCE if inside else PAN, fall_s(self._pan.position_mm[2])
        for name, station in self._station_of.items():
            mortar = self._sources[name].mortar
            if aside_mm(station) <= mortar.bore_mm / 2.0:
                place = in_source(name) if name == cone_source else RETURNED
                return place, fall_s(station.position_mm[2] + mortar.height_mm - mortar.depth_mm)
        for station in self._stations.values():
            if station.kind == "waste" and aside_mm(station) <= WASTE_RADIUS_MM:
                return WASTE, fall_s(station.position_mm[2])
        return SPILLED, fall_s(0.0)

    def mortar(self, pose: Pose) -> str | None:
        """The source whose mortar the apex is in: over its bore and below its rim."""
        x_mm, y_mm, z_mm = (1000.0 * float(value) for value in pose.position_m)
        for name, station in self._station_of.items():
            mortar = self._sources[name].mortar
            aside_mm = math.hypot(x_mm - station.position_mm[0], y_mm - station.position_mm[1])
            if aside_mm <= mortar.bore_mm / 2.0 and z_mm < station.position_mm[2] + mortar.height_mm:
                return name
        return None

    def overtravel_mm(self, pose: Pose, cone: Cone, source: str) -> float:
        """How far the undeformed sheet, its rim or its apex, would reach beyond the mortar's bowl."""
        mortar, station = self._sources[source].mortar, self._station_of[source]
        radius_mm = mortar.bowl_radius_mm
        rim_mm = station.position_mm[2] + mortar.height_mm
        centre = np.array([*station.position_mm[:2], rim_mm - mortar.depth_mm + radius_mm])
        up = np.asarray(pose.axis)
        apex_mm = 1000.0 * np.asarray(pose.position_m)
        across = np.cross(up, (1.0, 0.0, 0.0) if abs(up[0]) < 0.9 else (0.0, 1.0, 0.0))
        across /= np.linalg.norm(across)
        angles = np.linspace(0.0, 2.0 * math.pi, RIM_POINTS, endpoint=False)[:, None]
        ring = np.cos(angles) * across + np.sin(angles) * np.cross(up, across)
        points = np.vstack([apex_mm + cone.depth_mm * up + cone.diameter_mm / 2.0 * ring, apex_mm])
        points = points[points[:, 2] <= rim_mm + 1.0]
        if not len(points):
            return 0.0
        return float(np.linalg.norm(points - centre, axis=1).max() - radius_mm)
