"""Which of a balance's lines are believed: none of the four protocols has a checksum.

A line of the right grammar may still be false: a bit flipped in a digit leaves a digit. Three rules, pure:

- *Form.* A line has the decimals and the last digit of the configured readability, in a unit of mass.
- *Step.* A line that differs from the last believed one by more than powder can bring meanwhile is held back
  until the next two confirm it; so is the first of all. What is given out then is the middle one of the three,
  so that one false line among them does no harm.
- *Stability.* A line that says stable is believed to be so only where the balance has just said that value, or
  one about as near to it as its successive lines are to each other. A false line stands alone.
"""

import math
from collections import deque
from dataclasses import dataclass, replace
from decimal import Decimal
from itertools import pairwise

from scuhand_bt.device_specs.balance import BalanceSpec
from scuhand_bt.devices.balances.frames import MILLIGRAMS_PER_UNIT, OutOfRange, Weight
from scuhand_bt.devices.interfaces import Reading

LUMP_MG = 100.0
"""A step that one reading may bring at any rate: lumps weigh tens of milligrams, and one that lands is felt, for a
moment, as up to twice its weight."""
FLOW_MG_PER_S = 1000.0
"""More than runs out of the hand: glass beads at its full opening of 2.4 mm are 0.67 g/s, 0.8 g/s at most."""
CONFIRMATIONS = 2
"""Lines that a step waits for."""
STABLE_LINES = 10
"""Of so many lines, the newest that said stable, the values are remembered."""
MARGIN_DIGITS = 90.0
"""A balance shows up to 9 verification intervals beyond its maximum (OIML R 76-1, 3.2), of ten digits each."""
DIGITS_SEEN = 20
"""Different values before a last digit that never changes is believed: by chance all of them are even once in 10^6."""


@dataclass(frozen=True, slots=True)
class Misfit:
    """How what a balance shows differs from what robot/cell.yaml says of it."""

    found: str
    expected: str
    what_to_do: str

    def __str__(self) -> str:
        return f"it shows {self.found} instead of {self.expected}; {self.what_to_do}"


def misfit(weight: Weight, unit: str, spec: BalanceSpec) -> Misfit | None:
    """How a line's form differs from the configured readability; None if it does not. `unit` is its unit, or the last
    one said."""
    per_unit_mg = MILLIGRAMS_PER_UNIT.get(unit)
    if per_unit_mg is None:
        return Misfit(f"'{unit}' (not a unit of mass)", f"{', '.join(MILLIGRAMS_PER_UNIT)}", "set it to g")
    if spec.options.unit not in (None, unit):
        do = f"set it to {spec.options.unit}, or write `unit: {unit}` in robot/cell.yaml"
        return Misfit(f"'{unit}'", f"'{spec.options.unit}'", do)
    step = Decimal(f"{spec.readability_mg:.9g}") / per_unit_mg
    exponent, expected = weight.value.as_tuple().exponent, step.normalize().as_tuple().exponent
    assert isinstance(exponent, int)
    assert isinstance(expected, int)
    if exponent == min(0, expected) and weight.value % step == 0:
        return None
    return _in_steps_of(float(per_unit_mg.scaleb(exponent)), spec)


def _in_steps_of(step_mg: float, spec: BalanceSpec) -> Misfit:
    do = f"write `readability: {step_mg:g} mg` for the balance in robot/cell.yaml"
    if step_mg > spec.readability_mg:
        do += ", or set the balance to show its finest steps"
    return Misfit(f"steps of {step_mg:g} mg", f"{spec.readability_mg:g} mg", do)


class Plausibility:
    """Judges one conversation's lines, in their order."""

    def __init__(self, spec: BalanceSpec) -> None:
        self._spec = spec
        self._level: Reading | None = None
        self._held: list[Reading] = []
        self._stable_mg: deque[float] = deque(maxlen=STABLE_LINES)
        self._digits_seen: set[int] = set()
        self.discarded = 0
        """Lines that were held back and not confirmed."""

    @property
    def is_holding(self) -> bool:
        """A line is held back: the next ones decide."""
        return bool(self._held)

    def judge(self, line: Reading) -> tuple[Reading, Reading | None]:
        """A line that has the right form: as it is to be written down, and the reading to be given out now, if any."""
        judged = replace(line, stable=self._is_borne_out(line))
        if self._is_step(line):
            judged = replace(line, stable=False)
            self._held.append(judged)
            return judged, self._confirmed()
        self.discarded += len(self._held)
        self._held = []
        self._level = judged
        return judged, judged

    def beyond(self, reading: Reading) -> OutOfRange | None:
        """Whether a reading is above the maximum, or below what can have been tared away."""
        margin_mg = MARGIN_DIGITS * self._spec.readability_mg
        if abs(reading.value_mg) <= self._spec.maximum_mg + margin_mg:
            return None
        return OutOfRange(above=reading.value_mg > 0.0)

    def coarser(self, reading: Reading) -> Misfit | None:
        """Whether the last digit never changes though the value does: the balance shows coarser steps."""
        if len(self._digits_seen) < DIGITS_SEEN:
            self._digits_seen.add(round(reading.value_mg / self._spec.readability_mg))
        common = math.gcd(*self._digits_seen)
        if len(self._digits_seen) < DIGITS_SEEN or common == 1:
            return None
        return _in_steps_of(common * self._spec.readability_mg, self._spec)

    def _is_step(self, line: Reading) -> bool:
        level = self._level
        if level is None:
            return True
        return abs(line.value_mg - level.value_mg) > LUMP_MG + FLOW_MG_PER_S * (line.time_s - level.time_s)

    def _confirmed(self) -> Reading | None:
        """The middle one of the lines held back, if they are enough and agree."""
        if len(self._held) <= CONFIRMATIONS:
            return None
        held, level = self._held, self._level
        if level is not None and len({line.value_mg > level.value_mg for line in held}) > 1:  # they contradict
            self.discarded += 1
            del held[0]
            return None
        self._held = []
        self._level = sorted(held, key=lambda line: line.value_mg)[CONFIRMATIONS // 2]
        return self._level

    def _is_borne_out(self, line: Reading) -> bool:
        """Whether it says stable, and others that have just said so bear it out."""
        if not line.stable:
            self._stable_mg.clear()
            return False
        before_mg = list(self._stable_mg)
        self._stable_mg.append(line.value_mg)
        differences_mg = sorted(abs(b - a) for a, b in pairwise(before_mg))
        # A false line makes two large differences, a step of the load one: a third of all they leave alone.
        scatter_mg = differences_mg[len(differences_mg) // 3] if len(differences_mg) > 2 else 0.0
        near_mg = 2.0 * scatter_mg + self._spec.readability_mg / 2.0
        return any(abs(line.value_mg - value_mg) <= near_mg for value_mg in before_mg)
