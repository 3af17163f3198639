"""Bring the cone out of a mortar."""

from scuhand_bt.skill import Cell, Skill, Steps

from ._emptying import leave_mortar, under_the_cone

UPRIGHT = 0.999
"""Cosine of the axis' tilt above which the cone counts as upright."""
NEAR_MM = 2.0


class Withdraw(Skill[None]):
    """Bring the cone out of the mortar that its scoop was halted in; does nothing where it is in none.

    What the cone may hold goes back into the mortar.
    """

    devices = ("arm", "hand")
    typical_s = 0.0
    interrupted = "repeat"

    def run(self, cell: Cell) -> Steps[None]:
        axis, (_, _, apex_mm) = cell.apex().axis, cell.apex_mm()
        for source in under_the_cone(cell):
            is_above = axis[2] > UPRIGHT and apex_mm > cell.places_mm[source.station][2] - NEAR_MM
            if not is_above:
                yield from leave_mortar(cell, source)
                return
