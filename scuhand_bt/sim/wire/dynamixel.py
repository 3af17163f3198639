"""The twin of a servo bus: Dynamixel Protocol 2.0, for any number of servos on one line.

Source: ROBOTIS e-manual, "DYNAMIXEL Protocol 2.0".
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import ClassVar

from scuhand_bt.sim.plain_state import Plain
from scuhand_bt.sim.wire.servo import NO_ERROR, XM430, XM540, Servo

HEADER = b"\xff\xff\xfd\x00"
BROADCAST = 0xFE
PING, READ, WRITE, REG_WRITE, ACTION, FACTORY_RESET, REBOOT, CLEAR = 1, 2, 3, 4, 5, 6, 8, 0x10
STATUS = 0x55
SYNC_READ, SYNC_WRITE, FAST_SYNC_READ = 0x82, 0x83, 0x8A
BULK_READ, BULK_WRITE, FAST_BULK_READ = 0x92, 0x93, 0x9A
BAUD_RATES = (9_600, 57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)
"""By the value of a servo's register 8."""
BITS_PER_BYTE = 10
RESULT_FAIL, INSTRUCTION_ERROR, CRC_ERROR, LENGTH_ERROR = 1, 2, 3, 5
MULTI_TURN_RESET = b"\x01DXL\x22"


def _crc_table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        crc = byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x8005 if crc & 0x8000 else crc << 1) & 0xFFFF
        table.append(crc)
    return tuple(table)


_CRC = _crc_table()


def crc16(data: bytes, crc: int = 0) -> int:
    """CRC-16, polynomial 0x8005, most significant bit first, from the header on; stuffing included."""
    for byte in data:
        crc = (crc << 8 & 0xFFFF) ^ _CRC[crc >> 8 ^ byte]
    return crc


def stuffed(body: bytes) -> bytes:
    """Instruction and parameters, with every FF FF FD as FF FF FD FD."""
    return body.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")


def packet(servo: int, instruction: int, parameters: bytes) -> bytes:
    """A complete packet."""
    body = stuffed(bytes([instruction]) + parameters)
    head = HEADER + bytes([servo]) + (len(body) + 2).to_bytes(2, "little")
    return head + body + crc16(head + body).to_bytes(2, "little")


