"""What pushes at a balance's pan beside its load."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from harness.bench import Bench, Ill

STEPS_MG = (-5.0, -3.0, -2.0, -1.0, -0.5, 0.5, 1.0, 2.0, 3.0, 5.0)
SIGNS = (-1.0, 1.0)


@dataclass
class Step(Ill):
    """The zero jumps by one of `sizes_mg`, some time after a moment of a container; back again after `back_s`."""

    after: str
    delay_s: tuple[float, float] = (0.0, 0.0)
    sizes_mg: Sequence[float] = STEPS_MG
    back_s: tuple[float, float] | None = None
    chance: float = 1.0
    """Of one, for each container."""
    _seen_s: float | None = None
    _due: list[tuple[float, float]] = field(default_factory=list)
    _zero_mg: float = 0.0

    def force_mg(self, bench: Bench, dt_s: float) -> float:
        came_s = bench.at.get(self.after)
        if came_s is not None and came_s != self._seen_s:
            self._seen_s = came_s
            if self.chance < 1.0 and bench.rng.random() >= self.chance:
                return self._zero_mg
            at_s, size_mg = came_s + bench.rng.uniform(*self.delay_s), float(bench.rng.choice(self.sizes_mg))
            self._due.append((at_s, size_mg))
            if self.back_s is not None:
                self._due.append((at_s + bench.rng.uniform(*self.back_s), -size_mg))
        if self._due:
            self._zero_mg += sum(size_mg for at_s, size_mg in self._due if at_s <= bench.now_s)
            self._due = [due for due in self._due if due[0] > bench.now_s]
        return self._zero_mg


@dataclass
class Between(Ill):
    """Something pushes from one moment of a container until so long after another, and not a milligram stays."""

    first: str
    last: str
    sizes_mg: Sequence[float] = (-3.0, 3.0)
    later_s: float = 0.0
    _seen_s: float | None = None
    _size_mg: float = 0.0
    _until_s: float = 0.0

    def force_mg(self, bench: Bench, dt_s: float) -> float:
        came_s = bench.at.get(self.first)
        if came_s is not None and came_s != self._seen_s and self.last not in bench.at:
            self._seen_s, self._size_mg, self._until_s = came_s, float(bench.rng.choice(self.sizes_mg)), math.inf
        if self.last in bench.at:
            self._until_s = min(self._until_s, bench.at[self.last] + self.later_s)
        return self._size_mg if bench.now_s < self._until_s else 0.0


@dataclass
class Drift(Ill):
    """The zero wanders at a rate, of either sign; it turns round every `turns_s`."""

    rate_mg_per_s: float
    turns_s: float = math.inf
    _sign: float = 0.0
    _zero_mg: float = 0.0
    _turn_s: float = math.inf

    def force_mg(self, bench: Bench, dt_s: float) -> float:
        if self._sign == 0.0:
            self._sign, self._turn_s = float(bench.rng.choice(SIGNS)), bench.now_s + self.turns_s
        if bench.now_s >= self._turn_s:
            self._sign, self._turn_s = -self._sign, bench.now_s + self.turns_s * bench.rng.uniform(0.5, 1.5)
        self._zero_mg += self._sign * self.rate_mg_per_s * dt_s
        return self._zero_mg


@dataclass
class Walk(Ill):
    """The zero walks at random, by so much in the square root of a second."""

    spread_mg: float
    _zero_mg: float = 0.0

    def force_mg(self, bench: Bench, dt_s: float) -> float:
        self._zero_mg += self.spread_mg * math.sqrt(dt_s) * bench.rng.standard_normal()
        return self._zero_mg


@dataclass
class Creep(Ill):
    """From a container's first opening on, a force grows to its size; it goes with the container."""

    sizes_mg: tuple[float, float]
    time_s: float
    _seen_s: float | None = None
    _size_mg: float = 0.0

    def force_mg(self, bench: Bench, dt_s: float) -> float:
        came_s = bench.at.get("opened")
        if came_s is None:
            return 0.0
        if came_s != self._seen_s:
            self._seen_s, self._size_mg = came_s, float(bench.rng.choice(SIGNS)) * bench.rng.uniform(*self.sizes_mg)
        return self._size_mg * -math.expm1(-(bench.now_s - came_s) / self.time_s)


