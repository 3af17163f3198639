"""The simulated world: where every milligram is, and how it gets from one place to the next.

Mass moves by one operation, `transfer(from, to, mg)`, between compartments that never go negative:

    source:NAME   in that mortar              container:ID   in that container: the true mass of its dose
    cone          in the cone                 pan            on the balance, beside the container's mouth
    sheet         stuck to the sheet          returned       put back into another powder's mortar
    flight        fallen, not yet landed      waste, spilled

Everything that the powder does follows from the state of the devices; nothing here is a command. Powder
leaves the apex when the valve is open and lands, a fall later, on what stands below; it pours over the
rim when the cone is tipped beyond what the wall's friction holds; the cone scoops when it closes while
its sheet is pressed onto a mortar's bowl. A step is 20 ms while anything moves, else one balance period.

A world may live in a file (`keep_in`, `save`), from which another process takes it up (`restore`) as it is
some seconds after the first one was killed: by then the devices, which nobody spoke to, have come to rest.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from scuhand_bt.dosing.cone import Cone
from scuhand_bt.sim.arm import Pose, SimulatedArm
from scuhand_bt.sim.balance import SimulatedBalance
from scuhand_bt.sim.faults import Faults
from scuhand_bt.sim.hand import DEAD_MAN_S, SimulatedHand
from scuhand_bt.sim.memory import Memory
from scuhand_bt.sim.plant import Plant, PowderFlow
from scuhand_bt.sim.randomness import substream
from scuhand_bt.sim.surroundings import Surroundings
from scuhand_bt.sim.world_file import broken
from scuhand_bt.specs import CellSpec, Container, Source

STEP_S = 0.020
POUR_TIME_S = 0.15
"""Time constant of powder sliding out of a tipped cone."""
STICKING_SHARE = 0.02
"""Share of a scoop that touches bare sheet and sticks, until the sheet holds its residue."""
EMPTY_SPREAD = 0.2
"""Standard deviation of single containers' empty mass, as a share of their kind's tolerance."""
SERVO_WATCHDOG_S = 0.1
"""After this silence the arm's servos and the roller stand still."""
CLOG_SHAKE_S = 3.0
"""A clog at the apex is broken by so much vibration at full level."""
LEAK_MG_PER_S = 2.0
"""What a leaking cone loses while its valve is shut."""
WRONG_MASS = 0.2
"""How much heavier a wrong container is, as a share; at least three tolerances."""
OUTAGE_S = 2.0
"""Time that passes in the world at least, from the last word of a killed program to the first of the next one."""
LONGEST_OUTAGE_S = 10.0
"""And at most: a valve that is stuck open stays it."""


@dataclass
class Stroke:
    """One closing of the cone in contact with a mortar's bowl."""

    source: str
    diameter_mm: float
    closed_diameter_mm: float
    overtravel_mm: float


