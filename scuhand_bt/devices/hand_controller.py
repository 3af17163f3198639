"""The link to the hand's microcontroller: one command at a time, acknowledged, at 25 Hz or more.

Every command is answered with how the hand stands. One whose answer is lost is sent again under the same
number, which the controller then does not carry out twice. With nothing to say the link pings, and so
keeps the controller's dead-man (220 ms) from closing the valve; when the run's tick hangs it closes the
valve itself and pings no more.
"""

import threading
import time
from collections.abc import Callable

from scuhand_bt.clock import Signal
from scuhand_bt.device_specs.hand import HandSpec
from scuhand_bt.devices.hand_protocol import SEQUENCES, VERSION, Hello, Report, decode, encode
from scuhand_bt.devices.liveness import Liveness
from scuhand_bt.devices.serial_link import REOPEN_S, Framing, SerialLink
from scuhand_bt.failures import Code, SkillFailed

FRAMING = Framing(115200, "8N1")
PING_S = 0.03
"""Between the beginnings of two exchanges with nothing to say: more than 25 a second, with some to spare."""
ANSWER_S = 0.04
"""After this long without an answer a command is sent again."""
LOST_S = 0.5
"""After this long without any answer the controller is taken for lost."""


def map_commands(spec: HandSpec) -> list[str]:
    """What tells a controller its valve's map, and how fast the valve is to go."""
    points = spec.options.valve_map
    told = [f"point {index} {point.count} {point.opening_mm:.3f}" for index, point in enumerate(points)]
    return [*told, f"map {len(points)} {spec.valve_speed_mm_per_s:.3f}"]


