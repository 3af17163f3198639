"""Dynamixel packets, ours and the SDK's: checksum, stuffing, and what comes out of any stream."""

import random

import pytest
from dynamixel_sdk import COMM_SUCCESS, PacketHandler, Protocol2PacketHandler
from hypothesis import given
from hypothesis import strategies as st

from scuhand_bt.devices.dynamixel.bus import _Packets
from scuhand_bt.sim.wire.dynamixel import PacketReader, crc16, fast_status, packet


def test_packets_are_those_of_the_manual() -> None:
    assert packet(1, 1, b"") == bytes.fromhex("fffffd00 01 0300 01 194e")
    assert packet(1, 2, bytes([132, 0, 4, 0])) == bytes.fromhex("fffffd00 01 0700 02 8400 0400 1d15")
    three = fast_status([(3, 0, b"\xa6\0\0\0"), (7, 0, b"\x1f\x08\0\0"), (4, 0, b"\xff\x03\0\0")])
    assert three[:16] == bytes.fromhex("fffffd00 fe 1900 55 00 03 a6000000 8408")
    assert three[16:24] == bytes.fromhex("00 07 1f080000 16ca")


def test_what_looks_like_a_header_is_stuffed_and_comes_out_again() -> None:
    data = b"\xff\xff\xfd\xff\xff\xfd\xfd\xff\xff\xff\xfd"
    assert b"\xff\xff\xfd\xfd" in packet(1, 3, data)
    assert list(PacketReader().feed(packet(1, 3, data))) == [(1, 3, data, True)]


@given(st.lists(st.binary(max_size=30), max_size=5), st.integers(0, 200))
def test_packets_come_out_of_any_stream_however_it_is_cut(payloads: list[bytes], cut: int) -> None:
    stream = b"".join(packet(1, 3, payload) for payload in payloads)
    reader = PacketReader()
    seen = [*reader.feed(stream[:cut]), *reader.feed(stream[cut:])]
    assert [parameters for _, _, parameters, _ in seen] == payloads


class Recorder:
    """A port that keeps what is sent."""

    is_using = False
    sent = b""

    def clearPort(self) -> None:  # noqa: N802
        self.sent = b""

    def writePort(self, packet: list[int]) -> int:  # noqa: N802
        self.sent = bytes(packet)
        return len(packet)


def test_the_sdk_alone_loses_the_stuffing() -> None:
    """Why `_Packets` exists: when this fails the SDK has been fixed."""
    goal = [0xFF, 0xFF, 0xFD, 0xFF]
    sent = {}
    for packets in (PacketHandler(2.0), _Packets()):
        port = Recorder()
        packets.txPacket(port, [0, 0, 0, 0, 9, 9, 0, 3, 116, 0, *goal, 0, 0])
        sent[type(packets)] = port.sent
    assert sent[_Packets] == packet(9, 3, bytes([116, 0, *goal]))
    assert b"\xff\xff\xfd\xfd\xff" in sent[_Packets]
    assert sent[Protocol2PacketHandler] != sent[_Packets]


class NoisyPort:
    """A port on which bytes come in that nobody controls; time passes with every read."""

    def __init__(self, noise: bytes) -> None:
        self.noise = noise
        self.at = 0
        self.is_using = False
        self._reads = 0

    def readPort(self, length: int) -> bytes:  # noqa: N802
        self._reads += 1
        self.at += length
        return self.noise[self.at - length : self.at]

    def isPacketTimeout(self) -> bool:  # noqa: N802
        return self._reads > 200 or self.at >= len(self.noise)

    def begin(self) -> None:
        self._reads = 0


def test_a_million_random_and_mutated_bytes_give_no_packet_with_a_wrong_checksum() -> None:
    rng = random.Random(8)
    good = [packet(i, 0x55, b"\0" + rng.randbytes(n)) for i in (2, 3, 9) for n in (0, 1, 4, 25)]
    noise = bytearray()
    while len(noise) < 1_000_000:
        chunk = bytearray(rng.choice(good) if rng.random() < 0.7 else rng.randbytes(rng.randrange(60)))
        if chunk and rng.random() < 0.5:
            chunk[rng.randrange(len(chunk))] = rng.randrange(256)
        noise += chunk
    port, packets, accepted = NoisyPort(bytes(noise)), _Packets(), 0
    while port.at < len(noise):
        port.begin()
        received, result = packets.rxPacket(port, False)
        if result == COMM_SUCCESS:
            accepted += 1
            assert packet(received[4], received[7], bytes(received[8:-2])) in noise
    assert accepted > 1000


