"""All twins of one cell at once, backed by one simulated world that goes on in real time.

    with WireBench(spec, sources, firmware, joints, clock) as bench:
        devices = connect_cell_devices(bench.spec, clock)

The world sees the servos' shafts and the valve's position, not commands; the balance's twin shows what the
world's balance reads.
"""

import math
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, ClassVar

import numpy as np

from scuhand_bt.cell_spec import DEVICES, MOUNTED_DIAMETER_MM, ArmOptions, CellSpec, HandSpec
from scuhand_bt.clock import Clock
from scuhand_bt.devices.interfaces import Joints, Reading
from scuhand_bt.dosing.cone import Cone
from scuhand_bt.drivers import UNWIRED
from scuhand_bt.motion.kinematics import LIMITS_RAD, Mount
from scuhand_bt.sim.arm import SimulatedArm
from scuhand_bt.sim.balance import SimulatedBalance
from scuhand_bt.sim.faults import Faults
from scuhand_bt.sim.hand import SimulatedHand
from scuhand_bt.sim.instruments import ROOM
from scuhand_bt.sim.mass_ledger import Compartment
from scuhand_bt.sim.outage import SAG_RAD
from scuhand_bt.sim.plain_state import Plain
from scuhand_bt.sim.plant import Plant, probed_plant
from scuhand_bt.sim.snapshot import Stateful
from scuhand_bt.sim.wire.balances import balance_twin
from scuhand_bt.sim.wire.dynamixel import DynamixelTwin, crane_x7
from scuhand_bt.sim.wire.faults import WireFaults
from scuhand_bt.sim.wire.hand import HandTwin
from scuhand_bt.sim.wire.port import PtyPort
from scuhand_bt.sim.wire.power import Supplies
from scuhand_bt.sim.wire.scene import at_a_twin, twin_of
from scuhand_bt.sim.wire.server import TwinServer
from scuhand_bt.sim.wire.servo import Servo
from scuhand_bt.sim.world import STEP_S, World
from scuhand_bt.specs import Container, Source

SHOULDER = 1
STILL_AFTER_S = 0.1
"""What has not moved for this long stands still."""
SHUT_MM = 0.01
SWITCH_S = 0.0005
"""How often Python's threads take turns: drivers, twins and the world share one interpreter here, and at its
usual 5 ms a servo would be kept waiting."""
COUNTS_PER_RAD = 4096 / (2 * math.pi)
SINKS_RAD_PER_S = 0.3
"""So fast the shoulder of an arm without power gives way, and by `SAG_RAD` at most: then it rests on something."""
UNSAVED_S = 0.5
"""A world in which no powder moves is saved so often."""


class WireArm(SimulatedArm):
    """The world's arm: it is where the servos are."""

    def __init__(
        self, clock: Clock, mount: Callable[[], Mount], joints: Joints, servos: list[Servo], built: ArmOptions
    ) -> None:
        super().__init__(clock, mount, joints)
        self._servos = servos
        self._homes, self._per_rad = np.array(built.home_counts), np.array(built.directions) * COUNTS_PER_RAD
        self._moved_s = float("-inf")
        self._now_s = self._sunk_rad = 0.0
        self.stand_at(joints)

    def stand_at(self, joints: Joints) -> None:
        """A hand has moved the arm there, which was limp."""
        for servo, count in zip(self._servos, (self._homes + joints * self._per_rad).tolist(), strict=True):
            servo.position = count
            servo.stand()

    @property
    def is_limp(self) -> bool:
        """No servo of it holds anything."""
        return not any(servo.has_torque and servo.is_powered for servo in self._servos)

    @property
    def joints(self) -> Joints:
        """Where the servos are, as they are built in."""
        joints: Joints = (np.array([servo.position for servo in self._servos]) - self._homes) / self._per_rad
        return joints

    @property
    def is_active(self) -> bool:
        return self._now_s - self._moved_s < STILL_AFTER_S

    def advance(self, end_s: float) -> None:
        """See where the servos are."""
        self._sink(end_s - self._now_s)
        joints = self.joints
        if np.abs(joints - self._rest).max() > 0.5 / COUNTS_PER_RAD:
            if not self.is_active:
                self.faults.chance("motion", end_s)
            self._moved_s = end_s
            self._hold(joints)
        self._now_s = end_s

    def _sink(self, dt_s: float) -> None:
        """There are no brakes. Once the power is back a person has hold of it, whether or not it has torque."""
        if self._servos[SHOULDER].is_powered:
            self._sunk_rad = 0.0
            return
        by_rad = min(SINKS_RAD_PER_S * dt_s, SAG_RAD - self._sunk_rad)
        self._sunk_rad += by_rad
        joints = self.joints
        joints[SHOULDER] = max(joints[SHOULDER] - by_rad, LIMITS_RAD[0, SHOULDER])
        self.stand_at(joints)


