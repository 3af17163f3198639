"""The simulated world: its powder, what stands on the pan and what the cone holds, step by step.

The powder reacts to the state of the devices only, never to commands. A step is at most 20 ms while anything moves,
else it goes to the balance's next reading.

A world may be kept in a file (`keep_in`, `save`), from which another process resumes it (`restore`), some seconds of
world time after the first process was killed. By then the devices, which nobody spoke to, have come to rest.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.sim.arm import SimulatedArm
from scuhand_bt.sim.balance import SimulatedBalance
from scuhand_bt.sim.cone_load import ConeLoad
from scuhand_bt.sim.cone_over import ConePose
from scuhand_bt.sim.faults import Faults
from scuhand_bt.sim.hand import DEAD_MAN_S, SimulatedHand
from scuhand_bt.sim.mass_ledger import CONE, Compartment, MassLedger, in_container, in_source
from scuhand_bt.sim.mortars import Mortars
from scuhand_bt.sim.outage import PowerCut
from scuhand_bt.sim.pan import Pan
from scuhand_bt.sim.plant import Plant
from scuhand_bt.sim.randomness import substream
from scuhand_bt.sim.snapshot import Memory, look_into
from scuhand_bt.sim.sweep import Sweep
from scuhand_bt.sim.under_the_cone import Surroundings
from scuhand_bt.specs import Container, Source

STEP_S = 0.020
SERVO_WATCHDOG_S = 0.1
"""After this silence the arm's servos and the roller stand still."""
OUTAGE_S = 2.0
"""The least time that passes in the world between a killed program's last command and the next program's first."""
LONGEST_OUTAGE_S = 10.0
"""The most time that passes: a valve that is stuck open never comes to rest."""


def masses_in(path: Path) -> dict[str, float]:
    """The masses [mg] by compartment, as `World.masses_mg`, of the world in a file, even if another process has it.

    Raises SourceError as `World.restore` does.
    """
    (_, _, masses_mg), containers = look_into(path)
    found: dict[str, float] = {str(in_container(fields["id"])): held_mg for fields, _, held_mg in containers}
    found.update(masses_mg)
    return found


