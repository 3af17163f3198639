"""Physics for randomised plants, written apart from `scuhand_bt.sim`: powder at the apex, and the balance's filter.

    q = q1 ((D - D0) / (1 mm - D0))^n  load  opening  exp(noise)  head  mobility

q1 [mg/s] is the flow at an opening D of 1 mm, D0 [mm] the threshold, n the exponent. `load` and `opening` are
log-normal factors, drawn per load and per opening of the valve; `noise` is an Ornstein-Uhlenbeck process.

* A fresh load gives nothing for its priming time, and its first mass stays between the sheets.
* The mass between two arches diverges at a diameter Dc, as (1 - D/Dc)^-6 (Zuriguel et al., Phys. Rev. E 68, 030301,
  2003); an arch stands for a time with a power-law tail (Zuriguel et al., Sci. Rep. 4, 7324, 2014) that runs in full
  only under vibration.
* Lumps are a compound Poisson process: of one mass, of exponential ones, or of exponential ones that grow as D^3.
* What is on its way through the apex when the valve shuts goes on to fall, ever more slowly.
"""

import math
from bisect import bisect_left
from dataclasses import dataclass
from typing import Literal, TypeAlias

from numpy.random import Generator

HEAD_MG = 200.0
"""The last powder above the heel flows ever more slowly."""
CLOGGING_POWER = 6.0
LONGEST_ARCH_S = 40.0
ARCH_SURVIVES = 0.3
"""How often an arch outlives the valve's shutting."""
FALL_S = 0.1277
"""Of 80 mm."""

LumpKind: TypeAlias = Literal["one size", "exponential", "gap"]
BalanceKind: TypeAlias = Literal["poles", "mean", "delay", "adaptive", "ringing"]


@dataclass(frozen=True)
class FlowFigures:
    """A powder."""

    flow_mg_per_s: float
    """At an opening of 1 mm, shaken where it needs that."""
    exponent: float = 2.5
    threshold_mm: float = 0.1
    gravity: float = 1.0
    """Share of the flow without vibration."""
    load_spread: float = 0.1
    opening_spread: float = 0.03
    noise: float = 0.05
    noise_s: float = 0.3
    heel: float = 0.0
    """Share of the load that only vibration brings down."""
    prime_s: float = 0.0
    prime_mg: float = 0.0
    transit_s: float = 0.03
    """Time constant of the powder's way through the apex."""
    trickle_mg: float = 0.0
    """Mean mass that clings to the apex at each shutting, and falls afterwards."""
    trickle_s: float = 0.3
    arch_mg: float = 1.0
    """Mass between two arches at a vanishing opening."""
    arch_mm: float = 0.0
    """From this opening on there are none."""
    arch_s: float = 0.1
    """The shortest time that an arch stands under full vibration."""
    arch_tail: float = 2.0
    """Of a times longer stand a^-tail of them."""
    arch_creep: float = 0.0
    """How fast that time runs without vibration."""
    gush_mg: float = 0.0
    """Mean mass of what comes at once when one breaks."""
    lump_share: float = 0.0
    lump_mg: float = 1.0
    """Mean mass of a lump; at 1 mm where it grows with the gap."""
    lump_kind: LumpKind = "exponential"
    surge_mg: float = 0.0
    surge_every_s: float = math.inf
    """Mean time of flow between two avalanches of `surge_mg`."""


