"""Ask the person at the cell."""

from collections.abc import Mapping
from typing import Any

from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.skill import Cell, Code, Forecast, Skill, SkillFailed, Steps


class AskOperator(Skill[None]):
    """Ask the operator to do or confirm something, and go on when it is done."""

    raises = (Code.OPERATOR_REFUSED,)
    typical_s = 60.0
    interrupted = "repeat"

    question: str

    @classmethod
    def forecast(cls, inputs: Mapping[str, Any], cell: CellSpec) -> Forecast:
        return Forecast(cls.typical_s, str(inputs.get("question", "answer a question")))

    def run(self, cell: Cell) -> Steps[None]:
        answer = yield from cell.operator.ask(self.question)
        if answer != "done":
            raise SkillFailed(Code.OPERATOR_REFUSED, self.question)
