"""The SCU-Hand-SV: its roller on the servo bus, its valve and vibration behind a microcontroller.

Meets `devices.interfaces.Hand`.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np

from scuhand_bt.clock import Clock, Signal, Steps, Wake
from scuhand_bt.device_specs.hand import HandSpec
from scuhand_bt.devices.arguments import (
    check_rim,
    checked_course,
    checked_duration,
    checked_dwell,
    checked_vibration,
    possible_opening,
    require_streaming,
)
from scuhand_bt.devices.dynamixel import registers as r
from scuhand_bt.devices.dynamixel.axes import Axis
from scuhand_bt.devices.dynamixel.axis_group import AxisGroup
from scuhand_bt.devices.dynamixel.servo_loop import ServoChain, fault_of
from scuhand_bt.devices.hand_controller import HandController
from scuhand_bt.devices.hand_protocol import FAULTS, LONGEST_DWELL_S
from scuhand_bt.devices.interfaces import Forming, Joints
from scuhand_bt.devices.roller import BEYOND_DEG, RollerRecord, rims_mm, roller_lost
from scuhand_bt.dosing.cone import Cone, edge_travel_mm
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.motion.axes import SomeAxes

ROLLER_SPEED_RAD_PER_S = 0.9 * r.XM430.velocity_limit * r.RPM_PER_COUNT * 2 * math.pi / 60
"""The fastest the roller is asked to turn."""
MOVE_TIMEOUT_S = 5.0
"""Dead time, the way to the opening and back; the controller itself calls a stuck valve after 2.5 s."""


def roller_axis(spec: HandSpec) -> Axis:
    """The roller's servo."""
    return Axis(
        servo=spec.options.roller_id,
        name="roller",
        model=r.XM430,
        mode=r.EXTENDED_POSITION_MODE,
        home_count=0,
        direction=spec.options.roller_direction,
        following_limit_rad=math.radians(30.0),
    )


class Turn:
    """The roller's even turn from one angle [rad] to another; it may end anywhere, as nothing depends on its path."""

    def __init__(self, begin_rad: float, end_rad: float, duration_s: float) -> None:
        self.duration_s = duration_s
        self._begin_rad = begin_rad
        self._speed_rad_per_s = (end_rad - begin_rad) / duration_s

    def sample(self, time_s: float) -> Joints:
        return np.array([self._begin_rad + self._speed_rad_per_s * min(time_s, self.duration_s)])

    def stopped_from(self, at_s: float) -> "Turn":
        until_s = min(max(at_s, 1e-3), self.duration_s)
        return Turn(self._begin_rad, self._begin_rad + self._speed_rad_per_s * until_s, until_s)


