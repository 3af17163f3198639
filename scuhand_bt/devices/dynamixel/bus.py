"""One Dynamixel Protocol 2.0 bus: questions and answers over the ROBOTIS SDK's packet layer.

The SDK (dynamixel-sdk 4.1) is used below the level of packets only, as its calls have traps; each is met
here: byte stuffing of what is sent is lost (`_Packets`); it waits in a busy loop (`_Port`); it checks
neither an answer's length nor leaves the answer to ACTION on the wire unread; an answer that comes after
its timeout is taken for the next question's; after an I/O error its port stays busy for ever
(`DynamixelBus._ask`, `_resynchronise`, `_exchange`). Not for use from two threads.
"""

import contextlib
import time
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass

import serial
from dynamixel_sdk import (
    BROADCAST_ID,
    COMM_RX_TIMEOUT,
    COMM_SUCCESS,
    INST_ACTION,
    INST_FAST_SYNC_READ,
    INST_PING,
    INST_READ,
    INST_REBOOT,
    INST_SYNC_READ,
    INST_SYNC_WRITE,
    INST_WRITE,
    PortHandler,
    Protocol2PacketHandler,
)

from scuhand_bt.devices.dynamixel.registers import Register
from scuhand_bt.devices.serial_link import PORT_ERRORS

LENGTH_END = 7
"""FF FF FD 00, id, two bytes of length; the length counts what follows."""
HEADER_SIZE = 8
"""The same and the instruction."""
STATUS_OVERHEAD = 11
"""A status packet without parameters: the header with error and CRC."""
ALERT = 0x80
MAX_ID = 252
PING_TURN_MS = 3.0
"""Each servo answers a ping to all when those of lower ids have had so much time."""
ERROR_NAMES = {
    1: "it failed to process the packet",
    2: "it does not know the instruction",
    3: "it received a wrong CRC",
    4: "the value is out of range",
    5: "the value has the wrong length",
    6: "the value is beyond a limit",
    7: "the register cannot be written (now)",
}


class BusError(Exception):
    """A question without a usable answer."""


class BusLost(BusError):  # noqa: N818 - it reads as the sentence it is raised in
    """The port itself has gone; it must be opened again."""


class NoAnswer(BusError):  # noqa: N818
    """A servo did not answer, or not intelligibly."""


class ServoRefused(BusError):  # noqa: N818
    """A servo answered with an error."""

    def __init__(self, servo: int, code: int) -> None:
        super().__init__(f"servo {servo}: {ERROR_NAMES.get(code, f'error {code}')}")
        self.code = code


@dataclass(frozen=True, slots=True)
class Status:
    """One servo's answer."""

    alert: bool
    """A hardware error is latched; HARDWARE_ERROR says which."""
    data: bytes


class _Packets(Protocol2PacketHandler):  # type: ignore[misc]
    """The SDK's packets, rightly stuffed and unstuffed."""

    def addStuffing(self, packet: list[int]) -> list[int]:  # noqa: N802
        # The SDK builds the stuffed packet in a new list, and its caller goes on with the old one.
        stuffed: list[int] = super().addStuffing(packet)
        packet[:] = stuffed
        return packet

    def removeStuffing(self, packet: list[int]) -> list[int]:  # noqa: N802
        # The SDK corrects the length that the packet names, but leaves as many bytes behind its end.
        packet = super().removeStuffing(packet)
        return packet[: packet[5] + (packet[6] << 8) + LENGTH_END]


class _Port(PortHandler):  # type: ignore[misc]
    """The SDK's port, which sleeps while it waits and opens any pyserial URL."""

    def __init__(self, url: str, latency_ms: float) -> None:
        super().__init__(url)
        self._latency_ms = latency_ms

    def setupPort(self, cflag_baud: int) -> bool:  # noqa: N802
        # A read that may block for 1 ms instead of returning at once: the SDK spins on it.
        self.ser = serial.serial_for_url(
            self.port_name, baudrate=cflag_baud, timeout=0.001, write_timeout=0.5, exclusive=True
        )
        with contextlib.suppress(AttributeError, ValueError, OSError, NotImplementedError):
            self.ser.set_low_latency_mode(True)  # USB adapters hold bytes back for 16 ms otherwise
        self.is_open = True
        self.tx_time_per_byte = 10_000.0 / cflag_baud
        self.ser.reset_input_buffer()
        return True

    def setPacketTimeout(self, packet_length: int) -> None:  # noqa: N802
        self.setPacketTimeoutMillis(self.tx_time_per_byte * packet_length + 2 * self._latency_ms + 2)


