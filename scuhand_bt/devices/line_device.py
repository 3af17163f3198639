"""Devices that speak in lines over a serial port: what a driver of one has to say is its lines, and nothing else.

A `LineReader` is a sensor or a scanner, a `LineSwitch` an ioniser or a capper, a `LineWatcher` a watcher. Ports are
opened again whenever they come back; a device that is asked and does not answer for `silent_after_s` is lost.
"""

import time
from abc import ABC, abstractmethod
from typing import Annotated, Any, ClassVar, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field

from scuhand_bt.clock import Signal
from scuhand_bt.devices.instruments import Status
from scuhand_bt.devices.interfaces import Site
from scuhand_bt.devices.readers import Reader
from scuhand_bt.devices.serial_link import Framing, SerialLink, Silence
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.specs import Positive, Spec

T = TypeVar("T")


class LineOptions(Spec):
    """Where a device's own menu is not as it left the factory."""

    baud: Annotated[int, Positive] | None = None
    bits: Annotated[str, Field(pattern=r"^[78][NEO][12]$")] | None = None
    """Data bits, parity, stop bits: "7E1"."""


class LineDevice(ABC):
    """The line to a device; meets `serial_link.LineUser`."""

    Options: ClassVar[type[BaseModel]] = LineOptions
    twin: ClassVar[str] = ""
    framing: ClassVar[Framing]
    """The factory's setting."""
    question: ClassVar[bytes] = b""
    """Asked every `period_s`; b"" for a device that speaks by itself."""
    period_s: ClassVar[float] = 1.0
    silent_after_s: ClassVar[float] = 3.0

    @classmethod
    def connect(cls, site: Site) -> Self:
        """The device, with its port open; SkillFailed device.lost."""
        device = cls(site)
        device._link.start()
        return device

    def __init__(self, site: Site) -> None:
        self.options: Any = site.options
        framing = Framing(self.options.baud or self.framing.baud, self.options.bits or self.framing.bits)
        self._clock = site.clock
        self._link = SerialLink(site.spec.port, framing, self)
        self._silence = Silence()
        self._asked_s = float("-inf")
        self._name = f"the {type(self).__name__} on {site.spec.port}"

    @abstractmethod
    def heard(self, line: bytes) -> bool:
        """Take a line; False for one that this device does not send."""

    @abstractmethod
    def lost(self, why: str) -> None:
        """It is not there any more."""

    def close(self) -> None:
        """End the thread and close the port."""
        self._link.close()

    # From here on: called from the link's thread.

    def opened(self) -> None:
        """Begin anew."""
        self._silence.broken()
        self._asked_s = float("-inf")

    def line(self, raw: bytes) -> None:
        """Take a line; one that is not this device's breaks no silence."""
        if self.heard(raw):
            self._silence.broken()

    def idle(self) -> None:
        """Ask when it is time to, and notice silence."""
        now_s = self._clock.now_s
        if not self.question:
            return
        if now_s - self._asked_s >= self.period_s:
            self._asked_s = now_s
            self._link.write(self.question)
        if self._silence.seconds > self.silent_after_s:
            self._silence.broken()
            self.lost(f"it does not answer {self.question!r}; is it switched on, and are speed and parity right?")


class LineReader(LineDevice, Reader[T]):
    """A sensor or a scanner: `parse` says what a line has brought."""

    def __init__(self, site: Site) -> None:
        LineDevice.__init__(self, site)
        Reader.__init__(self, self._clock, self._name)

    @abstractmethod
    def parse(self, line: bytes) -> T | None:
        """What this line, terminator included, says; None if it is none of the device's."""

    def opened(self) -> None:
        super().opened()
        self.found()

    def lost(self, why: str) -> None:
        Reader.lost(self, why)

    def heard(self, line: bytes) -> bool:
        value = self.parse(line)
        if value is not None:
            self.took(value, line)
        return value is not None


