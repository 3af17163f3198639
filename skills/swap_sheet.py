"""Have a fresh sheet mounted, so that no powder touches what another has touched."""

from collections.abc import Mapping
from typing import Any

from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.skill import Cell, Code, Forecast, SheetSwapped, Skill, SkillFailed, Steps


class SwapSheet(Skill[None]):
    """Have the operator put a fresh sheet into the hand (two screws), the arm held where it is handy."""

    raises = (Code.HAND_WRONG_POWDER, Code.OPERATOR_REFUSED)
    devices = ("arm", "hand")
    typical_s = 60.0
    interrupted = "repeat"

    @classmethod
    def forecast(cls, inputs: Mapping[str, Any], cell: CellSpec) -> Forecast:
        return Forecast(cls.typical_s, "swap the sheet (two screws), wipe rollers and clamp")

    def run(self, cell: Cell) -> Steps[None]:
        believed = cell.believed
        if believed.sheet is None:
            return
        if believed.cone_source is not None:
            raise SkillFailed(Code.HAND_WRONG_POWDER, f"the cone still holds powder from '{believed.cone_source}'")
        service = [station.name for station in cell.spec.stations.values() if station.kind == "service"]
        yield from cell.move_to(service[0] if service else cell.spec.station_of_kind("park").name)
        mounted_mm = cell.spec.hand.options.start_diameter_mm
        answer = yield from cell.operator.ask(
            f"Put a fresh sheet into the hand, with a rim of {mounted_mm:g} mm. Wipe both rollers and the clamp: "
            f"they and the old sheet have touched {believed.sheet}."
        )
        if answer != "done":
            raise SkillFailed(Code.OPERATOR_REFUSED, "the sheet was not swapped")
        touched = believed.sheet
        cell.sheet_mounted()
        cell.hand.rim_is(mounted_mm)
        believed.sheet_swapped()
        cell.record.event(SheetSwapped(sheets_used=believed.sheets_used, touched=touched))
