"""What stands on the balance: one container at a time, put there by hand or by the carousel's swing.

A container that stood there before comes back with what it holds, and with an empty mass of its own.
"""

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np

from scuhand_bt.clock import Signal
from scuhand_bt.sim.faults import Faults
from scuhand_bt.sim.mass_ledger import FLIGHT, PAN, SPILLED, WASTE, Compartment, MassLedger, in_container
from scuhand_bt.sim.randomness import substream
from scuhand_bt.specs import Container

EMPTY_SPREAD = 0.2
"""Standard deviation of single containers' empty mass, as a share of their kind's tolerance."""
WRONG_MASS = 0.2
"""How much heavier a wrong container is, as a share; at least three tolerances."""

Known = tuple[dict[str, Any], float, float]
"""A container's fields, its empty mass [mg] and what it holds [mg]."""


class Pan:
    """The pan, and every container that has stood on it or is about to."""

    STATE: ClassVar[tuple[str, ...]] = ("container_id", "_swing", "_gone", "_strangers")
    """What the world's file keeps of it, beside the masses, and the containers in the file's log."""

    def __init__(self, ledger: MassLedger, seed: int, faults: Faults) -> None:
        self.container_id: str | None = None
        self.news = Signal()
        """Fires at the end of a swing."""
        self.log: Callable[[Known], None] = lambda known: None
        """Told of a container that comes, and again of what it holds when it goes: meanwhile only it can change."""
        self._ledger, self._seed, self._faults = ledger, seed, faults
        self._containers: dict[str, tuple[Container, float]] = {}
        self._empty_mg = 0.0
        self._inside: Compartment | None = None
        self._gone: list[str] = []  # containers that a hand has carried off, or that were knocked over
        self._strangers: list[str] = []  # containers that are not those they were
        self._swing: tuple[float, str | None] | None = None  # end of the carousel's swing [s], container it brings

    def place(self, container: Container, now_s: float) -> None:
        """Put a container on the pan, unless a hand has carried it off."""
        if self.container_id is not None:
            raise ValueError(f"'{self.container_id}' stands on the pan")
        self._know(container, now_s)
        if container.id not in self._gone:
            self._put(container.id)

    def remove(self) -> None:
        """Take the container, and what it holds, off the pan."""
        if self.container_id is not None:
            self.log(self._known(self.container_id))
        self._put(None)

    def swing(self, now_s: float, until_s: float, container: Container | None) -> None:
        """The carousel swings; at its end this container stands on the pan, or what stood there is gone."""
        if container is not None:
            self._know(container, now_s)
        self._swing = (until_s, container.id if container is not None else None)

    @property
    def is_swinging(self) -> bool:
        return self._swing is not None

    @property
    def swing_ends_s(self) -> float:
        """When the carousel's swing ends; long ago if it stands still."""
        return self._swing[0] if self._swing is not None else 0.0

    def advance(self, end_s: float) -> None:
        """End a swing that is over."""
        if self._swing is None or end_s < self._swing[0]:
            return
        (_, container_id), self._swing = self._swing, None
        if container_id is None:
            self.remove()
        else:
            self.place(self._containers[container_id][0], end_s)
        self.news.fire()

    def knock_over(self) -> None:
        """What stands here, and what the carousel brings, falls with all that it holds."""
        brought = self._swing[1] if self._swing is not None else None
        for container_id in (self.container_id, brought):
            if container_id is not None and container_id not in self._gone:
                self._gone.append(container_id)
                held_mg = self._ledger.masses_mg[in_container(container_id)]
                self._ledger.transfer(in_container(container_id), SPILLED, held_mg)
                self.log(self._known(container_id))
        self._put(None)

    # --- in an outage ---

    def end_swing(self) -> None:
        """The carousel goes home: what it was bringing is in its slot again."""
        self._swing = None

    def carry_off(self) -> None:
        """A hand takes the container away, and what it holds."""
        if self.container_id is not None:
            self._gone.append(self.container_id)
            self._exchange(*self._containers[self.container_id])
            self._put(None)

    def exchange(self, rng: np.random.Generator) -> None:
        """A hand puts an empty container of the same kind in the place of the one on the pan."""
        if self.container_id is not None:
            container, _ = self._containers[self.container_id]
            self._strangers.append(container.id)
            self._exchange(container, _empty_mass_mg(container, rng))
            self._put(self.container_id)

    @property
    def is_exchanged(self) -> bool:
        """Whether the container that stands here is not the one that is thought to."""
        return self.container_id in self._strangers

    def _exchange(self, container: Container, empty_mg: float) -> None:
        """What the container held is gone from now on, and its empty mass is this."""
        self._ledger.transfer(in_container(container.id), WASTE, self._ledger.masses_mg[in_container(container.id)])
        self._containers[container.id] = container, empty_mg
        self.log(self._known(container.id))

    # --- what the balance and the falling powder meet ---

    def gross_mg(self, landing_mg: float) -> float:
        """What the balance carries without `landing_mg` of it [mg]."""
        masses_mg = self._ledger.masses_mg
        on_pan_mg = self._empty_mg + masses_mg[PAN] - landing_mg
        return on_pan_mg if self._inside is None else on_pan_mg + masses_mg[self._inside]

    @property
    def mouth_mm(self) -> float:
        """The diameter of the container's mouth, 0 without one."""
        return self._containers[self.container_id][0].mouth_mm if self.container_id is not None else 0.0

    def land(self, mass_mg: float, density_mg_per_mm3: float) -> None:
        """Let powder from the air fall into the container's mouth; what it has no room for lies beside it."""
        if self.container_id is not None and self._inside is not None:
            into = self._inside
            capacity_mg = self._containers[self.container_id][0].capacity_mm3 * density_mg_per_mm3
            into_mg = min(mass_mg, max(0.0, capacity_mg - self._ledger.masses_mg[into]))
            self._ledger.transfer(FLIGHT, into, into_mg)
            mass_mg -= into_mg
        self._ledger.transfer(FLIGHT, PAN, mass_mg)

    # --- for the world's file ---

    def log_all(self) -> None:
        """Tell of every container again."""
        for container_id in self._containers:
            self.log(self._known(container_id))

    def recall(self, containers: list[Known]) -> None:
        """Know these containers, as they were when they last came or went."""
        for fields, empty_mg, mass_mg in containers:
            container = Container.model_validate(fields)
            self._containers[container.id] = (container, empty_mg)
            self._ledger.masses_mg[in_container(container.id)] = mass_mg
        self._put(self.container_id)

    def _known(self, container_id: str) -> Known:
        container, empty_mg = self._containers[container_id]
        return container.model_dump(), empty_mg, self._ledger.masses_mg[in_container(container_id)]

    def _know(self, container: Container, now_s: float) -> None:
        if container.id in self._containers:
            return
        rng = substream(self._seed, "container", container.id)
        wrong_mg = 0.0
        if self._faults.comes("container.wrong", now_s):
            wrong_mg = max(WRONG_MASS * container.empty_mass_mg, 3.0 * container.empty_mass_tolerance_mg)
        self._containers[container.id] = (container, _empty_mass_mg(container, rng) + wrong_mg)
        self._ledger.masses_mg[in_container(container.id)] = 0.0
        self.log(self._known(container.id))

    def _put(self, container_id: str | None) -> None:
        self.container_id = container_id
        self._inside = in_container(container_id) if container_id is not None else None
        self._empty_mg = self._containers[container_id][1] if container_id is not None else 0.0


def _empty_mass_mg(container: Container, rng: np.random.Generator) -> float:
    """One container's own empty mass, drawn."""
    spread_mg = EMPTY_SPREAD * container.empty_mass_tolerance_mg
    return max(1.0, container.empty_mass_mg + spread_mg * float(np.clip(rng.standard_normal(), -3.0, 3.0)))