class LineSwitch(LineDevice):
    """An ioniser or a capper: it is told one of two states, and asked for the one that it is in."""

    done_within_s: ClassVar[float] = 10.0
    """Longer, and a `set` has failed."""
    safe: ClassVar[bytes] = b""
    """What `stop` says; b"" where what it does goes on to its end."""

    def __init__(self, site: Site) -> None:
        super().__init__(site)
        self.news = Signal()
        self.state: bool | None = None
        self.fault: SkillFailed | None = None
        self._wanted = False
        self._status: Status | None = None
        self._until_s = 0.0

    @abstractmethod
    def command(self, value: bool) -> bytes:
        """What brings it into this state."""

    @abstractmethod
    def parse(self, line: bytes) -> bool | None:
        """The state that this line, terminator included, tells; None if it tells none."""

    @property
    def is_stopped(self) -> bool:
        return self._status is None

    def set(self, value: bool) -> Status:
        """Begin to bring it into this state; SkillFailed device.busy, device.lost."""
        if self.fault is not None:
            raise self.fault
        if self._status is not None:
            raise SkillFailed(Code.DEVICE_BUSY, f"{self._name} is still carrying out the command before")
        self._wanted, self._until_s = value, self._clock.now_s + self.done_within_s
        self._status = status = Status(self.news)
        self._link.write(self.command(value))
        return status

    def stop(self) -> None:
        """Its safe state, where it has one."""
        if self.safe:
            self._link.write(self.safe)
            self._complete(SkillFailed(Code.DEVICE_BUSY, f"{self._name} was stopped"))

    def health(self) -> dict[str, str]:
        """The state it says it is in."""
        return {"state": {None: "unknown", True: "on", False: "off"}[self.state]}

    def heard(self, line: bytes) -> bool:
        state = self.parse(line)
        if state is None:
            return False
        is_news = state != self.state or self.fault is not None
        self.state, self.fault = state, None
        if self._status is not None and state == self._wanted:
            self._complete()
        elif is_news:
            self.news.fire()
        return True

    def idle(self) -> None:
        super().idle()
        if self._status is not None and self._clock.now_s > self._until_s:
            told = "on" if self._wanted else "off"
            self._complete(
                SkillFailed(
                    Code.DEVICE_LOST,
                    f"{self._name} was commanded to be {told}, but does not report that it is; look at it",
                )
            )

    def lost(self, why: str) -> None:
        self.state, self.fault = None, SkillFailed(Code.DEVICE_LOST, f"{self._name}: {why}")
        self._complete(self.fault)
        self.news.fire()

    def _complete(self, failure: SkillFailed | None = None) -> None:
        status, self._status = self._status, None
        if status is not None:
            status.complete(failure)


class LineWatcher(LineDevice):
    """A watcher: `parse` says what a line tells to be there. It has a fault until it has told what it sees now.

    Silence is a fault, too, of one that speaks by itself: nobody knows what it would have seen.
    """

    silent_after_s: ClassVar[float] = 1.0
    is_stopped = True

    @classmethod
    def connect(cls, site: Site) -> Self:
        """The device, having told what it sees; SkillFailed device.lost."""
        device = super().connect(site)
        end_s = time.monotonic() + device.silent_after_s
        while device.fault is not None and time.monotonic() < end_s:
            time.sleep(0.01)
        if device.fault is not None:
            device.close()
            raise device.fault
        return device

    def __init__(self, site: Site) -> None:
        super().__init__(site)
        self.news = Signal()
        self.points_m: NDArray[np.float64] | None = None
        self.fault: SkillFailed | None = self._blind("it has not reported yet what it sees")

    @abstractmethod
    def parse(self, line: bytes) -> tuple[tuple[float, float, float], ...] | None:
        """The points [m] in the base frame that this line, terminator included, tells; None if it tells none.

        A line that is cut short tells none: half of what is there would be taken for all of it.
        """

    def stop(self) -> None:
        """Nothing of it moves."""

    def health(self) -> dict[str, str]:
        """How much it sees now."""
        return {"sees": "nothing" if self.points_m is None else f"{len(self.points_m)} points"}

    def heard(self, line: bytes) -> bool:
        told = self.parse(line)
        if told is None:
            return False
        before, points_m = self.points_m, np.array(told, dtype=float).reshape(-1, 3) if told else None
        is_same = points_m is before or (
            points_m is not None and before is not None and np.array_equal(points_m, before)
        )
        if not is_same:
            self.points_m = points_m
        if not is_same or self.fault is not None:
            self.fault = None
            self.news.fire()
        return True

    def idle(self) -> None:
        super().idle()
        if self._silence.seconds > self.silent_after_s:
            self._silence.broken()
            self.lost("it has gone silent; is it switched on?")

    def lost(self, why: str) -> None:
        self.points_m, self.fault = None, self._blind(why)
        self.news.fire()

    def _blind(self, why: str) -> SkillFailed:
        return SkillFailed(Code.DEVICE_LOST, f"{self._name}: {why}")
