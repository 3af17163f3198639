"""What sensors and scanners have in common: something is read, and who waits gets what came after now."""

from typing import ClassVar, Generic, TypeVar

from scuhand_bt.clock import Clock, Signal, Steps, Wake
from scuhand_bt.devices.instruments import Sample
from scuhand_bt.failures import Code, SkillFailed

T = TypeVar("T")


class Reader(Generic[T]):
    """Keeps the last thing read, and why nothing is; the part of a driver that skills meet."""

    nothing: ClassVar[Code] = Code.DEVICE_LOST
    """How `read` fails where the device is sound and nothing comes."""
    is_stopped: bool = True

    def __init__(self, clock: Clock, name: str) -> None:
        self.news = Signal()
        self.latest: Sample[T] | None = None
        """The last one; None before it, and while the device is lost."""
        self.fault: SkillFailed | None = None
        self._clock = clock
        self._name = name

    def stop(self) -> None:
        """Nothing of it moves."""

    def read(self, timeout_s: float = 10.0) -> Steps[Sample[T]]:
        """Wait for what is read after now; SkillFailed device.lost, or `nothing`."""
        deadline_s = self._clock.now_s + timeout_s
        seen = self.latest
        while True:
            wake = Wake.on(self.news, deadline_s)  # made before looking, so that no news falls between
            if self.fault is not None:
                raise self.fault
            if self.latest is not None and self.latest is not seen:
                return self.latest
            if self._clock.now_s >= deadline_s:
                raise SkillFailed(self.nothing, f"{self._name} has read nothing for {timeout_s:g} s")
            yield wake

    def took(self, value: T, raw: bytes) -> None:
        """This was read now."""
        self.latest, self.fault = Sample(value, self._clock.now_s, raw), None
        self.news.fire()

    def lost(self, why: str) -> None:
        """Nothing is read any more."""
        self.latest, self.fault = None, SkillFailed(Code.DEVICE_LOST, f"{self._name}: {why}")
        self.news.fire()

    def found(self) -> None:
        """It is there again, and has read nothing yet."""
        if self.fault is not None:
            self.fault = None
            self.news.fire()

    def health(self) -> dict[str, str]:
        """What it last read."""
        latest = self.latest
        return {"last read": "nothing yet" if latest is None else _in_words(latest.value)}


def _in_words(value: object) -> str:
    return ", ".join(f"{key} {one:g}" for key, one in value.items()) if isinstance(value, dict) else f"{value}"
