"""What is left in the cone goes back into its mortar."""

from scuhand_bt.skill import Cell, Code, Skill, SkillFailed, Source, Steps

from ._emptying import empty_into


class ReturnLeftover(Skill[None]):
    """Empty the cone into the mortar it was filled from (of this source's powder lot); nothing if it is empty."""

    raises = (Code.HAND_WRONG_POWDER,)
    devices = ("arm", "hand")
    typical_s = 15.0
    interrupted = "repeat"

    source: Source

    def run(self, cell: Cell) -> Steps[None]:
        believed = cell.believed
        if believed.cone_source is None:
            return
        source = cell.sources[believed.cone_source]
        if source.sheet_key != self.source.sheet_key:
            raise SkillFailed(Code.HAND_WRONG_POWDER, f"the cone holds {source.sheet_key}, not {self.source.sheet_key}")
        yield from cell.move_to(source.station)
        yield from empty_into(cell, source)