class World:
    """One bench's matter. `step` and `save` are what the virtual clock calls."""

    STATE: ClassVar[tuple[str, ...]] = (
        "now_s",
        "pan",
        "_swing",
        "_flow",
        "_cone_source",
        "_flying",
        "_was_open",
        "_stroke",
        "_flow_rng",
        "_scoop_rng",
        "_shaken_s",
    )
    """What its file keeps of it, beside the masses, and the containers in the file's log."""

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
        self._shaken_s = 0.0
        self.masses_mg: dict[str, float] = dict.fromkeys(
            ("cone", "sheet", "flight", "pan", "returned", "waste", "spilled"), 0.0
        )
        for name, source in sources.items():
            self.masses_mg[f"source:{name}"] = source.amount_mg
        self._compartments = tuple(self.masses_mg)
        self.now_s = 0.0
        """The time it has come to."""
        self.pan: str | None = None
        """The id of the container on the pan."""
        self._sources, self._plant, self._seed = sources, plant, seed
        self._arm, self._hand, self._balance = arm, hand, balance
        self._around = Surroundings(spec, sources)
        self._containers: dict[str, tuple[Container, float]] = {}
        self._empty_mg = 0.0
        self._flow: PowderFlow | None = None
        self._cone_source: str | None = None
        self._flying: deque[tuple[float, float, str]] = deque()  # (time of landing, mg, compartment)
        self._place: tuple[Pose, str, float] | None = None
        self._was_open = False
        self._stroke: Stroke | None = None
        self._swing: tuple[float, str | None] | None = None  # end of the carousel's swing [s], container it brings
        self._memory = Memory((self, hand, balance, *([self.faults] if self.faults.rules else [])), plant.name)
        self.begin_sample("", 0)

    # --- for judging, never for skills ---

    def true_mass(self, container_id: str) -> float:
        """What is in this container [mg]."""
        return self.masses_mg.get(f"container:{container_id}", 0.0)

    @property
    def is_open(self) -> bool:
        """Whether the valve is open, whatever it says itself."""
        return self._hand.gap_mm > 0.0

    @property
    def total_mg(self) -> float:
        """All there is; the same at all times."""
        return math.fsum(self.masses_mg.values())

    # --- hands that act beside the robot ---

    def begin_sample(self, sample: str, attempt: int) -> None:
        """Draw from the streams of this sample and attempt from now on."""

        def stream(device: str) -> np.random.Generator:
            return substream(self._seed, sample, attempt, device)

        self._flow_rng, self._scoop_rng = stream("flow"), stream("scoop")
        self.faults.begin_sample(sample, attempt, self.now_s)
        self._hand.use_randomness(stream("hand"))
        self._balance.use_randomness(stream("balance"))

    def place(self, container: Container) -> None:
        """Put a container on the pan; one that stood there before comes back with what it holds."""
        if self.pan is not None:
            raise ValueError(f"'{self.pan}' stands on the pan")
        self._know(container)
        self._put(container.id)

    def remove(self) -> None:
        """Take the container, and what it holds, off the pan."""
        if self.pan is not None:
            self._log(self.pan)
        self._put(None)

    def swing(self, until_s: float, container: Container | None) -> None:
        """The carousel swings; at its end this container stands on the pan, or what stood there is gone."""
        if container is not None:
            self._know(container)
        self._swing = (until_s, container.id if container is not None else None)

    @property
    def is_swinging(self) -> bool:
        return self._swing is not None

    @property
    def swing_ends_s(self) -> float:
        """When the carousel's swing ends, or ended if it stands still."""
        return self._swing[0] if self._swing is not None else self.now_s

    def _know(self, container: Container) -> None:
        if container.id not in self._containers:
            rng = substream(self._seed, "container", container.id)
            wrong_mg = 0.0
            if self.faults.befalls("container.wrong", self.now_s):
                wrong_mg = max(WRONG_MASS * container.empty_mass_mg, 3.0 * container.empty_mass_tolerance_mg)
            spread_mg = EMPTY_SPREAD * container.empty_mass_tolerance_mg
            empty_mg = container.empty_mass_mg + spread_mg * float(np.clip(rng.standard_normal(), -3.0, 3.0))
            self._containers[container.id] = (container, max(1.0, empty_mg) + wrong_mg)
            self.masses_mg[f"container:{container.id}"] = 0.0
            self._log(container.id)

    def _put(self, container_id: str | None) -> None:
        self.pan, self._place = container_id, None
        self._empty_mg = self._containers[container_id][1] if container_id is not None else 0.0

    def _end_swing(self) -> None:
        assert self._swing is not None
        (_, container_id), self._swing = self._swing, None
        if container_id is None:
            self.remove()
        else:
            self.place(self._containers[container_id][0])

    def load_cone(self, source: str, mass_mg: float) -> None:
        """Put powder of a source into the cone by hand, as the paper's experiments did."""
        self.transfer(f"source:{source}", "cone", mass_mg)
        self._start_load(source)

    def swap_sheet(self) -> None:
        """A new sheet: what stuck to the old one, and what was still in the cone, is thrown away."""
        for place in ("cone", "sheet"):
            self.transfer(place, "waste", self.masses_mg[place])
        self._flow = self._cone_source = None

    def transfer(self, source: str, target: str, mass_mg: float) -> None:
        """Move powder. ValueError for NaN, a negative mass, or more than there is."""
        there_mg = self.masses_mg[source]
        if not 0.0 <= mass_mg <= there_mg:
            raise ValueError(f"cannot move {mass_mg!r} mg from {source}, which holds {there_mg!r} mg")
        self.masses_mg[source] = there_mg - mass_mg
        self.masses_mg[target] += mass_mg

    # --- time ---

    def step(self, now_s: float, limit_s: float) -> float:
        """Go on by one step, not past `limit_s`; the new time."""
        hand, arm, balance, faults = self._hand, self._arm, self._balance, self.faults
        faults.advance(now_s)
        leaks = "cone.leak" in faults.active
        active = hand.is_active or arm.is_active or bool(self._flying) or self._was_open or leaks
        end_s = balance.next_reading_s
        if active and end_s > now_s + STEP_S + 1e-6:
            end_s = now_s + STEP_S
        end_s = min(end_s, limit_s)
        dt_s = end_s - now_s
        if dt_s <= 0.0:
            return end_s
        opening_mm = hand.advance(end_s, dt_s)
        arm.advance(end_s)
        if opening_mm > 0.0 or self._was_open:
            self._leave(end_s, dt_s, opening_mm)
        elif leaks and self.masses_mg["cone"] > 0.0:
            self._drop(end_s, min(LEAK_MG_PER_S * dt_s, self.masses_mg["cone"]))
        if arm.is_active:
            self._place = None
            self._pour(end_s, dt_s)
        if self._stroke is not None or hand.is_closing:
            self._scoop(end_s)
        landing_mg = self._land(end_s) if self._flying else 0.0
        on_pan_mg = self._empty_mg + self.masses_mg["pan"] - landing_mg
        if self.pan is not None:
            on_pan_mg += self.masses_mg[f"container:{self.pan}"]
        balance.advance(end_s, dt_s, on_pan_mg, landing_mg, self._vibration)
        self.now_s = end_s
        if self._swing is not None and end_s >= self._swing[0]:
            self._end_swing()
        return end_s

    def _leave(self, end_s: float, dt_s: float, opening_mm: float) -> None:
        """Powder leaves the apex."""
        in_cone_mg = self.masses_mg["cone"]
        self._was_open = opening_mm > 0.0
        if in_cone_mg <= 0.0 or self._flow is None or self._is_clogged(end_s, dt_s):
            return
        leaving_mg = self._plant.leaving(
            self._flow.step(dt_s, opening_mm, self._vibration, in_cone_mg, self._flow_rng), in_cone_mg
        )
        if leaving_mg > 0.0:
            self._drop(end_s, leaving_mg)

    @property
    def _vibration(self) -> float:
        return 0.0 if "vibration.dead" in self.faults.active else self._hand.vibration

    def _is_clogged(self, now_s: float, dt_s: float) -> bool:
        if "powder.clog" not in self.faults.active:
            return False
        self._shaken_s += self._vibration * dt_s
        if self._shaken_s >= CLOG_SHAKE_S:
            self._shaken_s = 0.0
            self.faults.end("powder.clog", now_s)
        return True

    def _pour(self, end_s: float, dt_s: float) -> None:
        """Powder slides over the rim of a cone that is tipped too far, unless the cone lies in a mortar."""
        in_cone_mg = self.masses_mg["cone"]
        if in_cone_mg <= 0.0 or self._cone_source is None:
            return
        pose = self._arm.pose(end_s)
        cone = Cone(self._hand.cone_diameter_mm, self._hand.spec.sheet_radius_mm)
        held_deg = cone.wall_deg + self._sources[self._cone_source].powder.wall_friction_deg
        if pose.axis[2] >= math.cos(math.radians(min(held_deg, 179.0))) or self._around.mortar(pose) is not None:
            return
        gone_mg = in_cone_mg if in_cone_mg < 0.1 else in_cone_mg * min(1.0, dt_s / POUR_TIME_S)
        self._drop(end_s, gone_mg)

    def _drop(self, now_s: float, mass_mg: float) -> None:
        if self._place is None or self._arm.is_active:
            pose = self._arm.pose(now_s)
            mouth_mm = self._containers[self.pan][0].mouth_mm if self.pan is not None else 0.0
            self._place = (pose, *self._around.below(pose, mouth_mm, self._cone_source))
        _, place, fall_s = self._place
        self.transfer("cone", "flight", mass_mg)
        self._flying.append((now_s + fall_s, mass_mg, place))

    def _land(self, now_s: float) -> float:
        """Let what has fallen land; the mass [mg] that landed on the balance."""
        landed_mg = 0.0
        flying = self._flying
        while flying and flying[0][0] <= now_s:
            _, mass_mg, place = flying.popleft()
            mass_mg = min(mass_mg, self.masses_mg["flight"])
            if place == "balance":
                landed_mg += mass_mg
                into_mg = min(mass_mg, self._room_mg())
                if into_mg > 0.0:
                    self.transfer("flight", f"container:{self.pan}", into_mg)
                self.transfer("flight", "pan", mass_mg - into_mg)
            else:
                landed_mg += mass_mg if place == "pan" else 0.0
                self.transfer("flight", place, mass_mg)
        if not flying:  # the dust of adding and subtracting
            self.transfer("flight", "waste", self.masses_mg["flight"])
        return landed_mg

    def _room_mg(self) -> float:
        if self.pan is None or self._cone_source is None:
            return 0.0
        container, _ = self._containers[self.pan]
        density = self._sources[self._cone_source].powder.bulk_density_mg_per_mm3
        return max(0.0, container.capacity_mm3 * density - self.masses_mg[f"container:{self.pan}"])

    # --- outliving the program ---

    def keep_in(self, path: Path, tell: Callable[[str], None]) -> None:
        """Live in a new file from now on. `tell` is told, at most once, why it cannot be saved after all."""
        self._memory.begin(path, tell)
        for container_id in self._containers:
            self._log(container_id)
        self.save()

    def restore(self, path: Path, tell: Callable[[str], None]) -> float:
        """Take up the world of a file, and live in it: as it is after the outage. Returns the time then [s].

        Raises SourceError for a file that is missing, damaged, or of a world that could not be saved.
        """
        (joints, masses_mg, on_pan_mg), containers = self._memory.take_up(path, tell)
        if self._cone_source is not None and self._cone_source not in self._sources:
            self.close()
            raise broken(path, f"powder of '{self._cone_source}', which the recipe no longer has, is in the cone")
        for container, empty_mg, mass_mg in containers:
            self._containers[container.id] = (container, empty_mg)
            self.masses_mg[f"container:{container.id}"] = mass_mg
        if self.pan is not None:
            self.masses_mg[f"container:{self.pan}"] = on_pan_mg
        self.masses_mg.update(masses_mg)
        self._put(self.pan)
        self._arm.hold(joints)
        self._sit_out()
        self.save()
        return self.now_s

    def save(self) -> None:
        """Keep the world as it is now in its file, if it has one."""
        if not self._memory.is_kept:
            return
        masses_mg = self.masses_mg
        self._memory.save(
            (
                self._arm.held_at(self.now_s + SERVO_WATCHDOG_S),
                {name: masses_mg[name] for name in self._compartments},
                masses_mg[f"container:{self.pan}"] if self.pan is not None else 0.0,
            )
        )

    def close(self) -> None:
        """Live in no file any more; what it is now is not saved."""
        self._memory.close()

    def _log(self, container_id: str) -> None:
        """Only what stands on the pan can change: what it is, and what it holds when it goes, is written once."""
        self._memory.log((*self._containers[container_id], self.true_mass(container_id)))

    def _sit_out(self) -> None:
        """What happens while nobody speaks to the devices: the valve stays as it is until its dead-man closes it."""
        hand, silent_s = self._hand, self.now_s
        self._go_on_to(silent_s + SERVO_WATCHDOG_S)
        hand.hold_sheet()
        self._go_on_to(silent_s + DEAD_MAN_S)
        hand.shut(self.now_s)
        self._go_on_to(silent_s + OUTAGE_S)
        while (hand.is_active or self._flying or self.is_swinging) and self.now_s < silent_s + LONGEST_OUTAGE_S:
            self._go_on_to(self.now_s + STEP_S)

    def _go_on_to(self, until_s: float) -> None:
        while self.now_s < until_s:
            self.step(self.now_s, until_s)

    # --- scooping ---

    def _scoop(self, now_s: float) -> None:
        """Follow a closing cone in a mortar; at the stroke's end the plant says what it has collected."""
        diameter_mm = self._hand.cone_diameter_mm
        if self._hand.is_closing:
            pose = self._arm.pose(now_s)
            source = self._around.mortar(pose)
            cone = Cone(diameter_mm, self._hand.spec.sheet_radius_mm)
            overtravel_mm = self._around.overtravel_mm(pose, cone, source) if source is not None else 0.0
            if source is not None and overtravel_mm > 0.0:
                if self._stroke is None:
                    self._stroke = Stroke(source, diameter_mm, diameter_mm, overtravel_mm)
                self._stroke.closed_diameter_mm = diameter_mm
                self._stroke.overtravel_mm = max(self._stroke.overtravel_mm, overtravel_mm)
            return
        stroke, self._stroke = self._stroke, None
        assert stroke is not None
        if self.faults.befalls("scoop.nothing", now_s):
            return
        stroke.closed_diameter_mm = diameter_mm
        mortar, powder = self._sources[stroke.source].mortar, self._sources[stroke.source].powder
        place = f"source:{stroke.source}"
        in_mortar_mg = self.masses_mg[place]
        taken_mg = self._plant.collected(
            self._plant.scoop(powder).collect(stroke, mortar, in_mortar_mg, self._scoop_rng), in_mortar_mg
        )
        self.transfer(place, "cone", taken_mg)
        room_mg = max(0.0, powder.simulation.residue_mg - self.masses_mg["sheet"])
        self.transfer("cone", "sheet", min(room_mg, STICKING_SHARE * taken_mg))
        self._start_load(stroke.source)

    def _start_load(self, source: str) -> None:
        self._cone_source, self._place = source, None
        self._flow = self._plant.flow(self._sources[source].powder)