class WireHand(SimulatedHand):
    """The world's hand: its valve is where the twin's is, its cone what the roller's servo has made of it."""

    STATE = (*SimulatedHand.STATE, "_at_zero_deg")

    def __init__(self, spec: HandSpec, clock: Clock, board: HandTwin, roller: Servo) -> None:
        super().__init__(spec, clock)
        self._board = board
        self._roller = roller
        self.rim_is(MOUNTED_DIAMETER_MM)
        self._morphed_s = self._closed_s = float("-inf")
        self._now_s = 0.0

    @property
    def _roller_deg(self) -> float:
        return self._roller.shaft * 360 / 4096

    def rim_is(self, diameter_mm: float) -> None:
        """A sheet is mounted so, as the roller stands now."""
        self._at_zero_deg = Cone(diameter_mm, self.spec.sheet_radius_mm).roller_deg(self.spec) - self._roller_deg

    @property
    def is_active(self) -> bool:
        morphs = self._now_s - self._morphed_s < STILL_AFTER_S
        return bool(self._servo_mm or self.vibration) or morphs

    @property
    def is_closing(self) -> bool:
        return self._now_s - self._closed_s < STILL_AFTER_S

    def advance(self, end_s: float, dt_s: float) -> float:
        """See where the valve and the roller are; the mean real opening [mm] since the last look."""
        self._now_s = end_s
        self.vibration = self._board.vibration
        opening_mm = self._board.opening_mm if self._board.opening_mm > SHUT_MM else 0.0
        self._turn_to(opening_mm, end_s)
        self._servo_mm = opening_mm
        before_mm, self._real_mm = self._real_mm, self._gap_mm()
        diameter_mm = Cone.from_roller(self._at_zero_deg + self._roller_deg, self.spec).diameter_mm
        if abs(diameter_mm - self.cone_diameter_mm) > 0.001:
            self._morphed_s = end_s
            if diameter_mm < self.cone_diameter_mm:
                self._closed_s = end_s
            self.cone_diameter_mm = diameter_mm
        return (before_mm + self._real_mm) / 2.0


class WireWorld(World):
    """The world that goes on in a thread of its own, while hands act on it from another.

    It lives in a file, if it is told to, with the twins that meet it: of a process that ends, however it does, another
    takes up devices and powder as if time had stood still.
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
        """Keep the state of these, too."""
        self._memory.add(twins)

    def save_changes(self) -> None:
        """Save it, if powder has moved since, or it was not saved for a while."""
        with self._lock:
            if self.ledger.masses_mg != self._saved_mg or self.now_s - self._saved_s >= UNSAVED_S:
                self.save()

    def save(self) -> None:
        with self._lock:
            super().save()
            self._saved_mg, self._saved_s = dict(self.ledger.masses_mg), self.now_s

    def _sit_out(self) -> None:
        """Nothing happens to twins between two of their processes."""

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


class BenchScene:
    """What the twins of the further devices meet: the air of a laboratory, and what stands on the world's pan."""

    STATE: ClassVar[tuple[str, ...]] = ("kept",)
    air = ROOM
    seen = ()
    """Nobody reaches into a bench of twins."""

    def __init__(self, world: WireWorld, slots: int) -> None:
        self.slots = slots
        self._world = world
        self._in_slots: dict[int, Container] = {}

    @property
    def on_pan(self) -> str | None:
        return self._world.pan.container_id

    def stands_in(self, slot: int, container: Container) -> None:
        """A person has filled the changer so."""
        self._in_slots[slot % self.slots] = container

    @property
    def kept(self) -> dict[int, dict[str, Plain]]:
        """What stands in which slot, for the world's file."""
        return {slot: container.model_dump() for slot, container in self._in_slots.items()}

    @kept.setter
    def kept(self, in_slots: dict[int, dict[str, Plain]]) -> None:
        self._in_slots = {slot: Container.model_validate(fields) for slot, fields in in_slots.items()}

    def bring(self, slot: int | None) -> None:
        self._world.remove()
        if (container := self._in_slots.get(slot) if slot is not None else None) is not None:
            self._world.place(container)


class WirePan:
    """What the balance's twin weighs: the reading of the world's balance, once that world is saved.

    So nobody has seen of a world what another process would not find in its file.
    """

    def __init__(self, balance: SimulatedBalance) -> None:
        self._balance = balance
        self.latest: Reading | None = None

    def gross_mg(self, now_s: float) -> float:
        if "balance.overload" in self._balance.faults.active:
            return 2.0 * self._balance.spec.maximum_mg
        return self.latest.value_mg if self.latest is not None else 0.0

    def is_stable(self, now_s: float) -> bool:
        return self.latest is not None and self.latest.stable


def at_twins(spec: CellSpec, url_of: Callable[[str], str]) -> CellSpec:
    """The description of a cell whose devices are twins, each at this port."""
    there = _with_twins(spec)

    def section(name: str) -> Any:
        said = spec.section(name)
        changes: dict[str, Any] = {"port": url_of(name)} if name in there else {}
        if "options" in type(said).model_fields:
            changes["options"] = at_a_twin(said.options)  # type: ignore[union-attr]
        return said.model_copy(update=changes)

    own_options = {name: at_a_twin(options) for name, options in spec.own_options.items()}
    devices = {name: section(name) for name in spec.devices}
    return spec.model_copy(
        update={name: section(name) for name in DEVICES} | {"devices": devices, "own_options": own_options}
    )


