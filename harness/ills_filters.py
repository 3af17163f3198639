"""What a balance makes of what it feels: other figures than its sheet has, and filters that show something else."""

import math
from collections import deque
from dataclasses import dataclass, field

from harness.bench import Bench, Ill
from scuhand_bt.device_specs.balance import BalanceResponseSpec

FOR_EVER_S = 1e9


class Figures(Ill):
    """Other figures than the cell's sheet has."""

    def __init__(self, **figures: float) -> None:
        self._figures = figures

    def balance(self, figures: BalanceResponseSpec) -> BalanceResponseSpec:
        return figures.model_copy(update=self._figures)


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
