"""Our balance's response: from the mass on the pan to the reading, before it is rounded to the readability.

    u = m + dm + dm t_fall / dt        x1' = (u - x1) / tau,   x2' = (x1 - x2) / tau
    reading = x2 + zero + noise

m [mg] lies on the pan; dm [mg] lands in this step after a fall of t_fall = 0.128 s (80 mm). The momentum of landing
powder weighs as much as the powder in flight. So during steady flow the pan reads what has left the nozzle (the
hourglass problem: Tuinstra & Tuinstra, Europhysics News 41/3, 2010). tau [s] is the time constant of each of two equal
poles. `zero` is a random walk; the noise is white, and larger while the motor shakes the bench.
"""

import math

from numpy.random import Generator

from scuhand_bt.device_specs.balance import BalanceSpec

FALL_TIME_S = math.sqrt(2.0 * 0.080 / 9.81)


class OurBalanceResponse:
    """Two poles, a random walk of the zero, and noise."""

    def __init__(self, spec: BalanceSpec) -> None:
        self._figures = spec.simulation
        self._noise_mg, self._drift_mg = spec.simulated_noise_mg, spec.simulated_drift_mg
        self._first = self._second = self._zero = 0.0
        self._dt_s = self._step = self._walk = 0.0

    def step(self, dt_s: float, on_pan_mg: float, landing_mg: float, vibration: float, rng: Generator) -> float:
        """The reading [mg]."""
        figures = self._figures
        if dt_s != self._dt_s:
            self._dt_s = dt_s
            self._step = -math.expm1(-dt_s / figures.lag_s)
            self._walk = self._drift_mg * math.sqrt(dt_s / 60.0)
        # The very first step may be too short to divide by; nothing lands in it.
        push_mg = on_pan_mg + landing_mg * (1.0 + FALL_TIME_S / dt_s) if landing_mg > 0.0 else on_pan_mg
        before = self._first
        self._first += (push_mg - before) * self._step
        self._second += ((before + self._first) / 2.0 - self._second) * self._step
        self._zero += self._walk * rng.standard_normal()
        noise_mg = self._noise_mg + figures.vibration_noise_mg * vibration
        return self._second + self._zero + noise_mg * rng.standard_normal()
