"""Empty the cone into the waste bin."""

from scuhand_bt.skill import Cell, Skill, Steps

from ._emptying import empty_at, out_of_mortar


class Discard(Skill[None]):
    """Empty the cone into the waste bin; does nothing if it is empty."""

    devices = ("arm", "hand")
    empties_cone = True
    typical_s = 9.0
    interrupted = "repeat"

    def run(self, cell: Cell) -> Steps[None]:
        yield from out_of_mortar(cell)
        if cell.believed.cone_source is not None:
            yield from empty_at(cell, cell.spec.station_of_kind("waste").name)
