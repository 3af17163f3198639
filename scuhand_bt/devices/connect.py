"""Opens the real devices that `robot/cell.yaml` names."""

from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

from scuhand_bt.cell_spec import ArmSpec, BalanceSpec, CellSpec
from scuhand_bt.clock import Clock, Signal
from scuhand_bt.devices.balances import DIALECTS, SerialBalance, dialect_of
from scuhand_bt.devices.dynamixel.arm import DynamixelArm, arm_axes
from scuhand_bt.devices.dynamixel.bus import DynamixelBus
from scuhand_bt.devices.dynamixel.servo_loop import AxisGroup, ServoChain
from scuhand_bt.devices.hand_controller import HandController
from scuhand_bt.devices.liveness import Liveness
from scuhand_bt.devices.roller import RollerRecord
from scuhand_bt.devices.scuhand import ScuHand, roller_axis


class Devices(NamedTuple):
    """The open devices of a cell. A changer of None means that the operator changes containers."""

    arm: DynamixelArm
    hand: ScuHand
    balance: SerialBalance
    changer: None

    def close(self) -> None:
        """Close the valve and all ports; the arm goes on holding."""
        self.hand.close()
        self.arm.close()
        self.balance.close()


def connect_cell_devices(
    spec: CellSpec,
    clock: Clock,
    liveness: Liveness | None = None,
    *,
    may_torque: bool = True,
    roller_file: Path | None = None,
) -> Devices:
    """Open everything; SkillFailed device.lost names the port that cannot be, and what to do.

    `roller_file` is where it is kept how far the sheet is rolled; without one only while this program has the hand.
    `liveness` is the pulse of the run's tick; without one, only a dead or stopped process is noticed. Without
    `may_torque` an arm that has no torque is refused, as arm.limp.
    The changer is the operator: whoever calls has refused a cell with another one.
    """
    news = Signal()
    with ExitStack() as opened:
        balance = connect_balance(spec.balance, clock)
        opened.callback(balance.close)
        record = RollerRecord(spec.hand, roller_file)
        arm_group = AxisGroup(arm_axes(spec.arm))
        roller_group = AxisGroup([roller_axis(spec.hand)], False, record.turns_were_lost)
        chain = ServoChain(bus_of(spec.arm), [arm_group, roller_group], news, liveness)
        chain.open(may_torque=may_torque)
        opened.callback(chain.close)
        controller = HandController(spec.hand, news, liveness)
        controller.open()
        opened.callback(controller.close)
        hand = ScuHand(spec.hand, controller, chain, roller_group, clock, record)
        opened.pop_all()
        return Devices(DynamixelArm(chain, arm_group), hand, balance, None)


def bus_of(spec: ArmSpec) -> DynamixelBus:
    """The bus of the cell's servos, not opened yet."""
    return DynamixelBus(spec.port, spec.options.baud, 1000 * spec.options.latency_s)


def connect_balance(spec: BalanceSpec, clock: Clock) -> SerialBalance:
    """Open the balance alone; SkillFailed device.lost."""
    balance = SerialBalance(spec, dialect_of(spec.driver), clock, DIALECTS.values())
    balance.open()
    return balance
