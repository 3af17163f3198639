"""The simulated hand: the sheet's size, the valve at the apex, the vibration motor.

The valve's servo moves at a constant speed, a dead time after a command. The gap it makes has an error: real opening =
servo + error. The error is drawn as the valve opens and stays until it is shut, because the sheet buckles a little
differently each time. Near shut the error fades to zero. The servo's encoder cannot see the error: `opening_mm`
reports the servo.
"""

import math
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import ClassVar

import numpy as np

from scuhand_bt.clock import Clock, Signal, Steps, Wake
from scuhand_bt.device_specs.hand import MOUNTED_DIAMETER_MM, HandSpec
from scuhand_bt.devices.arguments import (
    check_rim,
    checked_course,
    checked_duration,
    checked_dwell,
    checked_vibration,
    possible_opening,
    require_streaming,
)
from scuhand_bt.devices.hand_protocol import LONGEST_DWELL_S
from scuhand_bt.devices.interfaces import Forming
from scuhand_bt.devices.roller import rims_mm, roller_lost
from scuhand_bt.dosing.cone import Cone, edge_travel_mm
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.motion.axes import SomeAxes
from scuhand_bt.motion.kinematics import Mount
from scuhand_bt.sim.faults import Faults

FADE_MM = 0.2
"""Below this servo position the opening's error fades to zero."""
SHUT_MM = 0.01
"""A valve that is open less than this counts as shut."""
SLOW = 0.4
"""The share of its speed that a slow valve still has (fault `valve.slow`)."""
NO_ROLLER = frozenset({"arm.lost", "arm.no_power"})
"""Faults that stop the roller: it is on the arm's bus and has the arm's supply."""
STUCK_S = 2.5
"""A valve is stuck if it has had a command to move for this long in total, and has not moved."""
DEAD_MAN_S = 0.3
"""The hand's controller closes the valve if the host is silent for this long."""


