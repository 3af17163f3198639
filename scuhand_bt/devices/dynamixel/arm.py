"""The CRANE-X7 on the servo bus; meets `devices.interfaces.Arm`.

Source of ids, models, windows, home counts and gains: `rt-net/rt_manipulators_cpp`,
`samples/samples03/config/crane-x7_links.csv` (Apache-2.0), and RT's ROS 2 configuration.
"""

import math
from collections.abc import Callable

import numpy as np

from scuhand_bt.clock import Signal, Steps, Wake
from scuhand_bt.device_specs.arm import ArmSpec
from scuhand_bt.devices.arguments import check_trajectory
from scuhand_bt.devices.dynamixel.axes import Axis
from scuhand_bt.devices.dynamixel.axis_group import AxisGroup
from scuhand_bt.devices.dynamixel.registers import XM430, XM540
from scuhand_bt.devices.dynamixel.servo_loop import ServoChain, fault_of
from scuhand_bt.devices.interfaces import Joints, Trajectory
from scuhand_bt.failures import SkillFailed

GAINS = (
    (1000, 300, 200),
    (2200, 500, 500),
    (3000, 800, 1000),
    (1600, 400, 400),
    (800, 200, 200),
    (800, 100, 200),
    (800, 100, 200),
)
"""P, I and D of joints 1 to 7."""


def arm_axes(spec: ArmSpec) -> list[Axis]:
    """The seven joints of the cell's arm."""
    options = spec.options
    return [
        Axis(
            servo=options.servo_ids[index],
            name=f"joint {index + 1}",
            model=XM540 if index == 1 else XM430,
            home_count=options.home_counts[index],
            direction=options.directions[index],
            pid=GAINS[index],
            following_limit_rad=math.radians(options.following_limit_deg),
        )
        for index in range(7)
    ]


class DynamixelArm:
    """The seven joints, streamed to over a chain that is already open."""

    def __init__(self, chain: ServoChain, group: AxisGroup) -> None:
        self._chain = chain
        self._group = group
        self.on_start: Callable[[Trajectory], None] = lambda trajectory: None

    @property
    def news(self) -> Signal:
        return self._chain.news

    @property
    def is_stopped(self) -> bool:
        return not self._group.is_moving

    @property
    def positions(self) -> Joints:
        return self._group.positions_rad

    @property
    def was_limp(self) -> bool:
        return any(state.was_limp for state in self._group.states)

    @property
    def fault(self) -> SkillFailed | None:
        """What is wrong with the bus now, or ended the last motion early, until the next one begins."""
        return fault_of(self._chain, self._group)

    def close(self) -> None:
        """Close the bus; the servos go on holding."""
        self._chain.close()

    def stop(self) -> None:
        """Come to rest along the path as the trajectory tells, and hold there."""
        self._group.stop()

    def start(self, trajectory: Trajectory) -> None:
        """Begin a trajectory that starts where the arm is."""
        if self._chain.trouble is not None:
            raise self._chain.trouble
        windows_rad = np.array([state.window_rad for state in self._group.states]).T
        check_trajectory(trajectory, self.positions, windows_rad, is_moving=self._group.is_streaming)
        self.on_start(trajectory)
        self._group.move(trajectory)

    def follow(self, trajectory: Trajectory) -> Steps[None]:
        """Start the trajectory and wait until the arm is at rest; SkillFailed with the fault that ended it early."""
        self.start(trajectory)
        try:
            while True:
                wake = Wake.on(self.news)
                if self._group.fault is not None:
                    raise self._group.fault
                if not self._group.is_moving:
                    return
                yield wake
        finally:
            self._group.stop()