def feed(*parts: bytes) -> list[tuple[int, int, bytes, bool]]:
    reader = PacketReader()
    return [found for part in parts for found in reader.feed(part)]


@pytest.mark.parametrize(("data", "crc"), [(b"", 0), (b"123456789", 0xFEE8), (b"\x01", 0x8005), (b"\xff", 0x0202)])
def test_the_checksum_is_the_published_one(data: bytes, crc: int) -> None:
    """CRC-16/UMTS (BUYPASS), with the check values of its catalogue."""
    assert crc16(data) == crc
    assert crc16(data[1:], crc16(data[:1])) == crc, "it can be gone on with"


def test_a_packet_with_a_wrong_checksum_is_given_as_such() -> None:
    for at in (-1, -2, -3, 4, 7):
        broken = bytearray(packet(1, 3, b"abc"))
        broken[at] ^= 1
        ((_, _, _, intact),) = feed(bytes(broken))
        assert not intact


def test_a_packet_is_found_behind_noise_and_behind_one_that_broke_off() -> None:
    good = packet(2, 3, b"good")
    assert feed(b"\xff\xff\xfd noise " + good) == [(2, 3, b"good", True)]
    assert feed(packet(1, 3, bytes(30))[:20] + good) == [(2, 3, b"good", True)]
    assert feed(packet(1, 3, bytes(100))[:20] + good + good) == [(2, 3, b"good", True)] * 2
    assert feed(packet(1, 3, bytes(30))[:6], good[:3], good[3:]) == [(2, 3, b"good", True)]
    assert feed(good[:4] + good) == [(2, 3, b"good", True)], "a header alone"


@pytest.mark.parametrize(("length", "is_packet"), [(2, False), (3, True), (1024, True), (1025, False)])
def test_a_length_that_no_packet_has_is_noise(length: int, is_packet: bool) -> None:
    good = packet(2, 3, b"good")
    claims = b"\xff\xff\xfd\x00\x01" + length.to_bytes(2, "little") + bytes(length)
    assert len(feed(claims + good)) == (2 if is_packet else 1)
    assert feed(claims + good)[-1] == (2, 3, b"good", True)


def test_after_noise_only_what_may_be_the_begin_of_a_header_is_kept() -> None:
    reader = PacketReader()
    assert list(reader.feed(bytes(10_000) + b"\xff\xff\xfd")) == []
    assert len(reader._rest) == 3
    assert list(reader.feed(packet(2, 3, b"good")[3:])) == [(2, 3, b"good", True)]


def test_a_stuffed_answer_is_read_by_the_driver_as_it_was_meant() -> None:
    data = b"\0\xff\xff\xfd\xff\xff\xfd\x07"
    port = NoisyPort(packet(9, 0x55, data))
    received, result = _Packets().rxPacket(port, False)
    assert result == COMM_SUCCESS
    assert bytes(received[8:-2]) == data
    assert len(received) == received[5] + (received[6] << 8) + 7, "as long as it says it is"
    long = packet(9, 0x55, b"\0" + bytes(300) + b"\xff\xff\xfd")
    received, result = _Packets().rxPacket(NoisyPort(long), False)
    assert result == COMM_SUCCESS
    assert bytes(received[8:-2]) == b"\0" + bytes(300) + b"\xff\xff\xfd"


def test_the_common_answer_of_all_servos_carries_a_checksum_after_each() -> None:
    message = fast_status([(3, 0, b"ab"), (4, 0x80, b"")])
    assert message[:7] == bytes.fromhex("fffffd00 fe 0b00")
    assert message[7:12] == b"\x55\x00\x03ab"
    assert message[12:14] == crc16(message[:12]).to_bytes(2, "little")
    assert message[14:16] == b"\x80\x04"
    assert message[16:] == crc16(message[:16]).to_bytes(2, "little")