class SimulatedHand:
    """The hand in the world; see `scuhand_bt.devices.interfaces.Hand`."""

    identity = ""

    STATE: ClassVar[tuple[str, ...]] = (
        "vibration",
        "cone_diameter_mm",
        "_servo_mm",
        "_target_mm",
        "_real_mm",
        "_error_mm",
        "_sample_error_mm",
        "_commands",
        "_morph",
        "_moved",
        "_rng",
        "_blocked_s",
        "_seized_s",
        "knows_its_roller",
    )
    """The attributes that the world's file keeps."""

    def __init__(self, spec: HandSpec, clock: Clock, mount_of: Callable[[float], Mount] | None = None) -> None:
        self.spec = spec
        self._mount_of = mount_of or partial(Mount.of, spec)
        self.longest_dwell_s = LONGEST_DWELL_S
        self.news = Signal()
        self.on_start: Callable[[Forming], None] = lambda forming: None
        self.vibration = 0.0
        self.cone_diameter_mm = MOUNTED_DIAMETER_MM
        self.knows_its_roller = True
        self.faults = Faults()
        """Its active faults; the world replaces it by its own."""
        self._blocked_s = 0.0
        self._seized_s = -math.inf  # when its controller last closed the valve by itself
        self._was_faulty = self._was_lost = False
        self._clock = clock
        self._servo_mm = self._target_mm = self._real_mm = 0.0
        self._error_mm = self._sample_error_mm = 0.0
        self._commands: deque[tuple[float, float]] = deque()  # (run time it takes effect, servo target)
        self._morph: tuple[float, float, float, float] | None = None  # start, end [s], from, to [mm]
        self._course: tuple[float, SomeAxes] | None = None  # since when [s], of a motion with the arm
        self._moved = self._closes = False
        self._mount: tuple[float, Mount] | None = None
        self.use_randomness(np.random.default_rng(0))

    # --- what skills and drivers see ---

    @property
    def opening_mm(self) -> float:
        return 0.0 if self._is_lost else self._servo_mm

    @property
    def is_stopped(self) -> bool:
        return not (self.is_active or self._is_lost)

    @property
    def fault(self) -> SkillFailed | None:
        """Its present fault; None if it is sound."""
        active = self.faults.active
        if not active:
            return None
        if "hand.emergency_stop" in active:
            return SkillFailed(Code.DEVICE_EMERGENCY_STOP, "the hand controller: the emergency stop is pressed")
        if "hand.lost" in active:
            return SkillFailed(Code.DEVICE_LOST, "the hand controller does not answer; check its cable and supply")
        if "valve.no_power" in active:
            return SkillFailed(Code.HAND_VALVE_LOST, "the hand controller: the valve's servo does not answer")
        if self._blocked_s >= STUCK_S:
            stands = f"it stands at {self._servo_mm:.2f} mm and was told to go to {self._target_mm:.2f} mm"
            return SkillFailed(Code.HAND_VALVE_STUCK, f"the valve does not move: {stands}")
        return None

    def stop(self) -> None:
        if self._course is not None:
            begin_s, course = self._course
            self._course = begin_s, course.stopped_from(self._clock.now_s - begin_s)
        self._morph = None
        if not self._is_lost:
            self.shut(self._clock.now_s)

    @property
    def possible_rims_mm(self) -> Sequence[float]:
        return rims_mm(Cone(self.cone_diameter_mm, self.spec.sheet_radius_mm).roller_deg(self.spec), self.spec)

    def rim_is(self, diameter_mm: float) -> None:
        check_rim(diameter_mm, self.spec)
        self.cone_diameter_mm, self.knows_its_roller = diameter_mm, True

    def start_morph(self, cone_diameter_mm: float, duration_s: float | None = None) -> None:
        check_rim(cone_diameter_mm, self.spec)
        duration_s = checked_duration(duration_s)
        self._require_roller()
        fastest_s = edge_travel_mm(self.cone_diameter_mm, cone_diameter_mm) / self.spec.morph_speed_mm_per_s
        begin_s = self._clock.now_s
        end_s = begin_s + max(fastest_s, duration_s, 1e-6)
        from_mm = self.cone_diameter_mm
        duration_s = end_s - begin_s
        by_mm = cone_diameter_mm - from_mm
        self.on_start(Forming(duration_s, lambda s: from_mm + min(1.0, s / duration_s) * by_mm, with_arm=False))
        self._morph = (begin_s, end_s, from_mm, cone_diameter_mm)

    def start_rolling(self, course: SomeAxes) -> None:
        self._require_roller()
        checked_course(course, self.spec, self.cone_diameter_mm)
        self.on_start(Forming(course.duration_s, lambda s: self._rolled_mm(course, s), with_arm=True))
        self._morph, self._course = None, (self._clock.now_s, course)

    def morph(self, cone_diameter_mm: float, duration_s: float | None = None) -> Steps[None]:
        self.start_morph(cone_diameter_mm, duration_s)
        try:
            while self._morph is not None:
                yield Wake.on(self.news, self._morph[1])
        finally:
            self.hold_sheet()
        self._require_roller()

    def pulse(self, opening_mm: float, dwell_s: float, vibration: float = 0.0) -> Steps[None]:
        opening_mm = possible_opening(opening_mm, self.spec)
        dwell_s, vibration = checked_dwell(dwell_s, self.longest_dwell_s), checked_vibration(vibration)
        self._require_sound()
        ramp_s = opening_mm / self.spec.valve_speed_mm_per_s
        begin_s = self._clock.now_s
        self.set_vibration(vibration)
        self._command(opening_mm, begin_s)
        self._command(0.0, begin_s + ramp_s + dwell_s)
        shut_s = begin_s + 2.0 * ramp_s + dwell_s + self.spec.valve_dead_time_s
        is_shut = False
        try:
            while not is_shut:
                yield Wake.on(self.news, max(shut_s, self._clock.now_s + self.spec.valve_dead_time_s))
                self._require_sound()
                is_over = self._clock.now_s >= shut_s or not self._commands  # or it was shut earlier
                is_shut = is_over and self._servo_mm <= SHUT_MM
        finally:
            if not is_shut and not self._is_lost:
                self.shut(self._clock.now_s)
        self.set_vibration(0.0)

    def set_opening(self, opening_mm: float) -> None:
        require_streaming(self.spec)
        opening_mm = possible_opening(opening_mm, self.spec)
        if opening_mm > 0.0:
            self._require_sound()
        if not self._is_lost:
            self._command(opening_mm, self._clock.now_s)

    def set_vibration(self, level: float) -> None:
        if checked_vibration(level) > 0.0:
            self._require_sound()
        if not self._is_lost:
            self.vibration = level

    # --- what the world does with it ---

    def mount(self) -> Mount:
        """How it holds its cone now."""
        diameter_mm = self.cone_diameter_mm
        if self._mount is None or self._mount[0] != diameter_mm:
            self._mount = diameter_mm, self._mount_of(diameter_mm)
        return self._mount[1]

    @property
    def is_active(self) -> bool:
        """Whether anything moves, vibrates or is open, or is about to."""
        return bool(
            self._servo_mm or self._commands or self.vibration or self._target_mm or self._morph or self._course
        )

    @property
    def gap_mm(self) -> float:
        """The real opening now."""
        return self._real_mm

    @property
    def felt_vibration(self) -> float:
        """The real vibration, 0..1, whatever the command."""
        return 0.0 if "vibration.dead" in self.faults.active else self.vibration

    @property
    def is_closing(self) -> bool:
        """Whether the cone is getting smaller."""
        return self._closes or (self._morph is not None and self._morph[3] < self._morph[2])

    def shut(self, now_s: float) -> None:
        """The controller's dead-man: close the valve, whatever the command, and stop the vibration."""
        self._commands.clear()
        self._command(0.0, now_s)
        self.vibration = 0.0

    def freeze(self) -> None:
        """A power cut: the valve stays where it is, and the vibration stops."""
        self._commands.clear()
        self._target_mm = self._servo_mm
        self.vibration = 0.0

    def hold_sheet(self) -> None:
        """The roller's watchdog: the sheet keeps its size."""
        self._morph = self._course = None
        self._closes = False

    def use_randomness(self, rng: np.random.Generator) -> None:
        """Draw from this generator from now on; draws the new sample's constant error at once."""
        self._rng = rng
        self._sample_error_mm = self.spec.simulation.sample_mm * rng.standard_normal()

    def advance(self, end_s: float, dt_s: float) -> float:
        """Advance by `dt_s`; returns the mean real opening [mm] over it."""
        if self.faults.active or self._was_faulty:
            self._apply_faults(end_s - dt_s)
        if self._morph is not None:
            self._advance_morph(end_s)
        if self._course is not None:
            self._advance_course(end_s)
        if not self._commands and self._servo_mm == self._target_mm:
            if self._moved and not self.is_active:
                self._moved = False
                self.news.fire()
            return self._real_mm
        self._moved = True
        opened_mm_s, at_s = 0.0, end_s - dt_s
        while at_s < end_s:
            until_s = end_s
            if self._commands:
                begin_s, target_mm = self._commands[0]
                if begin_s <= at_s + 1e-9:
                    self._commands.popleft()
                    self._turn_to(target_mm, at_s)
                    continue
                until_s = min(end_s, begin_s)
            way_mm = self._target_mm - self._servo_mm
            step_mm = self._way_in(until_s - at_s, way_mm)
            if abs(way_mm) <= step_mm:
                self._servo_mm = self._target_mm
            else:
                self._servo_mm += math.copysign(step_mm, way_mm)
            before_mm, self._real_mm = self._real_mm, self._gap_mm()
            opened_mm_s += (before_mm + self._real_mm) / 2.0 * (until_s - at_s)
            at_s = until_s
        return opened_mm_s / dt_s

    def _way_in(self, dt_s: float, way_mm: float) -> float:
        """How far the valve can move in this time."""
        step_mm = self.spec.valve_speed_mm_per_s * dt_s
        active = self.faults.active
        if not active or way_mm == 0.0:
            return step_mm
        if "valve.no_power" in active:
            return 0.0
        if ("valve.stuck_open" if way_mm < 0.0 else "valve.stuck_closed") in active:
            self._blocked_s += dt_s
            return 0.0
        return step_mm * (SLOW if "valve.slow" in active else 1.0)

    def _apply_faults(self, now_s: float) -> None:
        """What the controller does by itself in a fault; fires `news` when a fault begins or ends."""
        active = self.faults.active
        seizing = [active[name] for name in ("hand.emergency_stop", "valve.no_power") if name in active]
        since_s = min(seizing, default=active.get("hand.lost", -math.inf) + DEAD_MAN_S)
        if self._seized_s < since_s <= now_s:
            self._seized_s = now_s
            self.shut(now_s)
        if self._was_lost and not self._is_lost:
            self.shut(now_s)  # as a controller does at a new connection
        self._was_lost = self._is_lost
        if NO_ROLLER & active.keys():
            self.hold_sheet()
        if "arm.no_power" in active:
            self.knows_its_roller = False
        if not ("valve.stuck_open" in active or "valve.stuck_closed" in active):
            self._blocked_s = 0.0
        is_faulty = self.fault is not None
        if is_faulty != self._was_faulty:
            self._was_faulty = is_faulty
            self.news.fire()

    @property
    def _is_lost(self) -> bool:
        return "hand.lost" in self.faults.active

    def _require_sound(self) -> None:
        if (fault := self.fault) is not None:
            raise fault

    def _require_roller(self) -> None:
        if NO_ROLLER & self.faults.active.keys():
            raise SkillFailed(Code.DEVICE_LOST, "the servo bus, which the roller is on, does not answer")
        if not self.knows_its_roller:
            raise roller_lost()

    def _turn_to(self, target_mm: float, now_s: float) -> None:
        if self._servo_mm == 0.0 and self._target_mm == 0.0 and target_mm > 0.0:
            self.faults.opening(now_s)
            figures = self.spec.simulation
            self._error_mm = self._sample_error_mm + figures.opening_mm * self._rng.standard_normal()
            if self._rng.random() < figures.stick_probability:
                self._error_mm += figures.stick_mm
        self._target_mm = target_mm

    def _gap_mm(self) -> float:
        return max(0.0, self._servo_mm + self._error_mm * min(1.0, self._servo_mm / FADE_MM))

    def _command(self, opening_mm: float, at_s: float) -> None:
        self._commands.append((at_s + self.spec.valve_dead_time_s, opening_mm))

    def _advance_morph(self, now_s: float) -> None:
        assert self._morph is not None
        begin_s, end_s, from_mm, to_mm = self._morph
        share = min(1.0, max(0.0, (now_s - begin_s) / (end_s - begin_s)))
        self.cone_diameter_mm = from_mm + share * (to_mm - from_mm)
        if share >= 1.0:
            self._morph = None
            self.news.fire()

    def _advance_course(self, now_s: float) -> None:
        assert self._course is not None
        begin_s, course = self._course
        before_mm = self.cone_diameter_mm
        self.cone_diameter_mm = self._rolled_mm(course, now_s - begin_s)
        self._closes = self.cone_diameter_mm < before_mm
        if now_s - begin_s >= course.duration_s - 1e-9:
            self.hold_sheet()
            self.news.fire()

    def _rolled_mm(self, course: SomeAxes, time_s: float) -> float:
        """The rim's diameter at this time of a course of the roller."""
        return Cone.from_roller(math.degrees(float(course.sample(time_s)[0])), self.spec).diameter_mm
