"""Where the cone's apex stands for each thing the cell does, in millimetres of the base frame.

All heights are here, so that `check`, the planner and the skills mean the same point.
"""

import math
from collections.abc import Iterable, Mapping

from scuhand_bt.bench_spec import Station
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.dosing.flow import GRAVITY_MM_PER_S2
from scuhand_bt.specs import ContainerKind, Mortar, Source

Position = tuple[float, float, float]

DISPENSING_HEIGHT_MM = 80.0
"""Apex above the pan while dispensing (paper, section V-A)."""
MOUTH_CLEARANCE_MM = 15.0
"""Apex above a container's mouth, where that is higher."""
CLEAR_MM = 90.0
"""The apex must be this far aside from the pan's centre while containers are changed."""
HOVER_MM = 25.0
"""Apex above a mortar's rim, or above the opening of the waste bin."""


def dispensing_height_mm(container: ContainerKind) -> float:
    """Apex above the pan for this container."""
    return max(DISPENSING_HEIGHT_MM, container.height_mm + MOUTH_CLEARANCE_MM)


def fall_s(container: ContainerKind) -> float:
    """How long powder falls, onto the container's floor [s]."""
    return math.sqrt(2.0 * dispensing_height_mm(container) / GRAVITY_MM_PER_S2)


def over_balance(cell: CellSpec, container: ContainerKind) -> tuple[str, Position]:
    """Name and position of the apex while dispensing into this container."""
    station = cell.station_of_kind("balance")
    height_mm = dispensing_height_mm(container)
    x_mm, y_mm, z_mm = station.position_mm
    return f"{station.name}+{height_mm:.0f}mm", (x_mm, y_mm, z_mm + height_mm)


def over_mortar(station: Station, mortar: Mortar) -> Position:
    """The apex above a mortar, out of the bowl."""
    x_mm, y_mm, z_mm = station.position_mm
    return (x_mm, y_mm, z_mm + mortar.height_mm + HOVER_MM)


def at_station(station: Station) -> Position:
    """The apex at the waste bin's opening (a hover above it), at the service or the park station."""
    x_mm, y_mm, z_mm = station.position_mm
    return (x_mm, y_mm, z_mm + HOVER_MM) if station.kind == "waste" else (x_mm, y_mm, z_mm)


def all_places(
    cell: CellSpec, sources: Mapping[str, Source], containers: Iterable[ContainerKind]
) -> dict[str, Position]:
    """Every named place that a batch with these sources and containers moves between."""
    places = {
        station.name: at_station(station)
        for station in cell.stations.values()
        if station.kind in ("waste", "service", "park")
    }
    for source in sources.values():
        places[source.station] = over_mortar(cell.stations[source.station], source.mortar)
    for container in containers:
        name, position = over_balance(cell, container)
        places[name] = position
    return places
