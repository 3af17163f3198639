"""The simulated balance: the plant's response, read at the balance's period, with the balance's stability criterion.

A reading is stable if, over the last `WINDOW_S`, the means of the newer and the older half differ by at most
`BAND_DIGITS` digits. A settled pan passes despite its noise; a filter that still creeps does not.
"""

import math
from collections import deque
from collections.abc import Callable
from decimal import Decimal
from typing import ClassVar

import numpy as np

from scuhand_bt.clock import Clock, Signal, Steps, Wake
from scuhand_bt.device_specs.balance import BalanceSpec
from scuhand_bt.devices.interfaces import Reading, StableMean
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.sim.faults import FLIPPED, Faults
from scuhand_bt.sim.plant import BREAKS, Plant

BAND_DIGITS = 1.5
WINDOW_S = 1.0
MEAN_OF = 5
"""The number of consecutive stable readings in a stable mean."""
DRIFT_MG_PER_S = 1.0
"""The drift of the fault `balance.drifting`: more than three times the drift that `BAND_DIGITS` lets pass at 0.1 mg."""


class SimulatedBalance:
    """The balance under the hand; see `scuhand_bt.devices.interfaces.Balance`."""

    STATE: ClassVar[tuple[str, ...]] = (
        "latest",
        "next_reading_s",
        "_response",
        "_rng",
        "_values",
        "_readings",
        "_overloaded",
        "_heard_s",
        "_zero_mg",
        "_span",
        "_is_off",
    )
    """The attributes that the world's file keeps."""

    def __init__(self, spec: BalanceSpec, clock: Clock, plant: Plant) -> None:
        self.spec = spec
        self.identity = "simulated"
        self.news = Signal()
        self._calm = Signal()  # `news` without the unstable readings
        self.latest: Reading | None = None
        self.on_reading: Callable[[Reading], None] | None = None
        self.is_stopped = True
        self.faults = Faults()
        """Its active faults; the world replaces it by its own."""
        self._is_powered = True
        self._heard_s = 0.0  # time of its last output
        self._was_lost = False
        self._zero_mg = 0.0  # the load that it shows as zero
        self._span = 1.0
        self._is_off = False
        self.next_reading_s = spec.period_s
        self._clock = clock
        self._plant = plant
        self._response = plant.balance(spec)
        self._rng = np.random.default_rng(0)
        self._line = _line_of(spec.readability_mg)
        self._half = max(3, round(WINDOW_S / spec.period_s / 2.0))
        self._values: deque[float] = deque(maxlen=2 * self._half)
        self._readings = 1
        self._overloaded = False

    def stop(self) -> None:
        """Does nothing: a balance only reads."""

    @property
    def fault(self) -> SkillFailed | None:
        """Its present fault; None if it is sound."""
        if self._was_lost:
            return SkillFailed(Code.DEVICE_LOST, f"the balance has sent no reading for {self.spec.lost_after_s:g} s")
        return None

    def next_reading(self, timeout_s: float | None = None) -> Steps[Reading]:
        timeout_s = self.spec.awaited_s if timeout_s is None else timeout_s
        deadline_s = self._clock.now_s + timeout_s
        seen = self.news.count
        while self.news.count == seen:
            if self._clock.now_s >= deadline_s:
                raise SkillFailed(Code.DEVICE_LOST, f"the balance sent nothing for {timeout_s:g} s")
            yield Wake(deadline_s, self.news, seen)
        return self._sound_reading()

    def stable_mean(self, timeout_s: float = 30.0) -> Steps[StableMean]:
        deadline_s = self._clock.now_s + timeout_s
        stable: list[Reading] = []
        while len(stable) < MEAN_OF:
            reading = yield from self.next_reading() if stable else self._next_calm(deadline_s)
            if reading.stable:
                stable.append(reading)
            else:
                stable.clear()
                if self._clock.now_s >= deadline_s:
                    raise SkillFailed(Code.BALANCE_UNSTABLE, f"no stable reading within {timeout_s:g} s")
        values = [reading.value_mg for reading in stable]
        mean = sum(values) / MEAN_OF
        variance = sum((value - mean) ** 2 for value in values) / (MEAN_OF - 1)
        uncertainty_mg = math.sqrt(variance / MEAN_OF + self.spec.readability_mg**2 / 12.0)
        return StableMean(mean, uncertainty_mg, stable[-1].time_s, tuple(stable))

    def _next_calm(self, until_s: float) -> Steps[Reading]:
        """The next stable reading, or the next of any kind after `until_s`: unstable ones need wake nobody."""
        seen = self._calm.count
        while self._calm.count == seen:
            if self._was_lost or self._clock.now_s >= until_s:
                return (yield from self.next_reading())
            yield Wake(until_s, self._calm, seen)
        return self._sound_reading()

    def _sound_reading(self) -> Reading:
        if (fault := self.fault) is not None:
            raise fault
        if self._overloaded or self.latest is None:
            raise SkillFailed(Code.BALANCE_OVERLOAD, f"more than {self.spec.maximum_mg / 1000.0:g} g on the pan")
        return self.latest

    def use_randomness(self, rng: np.random.Generator) -> None:
        """Draw from this generator from now on."""
        self._rng = rng

    def switch(self, *, on: bool) -> None:
        """Switch its supply. However short the cut was, the balance then takes the load on the pan as its zero."""
        self._is_powered, self._is_off = on, True

    def take_zero(self, on_pan_mg: float) -> None:
        """Take this load as the zero, as at power-on."""
        self._zero_mg, self.latest = on_pan_mg * self._span, None
        self._values.clear()

    def change_span(self, by_share: float) -> None:
        """Change the span: from now on every mass reads higher by this share."""
        self._span *= 1.0 + by_share

    def move_zero(self, by_mg: float) -> None:
        """Shift the zero: from now on every reading is higher by this."""
        self._zero_mg -= by_mg

    def advance(self, end_s: float, dt_s: float, on_pan_mg: float, landing_mg: float, vibration: float) -> None:
        """Advance by `dt_s`; give out a reading at the end of each period."""
        try:
            value_mg = self._plant.reading(self._response.step(dt_s, on_pan_mg, landing_mg, vibration, self._rng))
        except BREAKS as error:  # of a user's plant
            self._plant.blame(error, "balance")
            raise
        if end_s < self.next_reading_s - 1e-9:
            return
        self._readings += 1
        self.next_reading_s = self._readings * self.spec.period_s
        if self.faults.active or self._was_lost or self._is_off or not self._is_powered:
            was_off = self._is_off
            self._is_off = "balance.restarted" in self.faults.active or not self._is_powered
            if was_off and not self._is_off:
                self.take_zero(on_pan_mg + landing_mg)
            if self._is_silent(end_s):
                return
            value_mg += self._error_mg(end_s)
        self._heard_s = end_s
        value_mg = value_mg * self._span - self._zero_mg
        digit_mg = self.spec.readability_mg
        value_mg = round(value_mg / digit_mg) * digit_mg
        self._overloaded = value_mg > self.spec.maximum_mg or "balance.overload" in self.faults.active
        self._values.append(value_mg)
        stable = False
        if len(self._values) == 2 * self._half:
            values, newer = list(self._values), 0.0
            for old_mg, new_mg in zip(values, values[self._half :], strict=False):
                newer += new_mg - old_mg
            stable = abs(newer) <= BAND_DIGITS * digit_mg * self._half
        stable = stable and "balance.unstable" not in self.faults.active
        if self._overloaded:  # an overloaded balance reports no mass
            self._tell(calm=True)
            return
        if self.on_reading is None:
            self.latest = Reading(value_mg, stable, end_s)
        else:
            raw = self._line % (b"S" if stable else b"D", value_mg / 1000.0 + 0.0)  # no -0.0000
            self.latest = Reading(value_mg, stable, end_s, "g", raw)
            self.on_reading(self.latest)
        self._tell(calm=stable)

    def _tell(self, *, calm: bool) -> None:
        self.news.fire()
        if calm:
            self._calm.fire()

    def _is_silent(self, now_s: float) -> bool:
        """Whether it gives out no valid reading now; fires `news` when the balance is lost and when it is back."""
        active = self.faults.active
        is_silent = self._is_off or "balance.silent" in active or "balance.garbage" in active
        is_silent = is_silent or ("balance.bit_flips" in active and self._readings % FLIPPED == 0)  # discarded
        if self._was_lost != (is_silent and now_s - self._heard_s >= self.spec.lost_after_s):
            self._was_lost = not self._was_lost
            self.latest = None if self._was_lost else self.latest
            self._tell(calm=True)
        return is_silent

    def _error_mg(self, now_s: float) -> float:
        """The error of a drifting zero and of a draught."""
        active = self.faults.active
        error_mg = DRIFT_MG_PER_S * (now_s - active["balance.drifting"]) if "balance.drifting" in active else 0.0
        return error_mg + (self.faults.push_mg() if "balance.draught" in active else 0.0)


def _line_of(readability_mg: float) -> bytes:
    """The pattern of its lines in MT-SICS format, b"S S    12.3456 g": grams, to the balance's last digit."""
    decimals = max(0, -int(Decimal(str(readability_mg / 1000.0)).normalize().as_tuple().exponent))
    return b"S %%s %%10.%df g\r\n" % decimals
