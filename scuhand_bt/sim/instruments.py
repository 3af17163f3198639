"""The simulated further devices of a cell: they keep their Protocols on the run's clock, whatever their drivers."""

from collections.abc import Callable, Mapping

from scuhand_bt.clock import Clock, Signal, Steps, Wake
from scuhand_bt.devices.boxes import Boxes
from scuhand_bt.devices.instruments import Sample, Status
from scuhand_bt.devices.interfaces import Device
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.sim.world import World

PERIOD_S = 1.0
"""Time between two readings of a sensor or of a scanner."""
SWITCHED_AFTER_S = {"ioniser": 0.5, "capper": 5.0}
ROOM = {"temperature_c": 22.0, "humidity_percent": 45.0}
"""The air of a laboratory, by names with units; no world changes it."""


class _Simulated:
    """What these devices have in common: they never have a fault."""

    fault = None
    is_stopped = True

    def __init__(self, clock: Clock) -> None:
        self.news = Signal()
        self._clock = clock

    def stop(self) -> None:
        """Does nothing: a device ends what it does."""

    def health(self) -> dict[str, str]:
        return {"made by": "the simulation"}

    def _pause(self, until_s: float) -> Steps[None]:
        while self._clock.now_s < until_s:
            yield Wake(until_s)


class SimulatedSensor(_Simulated):
    """Measures the air of a laboratory."""

    def read(self, timeout_s: float = 10.0) -> Steps[Sample[Mapping[str, float]]]:
        yield from self._pause(self._clock.now_s + PERIOD_S)
        return Sample(ROOM, self._clock.now_s)


class SimulatedScanner(_Simulated):
    """Reads the code of the container on the pan."""

    def __init__(self, clock: Clock, on_pan: Callable[[], str | None]) -> None:
        super().__init__(clock)
        self._on_pan = on_pan

    def read(self, timeout_s: float = 10.0) -> Steps[Sample[str]]:
        until_s = self._clock.now_s + timeout_s
        while True:
            yield from self._pause(min(self._clock.now_s + PERIOD_S, until_s))
            if (code := self._on_pan()) is not None:
                return Sample(code, self._clock.now_s)
            if self._clock.now_s >= until_s:
                raise SkillFailed(Code.CONTAINER_MISSING, f"the scanner has read nothing for {timeout_s:g} s")


class _Timed(Status):
    """Done at a time of the run's clock."""

    def __init__(self, news: Signal, clock: Clock, done_s: float) -> None:
        super().__init__(news)
        self._clock, self._done_s = clock, done_s

    @property
    def is_done(self) -> bool:
        return self._clock.now_s >= self._done_s

    def _wake(self) -> Wake:
        return Wake(self._done_s)


class SimulatedSwitch(_Simulated):
    """An ioniser or a capper; each takes a fixed time."""

    def __init__(self, clock: Clock, takes_s: float) -> None:
        super().__init__(clock)
        self._takes_s = takes_s
        self._told = False
        self._status: Status | None = None

    @property
    def is_stopped(self) -> bool:  # type: ignore[override]
        return self._status is None or self._status.is_done

    @property
    def state(self) -> bool | None:
        return self._told if self.is_stopped else None

    def set(self, value: bool) -> Status:
        if not self.is_stopped:
            raise SkillFailed(Code.DEVICE_BUSY, "it has not done yet what it was told before")
        self._told = value
        self._status = _Timed(self.news, self._clock, self._clock.now_s + self._takes_s)
        return self._status


def simulated_instrument(kind: str, clock: Clock, world: World, options: object = None) -> Device:
    """The device of a kind, in a world. A watcher with another driver than `boxes` sees nothing."""
    if kind == "watcher":
        return Boxes(clock, options.boxes if isinstance(options, Boxes.Options) else ())
    if kind == "sensor":
        return SimulatedSensor(clock)
    if kind == "scanner":
        return SimulatedScanner(clock, lambda: world.pan.container_id)
    return SimulatedSwitch(clock, SWITCHED_AFTER_S[kind])