@dataclass
class Sine(Ill):
    """The zero swings."""

    amplitude_mg: float
    period_s: float

    def force_mg(self, bench: Bench, dt_s: float) -> float:
        return self.amplitude_mg * math.sin(math.tau * bench.now_s / self.period_s)


@dataclass
class Decay(Ill):
    """Each container comes with a force that decays: warm (its air rises), cold, or charged.

    With `lasting` it grows to its size instead, and decays when the container has gone: creep under load.
    """

    sizes_mg: tuple[float, float]
    times_s: tuple[float, float]
    lasting: bool = False
    _seen: tuple[str, float] | None = None
    _size_mg: float = 0.0
    _time_s: float = 1.0
    _left_mg: float = 0.0

    def force_mg(self, bench: Bench, dt_s: float) -> float:
        moment = "placed" if "placed" in bench.at else "bare"
        if (moment, bench.at[moment]) != self._seen:
            self._seen, self._left_mg = (moment, bench.at[moment]), self._last_mg(bench)
            if moment == "placed":
                self._size_mg = float(bench.rng.choice(SIGNS)) * bench.rng.uniform(*self.sizes_mg)
                self._time_s = bench.rng.uniform(*self.times_s)
        left = math.exp(-(bench.now_s - bench.at[moment]) / self._time_s)
        if moment == "bare":
            return self._left_mg * left if self.lasting else 0.0
        return self._size_mg * ((1.0 - left) if self.lasting else left)

    def _last_mg(self, bench: Bench) -> float:
        if self._seen is None or self._seen[0] == "bare":
            return 0.0
        return self._size_mg * -math.expm1(-(bench.now_s - self._seen[1]) / self._time_s)


@dataclass
class HandForce(Ill):
    """A charge pulls at the pan while the hand is above it; it leaks away within `time_s` of the container's coming."""

    size_mg: float
    time_s: float = math.inf
    _sign: float = 0.0

    def force_mg(self, bench: Bench, dt_s: float) -> float:
        self._sign = self._sign or float(bench.rng.choice(SIGNS))
        if not bench.is_over:
            return 0.0
        return self._sign * self.size_mg * math.exp(-(bench.now_s - bench.at.get("placed", bench.now_s)) / self.time_s)


@dataclass
class PowderForce(Ill):
    """The powder brings charge with it: while the hand is above, the dose weighs up to `size_mg` too little or much."""

    size_mg: float
    _sign: float = 0.0

    def force_mg(self, bench: Bench, dt_s: float) -> float:
        self._sign = self._sign or float(bench.rng.choice(SIGNS))
        return self._sign * self.size_mg * min(1.0, bench.held_mg / bench.target_mg) if bench.is_over else 0.0


@dataclass
class Draught(Ill):
    """Bursts of moving air: a push that changes within the second, some seconds long."""

    size_mg: float
    every_s: float
    lasts_s: tuple[float, float] = (2.0, 12.0)
    lean: float = 0.0
    """Share of a burst's push that does not change."""
    _until_s: float = -1.0
    _next_s: float = -1.0
    _push_mg: float = 0.0
    _lean_mg: float = 0.0

    def force_mg(self, bench: Bench, dt_s: float) -> float:
        if self._next_s < 0.0 or bench.now_s >= self._next_s:
            if self._next_s >= 0.0:
                self._until_s = bench.now_s + bench.rng.uniform(*self.lasts_s)
                self._lean_mg = self.lean * self.size_mg * float(bench.rng.choice(SIGNS))
            self._next_s = max(bench.now_s, self._until_s) + bench.rng.exponential(self.every_s)
        if bench.now_s >= self._until_s:
            return 0.0
        keep = math.exp(-dt_s / 0.3)
        spread_mg = (1.0 - self.lean) * self.size_mg * math.sqrt(1.0 - keep * keep)
        self._push_mg = keep * self._push_mg + spread_mg * bench.rng.standard_normal()
        return self._push_mg + self._lean_mg


@dataclass
class Span(Ill):
    """Powder weighs more or less by a share, drawn for each container: where it stands on the pan, or a wrong span."""

    spread: float = 0.0
    share: float = 0.0
    _seen_s: float | None = None
    _drawn: float = 0.0

    def force_mg(self, bench: Bench, dt_s: float) -> float:
        if bench.at.get("placed") != self._seen_s:
            self._seen_s = bench.at.get("placed")
            self._drawn = self.share + self.spread * bench.rng.standard_normal()
        return self._drawn * bench.held_mg