class PacketReader:
    """Finds packets in a stream of bytes."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> Iterator[tuple[int, int, bytes, bool]]:
        """Id, instruction, parameters without stuffing, and whether the CRC was right."""
        self._rest += data
        while (at := self._rest.find(HEADER)) >= 0:
            self._rest = self._rest[at:]
            if len(self._rest) < 7:
                return
            length = int.from_bytes(self._rest[5:7], "little")
            if not 3 <= length <= 1024:
                self._rest = self._rest[4:]
                continue
            if len(self._rest) < 7 + length:
                if (again := self._rest.find(HEADER, 4)) < 0:
                    return
                self._rest = self._rest[again:]  # stuffing keeps headers out of packets, so this packet was cut off
                continue
            whole, self._rest = self._rest[: 7 + length], self._rest[7 + length :]
            body = whole[7:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
            yield whole[4], body[0], body[1:], crc16(whole[:-2]) == int.from_bytes(whole[-2:], "little")
        self._rest = self._rest[-3:]


class DynamixelTwin:
    """A line with servos on it."""

    STATE: ClassVar[tuple[str, ...]] = ("kept",)

    def __init__(self, servos: Iterable[Servo]) -> None:
        self.servos = {servo.id: servo for servo in servos}
        self.missing: set[int] = set()
        """Ids of servos whose cable is off."""
        self.doubles: list[Servo] = []
        """Servos with the id of another: both obey, and their simultaneous answers collide."""
        self.takes_time = True
        """Whether a packet is given out only when its last byte would have come; False if the caller paces bytes."""
        self._reader = PacketReader()
        self._due: list[tuple[float, bytes]] = []

    @property
    def kept(self) -> dict[int, list[Plain]]:
        """The state of its servos, by their ids."""
        return {servo_id: servo.kept for servo_id, servo in self.servos.items()}

    @kept.setter
    def kept(self, by_id: dict[int, list[Plain]]) -> None:
        for servo_id, kept in by_id.items():
            self.servos[servo_id].kept = kept

    def hear(self, data: bytes, now_s: float) -> list[bytes]:
        """Obey what came in; a status packet comes after its servo's return delay and its own time on the line."""
        for servo in (*self.servos.values(), *self.doubles):
            servo.step(now_s)
        for servo_id, instruction, parameters, intact in self._reader.feed(data):
            if instruction != STATUS:
                line_s = now_s
                for due_s, message in self._obey(servo_id, instruction, parameters, intact, now_s):
                    line_s = max(line_s, due_s) + self._line_s(message)
                    self._due.append((line_s, message))
                self._renumber()
        ready = [message for due_s, message in self._due if due_s <= now_s]
        self._due = [(due_s, message) for due_s, message in self._due if due_s > now_s]
        return ready

    def _obey(
        self, servo_id: int, instruction: int, parameters: bytes, intact: bool, now_s: float
    ) -> Iterator[tuple[float, bytes]]:
        if not intact:
            if self._is_there(servo_id, now_s):
                yield self._status(self.servos[servo_id], now_s, CRC_ERROR)
            return
        if instruction in (SYNC_READ, FAST_SYNC_READ, BULK_READ, FAST_BULK_READ):
            yield from self._read_many(instruction, parameters, now_s)
        elif instruction in (SYNC_WRITE, BULK_WRITE):
            self._write_many(instruction, parameters, now_s)
        else:
            for servo in self._addressed(servo_id, now_s):
                servo.spoken_to(now_s)
                error, data = self._one(servo, instruction, parameters, now_s)
                if servo_id != BROADCAST or instruction == PING:
                    yield self._status(servo, now_s, error, data)

    def _addressed(self, servo_id: int, now_s: float) -> list[Servo]:
        ids = self.servos if servo_id == BROADCAST else [servo_id]
        doubles = [servo for servo in self.doubles if servo.id in ids and not servo.is_silent(now_s)]
        return [*(self.servos[i] for i in ids if self._is_there(i, now_s)), *doubles]

    def _line_s(self, message: bytes) -> float:
        """The time that a packet takes on the line; all its servos have one baud rate."""
        if not self.takes_time:
            return 0.0
        rate = next(iter(self.servos.values())).table[8]
        return len(message) * BITS_PER_BYTE / BAUD_RATES[min(rate, len(BAUD_RATES) - 1)]

    def _renumber(self) -> None:
        """A servo whose id was written answers to the new id from the next packet on."""
        servos = [*self.servos.values(), *self.doubles]
        if any(servo.id != servo.table[7] for servo in servos):
            self.servos, self.doubles = {}, []
            for servo in servos:
                servo.id = servo.table[7]
                if self.servos.setdefault(servo.id, servo) is not servo:
                    self.doubles.append(servo)

    def _is_there(self, servo_id: int, now_s: float) -> bool:
        servo = self.servos.get(servo_id)
        return servo is not None and servo_id not in self.missing and not servo.is_silent(now_s)

    def _one(self, servo: Servo, instruction: int, parameters: bytes, now_s: float) -> tuple[int, bytes]:
        """Carry out an instruction to one servo; returns error number and parameters of its status."""
        address = int.from_bytes(parameters[:2], "little")
        if instruction == PING:
            return NO_ERROR, bytes(servo.table[0:2]) + bytes([servo.table[6]])
        if instruction == READ and len(parameters) == 4:
            return servo.read(address, int.from_bytes(parameters[2:], "little"), now_s)
        if instruction == WRITE and len(parameters) > 2:
            return servo.write(address, parameters[2:], now_s), b""
        if instruction == REG_WRITE and len(parameters) > 2:
            servo.registered = (address, parameters[2:])
            servo.table[69] = 1
            return NO_ERROR, b""
        if instruction == ACTION:
            if servo.registered is None:
                return INSTRUCTION_ERROR, b""
            registered, servo.registered = servo.registered, None
            servo.table[69] = 0
            return servo.write(*registered, now_s), b""
        if instruction == REBOOT:
            servo.reboot(now_s)
            return NO_ERROR, b""
        if instruction == CLEAR:
            still = abs(servo.velocity) < 1
            if parameters != MULTI_TURN_RESET or not still:
                return RESULT_FAIL, b""
            servo.forget_turns()
            return NO_ERROR, b""
        known = instruction in (READ, WRITE, REG_WRITE)
        return LENGTH_ERROR if known else INSTRUCTION_ERROR, b""

    def _read_many(self, instruction: int, parameters: bytes, now_s: float) -> Iterator[tuple[float, bytes]]:
        if instruction in (SYNC_READ, FAST_SYNC_READ):
            span = (int.from_bytes(parameters[:2], "little"), int.from_bytes(parameters[2:4], "little"))
            wanted = [(servo_id, *span) for servo_id in parameters[4:]]
        else:
            wanted = [
                (entry[0], int.from_bytes(entry[1:3], "little"), int.from_bytes(entry[3:5], "little"))
                for entry in (parameters[i : i + 5] for i in range(0, len(parameters) - 4, 5))
            ]
        answers = []
        for servo_id, address, size in wanted:
            if not self._is_there(servo_id, now_s):
                break  # each servo waits for the status of the one before it
            servo = self.servos[servo_id]
            servo.spoken_to(now_s)
            answers.append((servo, *servo.read(address, size, now_s)))
        if instruction in (SYNC_READ, BULK_READ):
            for servo, error, data in answers:
                yield self._status(servo, now_s, error, data)
        elif len(answers) == len(wanted):
            yield now_s, fast_status([(servo.id, error | servo.alert, data) for servo, error, data in answers])

    def _write_many(self, instruction: int, parameters: bytes, now_s: float) -> None:
        if instruction == SYNC_WRITE:
            address, size = (int.from_bytes(parameters[k : k + 2], "little") for k in (0, 2))
            items = [
                (parameters[i], address, parameters[i + 1 : i + 1 + size])
                for i in range(4, len(parameters) - size, size + 1)
            ]
        else:
            items, rest = [], parameters
            while len(rest) > 5:
                size = int.from_bytes(rest[3:5], "little")
                items.append((rest[0], int.from_bytes(rest[1:3], "little"), rest[5 : 5 + size]))
                rest = rest[5 + size :]
        for servo_id, address, data in items:
            for servo in self._addressed(servo_id, now_s):
                servo.spoken_to(now_s)
                servo.write(address, data, now_s)  # an error is not reported: nobody answers a sync write

    def _status(self, servo: Servo, now_s: float, error: int, data: bytes = b"") -> tuple[float, bytes]:
        delay_s = servo.table[9] * 2e-6
        message = packet(servo.id, STATUS, bytes([error | servo.alert]) + data)
        if any(double.id == servo.id for double in self.doubles):
            message = bytes(byte | 0x55 for byte in message)
        return now_s + delay_s, message


def fast_status(answers: list[tuple[int, int, bytes]]) -> bytes:
    """The one packet that all servos write together: {error, id, data, CRC so far} each, without stuffing."""
    length = 1 + sum(len(data) + 4 for _, _, data in answers)
    message = HEADER + bytes([BROADCAST]) + length.to_bytes(2, "little") + bytes([STATUS])
    for servo_id, error, data in answers:
        message += bytes([error, servo_id]) + data
        message += crc16(message).to_bytes(2, "little")
    return message


def crane_x7(ids: Sequence[int] = (2, 3, 4, 5, 6, 7, 8, 9)) -> list[Servo]:
    """The servos of the arm, with factory ids by default, and that of the hand's roller, if it has an id.

    Position limits: `rt-net/rt_manipulators_cpp`, `samples/samples03/config/crane-x7_links.csv` (Apache-2.0).
    """
    windows = [(262, 3834), (1024, 3072), (262, 3834), (228, 2048), (262, 3834), (1024, 3072), (148, 3948)]
    arm = [Servo(ids[i], XM540 if i == 1 else XM430, 2048.0, window) for i, window in enumerate(windows)]
    return [*arm, *(Servo(number) for number in ids[7:])]
