"""The thread that owns the bus: streams goals at 100 Hz, reads the servos at 50 Hz, and guards them.

What moves, and how it stops, each group of servos knows (`axis_group.py`); a fault freezes its goals where they are.
Torque is never dropped: the arm has no brakes. An arm that has lost it is limp, and so it stays for this program: it is
listened to, and nothing is written any more.
"""

import contextlib
import threading
import time
from collections.abc import Sequence

import numpy as np

from scuhand_bt.clock import Signal
from scuhand_bt.devices.dynamixel import registers as r
from scuhand_bt.devices.dynamixel.axes import (
    BLOCK_LENGTH,
    BLOCK_START,
    WATCHDOG_UNITS,
    Axis,
    AxisState,
    hold_again,
    set_up,
    shut_down,
)
from scuhand_bt.devices.dynamixel.axis_group import AxisGroup
from scuhand_bt.devices.dynamixel.bus import BusError, BusLost, DynamixelBus, NoAnswer, Status
from scuhand_bt.devices.liveness import Liveness
from scuhand_bt.devices.serial_link import REOPEN_S, why_not_open
from scuhand_bt.failures import Code, SkillFailed

PERIOD_S = 0.01
"""Of the stream of goals; the servos are read in every second cycle."""
RESUME_LIMIT_S = 0.5
"""A motion goes on by itself after a pause of this computer that was shorter."""
LONGEST_STEP_S = 0.02
"""Of a motion's time in one cycle: after a late one the arm falls behind its time, not off its path."""
LOOKS = 3
"""Times that a servo is asked, one after the other, before it is taken for silent: known within 100 ms."""
FAR_LIMIT_S = 0.15
"""How long a servo may be too far from its goal."""
HOT_MARGIN_C = 5
"""Below the temperature at which a servo shuts itself down (and the arm falls)."""


