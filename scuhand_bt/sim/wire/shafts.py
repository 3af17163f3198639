"""The world's arm and hand behind twins: their state is that of the servos' shafts and of the board's valve.

The world sees the shafts, not commands.
"""

import math
from collections.abc import Callable

import numpy as np

from scuhand_bt.clock import Clock
from scuhand_bt.device_specs.arm import ArmOptions
from scuhand_bt.device_specs.hand import MOUNTED_DIAMETER_MM, HandSpec
from scuhand_bt.devices.interfaces import Joints
from scuhand_bt.dosing.cone import Cone
from scuhand_bt.motion.kinematics import LIMITS_RAD, Mount
from scuhand_bt.sim.arm import SimulatedArm
from scuhand_bt.sim.hand import SimulatedHand
from scuhand_bt.sim.outage import SAG_RAD
from scuhand_bt.sim.wire.hand import HandTwin
from scuhand_bt.sim.wire.servo import Servo

SHOULDER = 1
STILL_AFTER_S = 0.1
"""What has not moved for this long counts as still."""
SHUT_MM = 0.01
COUNTS_PER_RAD = 4096 / (2 * math.pi)
SINKS_RAD_PER_S = 0.3
"""How fast the shoulder of an arm without power sinks, by `SAG_RAD` at most: then it rests on something."""


class WireArm(SimulatedArm):
    """The world's arm: its joints follow the servos."""

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
        """A person has moved the limp arm there."""
        for servo, count in zip(self._servos, (self._homes + joints * self._per_rad).tolist(), strict=True):
            servo.position = count
            servo.stand()

    @property
    def is_limp(self) -> bool:
        """Whether no servo holds anything."""
        return not any(servo.has_torque and servo.is_powered for servo in self._servos)

    @property
    def joints(self) -> Joints:
        """The joints [rad] by the servos' positions and the way they are mounted."""
        joints: Joints = (np.array([servo.position for servo in self._servos]) - self._homes) / self._per_rad
        return joints

    @property
    def is_active(self) -> bool:
        return self._now_s - self._moved_s < STILL_AFTER_S

    def advance(self, end_s: float) -> None:
        """Take over the servos' positions."""
        self._sink(end_s - self._now_s)
        joints = self.joints
        if np.abs(joints - self._rest).max() > 0.5 / COUNTS_PER_RAD:
            if not self.is_active:
                self.faults.chance("motion", end_s)
            self._moved_s = end_s
            self._hold(joints)
        self._now_s = end_s

    def _sink(self, dt_s: float) -> None:
        """There are no brakes. Once the power is back a person holds the arm, with or without torque."""
        if self._servos[SHOULDER].is_powered:
            self._sunk_rad = 0.0
            return
        by_rad = min(SINKS_RAD_PER_S * dt_s, SAG_RAD - self._sunk_rad)
        self._sunk_rad += by_rad
        joints = self.joints
        joints[SHOULDER] = max(joints[SHOULDER] - by_rad, LIMITS_RAD[0, SHOULDER])
        self.stand_at(joints)


class WireHand(SimulatedHand):
    """The world's hand: its valve follows the twin's, its cone the roller's servo."""

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
        """A sheet is mounted with this rim, at the roller's present angle."""
        self._at_zero_deg = Cone(diameter_mm, self.spec.sheet_radius_mm).roller_deg(self.spec) - self._roller_deg

    @property
    def is_active(self) -> bool:
        morphs = self._now_s - self._morphed_s < STILL_AFTER_S
        return bool(self._servo_mm or self.vibration) or morphs

    @property
    def is_closing(self) -> bool:
        return self._now_s - self._closed_s < STILL_AFTER_S

    def advance(self, end_s: float, dt_s: float) -> float:
        """Take over the state of valve and roller; returns the mean real opening [mm] since the last step."""
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