class DynamixelBus:
    """The bus at one port.

    `latency_ms` is how long adapter and system may hold bytes back; an answer is waited for twice as long.
    """

    def __init__(self, url: str, baud: int = 3_000_000, latency_ms: float = 8.0) -> None:
        self.url = url
        self._baud = baud
        self._latency_ms = latency_ms
        self._packets = _Packets()
        self._port: _Port | None = None
        self._suspect: int | None = None
        """A servo whose answer may still come, from a question that was given up."""
        self._attempts = 1

    @contextlib.contextmanager
    def patience(self, attempts: int = 10) -> Generator[None, None, None]:
        """Ask a single servo up to so often before it is taken for missing: while nothing moves, there is time."""
        self._attempts = attempts
        try:
            yield
        finally:
            self._attempts = 1

    @property
    def is_open(self) -> bool:
        return self._port is not None

    def open(self) -> None:
        """Open the port; raises BusLost with the reason."""
        port = _Port(self.url, self._latency_ms)
        try:
            if not port.setBaudRate(self._baud):
                raise BusLost(f"{self._baud} baud is no speed that the SDK can set")
        except (*PORT_ERRORS, ValueError) as error:
            raise BusLost(str(error)) from error
        self._port = port
        self._suspect = None

    def close(self) -> None:
        """Close the port; it may be opened again."""
        port, self._port = self._port, None
        if port is not None:
            with contextlib.suppress(*PORT_ERRORS):
                port.closePort()

    def ping(self, servo: int) -> int:
        """The servo's model number; NoAnswer if it is not there."""
        return int.from_bytes(self._ask(servo, INST_PING, b"", 3).data[:2], "little")

    def scan(self) -> dict[int, int]:
        """Every servo that answers a ping to all: its model number by its id. Takes a second."""
        found: dict[int, int] = {}
        with self._exchange() as port:
            self._send(port, BROADCAST_ID, INST_PING, b"")
            port.setPacketTimeoutMillis(MAX_ID * PING_TURN_MS + 2 * self._latency_ms)
            while True:
                packet, result = self._packets.rxPacket(port, False)
                if result == COMM_RX_TIMEOUT:
                    return found
                if result == COMM_SUCCESS and len(packet) == STATUS_OVERHEAD + 3:
                    found[packet[4]] = int.from_bytes(bytes(packet[9:11]), "little")

    def read(self, servo: int, register: Register) -> int:
        """One value, with its sign."""
        question = register.address.to_bytes(2, "little") + register.size.to_bytes(2, "little")
        return register.decode(self._ask(servo, INST_READ, question, register.size).data)

    def write(self, servo: int, register: Register, value: int) -> None:
        """Write one value; ServoRefused if the servo does not take it."""
        self._ask(servo, INST_WRITE, register.address.to_bytes(2, "little") + register.encode(value), 0)

    def reboot(self, servo: int) -> None:
        """Restart the servo: clears a shutdown, and drops its torque."""
        self._ask(servo, INST_REBOOT, b"", 0)

    def action(self) -> None:
        """Carry out what was registered. To all: a single servo's answer would stay unread in the SDK."""
        self._tell(INST_ACTION, b"")

    def sync_write(self, register: Register, values: Mapping[int, int]) -> None:
        """Write one register of several servos at once; nobody answers."""
        head = register.address.to_bytes(2, "little") + register.size.to_bytes(2, "little")
        self._tell(INST_SYNC_WRITE, head + b"".join(bytes([i]) + register.encode(v) for i, v in values.items()))

    def sync_read(self, servos: Sequence[int], start: int, length: int, *, again: bool = False) -> dict[int, Status]:
        """A block of the table from several servos, each answering; those that do not are missing.

        `again`: this was just asked. An answer that comes late to that is as good: no time is spent to throw it away.
        """
        if again:
            self._suspect = None
        answers: dict[int, Status] = {}
        question = start.to_bytes(2, "little") + length.to_bytes(2, "little") + bytes(servos)
        with self._exchange() as port:
            self._send(port, BROADCAST_ID, INST_SYNC_READ, question)
            port.setPacketTimeout(len(servos) * (STATUS_OVERHEAD + length))
            while len(answers) < len(servos):
                packet, result = self._packets.rxPacket(port, False)
                if result == COMM_RX_TIMEOUT:
                    break
                if result == COMM_SUCCESS and packet[4] in servos and len(packet) == STATUS_OVERHEAD + length:
                    answers[packet[4]] = _status(packet)
        missing = [servo for servo in servos if servo not in answers]
        self._suspect = missing[0] if missing else None
        return answers

    def fast_sync_read(self, servos: Sequence[int], start: int, length: int) -> dict[int, Status]:
        """The same in one packet that all servos write together; NoAnswer if any of them is missing."""
        question = start.to_bytes(2, "little") + length.to_bytes(2, "little") + bytes(servos)
        part = length + 4  # error, id, data, CRC
        with self._exchange() as port:
            self._send(port, BROADCAST_ID, INST_FAST_SYNC_READ, question)
            port.setPacketTimeout(HEADER_SIZE + len(servos) * part)
            packet, result = self._packets.rxPacket(port, True)
        body = bytes(packet[HEADER_SIZE:])
        parts = [body[at : at + part] for at in range(0, len(body), part)]
        if result != COMM_SUCCESS or [p[1] for p in parts if len(p) == part] != list(servos):
            self._suspect = servos[0]
            raise NoAnswer("the servos did not all answer")
        return {p[1]: Status(bool(p[0] & ALERT), p[2 : 2 + length]) for p in parts}

    def _ask(self, servo: int, instruction: int, parameters: bytes, answer_size: int) -> Status:
        """A question to one servo, and its answer of just this size; NoAnswer when patience is at its end."""
        for _ in range(self._attempts - 1):
            with contextlib.suppress(NoAnswer):
                return self._ask_once(servo, instruction, parameters, answer_size)
        return self._ask_once(servo, instruction, parameters, answer_size)

    def _ask_once(self, servo: int, instruction: int, parameters: bytes, answer_size: int) -> Status:
        with self._exchange() as port:
            packet = self._question(port, servo, instruction, parameters, answer_size)
        if packet is None:
            self._suspect = servo
            raise NoAnswer(f"servo {servo} does not answer")
        if code := packet[HEADER_SIZE] & ~ALERT:
            raise ServoRefused(servo, code)
        if len(packet) != STATUS_OVERHEAD + answer_size:
            self._suspect = servo
            raise NoAnswer(f"servo {servo} answered something else")
        return _status(packet)

    def _question(
        self, port: _Port, servo: int, instruction: int, parameters: bytes, answer_size: int
    ) -> list[int] | None:
        self._send(port, servo, instruction, parameters)
        port.setPacketTimeout(STATUS_OVERHEAD + answer_size)
        while True:
            packet, result = self._packets.rxPacket(port, False)
            if result != COMM_SUCCESS:
                return None
            if packet[4] == servo:
                return list(packet)

    def _tell(self, instruction: int, parameters: bytes) -> None:
        """An instruction to all, which nobody answers."""
        with self._exchange() as port:
            self._send(port, BROADCAST_ID, instruction, parameters)

    def _send(self, port: _Port, servo: int, instruction: int, parameters: bytes) -> None:
        length = len(parameters) + 3
        packet = [0, 0, 0, 0, servo, length & 0xFF, length >> 8, instruction, *parameters, 0, 0]
        result = self._packets.txPacket(port, packet)
        if result != COMM_SUCCESS:
            raise BusLost(self._packets.getTxRxResult(result))

    @contextlib.contextmanager
    def _exchange(self) -> Generator[_Port, None, None]:
        """The port, in step with the servos; an I/O error closes it and is raised as BusLost."""
        if self._port is None:
            raise BusLost(f"{self.url} is not open")
        port = self._port
        try:
            if self._suspect is not None:
                self._resynchronise(port, self._suspect)
            yield port
        except PORT_ERRORS as error:
            self.close()  # with its port the SDK forgets that it is busy
            raise BusLost(str(error)) from error
        except BusLost:
            self.close()
            raise
        finally:
            port.is_using = False

    def _resynchronise(self, port: _Port, servo: int) -> None:
        """After a question was given up: be silent until its answer must have come, and throw it away.

        Packets carry no number; a ping's answer, of a length like no read's here, tells that the line is
        in step again. A servo that does not even answer a ping is missing: nothing of it can be late.
        """
        self._suspect = None
        for _ in range(3):
            time.sleep(2 * self._latency_ms / 1000)
            port.clearPort()
            answer = self._question(port, servo, INST_PING, b"", 3)
            if answer is None or len(answer) == STATUS_OVERHEAD + 3:
                return
        self._suspect = servo
        raise NoAnswer(f"servo {servo} answers other requests than it was sent")


def _status(packet: Sequence[int]) -> Status:
    return Status(bool(packet[HEADER_SIZE] & ALERT), bytes(packet[HEADER_SIZE + 1 : -2]))
