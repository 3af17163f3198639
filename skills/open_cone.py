"""Open the cone to the diameter at which it lets powder out."""

from scuhand_bt.skill import Cell, Skill, Steps

from ._opening import open_to_let_out


class OpenCone(Skill[None]):
    """Open the cone to the size at which it lets powder out; saves time after a scoop, beside another action.

    Otherwise `move_over`, and whatever empties the cone, does it first.
    """

    devices = ("arm", "hand")
    typical_s = 4.0
    interrupted = "repeat"

    def run(self, cell: Cell) -> Steps[None]:
        yield from open_to_let_out(cell)
