"""Opens the real devices that `robot/cell.yaml` names, each by its driver."""

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scuhand_bt.cell_spec import DEVICES, CellSpec
from scuhand_bt.clock import Clock
from scuhand_bt.devices.crane_x7 import Servos
from scuhand_bt.devices.interfaces import Arm, Balance, Changer, Device, Hand, Site
from scuhand_bt.devices.liveness import Liveness
from scuhand_bt.drivers import driver_of
from scuhand_bt.specs import Container


@dataclass(frozen=True)
class Devices:
    """The open devices of a cell, the further ones by their names."""

    arm: Arm
    hand: Hand
    balance: Balance
    changer: Changer | None
    """None where the operator changes containers."""
    others: Mapping[str, Device]
    close: Callable[[], None]
    """Close the valve and all ports; the arm goes on holding."""


def connect_cell_devices(
    spec: CellSpec,
    clock: Clock,
    liveness: Liveness | None = None,
    *,
    may_torque: bool = True,
    slot_of: Callable[[Container], int] = lambda container: 0,
    roller_file: Path | None = None,
) -> Devices:
    """Open everything; SkillFailed device.lost names the port that cannot be, and what to do.

    `liveness` is the pulse of the run's tick; without one, only a dead or stopped process is noticed. Without
    `may_torque` an arm that has no torque is refused, as arm.limp. `slot_of` is the slot of the changer, from 0, that a
    container is in. `roller_file` is where it is kept how far the sheet is rolled; without one only while this program
    has the hand.
    """
    liveness = liveness or Liveness()
    servos = Servos(spec, liveness, roller_file)
    made: dict[str, Any] = {}
    with ExitStack() as opened:

        def connect(name: str) -> None:
            site = site_of(spec, name, clock, liveness, may_torque, slot_of, servos)
            made[name] = driver_of(spec.kind_of(name), site.spec.driver).connect(site)
            opened.callback(made[name].close)

        connect("balance")
        opened.callback(servos.close)
        servos.open(may_torque=may_torque)
        by_hand = spec.changer.driver == "operator"
        for name in spec.device_names:
            if name != "balance" and not (name == "changer" and by_hand):
                connect(name)
        others = {name: device for name, device in made.items() if name not in DEVICES}
        close = opened.pop_all().close
        return Devices(made["arm"], made["hand"], made["balance"], made.get("changer"), others, close)


def site_of(spec: CellSpec, name: str, clock: Clock, *rest: Any) -> Site:
    """Where the device of this name connects."""
    return Site(spec.section(name), spec.options_of(name), clock, *rest)


def connect_alone(spec: CellSpec, name: str, clock: Clock) -> Any:
    """Open one device by itself, neither arm nor hand; SkillFailed device.lost."""
    return driver_of(spec.kind_of(name), spec.section(name).driver).connect(site_of(spec, name, clock))
