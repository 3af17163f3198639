"""Move through the cell."""

from scuhand_bt.skill import Cell, Skill, Steps


class Tour(Skill[None]):
    """Move the arm to every place that has no powder under it, and back to its park station."""

    devices = ("arm",)
    typical_s = 3.0
    interrupted = "repeat"

    def run(self, cell: Cell) -> Steps[None]:
        stations = cell.spec.stations.values()
        for kind in ("waste", "service", "park"):
            for station in stations:
                if station.kind == kind:
                    yield from cell.move_to(station.name)
