"""Have a mortar refilled before it runs short."""

from collections.abc import Mapping
from typing import Any

from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.quantity import format_mass
from scuhand_bt.skill import Cell, Code, Forecast, Refilled, Skill, SkillFailed, Source, Steps


class RefillMortar(Skill[None]):
    """Have a person put what the recipe says into a source's mortar; arm and hand stand still."""

    raises = (Code.OPERATOR_REFUSED,)
    devices = ("arm", "hand")
    typical_s = 60.0
    interrupted = "repeat"

    source: Source

    @classmethod
    def forecast(cls, inputs: Mapping[str, Any], cell: CellSpec) -> Forecast:
        source = inputs.get("source")
        what = f"'{source.name}' at {source.station}" if isinstance(source, Source) else "a mortar"
        return Forecast(cls.typical_s, f"refill {what}")

    def run(self, cell: Cell) -> Steps[None]:
        source, left_mg = self.source, cell.believed.sources_mg[self.source.name]
        mass_mg = source.refill_into_mg(left_mg)
        if mass_mg <= 0.0:
            return
        holds = f"it holds about {format_mass(left_mg)} now"
        answer = yield from cell.operator.ask(
            f"Put {format_mass(mass_mg)} of {source.sheet_key} into the mortar at {source.station}: {holds}."
        )
        if answer != "done":
            raise SkillFailed(Code.OPERATOR_REFUSED, f"the mortar at {source.station} was not refilled")
        cell.mortar_refilled(source.name, mass_mg)
        cell.believed.source_refilled(source.name, mass_mg)
        cell.record.event(Refilled(source=source.name, mass_mg=mass_mg, holds_mg=left_mg + mass_mg))