class ScuHand:
    """The hand, over a chain and a controller that are already open.

    How far the sheet is rolled, it knows from the `record` where the roller's servo has kept its turns.
    """

    def __init__(
        self,
        spec: HandSpec,
        controller: HandController,
        chain: ServoChain,
        roller: AxisGroup,
        clock: Clock,
        record: RollerRecord,
    ) -> None:
        self.spec = spec
        self.longest_dwell_s = LONGEST_DWELL_S
        self.on_start: Callable[[Forming], None] = lambda forming: None
        self.news: Signal = controller.news
        """The same signal as the chain's."""
        self._controller = controller
        self._chain = chain
        self._roller = roller
        self._clock = clock
        self._record = record
        if (count := record.count) is not None:
            low_deg, high_deg = count.between_deg
            if not low_deg - BEYOND_DEG <= self._roller_deg <= high_deg + BEYOND_DEG:
                record.turns_were_lost()

    @property
    def identity(self) -> str:
        hello = self._controller.hello
        return "" if hello is None else hello.firmware

    @property
    def is_stopped(self) -> bool:
        return self._controller.is_safe and not self._roller.is_moving

    @property
    def fault(self) -> SkillFailed | None:
        """What is wrong with its controller, its roller, or the bus that this is on.

        That the controller has once closed the valve because it heard nothing concerns the dose alone: it hears again.
        """
        report = self._controller.report
        heard_nothing = report is not None and report.faults == "d"
        return (None if heard_nothing else self._valve_fault) or fault_of(self._chain, self._roller)

    @property
    def _valve_fault(self) -> SkillFailed | None:
        report = self._controller.report
        if self._controller.trouble is not None or report is None or not report.faults:
            return self._controller.trouble
        code = next(code for letter, code in FAULT_CODES.items() if letter in report.faults)
        return SkillFailed(code, f"the hand controller: {report.why}")

    @property
    def cone_diameter_mm(self) -> float:
        if not self.knows_its_roller:
            return self.spec.options.start_diameter_mm
        return self._rim_mm(self._roller.positions_rad)

    @property
    def knows_its_roller(self) -> bool:
        return self._record.count is not None and self._record.count.is_intact

    @property
    def possible_rims_mm(self) -> Sequence[float]:
        if (count := self._record.count) is None:
            return ()
        return rims_mm(count.at_zero_deg + self._roller_deg, self.spec)

    @property
    def opening_mm(self) -> float:
        report = self._controller.report
        return 0.0 if report is None else max(0.0, report.opening_mm)

    def stop(self) -> None:
        """Close the valve, stop vibrating, and hold the sheet."""
        self._controller.make_safe()
        self._roller.stop()

    def close(self) -> None:
        """Close the valve and the controller's port; the chain is the arm's to close."""
        self._controller.close()

    def rim_is(self, diameter_mm: float) -> None:
        check_rim(diameter_mm, self.spec)
        here_deg = self._roller_deg
        self._record.keep(self._cone(diameter_mm).roller_deg(self.spec) - here_deg, (here_deg, here_deg))

    def start_morph(self, cone_diameter_mm: float, duration_s: float | None = None) -> None:
        """Begin to change the cone's size, no faster than the hand's speed and than the roller's servo can."""
        check_rim(cone_diameter_mm, self.spec)
        duration_s = checked_duration(duration_s)
        self._require_roller()
        begin_rad = float(self._roller.goals_rad[0])
        end_rad = math.radians(self._cone(cone_diameter_mm).roller_deg(self.spec) - self._at_zero_deg)
        fastest_s = edge_travel_mm(self.cone_diameter_mm, cone_diameter_mm) / self.spec.morph_speed_mm_per_s
        servo_s = abs(end_rad - begin_rad) / ROLLER_SPEED_RAD_PER_S
        self._keep(begin_rad, end_rad)
        self._form(Turn(begin_rad, end_rad, max(duration_s, fastest_s, servo_s, 0.02)), with_arm=False)

    def start_rolling(self, course: SomeAxes) -> None:
        """Begin to turn the roller along a course that is counted from the flat sheet."""
        self._require_roller()
        ends_rad = checked_course(course, self.spec, self.cone_diameter_mm)
        zero_rad = math.radians(self._at_zero_deg)
        self._keep(*(end_rad - zero_rad for end_rad in ends_rad))
        self._form(course.counted_from(zero_rad), with_arm=True)

    def morph(self, cone_diameter_mm: float, duration_s: float | None = None) -> Steps[None]:
        """Change the cone's size and wait for it; SkillFailed with what ended it early."""
        self.start_morph(cone_diameter_mm, duration_s)
        try:
            while True:
                wake = Wake.on(self.news)
                if self._roller.fault is not None:
                    raise self._roller.fault
                if not self._roller.is_moving:
                    return
                yield wake
        finally:
            self._roller.stop()

    def pulse(self, opening_mm: float, dwell_s: float, vibration: float = 0.0) -> Steps[None]:
        """The step command; returns when the valve is shut. SkillFailed with what went wrong.

        Closed early, by a halt or a failure, it closes the valve.
        """
        opening_mm = possible_opening(opening_mm, self.spec)
        dwell_s, vibration = checked_dwell(dwell_s, self.longest_dwell_s), checked_vibration(vibration)
        self._raise_trouble()
        self._controller.step(opening_mm, dwell_s, vibration)
        deadline_s = self._clock.now_s + dwell_s + MOVE_TIMEOUT_S
        shut = False
        try:
            while not shut:
                wake = Wake.on(self.news, deadline_s)
                self._raise_trouble()
                shut = self._controller.is_safe
                if not shut:
                    if self._clock.now_s >= deadline_s:
                        raise SkillFailed(
                            Code.DEVICE_BUSY, f"the valve was not shut {MOVE_TIMEOUT_S:g} s after its dwell"
                        )
                    yield wake
        finally:
            if not shut:
                self._controller.make_safe()

    def set_opening(self, opening_mm: float) -> None:
        """Go to this opening now. Opening fails while something is wrong; closing never does."""
        require_streaming(self.spec)
        opening_mm = possible_opening(opening_mm, self.spec)
        if opening_mm > 0.0:
            self._raise_trouble()
        self._controller.set_opening(opening_mm)

    def set_vibration(self, level: float) -> None:
        """Vibrate at this level. Starting fails while something is wrong; stopping never does."""
        level = checked_vibration(level)
        if level > 0.0:
            self._raise_trouble()
        self._controller.set_vibration(level)

    def _form(self, course: Turn | SomeAxes, *, with_arm: bool) -> None:
        """Turn the roller along a course that is counted from its servo's zero."""
        self.on_start(Forming(course.duration_s, lambda s: self._rim_mm(course.sample(s)), with_arm))
        self._roller.move(course)

    def _rim_mm(self, roller_rad: Joints) -> float:
        """The cone's rim with the roller's servo there."""
        return Cone.from_roller(self._at_zero_deg + math.degrees(float(roller_rad[0])), self.spec).diameter_mm

    @property
    def _roller_deg(self) -> float:
        return math.degrees(float(self._roller.positions_rad[0]))

    @property
    def _at_zero_deg(self) -> float:
        assert self._record.count is not None
        return self._record.count.at_zero_deg

    def _require_roller(self) -> None:
        if self._chain.trouble is not None:
            raise self._chain.trouble
        if not self.knows_its_roller:
            raise roller_lost()

    def _keep(self, *ends_rad: float) -> None:
        """On disk, before the roller turns: between where it is and where it will be, on the servo's count."""
        ends_deg = [self._roller_deg, *(math.degrees(end_rad) for end_rad in ends_rad)]
        self._record.keep(self._at_zero_deg, (min(ends_deg), max(ends_deg)))

    def _cone(self, diameter_mm: float) -> Cone:
        return Cone(diameter_mm, self.spec.sheet_radius_mm)

    def _raise_trouble(self) -> None:
        """Raise what is wrong; what was raised once is cleared, where its cause has gone."""
        controller = self._controller
        refused, controller.refused = controller.refused, None
        fault = self._valve_fault
        if fault is not None and controller.trouble is None:
            controller.reset()
        if (wrong := fault or refused) is not None:
            raise wrong


FAULT_CODES = {
    "e": Code.DEVICE_EMERGENCY_STOP,
    "s": Code.HAND_VALVE_LOST,
    "t": Code.HAND_VALVE_STUCK,
    "d": Code.DEVICE_LOST,
}
"""The failure that each of the controller's faults is, the most serious first."""
assert FAULT_CODES.keys() == FAULTS.keys()