class HandController:
    """The microcontroller at a hand's port. Commands start and return at once; `report` tells how it stands.

    It is told the valve's map whenever it is greeted: `robot/cell.yaml` is what counts, not what it has kept.
    """

    def __init__(
        self, spec: HandSpec, news: Signal | None = None, liveness: Liveness | None = None, reopen_s: float = REOPEN_S
    ) -> None:
        self.news = news or Signal()
        self.report: Report | None = None
        """The last one; None while the controller is lost."""
        self.hello: Hello | None = None
        """Its greeting; None until it has come, and again after a restart."""
        self.trouble: SkillFailed | None = None
        """Why the controller cannot be used now."""
        self.refused: SkillFailed | None = None
        """Why the last step, opening or vibration was not carried out, or not to its end."""
        self._url = spec.port
        self._map = map_commands(spec)
        self._liveness = liveness or Liveness()
        self._link = SerialLink(spec.port, FRAMING, self, reopen_s)
        self._lock = threading.RLock()
        self._sequence = 0
        self._queue: list[str] = []
        self._opening = ""
        self._vibration = ""
        self._close = False
        self._in_flight = ""
        self._begun_s = 0.0
        self._sent_s = 0.0
        self._hung = False

    def open(self, timeout_s: float = 4.0) -> Hello:
        """Open the port, greet the controller, and clear what it latched before, where the cause has gone.

        SkillFailed device.lost if it does not answer.
        A board that resets when its port is opened (most Arduinos) needs a second or two to answer.
        """
        self._link.start()
        deadline_s = time.monotonic() + timeout_s
        self._await(lambda: self.hello is not None, deadline_s)
        self.reset()
        self._await(lambda: self.is_done, deadline_s)
        self.refused = None  # what cannot be cleared is in the report
        assert self.hello is not None
        return self.hello

    def _await(self, condition: Callable[[], bool], deadline_s: float) -> None:
        while not condition():
            if time.monotonic() > deadline_s:
                self._link.close()
                raise SkillFailed(
                    Code.DEVICE_LOST,
                    f"the hand controller on {self._url} does not answer; is it the right port, and is its "
                    f"firmware that of robot/firmware (protocol {VERSION})?",
                )
            time.sleep(0.005)

    def close(self) -> None:
        """Close the valve, end the thread and close the port. The controller's dead-man does the rest."""
        with self._lock:
            if self.report is not None:
                self._link.write(encode(self._next_number(), "close"))
        self._link.close()

    def step(self, opening_mm: float, dwell_s: float, vibration: float) -> None:
        """The paper's step command: go to an opening, hold once there, close."""
        with self._lock:
            self.refused = None
            self._queue.append(f"step {opening_mm:.3f} {dwell_s:.3f} {vibration:.3f}")
            self._speak()

    def set_opening(self, opening_mm: float) -> None:
        """Streaming: a newer opening takes the place of one that was not sent yet."""
        with self._lock:
            self._opening = f"open {opening_mm:.3f}"
            self._speak()

    def set_vibration(self, level: float) -> None:
        """Vibration from 0 (off) to 1."""
        with self._lock:
            self._vibration = f"vibrate {level:.3f}"
            self._speak()

    def make_safe(self) -> None:
        """Close the valve and stop vibrating, before anything else that was to be said."""
        with self._lock:
            self._queue, self._opening, self._vibration = [], "", ""
            self._close = True
            if self.hello is not None:
                self._in_flight = ""  # its answer is waited for no longer
            self._speak()

    def reset(self) -> None:
        """Clear the controller's latched faults, if their causes have gone."""
        with self._lock:
            self._queue.append("reset")
            self._speak()

    @property
    def is_done(self) -> bool:
        """Everything that was to be said has been said and answered."""
        with self._lock:
            waiting = self._queue or self._opening or self._vibration or self._close
            return not waiting and self._in_flight in ("", "ping")

    @property
    def is_safe(self) -> bool:
        """By the answer to the last thing that was to be said, the valve is shut and nothing vibrates."""
        with self._lock:  # an answer in between would make an older report of a shut valve count
            return self.is_done and self.report is not None and self.report.is_safe

    # From here on: called from the link's thread.

    def opened(self) -> None:
        """Greet; the controller may have been restarted, and then knows nothing."""
        with self._lock:
            self._greet()

    def line(self, raw: bytes) -> None:
        """Take an answer."""
        answer = decode(raw)
        with self._lock:
            if answer is None or not self._in_flight or answer.sequence != self._sequence:
                return  # noise, or the answer to a command that was given up
            said, self._in_flight = self._in_flight, ""
            if isinstance(answer, Hello):
                self.hello, self.trouble = answer, None
                self._queue = [*self._map, *self._queue]
            elif answer.refusal == "hello":
                self.refused = SkillFailed(Code.DEVICE_LOST, f"the hand controller on {self._url} has restarted")
                self._greet()
            else:
                self._take(said, answer)
            self._speak()
        self.news.fire()

    def idle(self) -> None:
        """Say what is due; notice a hung tick, and silence."""
        with self._lock:
            self._watch_the_tick()
            now_s = time.monotonic()
            if self._in_flight and self.trouble is None and now_s - self._begun_s > LOST_S:
                self._lose(f"the hand controller on {self._url} does not answer; check its cable and supply")
                self.make_safe()  # what was to be said before is not said to it when it comes back
            if self._in_flight and now_s - self._sent_s > ANSWER_S:
                self._transmit()
            else:
                self._speak()

    def lost(self, why: str) -> None:
        """The port has gone."""
        with self._lock:
            self._forget()
            self._lose(why)

    def _watch_the_tick(self) -> None:
        if self._liveness.is_alive:
            self._hung = False
        elif not self._hung and self.report is not None and not self.report.is_safe:
            self._hung = True
            pause_ms = self._liveness.silent_s * 1000
            self.make_safe()
            self.refused = SkillFailed(Code.COMPUTER_BUSY, f"the run hung for {pause_ms:.0f} ms; the valve was closed")

    def _greet(self) -> None:
        self._forget()
        self.hello = self.report = None
        self._send(f"hello {VERSION}")

    def _take(self, said: str, report: Report) -> None:
        self.report, self.trouble = report, None
        if report.refusal and said != "ping":
            why = "it is in fault" if report.refusal == "fault" else f"({report.refusal})"
            self.refused = SkillFailed(Code.DEVICE_LOST, f"the hand controller refused '{said}': {why}")

    def _lose(self, why: str) -> None:
        if self.report is not None and not self.report.is_safe:
            # Its dead-man shuts the valve; a board without power does not, and the servo goes where it was told.
            why += "; at its last report the valve was not shut: check whether it is now"
        self.report = None
        self.trouble = SkillFailed(Code.DEVICE_LOST, why)
        self.news.fire()

    def _forget(self) -> None:
        self._queue, self._opening, self._vibration, self._close, self._in_flight = [], "", "", False, ""

    def _speak(self) -> None:
        """Send the next command, if none is waiting for its answer."""
        if self._in_flight or self.hello is None:
            return
        if self._close:
            self._close = False
            self._send("close")
        elif self._queue:
            self._send(self._queue.pop(0))
        elif self._vibration:
            command, self._vibration = self._vibration, ""
            self._send(command)
        elif self._opening:
            command, self._opening = self._opening, ""
            self._send(command)
        elif self._liveness.is_alive and time.monotonic() - self._begun_s >= PING_S:
            self._send("ping")

    def _next_number(self) -> int:
        self._sequence = (self._sequence + 1) % SEQUENCES
        return self._sequence

    def _send(self, command: str) -> None:
        self._next_number()
        self._in_flight = command
        self._begun_s = time.monotonic()
        self._transmit()

    def _transmit(self) -> None:
        self._sent_s = time.monotonic()
        self._link.write(encode(self._sequence, self._in_flight))
