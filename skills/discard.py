"""What is in the cone goes to waste."""

from scuhand_bt.skill import Cell, Discarded, Skill, Steps

from ._emptying import empty_cone


class Discard(Skill[None]):
    """Empty the cone into the waste bin; does nothing if it is empty."""

    devices = ("arm", "hand")
    typical_s = 15.0
    interrupted = "repeat"

    def run(self, cell: Cell) -> Steps[None]:
        if cell.believed.cone_source is None:
            return
        yield from cell.move_to(cell.spec.station_of_kind("waste").name)
        discarded_mg = cell.believed.cone_mg
        yield from empty_cone(cell)
        cell.record.event(Discarded(expected_mg=discarded_mg))
