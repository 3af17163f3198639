"""The cone as wide as it lets powder out."""

from scuhand_bt.skill import Cell, Skill, Steps

from ._opening import open_to_let_out


class OpenCone(Skill[None]):
    """Open the cone to the size in which it lets powder out: after a scoop, while something else goes on.

    `move_over` and whatever empties the cone do it before they begin, where it was not done yet.
    """

    devices = ("arm", "hand")
    typical_s = 4.0
    interrupted = "repeat"

    def run(self, cell: Cell) -> Steps[None]:
        yield from open_to_let_out(cell)
