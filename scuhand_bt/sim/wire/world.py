"""The world behind twins: it runs in real time, and is kept in a file with them."""

import threading
from collections.abc import Mapping, Sequence

from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.sim.balance import SimulatedBalance
from scuhand_bt.sim.faults import Faults
from scuhand_bt.sim.mass_ledger import Compartment
from scuhand_bt.sim.plant import Plant
from scuhand_bt.sim.snapshot import Stateful
from scuhand_bt.sim.wire.shafts import WireArm, WireHand
from scuhand_bt.sim.world import World
from scuhand_bt.specs import Container, Source

UNSAVED_S = 0.5
"""Time between two saves of a world in which no powder moves."""


class WireWorld(World):
    """A world that runs in a thread of its own, while calls from another thread act on it.

    It may be kept in a file with its twins. However its process ends, the next one resumes devices and powder as if
    time had stood still.
    """

    def __init__(
        self,
        spec: CellSpec,
        sources: Mapping[str, Source],
        plant: Plant,
        seed: int,
        arm: WireArm,
        hand: WireHand,
        balance: SimulatedBalance,
        faults: Faults | None = None,
    ) -> None:
        self._lock = threading.RLock()
        self._saved_mg: dict[Compartment, float] = {}
        self._saved_s = 0.0
        super().__init__(spec, sources, plant, seed, arm, hand, balance, faults)

    @property
    def masses_mg(self) -> dict[str, float]:
        with self._lock:
            return super().masses_mg

    def lives_with(self, twins: Sequence[Stateful]) -> None:
        """Keep the state of these twins, too."""
        self._memory.add(twins)

    def save_changes(self) -> None:
        """Save the world if powder has moved since the last save, or `UNSAVED_S` have passed."""
        with self._lock:
            if self.ledger.masses_mg != self._saved_mg or self.now_s - self._saved_s >= UNSAVED_S:
                self.save()

    def save(self) -> None:
        with self._lock:
            super().save()
            self._saved_mg, self._saved_s = dict(self.ledger.masses_mg), self.now_s

    def _sit_out(self) -> None:
        """Does nothing: time stands still for twins between two processes."""

    def step(self, now_s: float, limit_s: float) -> float:
        with self._lock:
            return super().step(now_s, limit_s)

    def begin_sample(self, sample: str, attempt: int) -> None:
        with self._lock:
            super().begin_sample(sample, attempt)

    def place(self, container: Container) -> None:
        with self._lock:
            super().place(container)
            self.save()

    def remove(self) -> None:
        with self._lock:
            super().remove()
            self.save()

    def swing(self, until_s: float, container: Container | None) -> None:
        with self._lock:
            super().swing(until_s, container)

    def load_cone(self, source: str, mass_mg: float) -> None:
        with self._lock:
            super().load_cone(source, mass_mg)
            self.save()

    def refill(self, source: str, mass_mg: float) -> None:
        with self._lock:
            super().refill(source, mass_mg)
            self.save()

    def swap_sheet(self) -> None:
        with self._lock:
            super().swap_sheet()
            self.save()
