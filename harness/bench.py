"""What a hostile world sees of one dry run, and through what it acts: the plant's seams, and the clock's process.

Nothing here reads a skill, a journal or a belief: moments are told from where the arm, the valve and the powder are.
"""

import math
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from scuhand_bt.cell.cell import Cell
from scuhand_bt.device_specs.balance import BalanceResponseSpec, BalanceSpec
from scuhand_bt.run.clock import VirtualClock
from scuhand_bt.run.session import Session
from scuhand_bt.sim.arm import SimulatedArm
from scuhand_bt.sim.hand import SimulatedHand
from scuhand_bt.sim.mass_ledger import CONE, Compartment, in_container
from scuhand_bt.sim.powder import OurPowderFlow
from scuhand_bt.sim.response import OurBalanceResponse
from scuhand_bt.sim.world import World
from scuhand_bt.specs import Container, Powder, PowderFlowSpec

if TYPE_CHECKING:
    from numpy.random import Generator

OVER_PAN_MM = 60.0
"""The hand is over the pan when its apex is no farther than this from the pan's middle."""
NEAR_MG = 10.0
"""A dose is near its end when so much is missing, or half of it."""
MOMENTS = ("bare", "placed", "scooping", "over", "opened", "shut", "near", "leaving", "gone")
"""In the order they come: the pan is bare; a container comes; for the first time since then the cone closes in a
mortar, rests over the pan, opens; it shuts (each time anew); the container is nearly full; and from then on the hand
begins to leave, and is away from the pan."""


class Ill:
    """One thing that is wrong in a world; an object of one run. What it does not override is sound."""

    def powder(self, figures: PowderFlowSpec) -> PowderFlowSpec:
        """How the powder is, which the lab's sheet does not say."""
        return figures

    def balance(self, figures: BalanceResponseSpec) -> BalanceResponseSpec:
        """How the balance is, which the cell's sheet does not say."""
        return figures

    def install(self, bench: "Bench") -> None:
        """Before the run."""

    def force_mg(self, bench: "Bench", dt_s: float) -> float:
        """What pushes on the pan beside its load."""
        return 0.0

    def shown_mg(self, bench: "Bench", value_mg: float, dt_s: float) -> float:
        """What the balance makes of what it feels."""
        return value_mg

    def act(self, bench: "Bench", dt_s: float) -> None:
        """Do something with the powder, after a step of the world."""


