"""Is there powder of the right kind in the cone?"""

from scuhand_bt.skill import Cell, Condition, Milligrams, Powder, SkillFailed


class ConeHolds(Condition):
    """Hold if the cone is believed to contain this powder, and at least so much of it."""

    watches = ("hand",)

    powder: Powder
    at_least_mg: Milligrams = 1.0

    def check(self, cell: Cell) -> None:
        believed = cell.believed
        source = cell.sources.get(believed.cone_source or "")
        if source is None or believed.cone_mg < self.at_least_mg:
            raise SkillFailed("hand.cone_empty", f"the cone is believed to hold {believed.cone_mg:.0f} mg")
        if source.powder.name != self.powder.name:
            raise SkillFailed("hand.wrong_powder", f"the cone holds {source.powder.name}, not {self.powder.name}")
