"""Bring the cone out of a mortar."""

from scuhand_bt.skill import Cell, Skill, Steps

from ._emptying import aside_mm, is_over, leave_mortar

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
        for source in sorted(cell.sources.values(), key=lambda source: aside_mm(cell, source)):
            is_above = axis[2] > UPRIGHT and apex_mm > cell.places_mm[source.station][2] - NEAR_MM
            # The sheet was noted before a scoop went in: so of mortars side by side, the cone is in none with another
            # lot.
            if source.sheet_key == cell.believed.sheet and is_over(cell, source) and not is_above:
                yield from leave_mortar(cell, source)
                return
