"""Is there powder of the right kind in the cone?"""

from scuhand_bt.skill import Cell, Code, Condition, Milligrams, Powder, SkillFailed


class ConeHolds(Condition):
    """Hold if the cone is believed to contain this powder, at least so much of it, and to let it out."""

    raises = (Code.HAND_CONE_EMPTY, Code.HAND_WRONG_POWDER)
    watches = ("hand",)

    powder: Powder
    at_least_mg: Milligrams = 1.0

    def check(self, cell: Cell) -> None:
        believed = cell.believed
        source = cell.sources.get(believed.cone_source or "")
        if source is None or believed.cone_mg < self.at_least_mg:
            raise SkillFailed(Code.HAND_CONE_EMPTY, f"the cone is believed to hold {believed.cone_mg:.0f} mg")
        if believed.is_load_doubted:
            raise SkillFailed(Code.HAND_CONE_EMPTY, "the cone's load was other than believed: it is let out first")
        if source.powder.name != self.powder.name:
            raise SkillFailed(Code.HAND_WRONG_POWDER, f"the cone holds {source.powder.name}, not {self.powder.name}")