def _with_twins(spec: CellSpec) -> list[str]:
    """The devices of a cell that are at a cable: a changer may be a person's hands."""
    return [name for name in spec.device_names if (spec.kind_of(name), spec.section(name).driver) not in UNWIRED]


class WireBench:
    """The twins of one cell on pseudo-terminals, and their world; a context manager.

    `firmware` is the lab's `robot/firmware`, `joints` where the arm stands [rad]. Raises NoCompiler where the
    firmware cannot be built, PlantError for a plant that cannot be used. The ports are `arm`, `hand` and `balance` in
    the folder `ports`, or somewhere else if that is None; `bench.spec` tells.
    """

    def __init__(
        self,
        spec: CellSpec,
        sources: Mapping[str, Source],
        firmware: Path,
        joints: Joints,
        clock: Clock,
        seed: int = 0,
        plant: str | None = None,
        ports: Path | None = None,
        faults: Faults | None = None,
    ) -> None:
        physics = probed_plant(plant or spec.plant, sources.values(), spec.balance)
        board = HandTwin(firmware, spec.hand.valve_dead_time_s, spec.hand.options.valve_map)
        *arm_servos, roller = servos = crane_x7((*spec.arm.options.servo_ids, spec.hand.options.roller_id))
        self.bus = TwinServer(DynamixelTwin(servos), PtyPort(ports and ports / "arm"))
        self.hand = TwinServer(board, PtyPort(ports and ports / "hand"))
        hand = WireHand(spec.hand, clock, board, roller)
        self.arm = arm = WireArm(clock, hand.mount, joints, arm_servos, spec.arm.options)
        balance = SimulatedBalance(spec.balance, clock, physics)
        self.world = WireWorld(spec, sources, physics, seed, arm, hand, balance, faults)
        kind = balance_twin(spec.balance.driver)
        self._balance, self._hand, self._pan = balance, hand, WirePan(balance)
        twin = kind(self._pan, spec.balance.readability_mg, spec.balance.maximum_mg)
        self.balance = TwinServer(twin, PtyPort(ports and ports / "balance"))
        self._faults = WireFaults(self.world.faults, self.bus, self.hand, self.balance)
        self.scene = BenchScene(self.world, spec.changer.slot_count)
        self.others = {
            name: TwinServer(
                twin_of(spec.kind_of(name), spec.section(name).driver)(spec.options_of(name), self.scene),
                PtyPort(ports and ports / name),
            )
            for name in _with_twins(spec)[3:]
        }
        """The changer's, where it is none of the operator's hands, and the further devices', by name."""
        others = [server.twin for server in self.others.values() if hasattr(server.twin, "STATE")]
        self.world.lives_with([self.bus.twin, board.valve.line, twin, self.scene, *others])
        self.servers: dict[str, TwinServer[Any]] = {
            "arm": self.bus,
            "hand": self.hand,
            "balance": self.balance,
            **self.others,
        }
        """All twins at their ports, by the names of their devices."""
        self.power = Supplies(servos, self.hand, self.balance, balance, self.others)
        self.spec = at_twins(spec, lambda name: self.servers[name].url)
        """The cell's description with the twins' ports in it."""
        self._clock = clock
        self._running = ExitStack()
        self._failure: Exception | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._go_on, name="world", daemon=True)

    def __enter__(self) -> "WireBench":
        self._running.callback(sys.setswitchinterval, sys.getswitchinterval())
        sys.setswitchinterval(SWITCH_S)
        for server in self.servers.values():
            self._running.enter_context(server)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._closing.set()
        self._thread.join()
        self._running.close()

    def take_up(self, path: Path, tell: Callable[[str], None]) -> float:
        """Be what the world of this file was, with all its twins; as `World.restore`.

        But for the valve: the board, which begins anew, would have shut it when nobody spoke to it any more.
        """
        now_s = self.world.restore(path, tell)
        if "valve.stuck_open" not in self.world.faults.active:
            self.hand.twin.valve.shut()
        return now_s

    @property
    def rim_mm(self) -> float:
        """How wide the cone's rim is."""
        return self._hand.cone_diameter_mm

    def check(self) -> None:
        """Raise, once, what has ended the world's thread: a plant may fail in the middle of a run."""
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure

    def _go_on(self) -> None:
        world = self.world
        try:
            while not self._closing.wait(STEP_S):
                end_s = self._clock.now_s
                while world.now_s < end_s and not self._closing.is_set():
                    world.step(world.now_s, end_s)
                reading = self._balance.latest
                world.save_changes()
                self._pan.latest = reading
                self._faults.apply()
            world.save()
        except Exception as error:
            self._failure = error
