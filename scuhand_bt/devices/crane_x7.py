"""The drivers of the CRANE-X7 and of the SCU-Hand-SV: two devices, whose servos share a bus."""

from contextlib import ExitStack
from pathlib import Path
from typing import ClassVar

from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.clock import Signal
from scuhand_bt.device_specs.arm import ArmOptions, ArmSpec
from scuhand_bt.device_specs.hand import HandOptions
from scuhand_bt.devices.dynamixel.arm import DynamixelArm, arm_axes
from scuhand_bt.devices.dynamixel.axis_group import AxisGroup
from scuhand_bt.devices.dynamixel.bus import DynamixelBus
from scuhand_bt.devices.dynamixel.servo_loop import ServoChain
from scuhand_bt.devices.hand_controller import HandController
from scuhand_bt.devices.interfaces import Site
from scuhand_bt.devices.liveness import Liveness
from scuhand_bt.devices.roller import RollerRecord
from scuhand_bt.devices.scuhand import ScuHand, roller_axis
from scuhand_bt.drivers import is_ours


def bus_of(spec: ArmSpec, port: str = "") -> DynamixelBus:
    """The bus of the cell's servos, not opened yet."""
    return DynamixelBus(port or spec.port, spec.options.baud, 1000 * spec.options.latency_s)


class Servos:
    """The servos of a cell's arm and roller, as far as they are the engine's: on one bus, or each on its own."""

    def __init__(self, spec: CellSpec, liveness: Liveness, roller_file: Path | None = None) -> None:
        self.news = Signal()
        self.record = RollerRecord(spec.hand, roller_file)
        self.arm = AxisGroup(arm_axes(spec.arm))
        self.roller = AxisGroup([roller_axis(spec.hand)], False, self.record.turns_were_lost)
        self._ports = {"arm": spec.arm.port, "hand": spec.hand.options.roller_port or spec.arm.port}
        groups: dict[str, list[AxisGroup]] = {}
        for name, group in (("arm", self.arm), ("hand", self.roller)):
            if is_ours(name, spec.section(name).driver):
                groups.setdefault(self._ports[name], []).append(group)
        self._chains = {
            port: ServoChain(bus_of(spec.arm, port), of_port, self.news, liveness) for port, of_port in groups.items()
        }

    def open(self, *, may_torque: bool) -> None:
        """Open every bus; SkillFailed device.lost, arm.limp."""
        with ExitStack() as opened:
            for chain in self._chains.values():
                chain.open(may_torque=may_torque)
                opened.callback(chain.close)
            opened.pop_all()

    def close(self) -> None:
        """Close every bus; the servos go on holding."""
        for chain in self._chains.values():
            chain.close()

    def chain_of(self, device: str) -> ServoChain:
        """The chain with the servos of the arm, or the hand's."""
        return self._chains[self._ports[device]]


class CraneX7:
    """`driver: dynamixel` of the arm."""

    Options: ClassVar = ArmOptions
    twin: ClassVar = ""  # of all its servos at once: `sim/wire/bench.py`

    @staticmethod
    def connect(site: Site) -> DynamixelArm:
        servos: Servos = site.servos
        return DynamixelArm(servos.chain_of("arm"), servos.arm)


class Hand:
    """`driver: hand_controller` of the hand."""

    Options: ClassVar = HandOptions
    twin: ClassVar = ""  # the same

    @staticmethod
    def connect(site: Site) -> ScuHand:
        servos: Servos = site.servos
        controller = HandController(site.spec, servos.news, site.liveness)
        controller.open()
        return ScuHand(site.spec, controller, servos.chain_of("hand"), servos.roller, site.clock, servos.record)
