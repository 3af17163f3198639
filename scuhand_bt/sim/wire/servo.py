"""One servo of the bus twin: its control table, its locks and limits, and its motion in time.

Source: ROBOTIS e-manual of XM430-W350, XM540-W270 and XC330-T288, and Protocol 2.0. Written from the tables, not from
the driver, so that a mistake in one does not hide in the other.
"""

import math
from dataclasses import dataclass

from scuhand_bt.sim.plain_state import Plain

NO_ERROR, RANGE_ERROR, LENGTH_ERROR, LIMIT_ERROR, ACCESS_ERROR = 0, 4, 5, 6, 7
ALERT = 0x80

TABLE_SIZE = 1024
EEPROM_END = 64
PRESENT = range(120, 168)
"""Read-only, as are the model number, the firmware version and the others in `READ_ONLY`."""
READ_ONLY = frozenset((*range(7), 69, 70, *PRESENT))
GOALS = range(100, 120)
OVERLOAD_BIT, HEAT_BIT, VOLTAGE_BIT = 5, 2, 0
TICK_S = 0.004
LAG_S = 0.015
"""The position controller's time constant: the shaft's lag behind its reference."""
OVERLOAD_S = 1.0
AMBIENT_C = 25.0
BOOT_S = 0.15
"""From power-on to the first answer; our assumption, no source names it."""
FULL_PWM = 885
STRAINING_PWM = 0.75 * FULL_PWM
"""A blocked servo whose goal PWM is at most this does not overload."""


@dataclass(frozen=True, slots=True)
class ServoModel:
    """Factory settings of a model."""

    number: int
    velocity_limit: int
    current_limit: int
    temperature_limit: int
    min_voltage: int
    max_voltage: int
    firmware: int = 46
    indirect: tuple[tuple[int, int, int], ...] = ((168, 224, 28), (578, 634, 28))
    """Each list of indirect addresses: its first address, the first address of its data, and its length."""
    friction: int = 0
    """Gear friction, as P gain times counts: within this error it does not move without an I gain."""


XM430 = ServoModel(1020, 200, 1193, 80, 95, 160)
XM540 = ServoModel(1120, 128, 2047, 80, 95, 160)
XC330 = ServoModel(1220, 320, 910, 70, 55, 140, indirect=((168, 208, 20),), friction=4000)


