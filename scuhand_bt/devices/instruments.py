"""What the devices beside the dose can do, whoever makes them: as the Protocols of `interfaces.py`."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from scuhand_bt.clock import Signal, Steps, Wake
from scuhand_bt.devices.interfaces import Device
from scuhand_bt.failures import SkillFailed

T_co = TypeVar("T_co", covariant=True)


@dataclass(frozen=True, slots=True)
class Sample(Generic[T_co]):
    """What a sensor or a scanner has read: the value, when it came (run time), and its raw bytes."""

    value: T_co
    time_s: float
    raw: bytes = b""


class Status:
    """What a `set` has begun. It completes, done or failed, whatever happens; then the device's news fires."""

    def __init__(self, news: Signal) -> None:
        self.failure: SkillFailed | None = None
        self._news = news
        self._is_done = False

    @property
    def is_done(self) -> bool:
        return self._is_done

    def complete(self, failure: SkillFailed | None = None) -> None:
        """It is over, and well without a failure."""
        self.failure, self._is_done = failure, True
        self._news.fire()

    def wait(self) -> Steps[None]:
        """Wait for it; SkillFailed as it has failed."""
        while True:
            wake = self._wake()
            if self.is_done:
                break
            yield wake
        if self.failure is not None:
            raise self.failure

    def _wake(self) -> Wake:
        return Wake.on(self._news)


class Instrument(Device, Protocol):
    """A device beside the dose: skills lease it under the name that robot/cell.yaml gives it.

    Its fault ends the skill that uses it, and no other.
    """

    def health(self) -> Mapping[str, str]:
        """What a doctor looks at, in words: who it is, what it last said, …"""
        ...


class Sensor(Instrument, Protocol):
    """Measures something of the room or the cell."""

    def read(self, timeout_s: float = 10.0) -> Steps[Sample[Mapping[str, float]]]:
        """Wait for what it measures after now, by names with units (`temperature_c`); SkillFailed device.lost."""
        ...


class Watcher(Instrument, Protocol):
    """Sees what comes into the cell: a depth camera, a light curtain. Nobody leases it; the arm heeds it always.

    With a fault it sees nothing, and the arm does not begin to move.
    """

    @property
    def points_m(self) -> NDArray[np.float64] | None:
        """Where something is seen now that is none of the cell's, in the base frame, shape (n, 3); None: nowhere.

        The arm's own points are left out, and the bench's, which are known. The same array as long as it is the same.
        """
        ...


class Scanner(Instrument, Protocol):
    """Reads the codes of containers."""

    def read(self, timeout_s: float = 10.0) -> Steps[Sample[str]]:
        """Wait for a code that is read after now; SkillFailed container.missing if none is, device.lost."""
        ...


class Ioniser(Instrument, Protocol):
    """Takes charge from powder and containers."""

    @property
    def state(self) -> bool | None:
        """Whether it is on; None while nobody knows."""
        ...

    def set(self, value: bool) -> Status:
        """Switch it on or off; SkillFailed device.busy while it still does what it was told before, device.lost."""
        ...


class Capper(Instrument, Protocol):
    """Puts a cap on a container, and takes it off."""

    @property
    def state(self) -> bool | None:
        """Whether the container is capped; None while nobody knows."""
        ...

    def set(self, value: bool) -> Status:
        """Cap the container, or take its cap off; SkillFailed device.busy, device.lost."""
        ...
