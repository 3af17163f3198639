"""What is left in the cone goes back into its mortar."""

from scuhand_bt.skill import Cell, Skill, SkillFailed, Source, Steps

from ._emptying import empty_cone


class ReturnLeftover(Skill[None]):
    """Empty the cone into the mortar it was filled from; does nothing if it is empty."""

    devices = ("arm", "hand")
    typical_s = 15.0

    source: Source

    def run(self, cell: Cell) -> Steps[None]:
        believed = cell.believed
        if believed.cone_source is None:
            return
        if believed.cone_source != self.source.name:
            raise SkillFailed(
                "hand.wrong_powder", f"the cone was filled from '{believed.cone_source}', not from '{self.source.name}'"
            )
        yield from cell.move_to(self.source.station)
        returned_mg = believed.cone_mg
        yield from empty_cone(cell)
        believed.sources_mg[self.source.name] += returned_mg
        cell.record.event("returned", {"source": self.source.name, "expected_mg": returned_mg})
