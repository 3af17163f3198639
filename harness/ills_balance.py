"""What can be wrong with a balance: forces on its pan beside its load, and what its filter makes of what it feels."""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from harness.bench import Bench, Ill
from scuhand_bt.device_specs.balance import BalanceResponseSpec

STEPS_MG = (-5.0, -3.0, -2.0, -1.0, -0.5, 0.5, 1.0, 2.0, 3.0, 5.0)
SIGNS = (-1.0, 1.0)
FOR_EVER_S = 1e9


class Figures(Ill):
    """Other figures than the cell's sheet has."""

    def __init__(self, **figures: float) -> None:
        self._figures = figures

    def balance(self, figures: BalanceResponseSpec) -> BalanceResponseSpec:
        return figures.model_copy(update=self._figures)


# --- forces ---


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


# --- filters ---


@dataclass
class MovingMean(Ill):
    """The mean of the last seconds."""

    length_s: float
    _kept: deque[tuple[float, float]] = field(default_factory=deque)
    _sum_mg_s: float = 0.0
    _sum_s: float = 0.0

    def shown_mg(self, bench: Bench, value_mg: float, dt_s: float) -> float:
        self._kept.append((dt_s, value_mg))
        self._sum_s += dt_s
        self._sum_mg_s += dt_s * value_mg
        while self._sum_s > self.length_s and len(self._kept) > 1:
            old_s, old_mg = self._kept.popleft()
            self._sum_s -= old_s
            self._sum_mg_s -= old_s * old_mg
        return self._sum_mg_s / self._sum_s


@dataclass
class Poles(Ill):
    """Two more poles of a time constant."""

    lag_s: float
    _first_mg: float | None = None
    _second_mg: float = 0.0

    def shown_mg(self, bench: Bench, value_mg: float, dt_s: float) -> float:
        if self._first_mg is None:
            self._first_mg = self._second_mg = value_mg
        share = -math.expm1(-dt_s / self.lag_s)
        self._first_mg += share * (value_mg - self._first_mg)
        self._second_mg += share * (self._first_mg - self._second_mg)
        return self._second_mg


@dataclass
class Delay(Ill):
    """What it felt some time ago."""

    delay_s: float
    _kept: deque[tuple[float, float]] = field(default_factory=deque)

    def shown_mg(self, bench: Bench, value_mg: float, dt_s: float) -> float:
        self._kept.append((bench.now_s, value_mg))
        while len(self._kept) > 1 and self._kept[1][0] <= bench.now_s - self.delay_s:
            self._kept.popleft()
        return self._kept[0][1]


@dataclass
class Ringing(Ill):
    """An underdamped second-order system."""

    frequency_hz: float
    damping: float
    _at_mg: float | None = None
    _speed: float = 0.0

    def shown_mg(self, bench: Bench, value_mg: float, dt_s: float) -> float:
        omega = math.tau * self.frequency_hz
        at_mg, parts = value_mg if self._at_mg is None else self._at_mg, max(1, math.ceil(dt_s / 0.02))
        for _ in range(parts):
            self._speed += (omega * omega * (value_mg - at_mg) - 2 * self.damping * omega * self._speed) * dt_s / parts
            at_mg += self._speed * dt_s / parts
        self._at_mg = at_mg
        return at_mg


@dataclass
class Hold(Ill):
    """An adaptive filter that holds its display: it follows for a second when it is off by a band, and holds again."""

    band_mg: float
    follow_s: float = 1.0
    _held_mg: float | None = None
    _until_s: float = -1.0

    def shown_mg(self, bench: Bench, value_mg: float, dt_s: float) -> float:
        if self._held_mg is None or abs(value_mg - self._held_mg) > self.band_mg:
            self._until_s = bench.now_s + self.follow_s
        if bench.now_s <= self._until_s or self._held_mg is None:
            self._held_mg = value_mg
        return self._held_mg


