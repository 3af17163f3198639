"""Opens the real devices that `robot/cell.yaml` names."""

from collections.abc import Collection
from contextlib import ExitStack
from typing import NamedTuple

from scuhand_bt.clock import Clock, Signal
from scuhand_bt.devices.balances import DIALECTS, SerialBalance
from scuhand_bt.devices.dynamixel.arm import DynamixelArm, arm_axes
from scuhand_bt.devices.dynamixel.bus import DynamixelBus
from scuhand_bt.devices.dynamixel.chain import AxisGroup, ServoChain
from scuhand_bt.devices.hand_controller import HandController
from scuhand_bt.devices.liveness import Liveness
from scuhand_bt.devices.scuhand import ScuHand, roller_axis
from scuhand_bt.failures import SkillFailed
from scuhand_bt.specs import BalanceSpec, CellSpec

ARM_DRIVERS = ("dynamixel",)
HAND_DRIVERS = ("hand_controller",)
START_DIAMETER_MM = 90.0
"""Of the cone when the sheet has just been mounted (paper, section V)."""


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


def connect_cell_devices(spec: CellSpec, clock: Clock, liveness: Liveness | None = None) -> Devices:
    """Open everything; SkillFailed device.lost names the port that cannot be, and what to do.

    `liveness` is the pulse of the run's tick; without one, only a dead or stopped process is noticed.
    `hand.options.start_diameter` (mm) is the cone's size now, where it is not 90 mm.
    """
    _check_drivers(spec)
    news = Signal()
    with ExitStack() as opened:
        balance = connect_balance(spec.balance, clock)
        opened.callback(balance.close)
        arm_group, roller_group = AxisGroup(arm_axes(spec.arm)), AxisGroup([roller_axis(spec.hand)], watched=False)
        options = spec.arm.options
        bus = DynamixelBus(spec.arm.port, int(options.get("baud", 3_000_000)), float(options.get("latency_ms", 8.0)))
        chain = ServoChain(bus, [arm_group, roller_group], news, liveness)
        chain.open()
        opened.callback(chain.close)
        controller = HandController(spec.hand.port, news, liveness)
        hello = controller.open()
        opened.callback(controller.close)
        if hello.max_opening_mm < spec.hand.max_opening_mm:
            raise SkillFailed(
                "device.lost",
                f"the hand controller opens its valve up to {hello.max_opening_mm:g} mm, and robot/cell.yaml asks for "
                f"{spec.hand.max_opening_mm:g} mm; correct `max_opening` of the hand, or its firmware's settings",
            )
        start_mm = float(spec.hand.options.get("start_diameter", START_DIAMETER_MM))
        hand = ScuHand(spec.hand, controller, chain, roller_group, clock, start_mm)
        opened.pop_all()
        return Devices(DynamixelArm(chain, arm_group), hand, balance, None)


def connect_balance(spec: BalanceSpec, clock: Clock) -> SerialBalance:
    """Open the balance alone; SkillFailed device.lost."""
    require_driver("balance", spec.driver, DIALECTS)
    balance = SerialBalance(spec, DIALECTS[spec.driver], clock, DIALECTS.values())
    balance.open()
    return balance


def _check_drivers(spec: CellSpec) -> None:
    require_driver("arm", spec.arm.driver, ARM_DRIVERS)
    require_driver("hand", spec.hand.driver, HAND_DRIVERS)
    require_driver("balance", spec.balance.driver, DIALECTS)
    if spec.changer.driver != "operator":
        raise SkillFailed(
            "device.lost",
            f"there is no driver for the changer '{spec.changer.driver}' yet; "
            "write `changer: {driver: operator}` in robot/cell.yaml, and a person changes the containers",
        )


def require_driver(device: str, driver: str, drivers: Collection[str]) -> None:
    """SkillFailed device.lost for a driver that is none of these."""
    if driver not in drivers:
        raise SkillFailed(
            "device.lost",
            f"no driver for the {device} is called '{driver}'; robot/cell.yaml may name {', '.join(drivers)}",
        )