class Servo:
    """A servo with a shaft that turns in time. Positions are counts, 4096 a turn."""

    def __init__(
        self,
        servo_id: int,
        kind: ServoModel = XM430,
        position: float = 2048.0,
        window: tuple[int, int] = (0, 4095),
        dead_time_s: float = 0.0,
    ):
        self.id = servo_id
        self.kind = kind
        self.shaft = position
        """The shaft's real position, with all its turns."""
        self._forgotten = 0
        """Counts of the turns that it has lost."""
        self.velocity = 0.0
        """Counts per second."""
        self.temperature_c = AMBIENT_C
        self.can_rise = self.can_fall = True
        """Whether the shaft is free to turn up and down in counts."""
        self.speed_ratio = 1.0
        """Its speed relative to the nominal one."""
        self.is_powered = True
        self.table = bytearray(TABLE_SIZE)
        self.registered: tuple[int, bytes] | None = None
        self._reference = position
        self._reference_velocity = 0.0
        self._stepped_s: float | None = None
        self._spoken_to_s = 0.0
        self._loaded_s = 0.0
        self._boots_until_s = float("-inf")
        self._dead_time_s = dead_time_s
        """From a new goal to the first motion."""
        self._goal = position
        self._goals: list[tuple[float, float]] = []
        """Goals that it does not follow yet, and from when it will."""
        self._factory_settings(window)

    @property
    def position(self) -> float:
        """The position that it reports."""
        return self.shaft - self._forgotten

    @position.setter
    def position(self, count: float) -> None:
        self.shaft = count + self._forgotten

    @property
    def kept(self) -> list[Plain]:
        """What outlives the twin's process (time stands still meanwhile): its turns and its registers."""
        return [self.shaft, self._forgotten, self.table.hex()]

    @kept.setter
    def kept(self, written: list[Plain]) -> None:
        self.shaft, self._forgotten, registers = written
        self.table = bytearray.fromhex(registers)
        self.stand()

    def forget_turns(self) -> None:
        """Keep only the angle within one turn, and hold there."""
        self._forgotten += 4096 * math.floor(self.position / 4096)
        self.stand()

    def _factory_settings(self, window: tuple[int, int]) -> None:
        kind = self.kind
        for address, size, value in (
            (0, 2, kind.number), (6, 1, kind.firmware), (7, 1, self.id), (8, 1, 5), (9, 1, 250), (11, 1, 3),
            (13, 1, 2), (31, 1, kind.temperature_limit), (32, 2, kind.max_voltage), (34, 2, kind.min_voltage),
            (36, 2, FULL_PWM), (38, 2, kind.current_limit), (44, 4, kind.velocity_limit), (48, 4, window[1]),
            (52, 4, window[0]), (63, 1, 52), (68, 1, 2), (144, 2, 120),
        ):  # fmt: skip
            self.put(address, size, value)
        self._volatile_settings()

    def _volatile_settings(self) -> None:
        self.table[EEPROM_END : PRESENT[0]] = bytes(PRESENT[0] - EEPROM_END)
        self.put(68, 1, 2)
        self.put(84, 2, 800)
        for listed, data, count in self.kind.indirect:
            for k in range(count):
                self.put(listed + 2 * k, 2, data + k)
        self.put(100, 2, self.get(36, 2))
        self.put(116, 4, round(self.position))
        self.stand()

    def stand(self) -> None:
        """Drop all goals and hold the present position."""
        self._goals, self._goal = [], self.position
        self._reference, self._reference_velocity = self.position, 0.0

    def get(self, address: int, size: int, signed: bool = False) -> int:
        return int.from_bytes(self.table[address : address + size], "little", signed=signed)

    def put(self, address: int, size: int, value: int) -> None:
        self.table[address : address + size] = (value % (1 << 8 * size)).to_bytes(size, "little")

    @property
    def has_torque(self) -> bool:
        return self.table[64] == 1

    @property
    def alert(self) -> int:
        """The alert bit of a status packet."""
        return ALERT if self.table[70] else 0

    def read(self, address: int, size: int, now_s: float) -> tuple[int, bytes]:
        """Error number and data."""
        self.step(now_s, force=True)
        if address + size > TABLE_SIZE:
            return RANGE_ERROR, b""
        return NO_ERROR, bytes(self.table[a] for a in self._meant(range(address, address + size)))

    def _meant(self, span: range) -> list[int]:
        """The registers behind a span of addresses, with indirect data replaced by their targets."""
        registers = list(span)
        for listed, data, count in self.kind.indirect:
            for a in range(max(span.start, data), min(span.stop, data + count)):
                registers[a - span.start] = self.get(listed + 2 * (a - data), 2) % TABLE_SIZE
        return registers

    def write(self, address: int, data: bytes, now_s: float) -> int:
        """The error number."""
        self.step(now_s, force=True)
        if address + len(data) > TABLE_SIZE:
            return RANGE_ERROR
        registers = self._meant(range(address, address + len(data)))
        errors, begin = [], 0
        for end in range(1, len(registers) + 1):
            if end == len(registers) or registers[end] != registers[end - 1] + 1:
                errors.append(self._put_in(registers[begin], data[begin:end], now_s))
                begin = end
        return next((error for error in errors if error), NO_ERROR)

    def _put_in(self, address: int, data: bytes, now_s: float) -> int:
        if error := self._refusal(address, data):
            return error
        mode_before, torque_before = self.table[11], self.table[64]
        self.table[address : address + len(data)] = data
        if self.table[11] != mode_before:
            self._mode_changed()
        if self.table[64] and not torque_before:
            self._reference, self._reference_velocity = self.position, 0.0
            self._goals = [(now_s, float(self.get(116, 4, signed=True)))]
        elif address <= 116 < address + len(data):
            self._goals.append((now_s + self._dead_time_s, float(self.get(116, 4, signed=True))))
        return NO_ERROR

    def _refusal(self, address: int, data: bytes) -> int:
        span = range(address, address + len(data))
        if any(a in READ_ONLY for a in span) or (address < EEPROM_END and self.has_torque):
            return ACCESS_ERROR
        if address == 64 and (data[0] > 1 or (data[0] == 1 and self.table[70])):
            return RANGE_ERROR if data[0] > 1 else ACCESS_ERROR
        if address == 7 and data[0] > 252:
            return RANGE_ERROR
        if address == 11 and data[0] not in (0, 1, 3, 4, 5, 16):
            return RANGE_ERROR
        if self.get(98, 1, signed=True) == -1 and any(a in GOALS for a in span):
            return RANGE_ERROR  # the watchdog has tripped
        if address == 98 and not 0 <= int.from_bytes(data[:1], "little", signed=True) <= 127:
            return RANGE_ERROR
        if address == 116 and len(data) == 4:
            return self._goal_refusal(int.from_bytes(data, "little", signed=True))
        if address == 112 and len(data) == 4 and int.from_bytes(data, "little") > 32767:
            return RANGE_ERROR
        return NO_ERROR

    def _goal_refusal(self, goal: int) -> int:
        if self.table[11] == 3:
            return NO_ERROR if self.get(52, 4) <= goal <= self.get(48, 4) else LIMIT_ERROR
        return NO_ERROR if abs(goal) <= 1_048_575 else LIMIT_ERROR

    def _mode_changed(self) -> None:
        for address in (80, 82):
            self.put(address, 2, 0)
        self.put(84, 2, 800)
        self.put(108, 4, 0)
        self.put(112, 4, 0)

    @property
    def blocked(self) -> bool:
        """Whether something holds the shaft."""
        return not (self.can_rise or self.can_fall)

    @blocked.setter
    def blocked(self, is_held: bool) -> None:
        self.can_rise = self.can_fall = not is_held

    def spoken_to(self, now_s: float) -> None:
        """A valid instruction has come for this servo: feeds its watchdog."""
        self.step(now_s)
        self._spoken_to_s = now_s

    def reboot(self, now_s: float) -> None:
        """Restart: everything outside EEPROM is lost, also the number of turns, and a shutdown is cleared."""
        self.registered = None
        self._loaded_s = 0.0
        self.forget_turns()
        self._volatile_settings()
        self._stepped_s = now_s
        self._boots_until_s = now_s + BOOT_S

    def cut_power(self, now_s: float) -> None:
        """The supply is off: the shaft stays where it is, as far as the gears hold it.

        What a reboot loses is lost now: the twin may end before the supply is back, and has power when it starts
        again.
        """
        self.step(now_s, force=True)
        self.reboot(now_s)
        self.is_powered, self.velocity = False, 0.0

    def restore_power(self, now_s: float) -> None:
        """The supply is back."""
        self.is_powered = True
        self.reboot(now_s)

    def is_silent(self, now_s: float) -> bool:
        """Whether it has no power, or still boots."""
        return not self.is_powered or now_s < self._boots_until_s

    def fail(self, bit: int) -> None:
        """Set a hardware error; one that the shutdown mask names switches the torque off."""
        self.table[70] |= 1 << bit
        if self.table[63] & 1 << bit:
            self.table[64] = 0

    def step(self, now_s: float, force: bool = False) -> None:
        """Advance to now."""
        if self._stepped_s is None:
            self._stepped_s = self._spoken_to_s = now_s
        dt_s = now_s - self._stepped_s
        if dt_s < TICK_S and not force:
            return
        if dt_s > 0:
            self._move(now_s, dt_s)
        self._tell()

    def _move(self, now_s: float, dt_s: float) -> None:
        self._stepped_s = now_s
        self._watch(now_s)
        before = self.position
        if self.has_torque and self.is_powered:
            self._follow(now_s, dt_s)
        self.velocity = (self.position - before) / dt_s
        self._heat(dt_s)

    def _watch(self, now_s: float) -> None:
        units = self.get(98, 1, signed=True)
        if units > 0 and self.has_torque and now_s - self._spoken_to_s > units * 0.02:
            self.put(98, 1, -1)
            self.stand()
            self.put(116, 4, round(self.position))

    def _follow(self, now_s: float, dt_s: float) -> None:
        """Move the reference to the goal within the profile, and the shaft after the reference."""
        while self._goals and self._goals[0][0] <= now_s:
            self._goal = self._goals.pop(0)[1]
        goal = self._goal
        top = self.speed_ratio * self._counts_per_s(self.get(112, 4) or self.kind.velocity_limit)
        acceleration = self.get(108, 4) * 214.577 / 3600 * 4096
        if not self.get(112, 4):
            self._reference = goal  # no profile: the controller sees the step
        elif not acceleration:
            self._reference += math.copysign(min(abs(goal - self._reference), top * dt_s), goal - self._reference)
        else:
            left = goal - self._reference
            wanted = math.copysign(min(top, math.sqrt(2 * acceleration * abs(left))), left)
            change = max(-acceleration * dt_s, min(acceleration * dt_s, wanted - self._reference_velocity))
            self._reference_velocity += change
            move = self._reference_velocity * dt_s
            self._reference = goal if abs(move) >= abs(left) and move * left >= 0 else self._reference + move
        error = self._reference - self.position
        most = self.speed_ratio * self._counts_per_s(self.kind.velocity_limit) * dt_s
        holds = not self.get(82, 2) and abs(error) * self.get(84, 2) < self.kind.friction
        if holds or not (self.can_rise if error > 0 else self.can_fall):
            return
        self.position += max(-most, min(most, error * (1.0 - math.exp(-dt_s / LAG_S))))

    @staticmethod
    def _counts_per_s(velocity_register: float) -> float:
        return velocity_register * 0.229 / 60 * 4096

    def _heat(self, dt_s: float) -> None:
        error = self._goal - self.position
        held = abs(error) > 20 and not (self.can_rise if error > 0 else self.can_fall)
        strained = self.has_torque and held and self.get(100, 2) > STRAINING_PWM
        self.put(126, 2, round(math.copysign(self.kind.current_limit if strained else 40, error)) * self.has_torque)
        self._loaded_s = self._loaded_s + dt_s if strained else 0.0
        self.temperature_c += ((40.0 if strained else 0.0) - (self.temperature_c - AMBIENT_C) / 60) * dt_s / 10
        if self._loaded_s > OVERLOAD_S:
            self.fail(OVERLOAD_BIT)
        if self.temperature_c > self.table[31]:
            self.fail(HEAT_BIT)

    def _tell(self) -> None:
        self.put(122, 1, int(abs(self.velocity) > self._counts_per_s(10)))
        self.put(128, 4, round(self.velocity / 4096 * 60 / 0.229))
        self.put(132, 4, round(self.position))
        self.put(140, 4, round(self._reference))
        self.put(146, 1, round(self.temperature_c))