class World:
    """One bench's powder. The virtual clock calls `step` and `save`."""

    def __init__(
        self,
        spec: CellSpec,
        sources: Mapping[str, Source],
        plant: Plant,
        seed: int,
        arm: SimulatedArm,
        hand: SimulatedHand,
        balance: SimulatedBalance,
        faults: Faults | None = None,
    ) -> None:
        self.faults = arm.faults = hand.faults = balance.faults = faults or Faults()
        self.now_s = 0.0
        """The time it has advanced to."""
        self.ledger = MassLedger(sources, [station.name for station in spec.vessels])
        self.pan = Pan(self.ledger, seed, self.faults)
        mortars = Mortars(spec, sources, plant, self.ledger)
        around = Surroundings(spec, sources)
        self.load = ConeLoad(self.ledger, self.pan, around, sources, plant, mortars, arm, hand, self.faults)
        self._sweep = Sweep(spec)
        self._seed = seed
        self._arm, self._hand, self._balance = arm, hand, balance
        self._compartments = tuple((str(compartment), compartment) for compartment in self.ledger.masses_mg)
        self._memory = Memory(
            (self.pan, self.load, mortars, hand, balance, *([self.faults] if self.faults.rules else [])), plant.name
        )
        self.pan.log = self._memory.log
        self.begin_sample("", 0)

    # --- for judging, never for skills ---

    @property
    def masses_mg(self) -> dict[str, float]:
        """The mass in every compartment [mg], by its text (`scuhand_bt.sim.mass_ledger`)."""
        return {str(compartment): mass_mg for compartment, mass_mg in self.ledger.masses_mg.items()}

    def true_mass(self, container_id: str) -> float:
        """The mass in this container [mg]."""
        return self.ledger.masses_mg.get(in_container(container_id), 0.0)

    @property
    def is_open(self) -> bool:
        """Whether the valve is really open, whatever it reports."""
        return self._hand.gap_mm > 0.0

    @property
    def fault_account(self) -> list[dict[str, Any]]:
        """The fault of each rule, and when it began [s]."""
        return self.faults.account()

    # --- hands that act beside the robot ---

    def begin_sample(self, sample: str, attempt: int) -> None:
        """Draw from the streams of this sample and attempt from now on."""

        def stream(device: str) -> np.random.Generator:
            return substream(self._seed, sample, attempt, device)

        self.load.use_randomness(stream("flow"), stream("scoop"))
        self.faults.begin_sample(sample, attempt, self.now_s)
        self._hand.use_randomness(stream("hand"))
        self._balance.use_randomness(stream("balance"))

    def place(self, container: Container) -> None:
        """Put a container on the pan; one that stood there before still has its content."""
        self.pan.place(container, self.now_s)

    def remove(self) -> None:
        """Take the container with its content off the pan."""
        self.pan.remove()

    def swing(self, until_s: float, container: Container | None) -> None:
        """Start a swing of the carousel; at its end this container stands on the pan, or the pan is clear."""
        self.pan.swing(self.now_s, until_s, container)

    def load_cone(self, source: str, mass_mg: float) -> None:
        """Put powder of a source into the cone by hand, as the paper's experiments did."""
        self.ledger.transfer(in_source(source), CONE, mass_mg)
        self.load.begin(source)

    def swap_sheet(self) -> None:
        """Mount a new sheet; the powder on the old one and in the cone is thrown away."""
        self.load.throw_away()
        self._hand.rim_is(self._hand.spec.options.start_diameter_mm)

    def refill(self, source: str, mass_mg: float) -> None:
        """Add powder to the mortar of a source. Raises ValueError as `MassLedger.refill` does."""
        self.ledger.refill(source, mass_mg)

    # --- time ---

    def step(self, now_s: float, limit_s: float) -> float:
        """Advance by one step, not past `limit_s`; returns the new time."""
        hand, arm, balance, load = self._hand, self._arm, self._balance, self.load
        self.faults.advance(now_s)
        end_s = balance.next_reading_s
        if end_s > now_s + STEP_S + 1e-6 and (hand.is_active or arm.is_active or load.is_falling):
            end_s = now_s + STEP_S
        end_s = min(end_s, limit_s)
        dt_s = end_s - now_s
        if dt_s <= 0.0:
            return end_s
        opening_mm = hand.advance(end_s, dt_s)
        arm.advance(end_s)
        if self.pan.is_swinging:
            self._swing_on(end_s)
        landing_mg = load.advance(end_s, dt_s, opening_mm)
        balance.advance(end_s, dt_s, self.pan.gross_mg(landing_mg), landing_mg, hand.felt_vibration)
        self.now_s = end_s
        self.pan.advance(end_s)
        return end_s

    def _swing_on(self, now_s: float) -> None:
        """The carousel swings; if the cone is in its way, the containers fall."""
        at, hand = self._arm.pose(now_s), self._hand
        cone = ConePose(1000.0 * at.position_m, at.axis, hand.cone_diameter_mm, hand.spec.sheet_radius_mm)
        if self._sweep.meets(cone):
            self.pan.knock_over()

    # --- outliving the program ---

    def keep_in(self, path: Path, tell: Callable[[str], None]) -> None:
        """Keep the world in a new file from now on. If saving fails later, `tell` is called once with the reason."""
        self._memory.begin(path, tell)
        self.pan.log_all()
        self.save()

    def restore(self, path: Path, tell: Callable[[str], None]) -> float:
        """Resume the world of a file, as it is after the outage, and keep it there. Returns the time then [s].

        Raises SourceError for a file that is missing, damaged, or of a world that could not be saved.
        """
        (self.now_s, joints, masses_mg), containers = self._memory.take_up(path, tell)
        self.pan.recall(containers)
        self.ledger.masses_mg.update({Compartment.of_text(text): mass_mg for text, mass_mg in masses_mg.items()})
        self._arm.hold(joints)
        self._sit_out()
        self.save()
        return self.now_s

    def save(self) -> None:
        """Save the world in its file, if it has one."""
        if not self._memory.is_kept:
            return
        joints = self._arm.held_at(self.now_s + SERVO_WATCHDOG_S)
        places = [*self._compartments]
        if self.pan.container_id is not None:  # the content of all others is in the log
            place = in_container(self.pan.container_id)
            places.append((str(place), place))
        masses_mg = {text: self.ledger.masses_mg[compartment] for text, compartment in places}
        self._memory.save((self.now_s, joints, masses_mg))

    def close(self) -> None:
        """Stop keeping the world in its file; does not save it."""
        self._memory.close()

    def _sit_out(self) -> None:
        """Simulate the outage: nobody speaks to the devices, until the dead-man closes the valve.

        It includes what a power cut does (faults `outage.…`); its end shuts the valve, too.
        """
        hand, silent_s = self._hand, self.now_s
        cut = PowerCut(self.faults, silent_s, substream(self._seed, f"{silent_s:.4f}", 0, "outage"))
        self._go_on_to(silent_s + SERVO_WATCHDOG_S)
        hand.hold_sheet()
        self._go_on_to(silent_s + DEAD_MAN_S)
        cut.begin(self.now_s, self._arm, hand, self.pan)
        self._go_on_to(silent_s + OUTAGE_S)
        cut.go_on(self.now_s, hand, self.load, self.ledger.masses_mg[CONE])
        while self._is_at_work and self.now_s < silent_s + LONGEST_OUTAGE_S:
            self._go_on_to(self.now_s + STEP_S)
        cut.end(self._balance, self.pan)

    @property
    def _is_at_work(self) -> bool:
        return self._hand.is_active or self.load.is_in_the_air or self.pan.is_swinging

    def _go_on_to(self, until_s: float) -> None:
        while self.now_s < until_s:
            self.step(self.now_s, until_s)