class DrawnFlow:
    """Powder leaving the apex; one object per cone load."""

    def __init__(self, figures: FlowFigures) -> None:
        self.figures = figures
        self._load = 0.0  # not drawn yet
        self._heel_mg = 0.0
        self._opening = 1.0
        self._noise = 0.0
        self._is_open = False
        self._prime_s, self._prime_mg = figures.prime_s, figures.prime_mg
        self._arch_s = 0.0
        self._between_mg = 0.0  # in the apex, on its way
        self._trickle_mg = 0.0

    def step(self, dt_s: float, opening_mm: float, vibration: float, in_cone_mg: float, rng: Generator) -> float:
        figures = self.figures
        if self._load == 0.0:
            self._load = math.exp(figures.load_spread * rng.standard_normal())
            self._heel_mg = figures.heel * in_cone_mg
        if opening_mm <= 0.0:
            if self._is_open:
                self._shut(rng)
            return self.trickle(dt_s, in_cone_mg)
        if not self._is_open:
            self._is_open = True
            self._opening = math.exp(figures.opening_spread * rng.standard_normal())
            self._between_mg, self._trickle_mg = self._between_mg + self._trickle_mg, 0.0
        entering_mg = self._entering_mg(dt_s, opening_mm, vibration, in_cone_mg, rng)
        self._between_mg += entering_mg
        held_mg = min(self._prime_mg, self._between_mg)
        leaving_mg = (self._between_mg - held_mg) * -math.expm1(-dt_s / figures.transit_s)
        leaving_mg = min(leaving_mg, in_cone_mg)
        self._between_mg -= leaving_mg
        return leaving_mg

    def trickle(self, dt_s: float, in_cone_mg: float) -> float:
        """What still falls in `dt_s` of the shut valve [mg]."""
        falling_mg = min(self._trickle_mg * -math.expm1(-dt_s / self.figures.trickle_s), in_cone_mg)
        self._trickle_mg -= falling_mg
        return falling_mg

    def _shut(self, rng: Generator) -> None:
        figures = self.figures
        self._is_open = False
        if rng.random() >= ARCH_SURVIVES:
            self._arch_s = 0.0
        held_mg = min(self._prime_mg, self._between_mg)
        came = figures.trickle_mg * rng.standard_exponential() if self._between_mg > 0.0 else 0.0
        self._trickle_mg += self._between_mg - held_mg + came
        self._between_mg = held_mg

    def _entering_mg(
        self, dt_s: float, opening_mm: float, vibration: float, in_cone_mg: float, rng: Generator
    ) -> float:
        """What enters the apex from above."""
        figures = self.figures
        gap_mm = opening_mm - figures.threshold_mm
        mobility = figures.gravity + (1.0 - figures.gravity) * vibration
        if gap_mm <= 0.0 or mobility <= 0.0:
            return 0.0
        if self._prime_s > 0.0:
            self._prime_s -= dt_s * mobility
            return 0.0
        if self._arch_s > 0.0:
            self._arch_s -= dt_s * (figures.arch_creep + (1.0 - figures.arch_creep) * vibration)
            return figures.gush_mg * rng.standard_exponential() if self._arch_s <= 0.0 else 0.0
        keep = math.exp(-dt_s / figures.noise_s)
        self._noise = keep * self._noise + math.sqrt(1.0 - keep * keep) * figures.noise * rng.standard_normal()
        above_mg = in_cone_mg - self._heel_mg * (1.0 - vibration)
        head = min(1.0, max(0.0, above_mg) / HEAD_MG)
        flow = figures.flow_mg_per_s * (gap_mm / (1.0 - figures.threshold_mm)) ** figures.exponent
        entering_mg = dt_s * flow * self._load * self._opening * math.exp(self._noise) * head * mobility
        if entering_mg <= 0.0:
            return 0.0
        if opening_mm < figures.arch_mm:
            apart_mg = figures.arch_mg * (1.0 - opening_mm / figures.arch_mm) ** -CLOGGING_POWER
            if rng.random() < entering_mg / apart_mg:
                self._arch_s = min(figures.arch_s * rng.random() ** (-1.0 / figures.arch_tail), LONGEST_ARCH_S)
        return self._lumpy_mg(entering_mg, opening_mm, rng) + self._surge_mg(dt_s, rng)

    def _lumpy_mg(self, mass_mg: float, opening_mm: float, rng: Generator) -> float:
        figures = self.figures
        if figures.lump_share <= 0.0:
            return mass_mg
        lump_mg = figures.lump_mg * (opening_mm**3 if figures.lump_kind == "gap" else 1.0)
        lumps = rng.poisson(figures.lump_share * mass_mg / lump_mg)
        smooth_mg = (1.0 - figures.lump_share) * mass_mg
        if lumps == 0:
            return smooth_mg
        return smooth_mg + lump_mg * (lumps if figures.lump_kind == "one size" else rng.standard_gamma(lumps))

    def _surge_mg(self, dt_s: float, rng: Generator) -> float:
        figures = self.figures
        if figures.surge_mg <= 0.0 or rng.random() >= dt_s / figures.surge_every_s:
            return 0.0
        return figures.surge_mg * rng.uniform(0.7, 1.3)


@dataclass(frozen=True)
class BalanceFigures:
    """A balance. `delay_s` is how far the reading of a steadily growing mass is behind, whatever its kind."""

    kind: BalanceKind = "poles"
    delay_s: float = 0.6
    poles: int = 2
    damping: float = 0.6
    """Of the kind that rings."""
    patience: float = 4.0
    """Of the adaptive kind: how many times slower its filter is while little changes."""
    restless_mg: float = 10.0
    """Of the adaptive kind: so far from its reading, much changes."""
    momentum: float = 1.0
    """Share of the landing powder's momentum that is weighed."""
    noise_mg: float = 0.08
    shake_mg: float = 0.4
    """Noise that the motor adds at full level."""
    drift_mg: float = 0.1
    """Random walk of the zero, after a minute."""


