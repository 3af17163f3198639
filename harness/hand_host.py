"""Shared by the firmware's tests: a host that talks to the hand's board in a time of its own."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TypeAlias

from harness.avr_board import AvrHand
from scuhand_bt.device_specs.hand import HandSpec
from scuhand_bt.devices.hand_controller import map_commands
from scuhand_bt.devices.hand_protocol import SEQUENCES, Hello, Report, decode, encode
from scuhand_bt.sim.wire.hand import HandTwin

FIRMWARE = Path(__file__).parent.parent / "robot" / "firmware"
MAP = map_commands(HandSpec())
Board: TypeAlias = HandTwin | AvrHand


class Host:
    """Talks to the firmware in a time of its own."""

    def __init__(self, board: Board | None = None, greet: bool = True, begins_s: float = 1000.0) -> None:
        self.twin = board or HandTwin(FIRMWARE)
        self.now_s = begins_s
        self.number = 0
        self.twin.hear(b"", self.now_s)
        self.wait(0.05, talking=False)  # it starts
        if greet:
            self.greet()

    def greet(self, commands: Iterable[str] = MAP) -> None:
        """Say hello, tell the valve's map, and clear what there was before."""
        assert isinstance(self.say("hello 2"), Hello)
        assert [self.report(command).refusal for command in (*commands, "reset")] == [""] * (len(tuple(commands)) + 1)

    def say(self, command: str, number: int | None = None) -> Report | Hello | None:
        if number is None:
            self.number = (self.number + 1) % SEQUENCES
            number = self.number
        replies = self.twin.hear(encode(number, command), self.now_s)
        for _ in range(40):  # on the wire, what is said and answered takes its time
            if replies or isinstance(self.twin, HandTwin):
                break
            self.now_s += 0.005
            replies = self.twin.hear(b"", self.now_s)
        return decode(replies[0]) if replies else None

    def report(self, command: str = "ping", number: int | None = None) -> Report:
        answer = self.say(command, number)
        assert isinstance(answer, Report)
        return answer

    def wait(self, seconds: float, talking: bool = True) -> "Host":
        end_s = self.now_s + seconds - 1e-6
        while self.now_s < end_s:
            self.now_s += 0.01
            self.twin.hear(b"", self.now_s)
            if talking:
                self.say("ping")
        return self

    def until(self, condition: Callable[[], bool], timeout_s: float, talking: bool = True) -> float:
        """How long it took [s] until this came true."""
        began_s = self.now_s
        while not condition():
            assert self.now_s - began_s < timeout_s, "this never came true"
            self.wait(0.01, talking)
        return self.now_s - began_s
