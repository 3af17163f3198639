"""Move the arm out of the way."""

from scuhand_bt.skill import Cell, Skill, Steps


class Park(Skill[None]):
    """Move the arm to its park station, clear of the balance and the mortars."""

    devices = ("arm",)
    typical_s = 1.5
    interrupted = "repeat"

    def run(self, cell: Cell) -> Steps[None]:
        yield from cell.move_to(cell.spec.station_of_kind("park").name)
