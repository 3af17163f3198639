"""Check the balance with a check weight."""

import statistics
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

from pydantic import Field

from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.quantity import format_mass
from scuhand_bt.skill import (
    Cell,
    Code,
    Failure,
    Forecast,
    Milligrams,
    OnPan,
    RepeatabilityMeasured,
    Skill,
    SkillFailed,
    Steps,
    WeightChecked,
)


class CheckWeight(Skill[Milligrams]):
    """Have the operator put a check weight on the empty pan and take it off; returns the balance's error.

    With several `times` the worst error counts, and their standard deviation is kept as the balance's repeatability.
    Arm and hand stand still from each request to its answer, and for each weighing.
    """

    raises = (Code.OPERATOR_REFUSED, "balance.inaccurate", "balance.not_bare")
    devices = ("balance",)
    zones = ("pan",)  # where a person reaches
    failures: ClassVar = {
        "balance.inaccurate": Failure(
            "The balance weighs a check weight wrong, by more than the tolerance.",
            "Check that it is the right weight, clean and in the middle of the pan. Then adjust the balance.",
        ),
        "balance.not_bare": Failure(
            "A container stands on the pan, where the check weight is to be put.",
            "In the workflow, call `remove_container` before `check_weight`.",
        ),
    }
    typical_s = 120.0
    interrupted = "repeat"

    weight_mg: Annotated[Milligrams, Field(gt=0), OnPan()]
    tolerance_mg: Milligrams = 1.0
    times: Annotated[int, Field(ge=1, le=50)] = 1

    @classmethod
    def forecast(cls, inputs: Mapping[str, Any], cell: CellSpec) -> Forecast:
        times = inputs.get("times", 1)
        again = f" ({times} times)" if times > 1 else ""
        return Forecast(cls.typical_s * times, f"put a check weight on the pan, and take it off again{again}")

    def run(self, cell: Cell) -> Steps[Milligrams]:
        if (container := cell.believed.pan) is not None:
            raise SkillFailed("balance.not_bare", f"'{container.id}' still stands on the pan")
        cell.balance_figures["check_weight_error_mg"] = None  # until it has passed again
        errors_mg = []
        for _ in range(self.times):
            error_mg = yield from self._weigh(cell)
            errors_mg.append(error_mg)
        if len(errors_mg) > 1:
            repeatability_mg = statistics.stdev(errors_mg)
            cell.balance_figures["repeatability_mg"] = repeatability_mg
            cell.record.event(
                RepeatabilityMeasured(
                    weight_mg=self.weight_mg,
                    weighings=self.times,
                    repeatability_mg=repeatability_mg,
                    balance=cell.balance.identity,
                )
            )
        error_mg = max(errors_mg, key=abs)
        if abs(error_mg) > self.tolerance_mg:
            raise SkillFailed(
                "balance.inaccurate",
                f"the check weight of {format_mass(self.weight_mg)} is weighed wrong by {error_mg:+.1f} mg; "
                f"{self.tolerance_mg:g} mg are allowed",
            )
        cell.balance_figures["check_weight_error_mg"] = error_mg
        return error_mg

    def _weigh(self, cell: Cell) -> Steps[float]:
        """Weigh the check weight once; returns the error in mg, positive where the balance shows too much."""
        bare = yield from cell.right_of_way.stable_mean()
        yield from self._ask(cell, f"Put the check weight of {format_mass(self.weight_mg)} on the empty pan.")
        cell.weight_on_pan(self.weight_mg)
        loaded = yield from cell.right_of_way.stable_mean()
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
        return error_mg

    def settle(self, cell: Cell) -> Steps[None]:
        yield from self._ask(cell, "Take everything off the pan.")
        cell.weight_on_pan(0.0)

    @staticmethod
    def _ask(cell: Cell, request: str) -> Steps[None]:
        answer = yield from cell.right_of_way.undisturbed(cell.operator.ask(request))
        if answer != "done":
            raise SkillFailed(Code.OPERATOR_REFUSED, request)
