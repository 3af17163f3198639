"""What stands on the balance: one container at a time, put there by hand or by the carousel's swing.

A container that comes back still has its content and its own empty mass.
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
"""A container's fields, its empty mass [mg] and its content [mg]."""


class Pan:
    """The pan, and every container that has stood on it or is about to."""

    STATE: ClassVar[tuple[str, ...]] = ("container_id", "_swing", "_gone", "_strangers")
    """The attributes that the world's file keeps, beside the masses, and the containers in the file's log."""

    def __init__(self, ledger: MassLedger, seed: int, faults: Faults) -> None:
        self.container_id: str | None = None
        self.news = Signal()
        """Fires at the end of a swing."""
        self.log: Callable[[Known], None] = lambda known: None
        """Called for a container that comes, and again when it goes; its content can change only in between."""
        self._ledger, self._seed, self._faults = ledger, seed, faults
        self._containers: dict[str, tuple[Container, float]] = {}
        self._empty_mg = 0.0
        self._inside: Compartment | None = None
        self._gone: list[str] = []  # containers that somebody carried off, or that were knocked over
        self._strangers: list[str] = []  # containers that were exchanged for others
        self._swing: tuple[float, str | None] | None = None  # end of the carousel's swing [s], container it brings

    def place(self, container: Container, now_s: float) -> None:
        """Put a container on the pan, unless somebody has carried it off."""
        if self.container_id is not None:
            raise ValueError(f"'{self.container_id}' stands on the pan")
        self._know(container, now_s)
        if container.id not in self._gone:
            self._put(container.id)

    def remove(self) -> None:
        """Take the container with its content off the pan."""
        if self.container_id is not None:
            self.log(self._known(self.container_id))
        self._put(None)

    def swing(self, now_s: float, until_s: float, container: Container | None) -> None:
        """Start a swing of the carousel; at its end this container stands on the pan, or the pan is clear."""
        if container is not None:
            self._know(container, now_s)
        self._swing = (until_s, container.id if container is not None else None)

    @property
    def is_swinging(self) -> bool:
        return self._swing is not None

    @property
    def swing_ends_s(self) -> float:
        """The end of the carousel's swing; 0 if it stands still."""
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
        """The container on the pan, and the one the carousel brings, fall with their content."""
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
        """The carousel goes home: the container it was bringing is in its slot again."""
        self._swing = None

    def carry_off(self) -> None:
        """Somebody takes the container away with its content."""
        if self.container_id is not None:
            self._gone.append(self.container_id)
            self._exchange(*self._containers[self.container_id])
            self._put(None)

    def exchange(self, rng: np.random.Generator) -> None:
        """Somebody exchanges the container on the pan for an empty one of the same kind."""
        if self.container_id is not None:
            container, _ = self._containers[self.container_id]
            self._strangers.append(container.id)
            self._exchange(container, _empty_mass_mg(container, rng))
            self._put(self.container_id)

    @property
    def is_exchanged(self) -> bool:
        """Whether the container on the pan is not the one that the run knows."""
        return self.container_id in self._strangers

    def _exchange(self, container: Container, empty_mg: float) -> None:
        """The container's content is gone from now on, and this is its empty mass."""
        self._ledger.transfer(in_container(container.id), WASTE, self._ledger.masses_mg[in_container(container.id)])
        self._containers[container.id] = container, empty_mg
        self.log(self._known(container.id))

    # --- what the balance and the falling powder meet ---

    def gross_mg(self, landing_mg: float) -> float:
        """The load on the balance [mg], without `landing_mg` of it."""
        masses_mg = self._ledger.masses_mg
        on_pan_mg = self._empty_mg + masses_mg[PAN] - landing_mg
        return on_pan_mg if self._inside is None else on_pan_mg + masses_mg[self._inside]

    @property
    def mouth_mm(self) -> float:
        """The diameter of the container's mouth, 0 without one."""
        return self._containers[self.container_id][0].mouth_mm if self.container_id is not None else 0.0

    def land(self, mass_mg: float, density_mg_per_mm3: float) -> None:
        """Land powder from the air in the container; what exceeds its capacity lies on the pan."""
        if self.container_id is not None and self._inside is not None:
            into = self._inside
            capacity_mg = self._containers[self.container_id][0].capacity_mm3 * density_mg_per_mm3
            into_mg = min(mass_mg, max(0.0, capacity_mg - self._ledger.masses_mg[into]))
            self._ledger.transfer(FLIGHT, into, into_mg)
            mass_mg -= into_mg
        self._ledger.transfer(FLIGHT, PAN, mass_mg)

    # --- for the world's file ---

    def log_all(self) -> None:
        """Log every container again."""
        for container_id in self._containers:
            self.log(self._known(container_id))

    def recall(self, containers: list[Known]) -> None:
        """Restore these containers as they were last logged."""
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
    """One container's own empty mass, drawn at random."""
    spread_mg = EMPTY_SPREAD * container.empty_mass_tolerance_mg
    return max(1.0, container.empty_mass_mg + spread_mg * float(np.clip(rng.standard_normal(), -3.0, 3.0)))
