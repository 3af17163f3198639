"""What `adaptive` is asked for and believes on a bench of no cell: a powder of one coefficient and its scale."""

import pytest
from dose_bench import dose_request, shipped_powders

from scuhand_bt.dosing import DoseRequest, Observation
from scuhand_bt.dosing.knowledge import Knowledge
from scuhand_bt.specs import BalanceBelief

BEADS = shipped_powders()["glass_beads"].belief
QUICK = BalanceBelief(lag_s=0.05, doubt=0.08, fits=3, noise_mg=0.05)
PERIOD_S = 0.1


def request(**changes: object) -> DoseRequest:
    return dose_request(**({"powder": BEADS.model_copy(update={"doses": 3}), "balance": QUICK} | changes))


class Scale:
    """A powder of this coefficient, and a balance that shows it as it leaves."""

    def __init__(self, known: Knowledge, coefficient: float) -> None:
        self.known, self.coefficient = known, coefficient
        self.left_mg = known.begin_mg

    def act(self, opening_mm: float, duration_s: float) -> None:
        for _ in range(round(duration_s / PERIOD_S)):
            step = self.known.act(opening_mm, 0.0)
            next(step)
            time_s = self.known.time_s + PERIOD_S
            # The valve is where it is reckoned to be: the coefficient alone is in question.
            self.left_mg += self.coefficient * PERIOD_S * self.known.shape.value(self.known.valve.opening_mm)
            with pytest.raises(StopIteration):
                step.send(Observation(time_s, self.left_mg, 0.05, False))

    def opening(self, opening_mm: float, duration_s: float) -> float:
        """The reference after it."""
        self.act(opening_mm, duration_s)
        self.act(0.0, 2.0)
        self.known.learn(self.left_mg - self.known.begin_mg)
        self.known.begin(self.left_mg, 0.1)
        return self.known.reference
