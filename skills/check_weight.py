"""Does the balance weigh right?"""

from collections.abc import Mapping
from typing import Any, ClassVar

from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.quantity import format_mass
from scuhand_bt.skill import Cell, Code, Failure, Forecast, Milligrams, Skill, SkillFailed, Steps, WeightChecked


class CheckWeight(Skill[Milligrams]):
    """Have the operator put a check weight on the empty pan, and off again; gives how far off the balance is."""

    raises = (Code.OPERATOR_REFUSED, "balance.inaccurate")
    devices = ("balance",)
    failures: ClassVar = {
        "balance.inaccurate": Failure(
            "The balance does not weigh a check weight right.",
            "Check that it is the right weight, clean and in the middle of the pan; adjust the balance.",
        )
    }
    typical_s = 120.0
    interrupted = "repeat"

    weight_mg: Milligrams
    tolerance_mg: Milligrams = 1.0

    @classmethod
    def forecast(cls, inputs: Mapping[str, Any], cell: CellSpec) -> Forecast:
        return Forecast(cls.typical_s, "put a check weight on the pan, and take it off again")

    def run(self, cell: Cell) -> Steps[Milligrams]:
        bare = yield from cell.balance.stable_mean()
        yield from self._ask(cell, f"Put the check weight of {format_mass(self.weight_mg)} on the empty pan.")
        cell.weight_on_pan(self.weight_mg)
        loaded = yield from cell.balance.stable_mean()
        yield from self._ask(cell, "Take the check weight off the pan.")
        cell.weight_on_pan(0.0)
        error_mg = loaded.value_mg - bare.value_mg - self.weight_mg
        cell.record.event(
            WeightChecked(
                weight_mg=self.weight_mg,
                error_mg=error_mg,
                tolerance_mg=self.tolerance_mg,
                balance=cell.balance.identity,
                bare=bare.written(),
                loaded=loaded.written(),
            )
        )
        if abs(error_mg) > self.tolerance_mg:
            raise SkillFailed(
                "balance.inaccurate",
                f"a check weight of {format_mass(self.weight_mg)} weighs {error_mg:+.1f} mg more, "
                f"and may {self.tolerance_mg:g} mg",
            )
        return error_mg

    def settle(self, cell: Cell) -> Steps[None]:
        yield from self._ask(cell, "Take everything off the pan.")
        cell.weight_on_pan(0.0)

    @staticmethod
    def _ask(cell: Cell, request: str) -> Steps[None]:
        answer = yield from cell.operator.ask(request)
        if answer != "done":
            raise SkillFailed(Code.OPERATOR_REFUSED, request)