class DrawnBalance:
    """A filter, a wandering zero, and noise; it has been at rest when it is first looked at.

    `later` is what it becomes `change_s` after the first powder has landed.
    """

    def __init__(
        self, figures: BalanceFigures, later: BalanceFigures | None = None, change_s: float = math.inf
    ) -> None:
        self.figures = figures
        self._later, self._change_s = later or figures, change_s
        self._since_s = 0.0  # since the first powder landed
        self._poles_mg: list[float] = []
        self._ring_mg = self._ring_mg_per_s = 0.0
        self._zero_mg = 0.0
        # Of every step since it was first looked at: its end, what was felt in it, and the integral of that until then.
        self._ends_s, self._felt_mg, self._integrals = [0.0], [0.0], [0.0]

    def step(self, dt_s: float, on_pan_mg: float, landing_mg: float, vibration: float, rng: Generator) -> float:
        if not self._poles_mg:
            self._poles_mg = [on_pan_mg] * 6
            self._ring_mg = self._felt_mg[0] = on_pan_mg
        if landing_mg > 0.0 or self._since_s > 0.0:
            self._since_s += dt_s
            if self._since_s > self._change_s:
                self.figures = self._later
        figures = self.figures
        felt_mg = on_pan_mg + landing_mg
        felt_mg += landing_mg * figures.momentum * FALL_S / dt_s if landing_mg > 0.0 else 0.0
        self._ends_s.append(self._ends_s[-1] + dt_s)
        self._felt_mg.append(felt_mg)
        self._integrals.append(self._integrals[-1] + dt_s * felt_mg)
        value_mg: float = getattr(self, f"_of_{figures.kind}")(dt_s, felt_mg)
        self._zero_mg += figures.drift_mg * math.sqrt(dt_s / 60.0) * rng.standard_normal()
        noise_mg = figures.noise_mg + figures.shake_mg * vibration
        return value_mg + self._zero_mg + noise_mg * rng.standard_normal()

    def _of_poles(self, dt_s: float, felt_mg: float) -> float:
        return self._filtered(dt_s, felt_mg, self.figures.poles, self.figures.delay_s / self.figures.poles)

    def _of_adaptive(self, dt_s: float, felt_mg: float) -> float:
        is_restless = abs(felt_mg - self._poles_mg[1]) > self.figures.restless_mg
        pole_s = self.figures.delay_s / 2.0
        return self._filtered(dt_s, felt_mg, 2, pole_s if is_restless else pole_s * self.figures.patience)

    def _of_delay(self, dt_s: float, felt_mg: float) -> float:
        delay_s = 0.9 * self.figures.delay_s
        was_mg = self._felt_mg[max(0, bisect_left(self._ends_s, self._ends_s[-1] - delay_s))]
        return self._filtered(dt_s, was_mg, 1, self.figures.delay_s - delay_s)

    def _of_mean(self, dt_s: float, felt_mg: float) -> float:
        window_s = 2.0 * self.figures.delay_s
        begin_s = self._ends_s[-1] - window_s
        index = bisect_left(self._ends_s, begin_s)
        before_mg_s = self._integrals[index] - (self._ends_s[index] - begin_s) * self._felt_mg[index]
        return (self._integrals[-1] - before_mg_s) / window_s

    def _of_ringing(self, dt_s: float, felt_mg: float) -> float:
        """x'' = w^2 (u - x) - 2 z w x', exactly for a constant u; a ramp is followed 2 z / w late."""
        damping = self.figures.damping
        own = 2.0 * damping / self.figures.delay_s
        ringing, fading = own * math.sqrt(1.0 - damping * damping), damping * own
        away_mg, speed = self._ring_mg - felt_mg, self._ring_mg_per_s
        sine, cosine = math.sin(ringing * dt_s), math.cos(ringing * dt_s)
        fade = math.exp(-fading * dt_s)
        self._ring_mg = felt_mg + fade * (away_mg * cosine + (speed + fading * away_mg) / ringing * sine)
        self._ring_mg_per_s = fade * (speed * cosine - (fading * speed + own * own * away_mg) / ringing * sine)
        return self._ring_mg

    def _filtered(self, dt_s: float, felt_mg: float, poles: int, pole_s: float) -> float:
        """A chain of equal poles, each fed with the mean of the one before it over the step."""
        step = -math.expm1(-dt_s / pole_s)
        chain = self._poles_mg
        for index in range(poles):
            before_mg = chain[index]
            chain[index] += (felt_mg - before_mg) * step
            felt_mg = (before_mg + chain[index]) / 2.0
        return chain[poles - 1]
