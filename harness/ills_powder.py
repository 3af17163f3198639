"""What can be wrong with powder, hand and people: leaks, drips, powder beside the mouth, a wrong sheet, wrong hands."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from harness.bench import Bench, Ill
from scuhand_bt.clock import Signal, Steps
from scuhand_bt.devices.interfaces import Changer
from scuhand_bt.failures import SkillFailed
from scuhand_bt.sim.mass_ledger import PAN, SPILLED, Compartment
from scuhand_bt.specs import Container, PowderFlowSpec


@dataclass
class Sheet(Ill):
    """Powder that flows otherwise than its sheet says: by a factor, and with other figures."""

    flow_factor: float = 1.0
    figures: Mapping[str, float] = field(default_factory=dict)

    def powder(self, figures: PowderFlowSpec) -> PowderFlowSpec:
        flow = figures.flow_coefficient * self.flow_factor
        return figures.model_copy(update={"flow_coefficient": flow, **self.figures})


def always(bench: Bench) -> bool:
    """At any time."""
    return True


def shaken(bench: Bench) -> bool:
    """While the arm or the motor shakes the cone."""
    return bench.is_shaken


def carried(bench: Bench) -> bool:
    """While the arm moves."""
    return bench.is_moving


def dosed(bench: Bench) -> bool:
    """Only when the dose is nearly there."""
    return "near" in bench.at


@dataclass
class Leak(Ill):
    """The shut valve lets powder through."""

    rate_mg_per_s: float
    when: Callable[[Bench], bool] = always

    def act(self, bench: Bench, dt_s: float) -> None:
        if not bench.world.is_open and self.when(bench):
            bench.drop(self.rate_mg_per_s * dt_s)


@dataclass
class Drips(Ill):
    """Lumps fall out of the shut valve now and then."""

    every_s: float
    mean_mg: float

    def act(self, bench: Bench, dt_s: float) -> None:
        if not bench.world.is_open and bench.rng.random() < dt_s / self.every_s:
            bench.drop(self.mean_mg * bench.rng.standard_exponential())


@dataclass
class Drip(Ill):
    """Powder that hung at the apex falls, once some time after a moment."""

    after: str
    mass_mg: float
    delay_s: tuple[float, float] = (0.0, 0.0)
    rate_mg_per_s: float = 20.0
    chance: float = 0.5
    _seen_s: float | None = None
    _begin_s: float = 0.0
    _left_mg: float = 0.0

    def act(self, bench: Bench, dt_s: float) -> None:
        came_s = bench.at.get(self.after)
        if came_s is not None and came_s != self._seen_s:
            self._seen_s = came_s
            if bench.rng.random() < self.chance:
                self._begin_s, self._left_mg = came_s + bench.rng.uniform(*self.delay_s), self.mass_mg
        if self._left_mg > 0.0 and bench.now_s >= self._begin_s:
            part_mg = min(self._left_mg, self.rate_mg_per_s * dt_s)
            self._left_mg -= part_mg
            bench.drop(part_mg)


@dataclass
class Astray(Ill):
    """A share of what should land in the container lands elsewhere: on the pan, or on the container's outside.

    What is on the outside goes with the container when that is lifted.
    """

    share: float
    chance: float = 1.0
    outside: bool = False
    _on: str | None = None
    _before_mg: float = 0.0
    _is_here: bool = False
    _outside_mg: float = 0.0

    def act(self, bench: Bench, dt_s: float) -> None:
        if bench.container != self._on:
            bench.move(PAN, SPILLED, self._outside_mg)
            self._on, self._before_mg, self._outside_mg = bench.container, bench.held_mg, 0.0
            self._is_here = bench.rng.random() < self.chance
        landed_mg = bench.held_mg - self._before_mg
        if self._is_here and landed_mg > 0.0:
            bench.move(bench.inside, PAN, self.share * landed_mg)
            self._outside_mg += self.share * landed_mg if self.outside else 0.0
        self._before_mg = bench.held_mg


@dataclass
class Loss(Ill):
    """Powder leaves the container: a puff of air, a knock; onto the pan, or away."""

    after: str
    masses_mg: tuple[float, float]
    delay_s: tuple[float, float] = (0.0, 0.0)
    chance: float = 0.5
    onto: Compartment = SPILLED
    _seen_s: float | None = None
    _due_s: float | None = None

    def act(self, bench: Bench, dt_s: float) -> None:
        came_s = bench.at.get(self.after)
        if came_s is not None and came_s != self._seen_s:
            self._seen_s = came_s
            here = bench.rng.random() < self.chance
            self._due_s = came_s + bench.rng.uniform(*self.delay_s) if here else None
        if self._due_s is not None and bench.now_s >= self._due_s and bench.container is not None:
            self._due_s = None
            bench.move(bench.inside, self.onto, bench.rng.uniform(*self.masses_mg))


@dataclass
class Leftover(Ill):
    """A container comes that is not empty."""

    masses_mg: tuple[float, float]
    chance: float = 0.5
    _seen_s: float | None = None

    def act(self, bench: Bench, dt_s: float) -> None:
        came_s = bench.at.get("placed")
        if came_s is not None and came_s != self._seen_s and bench.held_mg == 0.0:
            self._seen_s = came_s
            if bench.rng.random() < self.chance:
                source = next(place for place in bench.world.ledger.masses_mg if place.kind == "source")
                bench.move(source, bench.inside, bench.rng.uniform(*self.masses_mg))


class Exchanged(Ill):
    """The person who filled the changer has exchanged pairs of containers of one kind."""

    def install(self, bench: Bench) -> None:
        by_kind: dict[str, list[Container]] = {}
        for container in bench.containers:
            by_kind.setdefault(container.name, []).append(container)
        partner = {}
        for same in by_kind.values():
            for one, other in zip(same[::2], same[1::2], strict=False):
                partner[one.id], partner[other.id] = other, one
        bench.cell.changer = _ExchangingChanger(bench.cell.changer, partner)


class _ExchangingChanger:
    """A changer that brings another container than the one it is asked for."""

    def __init__(self, changer: Changer, partner: Mapping[str, Container]) -> None:
        self._changer, self._partner = changer, partner

    @property
    def needs_person(self) -> bool:
        return self._changer.needs_person

    @property
    def news(self) -> Signal:
        return self._changer.news

    @property
    def is_stopped(self) -> bool:
        return self._changer.is_stopped

    @property
    def fault(self) -> SkillFailed | None:
        return self._changer.fault

    def stop(self) -> None:
        self._changer.stop()

    def bring(self, container: Container) -> Steps[None]:
        yield from self._changer.bring(self._partner.get(container.id, container))

    def take_away(self) -> Steps[None]:
        yield from self._changer.take_away()
