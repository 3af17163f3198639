"""Check that the balance stands still."""

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field

from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.dosing.characteristic import noise_and_drift
from scuhand_bt.skill import BalanceWatched, Cell, Code, Forecast, Milligrams, Seconds, Skill, SkillFailed, Steps

LEAST = 3
"""The fewest readings that give both a noise and a drift."""


class WatchBalance(Skill[Milligrams]):
    """Read the balance for a while, with nothing changing on its pan; returns the span of its readings.

    Hand and changer stand still, or it begins again. The arm may move, which shows whether the zero follows it.
    """

    raises = (Code.BALANCE_UNSTABLE,)
    devices = ("balance",)
    interrupted = "repeat"

    duration_s: Annotated[Seconds, Field(gt=0)] = 20.0
    limit_mg: Milligrams = 2.0

    @classmethod
    def forecast(cls, inputs: Mapping[str, Any], cell: CellSpec) -> Forecast:
        return Forecast(inputs.get("duration", 20.0))

    def run(self, cell: Cell) -> Steps[Milligrams]:
        curve = yield from cell.right_of_way.beside_arm(lambda: self._watch(cell))
        values_mg = [value_mg for _, value_mg in curve]
        span_mg = max(values_mg) - min(values_mg)
        noise_mg, drift = noise_and_drift(curve)
        cell.balance_figures |= {"noise_mg": noise_mg, "drift_mg_per_s": drift}
        cell.record.event(BalanceWatched(readings=len(curve), span_mg=span_mg, noise_mg=noise_mg, drift_mg_per_s=drift))
        if span_mg > self.limit_mg:
            raise SkillFailed(
                Code.BALANCE_UNSTABLE,
                f"the readings differed by up to {span_mg:.1f} mg in {self.duration_s:g} s; {self.limit_mg:g} mg are "
                "allowed",
            )
        return span_mg

    def _watch(self, cell: Cell) -> Steps[list[tuple[float, float]]]:
        """The readings as (time in s, value in mg), from when the balance has come to rest."""
        yield from cell.balance.stable_mean(cell.spec.balance.settles_s)
        end_s = cell.clock.now_s + self.duration_s
        curve: list[tuple[float, float]] = []
        while len(curve) < LEAST or cell.clock.now_s < end_s:
            reading = yield from cell.balance.next_reading()
            curve.append((reading.time_s, reading.value_mg))
        return curve