class ServoChain:
    """All servos of one bus, and the thread that talks to them."""

    def __init__(
        self,
        bus: DynamixelBus,
        groups: Sequence[AxisGroup],
        news: Signal | None = None,
        liveness: Liveness | None = None,
        reopen_s: float = REOPEN_S,
    ) -> None:
        self.bus = bus
        self.groups = list(groups)
        self.news = news or Signal()
        self.lost: SkillFailed | None = None
        """Why the bus cannot be used now."""
        self.limp: SkillFailed | None = None
        """How the servos were found without torque. Only a person gives it back, by a new run or a resumed one."""
        self._liveness = liveness or Liveness()
        self._reopen_s = reopen_s
        self._fast = True
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"servos {bus.url}", daemon=True)

    def open(self, *, may_torque: bool = True) -> None:
        """Open the bus, set up every servo and begin; raises SkillFailed.

        `may_torque`: a person has seen to an arm without torque; without that it is refused as arm.limp.
        """
        try:
            self.bus.open()
        except BusLost as error:
            raise SkillFailed(Code.DEVICE_LOST, why_not_open(self.bus.url, error)) from error
        try:
            if not may_torque:
                self._require_torque()
            self._set_up()
        except BusError as error:
            self.bus.close()
            raise SkillFailed(
                Code.DEVICE_LOST, f"{error} on {self.bus.url}; check the servo's cable, its id and the supply"
            ) from error
        except SkillFailed:
            self.bus.close()
            raise
        self._thread.start()

    def _require_torque(self) -> None:
        with self.bus.patience():
            without = [axis.name for axis in self._axes if not self.bus.read(axis.servo, r.TORQUE_ENABLE)]
        if without:
            what = f"{', '.join(without)} on {self.bus.url} have no torque: support the arm, and allow them to hold it"
            raise SkillFailed(Code.ARM_LIMP, f"{what} where it is (`resume` at a terminal, or with --yes)")

    def close(self) -> None:
        """End the thread. The servos go on holding, with their watchdogs off."""
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join()
        if self.bus.is_open:
            self._disarm()
        self.bus.close()

    def _disarm(self) -> None:
        try:
            self.bus.sync_write(r.BUS_WATCHDOG, {axis.servo: 0 for axis in self._axes})
        except BusError:
            return  # then the watchdogs stop what they guard, which stands still anyway

    @property
    def trouble(self) -> SkillFailed | None:
        """Why nothing can be moved now."""
        return self.limp or self.lost

    @property
    def _axes(self) -> list[Axis]:
        return [axis for group in self.groups for axis in group.axes]

    @property
    def _states(self) -> list[AxisState]:
        return [state for group in self.groups for state in group.states]

    def _set_up(self) -> None:
        for group in self.groups:
            with self.bus.patience():  # a late answer on a busy computer is no missing servo
                group.states = [set_up(self.bus, axis, group.was_without_torque) for axis in group.axes]
            group.goals_rad = group.positions_rad
        self._hold()
        self._read()

    def _run(self) -> None:
        """One cycle every 10 ms; one that comes late is not made up for."""
        due_s = last_s = time.monotonic()
        read_now = True
        while not self._closing.wait(max(0.0, due_s - time.monotonic())):
            now_s = time.monotonic()
            dt_s, last_s = now_s - last_s, now_s
            due_s = max(due_s + PERIOD_S, now_s)
            try:
                if self.limp is not None:
                    self._listen()
                elif self.lost is not None:
                    self._come_back()
                else:
                    self._cycle(dt_s, now_s, read_now)
            except BusError as error:
                self._lose(SkillFailed(Code.DEVICE_LOST, f"{self.bus.url}: {error}; check the cable and the supply"))
            except Exception as error:
                self._lose(SkillFailed(Code.DEVICE_LOST, f"the thread of {self.bus.url} has failed: {error!r}"))
                raise
            read_now = not read_now

    def _cycle(self, dt_s: float, now_s: float, read_now: bool) -> None:
        if dt_s > WATCHDOG_UNITS * r.WATCHDOG_UNIT_S:
            self._recover(dt_s)
            dt_s = 0.0
        moving = [group for group in self.groups if group.is_streaming]
        if not self._liveness.is_alive and (watched := [group for group in moving if group.watched]):
            pause_ms = self._liveness.silent_s * 1000
            for group in watched:
                detail = f"the run hung for {pause_ms:.0f} ms; the arm was stopped"
                group.freeze(SkillFailed(Code.COMPUTER_BUSY, detail))
            self._hold()
        for group in moving:
            group.advance(min(dt_s, LONGEST_STEP_S))
            if fault := group.beyond():
                group.freeze(fault)
        if moving:
            self._write_goals(moving)
        if read_now:
            self._read()
            if self.lost is not None or self._has_gone_limp():
                return
            if any(state.tripped for state in self._states):
                self._recover(dt_s)  # the line was silent, though this thread was not: a busy adapter or system
            self._guard(now_s)
            self.news.fire()

    def _recover(self, pause_s: float) -> None:
        """The line was silent, and the watchdogs have stopped the servos: go on, from rest, if that was short."""
        for group in self.groups:
            if pause_s < RESUME_LIMIT_S:
                group.rest()
            elif group.is_streaming:
                detail = f"this computer paused for {pause_s * 1000:.0f} ms; the servos have stopped"
                group.freeze(SkillFailed(Code.COMPUTER_BUSY, detail))
        self._hold()

    def _write_goals(self, groups: Sequence[AxisGroup]) -> None:
        goals = {axis.servo: axis.count(group.goal_of(axis)) for group in groups for axis in group.axes}
        self.bus.sync_write(r.GOAL_POSITION, goals)

    def _hold(self) -> None:
        for group in self.groups:
            hold_again(self.bus, group.axes, group.goal_of)

    def _read(self) -> None:
        answers = self._ask_all([axis.servo for axis in self._axes])
        for state in self._states:
            answer = answers.get(state.axis.servo)
            if answer is not None:
                state.take(answer.data)
        silent = [state.axis for state in self._states if state.axis.servo not in answers]
        if silent and not answers:
            what = f"no servo on {self.bus.url} answers any more: they have no supply, or the line is broken"
            self._lose(SkillFailed(Code.ARM_LIMP, what))
        elif silent:
            raise NoAnswer(f"servo {silent[0].servo} ({silent[0].name}) does not answer")

    def _ask_all(self, servos: list[int]) -> dict[int, Status]:
        """What the servos answer, asked up to `LOOKS` times."""
        if self._fast:
            with contextlib.suppress(NoAnswer):
                return self.bus.fast_sync_read(servos, BLOCK_START, BLOCK_LENGTH)
        # One of them is missing, or its firmware is too old to answer so: ask so that each answers.
        answers = self.bus.sync_read(servos, BLOCK_START, BLOCK_LENGTH, again=self._fast)
        self._fast = self._fast and len(answers) < len(servos)
        for _ in range(LOOKS - 2):
            if missing := [servo for servo in servos if servo not in answers]:
                answers |= self.bus.sync_read(missing, BLOCK_START, BLOCK_LENGTH, again=True)
        return answers

    def _has_gone_limp(self) -> bool:
        """One that has shut itself down is no matter of power: it says so."""
        if self.limp is None:
            without = [state for state in self._states if not (state.has_torque or state.hardware_error)]
            if without:
                names, volts = ", ".join(state.axis.name for state in without), without[0].voltage_v
                what = f"{names} lost torque: the supply was off, or is too weak; it has {volts:.1f} V now"
                self.limp = SkillFailed(Code.ARM_LIMP, what)
                self._freeze(self.limp)
                self.news.fire()
        return self.limp is not None

    def _listen(self) -> None:
        """Where limp servos are; nothing is told to them."""
        try:
            if not self.bus.is_open:
                self.bus.open()
            answers = self.bus.sync_read([axis.servo for axis in self._axes], BLOCK_START, BLOCK_LENGTH)
        except BusError:
            self.bus.close()
            self._closing.wait(self._reopen_s)
            return
        for state in self._states:
            if (answer := answers.get(state.axis.servo)) is not None:
                state.take(answer.data)
        self.news.fire()

    def _guard(self, now_s: float) -> None:
        for group in self.groups:
            for state in group.states:
                if fault := self._fault_of(group, state, now_s):
                    if group.is_streaming or state.hardware_error:
                        group.freeze(fault)
                    else:
                        group.fault = fault  # it stays told to be where it should be
                    self._hold()

    def _fault_of(self, group: AxisGroup, state: AxisState, now_s: float) -> SkillFailed | None:
        axis = state.axis
        if state.hardware_error:
            if group.fault is not None and group.fault.code == Code.SERVO_OVERLOAD:
                return None  # said already
            return shut_down(axis, state.hardware_error)
        off_rad = abs(group.goal_of(axis) - state.position_rad)
        if off_rad <= axis.following_limit_rad:
            state.far_since_s = None
        elif state.far_since_s is None:
            state.far_since_s = now_s
        elif now_s - state.far_since_s > FAR_LIMIT_S:
            state.far_since_s = None
            return SkillFailed(
                Code.ARM_NOT_FOLLOWING, f"{axis.name} is {np.degrees(off_rad):.1f}° from where it should be"
            )
        if state.temperature_c >= state.temperature_limit_c - HOT_MARGIN_C and group.is_streaming:
            return SkillFailed(
                Code.SERVO_OVERLOAD,
                f"servo {axis.servo} ({axis.name}) is at {state.temperature_c} °C and shuts down at "
                f"{state.temperature_limit_c} °C; let it cool",
            )
        return None

    def _lose(self, why: SkillFailed) -> None:
        """Nothing is heard any more; whether the arm is limp is seen when it is."""
        self.lost = why
        self._freeze(why)
        self.bus.close()
        self.news.fire()

    def _freeze(self, fault: SkillFailed) -> None:
        for group in self.groups:
            group.freeze(fault)
            for state in group.states:  # nothing more may be heard of them: their watchdogs stop them now
                state.moving, state.velocity_rad_per_s = False, 0.0

    def _come_back(self) -> None:
        """Open the port again and hold, if it is back and all servos are there, and have held meanwhile."""
        if self._closing.wait(self._reopen_s):
            return
        try:
            self.bus.open()
            with self.bus.patience():
                for state in self._states:
                    state.has_torque = self.bus.read(state.axis.servo, r.TORQUE_ENABLE) == 1
                    state.hardware_error = self.bus.read(state.axis.servo, r.HARDWARE_ERROR)
            if self._has_gone_limp():
                return
            self._set_up()
        except (BusError, SkillFailed):
            self.bus.close()
            return
        self.lost = None
        self.news.fire()


def fault_of(chain: ServoChain, group: AxisGroup) -> SkillFailed | None:
    """What is wrong with a group now; a bus that has come back is sound again, one that is limp is not."""
    if chain.trouble is not None:
        return chain.trouble
    fault = group.fault
    return fault if fault is not None and fault.code not in (Code.DEVICE_LOST, Code.ARM_LIMP) else None
