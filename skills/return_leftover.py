"""What is left in the cone goes back into its mortar."""

from scuhand_bt.skill import Cell, Code, Returned, Skill, SkillFailed, Source, Steps

from ._emptying import empty_cone


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
        returned_mg = believed.cone_mg
        yield from empty_cone(cell)
        believed.returned(source.name, returned_mg)
        cell.record.event(Returned(source=source.name, expected_mg=returned_mg))
