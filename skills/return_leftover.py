"""Put what is left in the cone where the recipe wants it: kept for the next sample, back, or away."""

from collections.abc import Mapping
from typing import Any

from scuhand_bt.skill import Cell, CellSpec, Code, Forecast, Keeping, Kept, Skill, SkillFailed, Source, Steps

from ._emptying import out_of_mortar, pour_rest, put_away


class ReturnLeftover(Skill[None]):
    """Empty the cone of this source's powder, to where the recipe's `leftover` says, or back into its mortar."""

    raises = (Code.HAND_WRONG_POWDER,)
    devices = ("arm", "hand")
    empties_cone = True
    typical_s = 5.0
    interrupted = "repeat"

    source: Source
    keep: Keeping = "never"
    """Whether it may stay in the cone for the next sample: never, if the recipe's `leftover` says `keep` (`if_told`),
    or also if the recipe says nothing (`unless_told`)."""

    @classmethod
    def forecast(cls, inputs: Mapping[str, Any], cell: CellSpec) -> Forecast:
        source = inputs.get("source")
        is_kept = isinstance(source, Source) and source.is_kept(inputs.get("keep", "never"))
        return Forecast(0.0 if is_kept else cls.typical_s)

    def run(self, cell: Cell) -> Steps[None]:
        believed = cell.believed
        yield from out_of_mortar(cell)
        if believed.cone_source is None:
            if believed.has_rest and self.keep == "never" and believed.sheet == self.source.sheet_key:
                yield from pour_rest(cell, self.source)
            return
        source = cell.sources[believed.cone_source]
        if source.sheet_key != self.source.sheet_key:
            raise SkillFailed(Code.HAND_WRONG_POWDER, f"the cone holds {source.sheet_key}, not {self.source.sheet_key}")
        if source.is_kept(self.keep):
            cell.record.event(Kept(source=source.name, expected_mg=believed.cone_mg))
        else:
            yield from put_away(cell)