class Bench:
    """One run, as its ills see it. It stands between the virtual clock and the simulated world."""

    def __init__(self, ills: list[Ill], rng: "Generator") -> None:
        self.ills, self.rng = ills, rng
        self.now_s = 0.0
        self.container: str | None = None
        """What stands on the pan."""
        self.at: dict[str, float] = {}
        """When the moments came [s], of this container; see `MOMENTS`."""
        self.is_over = False
        """The hand is over the pan."""
        self.is_moving = False
        """The arm moves."""
        self.is_attached = False
        self.containers: list[Container] = []
        """All that the recipe names."""
        self._targets_mg: dict[str, float] = {}
        self.world: World
        self.cell: Cell
        self._was_open = self._is_placed = False

    def attach(self, session: Session) -> None:
        """Take this session's world over; before it runs."""
        assert session.world is not None
        self.world, self.cell = session.world, session.cell
        assert isinstance(self.cell.arm, SimulatedArm)
        assert isinstance(self.cell.hand, SimulatedHand)
        assert isinstance(self.cell.clock, VirtualClock)
        self._arm, self._hand = self.cell.arm, self.cell.hand
        self._pan_mm = session.cell.spec.station_of_kind("balance").position_mm
        for sample in session.plan.recipe.samples:
            if sample.container is not None and sample.mass_mg is not None:
                self.containers.append(sample.container)
                self._targets_mg[sample.container.id] = sample.mass_mg
        self.cell.clock.process = self
        for ill in self.ills:
            ill.install(self)
        self.is_attached = True
        self._look()

    @property
    def held_mg(self) -> float:
        """What is in the container on the pan."""
        return self.world.true_mass(self.container) if self.container is not None else 0.0

    @property
    def target_mg(self) -> float:
        """What is to come into it; of a second attempt's container too."""
        name = self.container or ""
        return self._targets_mg.get(name, self._targets_mg.get(name.rpartition(".")[0], math.inf))

    @property
    def is_shaken(self) -> bool:
        """The cone is: by the arm, or by its motor."""
        return self.is_moving or self._hand.felt_vibration > 0.0

    def drop(self, mass_mg: float) -> None:
        """Let so much fall from the cone, if it has it, valve or no valve."""
        self.world.load.drop(self.now_s, min(mass_mg, self.world.ledger.masses_mg[CONE]))

    def move(self, source: Compartment, target: Compartment, mass_mg: float) -> None:
        """Move so much powder, or what there is, from one place of the world to another."""
        ledger = self.world.ledger
        ledger.transfer(source, target, max(0.0, min(mass_mg, ledger.masses_mg[source])))

    @property
    def inside(self) -> Compartment:
        """The inside of the container on the pan."""
        assert self.container is not None
        return in_container(self.container)

    # --- what the virtual clock calls ---

    def step(self, now_s: float, limit_s: float) -> float:
        """One step of the world, and of what is wrong in it."""
        end_s = self.world.step(now_s, limit_s)
        self.now_s = end_s
        self._look()
        for ill in self.ills:
            ill.act(self, end_s - now_s)
        return end_s

    def save(self) -> None:
        self.world.save()

    def _look(self) -> None:
        at, now_s = self.at, self.now_s
        if self.world.pan.container_id != self.container or not at:
            self.container = self.world.pan.container_id
            self.at = at = {"bare" if self.container is None else "placed": now_s}
        was_moving, self.is_moving = self.is_moving, self._arm.is_active
        if self.is_moving or was_moving or not self._is_placed:
            self._is_placed = True
            x_m, y_m, _ = self._arm.pose(now_s).position_m
            self.is_over = math.hypot(1000 * x_m - self._pan_mm[0], 1000 * y_m - self._pan_mm[1]) <= OVER_PAN_MM
        if self.container is None:
            return
        if self._hand.is_closing:
            at.setdefault("scooping", now_s)
        if self.is_over and not self.is_moving:
            at.setdefault("over", now_s)
        is_open = self.world.is_open
        if is_open:
            at.setdefault("opened", now_s)
        if self._was_open and not is_open:
            at["shut"] = now_s
        self._was_open = is_open
        if "opened" in at and self.held_mg >= self.target_mg - min(NEAR_MG, self.target_mg / 2):
            at.setdefault("near", now_s)
        if "near" in at and not is_open and self.is_moving and self.is_over:
            at.setdefault("leaving", now_s)
        if "leaving" in at and not self.is_over:
            at.setdefault("gone", now_s)


class Response:
    """The balance of a hostile world: ours, with what its ills push on the pan and do to the display."""

    def __init__(self, bench: Bench, spec: BalanceSpec) -> None:
        figures = spec.simulation
        for ill in bench.ills:
            figures = ill.balance(figures)
        self._bench = bench
        self._sound = OurBalanceResponse(spec.model_copy(update={"simulation": figures}))

    def step(self, dt_s: float, on_pan_mg: float, landing_mg: float, vibration: float, rng: "Generator") -> float:
        bench = self._bench
        if not bench.is_attached:
            return self._sound.step(dt_s, on_pan_mg, landing_mg, vibration, rng)
        force_mg = sum(ill.force_mg(bench, dt_s) for ill in bench.ills)
        value_mg = self._sound.step(dt_s, on_pan_mg + force_mg, landing_mg, vibration, rng)
        for ill in bench.ills:
            value_mg = ill.shown_mg(bench, value_mg, dt_s)
        return value_mg


class HostilePlant:
    """The physics of the bench that is `at_hand` when a cell is made: `--plant harness.bench:HostilePlant`."""

    at_hand: ClassVar[Bench] = Bench([], np.random.default_rng(0))

    def __init__(self) -> None:
        self._bench = self.at_hand

    def balance(self, spec: BalanceSpec) -> Response:
        return Response(self._bench, spec)

    def flow(self, powder: Powder) -> OurPowderFlow:
        figures = powder.simulation
        for ill in self._bench.ills:
            figures = ill.powder(figures)
        return OurPowderFlow(powder.model_copy(update={"simulation": figures}))