@dataclass
class Adaptive(Ill):
    """A filter that is fast while the load changes by more than a band, and slow when it is quiet."""

    band_mg: float
    slow_s: float
    fast_s: float = 0.2
    _at_mg: float | None = None

    def shown_mg(self, bench: Bench, value_mg: float, dt_s: float) -> float:
        at_mg = value_mg if self._at_mg is None else self._at_mg
        time_s = self.fast_s if abs(value_mg - at_mg) > self.band_mg else self.slow_s
        self._at_mg = at_mg - (value_mg - at_mg) * math.expm1(-dt_s / time_s)
        return self._at_mg


@dataclass
class ZeroTracking(Ill):
    """Changes within a window are taken for drift, and swallowed at a rate, at any load."""

    window_mg: float
    rate_mg_per_s: float
    _held_mg: float | None = None
    _swallowed_mg: float = 0.0

    def shown_mg(self, bench: Bench, value_mg: float, dt_s: float) -> float:
        value_mg -= self._swallowed_mg
        if self._held_mg is None:
            self._held_mg = value_mg
        off_mg = value_mg - self._held_mg
        if abs(off_mg) > self.window_mg:
            self._held_mg = value_mg
            return value_mg
        most_mg = self.rate_mg_per_s * dt_s
        self._swallowed_mg += max(-most_mg, min(most_mg, off_mg))
        return value_mg


@dataclass
class Coarse(Ill):
    """It shows more digits than it has."""

    step_mg: float

    def shown_mg(self, bench: Bench, value_mg: float, dt_s: float) -> float:
        return round(value_mg / self.step_mg) * self.step_mg


@dataclass
class Frozen(Ill):
    """From some time after a moment on, it shows what it showed; for a while, for ever, or until the load is lifted."""

    after: str
    delay_s: tuple[float, float]
    for_s: tuple[float, float] = (FOR_EVER_S, FOR_EVER_S)
    chance: float = 0.5
    until_lifted: bool = False
    _seen_s: float | None = None
    _begin_s: float = math.inf
    _end_s: float = -1.0
    _shown_mg: float | None = None
    _on: str | None = None

    def shown_mg(self, bench: Bench, value_mg: float, dt_s: float) -> float:
        came_s = bench.at.get(self.after)
        if came_s is not None and came_s != self._seen_s and self._shown_mg is None:
            self._seen_s = came_s
            if bench.rng.random() < self.chance:
                self._begin_s = came_s + bench.rng.uniform(*self.delay_s)
                self._end_s = self._begin_s + (
                    self.for_s[0] if self.for_s[0] == math.inf else bench.rng.uniform(*self.for_s)
                )
        is_frozen = self._begin_s <= bench.now_s < self._end_s
        if is_frozen and self._shown_mg is None:
            self._shown_mg, self._on = value_mg, bench.container
        if self.until_lifted and is_frozen and bench.container != self._on:
            is_frozen, self._begin_s = False, math.inf
        if not is_frozen:
            self._shown_mg = None
        return value_mg if self._shown_mg is None else self._shown_mg


class Later(Ill):
    """A filter that is switched on in mid-run, at a random time: somebody, or the balance itself, changes its menu."""

    def __init__(self, ill: Ill, between_s: tuple[float, float]) -> None:
        self._ill, self._between_s, self._from_s = ill, between_s, -1.0

    def shown_mg(self, bench: Bench, value_mg: float, dt_s: float) -> float:
        if self._from_s < 0.0:
            self._from_s = bench.rng.uniform(*self._between_s)
        return self._ill.shown_mg(bench, value_mg, dt_s) if bench.now_s >= self._from_s else value_mg


@dataclass
class FromContainer(Ill):
    """A filter that is switched on while the pan is bare: somebody changes the balance's menu between two samples."""

    ill: Ill
    number: int
    """Of the first container that is weighed with it, from 1."""
    _containers: int = 0
    _on: str | None = None

    def shown_mg(self, bench: Bench, value_mg: float, dt_s: float) -> float:
        if bench.container != self._on:
            self._on = bench.container
            self._containers += self._on is not None
        return value_mg if self._containers < self.number else self.ill.shown_mg(bench, value_mg, dt_s)
