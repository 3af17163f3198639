"""What powder from the cone falls onto."""

import math
from collections.abc import Mapping

from scuhand_bt.bench_spec import Station
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.sim.cone_over import Floats
from scuhand_bt.sim.mass_ledger import BALANCE, PAN, RETURNED, SPILLED, WASTE, Compartment, in_source, in_vessel
from scuhand_bt.specs import Source

GRAVITY_MM_PER_S2 = 9810.0
PAN_RADIUS_MM = 60.0
WASTE_RADIUS_MM = 50.0


class Surroundings:
    """The stations of a cell and the mortars that stand on them."""

    def __init__(self, spec: CellSpec, sources: Mapping[str, Source]) -> None:
        self._stations, self._sources = spec.stations, sources
        self._station_of = {name: spec.stations[source.station] for name, source in sources.items()}
        self._pan = spec.station_of_kind("balance")
        self._vessels = {station.name for station in spec.vessels}

    def below(self, point_mm: Floats, mouth_mm: float, cone_source: str | None) -> tuple[Compartment, float]:
        """The compartment under a point (3,) [mm], and the fall time to it [s].

        `mouth_mm` is the container's mouth, 0 without one. `cone_source` is the source of the falling powder; None
        while a new sheet is in its first mortar.
        """
        x_mm, y_mm, z_mm = point_mm.tolist()

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
                place = into_mortar(self._sources, name, cone_source)
                return place, fall_s(station.position_mm[2] + mortar.height_mm - mortar.depth_mm)
        for station in self._stations.values():
            if station.kind == "waste" and aside_mm(station) <= WASTE_RADIUS_MM:
                place = in_vessel(station.name) if station.name in self._vessels else WASTE
                return place, fall_s(station.position_mm[2])
        return SPILLED, fall_s(0.0)


def into_mortar(sources: Mapping[str, Source], name: str, of: str | None) -> Compartment:
    """The compartment of powder of source `of` that gets into this mortar: the mortar itself only for the same lot.

    `of` is None while a new sheet is in its first mortar.
    """
    came_from = sources.get(of or name)
    is_same = came_from is not None and came_from.sheet_key == sources[name].sheet_key
    return in_source(name) if is_same else RETURNED
