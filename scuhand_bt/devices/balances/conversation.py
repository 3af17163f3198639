"""What the driver says to a balance, and when: who are you, then stream, or one question at a time.

    identifying ──answer, or none in time──► listening                     (a dialect that streams)
                                       └───► asked ──line──► resting ──period──► asked …  (one that is polled)
    listening ──the stream is refused──► asked           asked ──no line in time──► draining ──quiet line──► asked

Dialects that are polled have no sequence numbers. What arrives after a question was given up is the
answer to that one, measured who knows when; `draining` throws it away.
"""

import time
from collections.abc import Callable
from enum import Enum, auto

from scuhand_bt.devices.balances.frames import Answer, Dialect, Frame, Refused, Weight

ANSWER_TIMEOUT_S = 2.0
"""Replies of more than a second are common: they wait for the balance's measuring cycle."""
QUIET_S = 0.3
"""How long the line must be quiet before the next question after one without an answer."""


class Phase(Enum):
    """Where the conversation stands."""

    CLOSED = auto()
    IDENTIFYING = auto()
    LISTENING = auto()
    ASKED = auto()
    RESTING = auto()
    DRAINING = auto()


class Conversation:
    """One conversation with a balance, from the opening of the port to its loss."""

    def __init__(
        self,
        dialect: Dialect,
        send: Callable[[bytes], object],
        discard_input: Callable[[], None],
        period_s: float,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self.state = Phase.CLOSED
        self._dialect = dialect
        self._send = send
        self._discard_input = discard_input
        self._period_s = period_s
        self._now = now
        self._since_s = now()
        self._polls = not dialect.stream

    def begin(self) -> None:
        """The port has just been opened, or the balance has to be woken again."""
        if self._dialect.identify:
            self._go_to(Phase.IDENTIFYING, self._dialect.identify)
        else:
            self._read_on()

    def heard(self, frame: Frame) -> bool:
        """Note a frame; False if it must not be used, being the answer to an older question."""
        if self.state is Phase.DRAINING:
            self._go_to(Phase.DRAINING)
            return False
        unasked = isinstance(frame, Weight) and self._polls
        if self.state is Phase.LISTENING and isinstance(frame, Refused) and self._dialect.poll:
            self._polls = True  # not every model can stream
            self._read_on()
        elif self.state is Phase.LISTENING:
            self._go_to(Phase.LISTENING)
        elif self.state is Phase.ASKED and not isinstance(frame, Answer):
            self.state = Phase.RESTING  # the period counts from the question
        elif self.state in (Phase.IDENTIFYING, Phase.RESTING) and unasked:
            self._go_to(Phase.LISTENING)  # auto-print is on; asking would switch it off
        elif self.state is Phase.IDENTIFYING and isinstance(frame, Answer | Refused):
            self._read_on()
        return True

    def misheard(self) -> None:
        """Note a broken line that is as long as an answer: it was the answer, and no other is to be waited for."""
        if self.state is Phase.ASKED:
            self.state = Phase.RESTING

    def go_on(self, patience_s: float) -> None:
        """Say what is due. `patience_s`: how long a stream may pause before it is started again."""
        waited_s = self._now() - self._since_s
        if self.state is Phase.IDENTIFYING and waited_s >= ANSWER_TIMEOUT_S:
            self._read_on()  # many balances do not say who they are
        elif self.state is Phase.ASKED and waited_s >= ANSWER_TIMEOUT_S:
            self._discard_input()
            self._go_to(Phase.DRAINING)
        elif (self.state is Phase.RESTING and waited_s >= self._period_s) or (
            self.state is Phase.DRAINING and waited_s >= QUIET_S
        ):
            self._read_on()
        elif self.state is Phase.LISTENING and waited_s >= patience_s:
            self.begin()

    def _read_on(self) -> None:
        if self._polls:
            self._go_to(Phase.ASKED, self._dialect.poll)
        else:
            self._go_to(Phase.LISTENING, self._dialect.stream)

    def _go_to(self, state: Phase, saying: bytes = b"") -> None:
        self.state = state
        self._since_s = self._now()
        if saying:
            self._send(saying)
