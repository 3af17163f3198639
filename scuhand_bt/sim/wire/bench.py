"""All device twins of one cell, with one simulated world behind them that runs in real time.

    with WireBench(spec, sources, firmware, joints, clock) as bench:
        devices = connect_cell_devices(bench.spec, clock)

The balance's twin shows what the world's balance reads.
"""

import sys
import threading
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, ClassVar

from scuhand_bt.cell_spec import DEVICES, CellSpec
from scuhand_bt.clock import Clock
from scuhand_bt.devices.interfaces import Joints, Reading
from scuhand_bt.drivers import UNWIRED
from scuhand_bt.sim.balance import SimulatedBalance
from scuhand_bt.sim.faults import Faults
from scuhand_bt.sim.instruments import ROOM
from scuhand_bt.sim.plain_state import Plain
from scuhand_bt.sim.plant import probed_plant
from scuhand_bt.sim.wire.balances import balance_twin
from scuhand_bt.sim.wire.dynamixel import DynamixelTwin, crane_x7
from scuhand_bt.sim.wire.faults import WireFaults
from scuhand_bt.sim.wire.hand import HandTwin
from scuhand_bt.sim.wire.port import PtyPort
from scuhand_bt.sim.wire.power import Supplies
from scuhand_bt.sim.wire.scene import at_a_twin, twin_of
from scuhand_bt.sim.wire.server import TwinServer
from scuhand_bt.sim.wire.shafts import WireArm, WireHand
from scuhand_bt.sim.wire.world import WireWorld
from scuhand_bt.sim.world import STEP_S
from scuhand_bt.specs import Container, Source

SWITCH_S = 0.0005
"""Python's thread switch interval. Drivers, twins and the world share one interpreter, where the default of 5 ms would
delay the servos."""


class BenchScene:
    """What the twins of the further devices sense and change: the air of a laboratory, and the world's pan."""

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
        """A person has put this container into this slot of the changer."""
        self._in_slots[slot % self.slots] = container

    @property
    def kept(self) -> dict[int, dict[str, Plain]]:
        """The container in each slot, for the world's file."""
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

    So no client sees a state that a later process would not find in the world's file.
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
    """The description of a cell whose devices are twins, each at its port."""
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
    """The devices of a cell that have a cable; a changer may be a person's hands."""
    return [name for name in spec.device_names if (spec.kind_of(name), spec.section(name).driver) not in UNWIRED]


class WireBench:
    """The twins of one cell on pseudo-terminals, and their world; a context manager.

    `firmware` is the lab's `robot/firmware`, `joints` where the arm stands [rad]. The ports are `arm`, `hand` and
    `balance` in the folder `ports`, or in a temporary one for None; `bench.spec` has their names. Raises NoCompiler if
    the firmware cannot be built, PlantError for a plant that cannot be used.
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
        twin.period_s = spec.balance.period_s  # a reading sent twice would look like a frozen display
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
        """The twins of the changer (unless it is the operator's hands) and of the further devices, by name."""
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
        """Resume the world of this file with all its twins; as `World.restore`.

        The valve starts shut, unless it is stuck open: the board would have shut it when nobody spoke to it any more.
        """
        now_s = self.world.restore(path, tell)
        if "valve.stuck_open" not in self.world.faults.active:
            self.hand.twin.valve.shut()
        return now_s

    @property
    def rim_mm(self) -> float:
        """The diameter of the cone's rim."""
        return self._hand.cone_diameter_mm

    def check(self) -> None:
        """Raises, once, the exception that has ended the world's thread, such as that of a plant."""
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
