"""The arm moved by hand: no torque, and its servos read one by one.

It is never given torque here: who begins the next motion is asked for that.
"""

from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass

import numpy as np

from scuhand_bt.commissioning.step import Dialogue
from scuhand_bt.device_specs.arm import ArmSpec
from scuhand_bt.devices.crane_x7 import bus_of
from scuhand_bt.devices.dynamixel import registers as r
from scuhand_bt.devices.dynamixel.arm import arm_axes
from scuhand_bt.devices.dynamixel.bus import BusError, DynamixelBus
from scuhand_bt.devices.interfaces import Joints
from scuhand_bt.failures import Code, SkillFailed


@dataclass(frozen=True)
class LimpArm:
    """Servos without torque, on an open bus."""

    bus: DynamixelBus
    models: dict[int, int]
    """Model numbers of all servos that answer, by their ids."""

    def counts(self, servos: Sequence[int]) -> list[int]:
        return [self.bus.read(servo, r.PRESENT_POSITION) for servo in servos]

    def joints(self, spec: ArmSpec) -> Joints:
        """Where the joints are [rad], (7,), by the cell's description."""
        axes = arm_axes(spec)
        counts = self.counts([axis.servo for axis in axes])
        return np.array([axis.angle_rad(count) for axis, count in zip(axes, counts, strict=True)])


@contextmanager
def limp(spec: ArmSpec, person: Dialogue, but: int | None = None) -> Iterator[LimpArm]:
    """All servos on the arm's bus, without torque once the person holds the arm. SkillFailed device.lost.

    `but` is the id of one that keeps what torque it has: a roller that was let go is taken to have lost its turns.
    """
    bus = bus_of(spec)
    try:
        bus.open()
        with closing(bus), bus.patience():
            models = bus.scan()
            held = [servo for servo in models if servo != but and bus.read(servo, r.TORQUE_ENABLE)]
            if held:
                person.ask("Hold the arm with both hands: its servos will now let go. Do you hold it?")
            for servo in held:
                bus.write(servo, r.TORQUE_ENABLE, 0)
            yield LimpArm(bus, models)
    except BusError as error:
        raise SkillFailed(Code.DEVICE_LOST, f"{error}; check the cable and the supply of the servos") from None
