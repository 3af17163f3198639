"""Tests in real time, marked `real_time`, on a computer that may have other work.

One that fails while the computer is too busy to keep time says little, so it is tried again, twice at the most, each
time once the load has fallen or after a minute. If it still fails it fails, with the load in its message; it is never
skipped. One that fails on a computer that keeps time has failed.
"""

import os
import threading
import time
from collections.abc import Generator
from dataclasses import dataclass

import pytest
from _pytest.runner import runtestprotocol  # no public hook runs a test again with fresh fixtures

ATTEMPTS = 3
WAIT_S = 60.0
"""The longest wait for the load to fall, before another attempt."""
LATE_MS, TAKEN = 20.0, 0.9
"""A computer that wakes a thread so late, or of whose cores others want so large a share, is no measure of times."""


@dataclass(frozen=True)
class Business:
    """What else the computer had to do during an attempt."""

    load: float
    """Processes that want a processor: the system's mean of the last minute."""
    late_ms: float
    """The latest that a sleeping thread was woken."""

    @property
    def is_too_much(self) -> bool:
        return self.load > TAKEN * cores() or self.late_ms > LATE_MS

    def __str__(self) -> str:
        return f"load {self.load:.1f} on {cores()} cores, a thread woken {self.late_ms:.0f} ms late"


def load() -> float:
    return os.getloadavg()[0]


def cores() -> int:
    return os.cpu_count() or 1


pause = time.sleep
METRONOME = pytest.StashKey["Metronome"]()
ATTEMPT = pytest.StashKey[int]()
GIVES_WAY = pytest.StashKey[bool]()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """They run one after the other, beside those that only compute; of which one process makes what a file's share.

    Files that share something dear name a group of their own.
    """
    for item in items:
        if item.get_closest_marker("real_time") is not None:
            item.add_marker(pytest.mark.xdist_group("real_time"))
        elif item.get_closest_marker("xdist_group") is None:
            item.add_marker(pytest.mark.xdist_group(item.path.stem))


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    if item.get_closest_marker("real_time") is None:
        _give_way(item.config)
        return None
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    for attempt in range(1, ATTEMPTS + 1):
        with Metronome() as metronome:
            item.stash[METRONOME], item.stash[ATTEMPT] = metronome, attempt
            reports = runtestprotocol(item, nextitem=nextitem, log=False)
        goes_on = attempt < ATTEMPTS and metronome.business.is_too_much
        is_tried_again = goes_on and any(report.failed for report in reports)
        for report in reports:
            if is_tried_again and report.failed:
                report.outcome = "retried"  # type: ignore[assignment]
            if not is_tried_again or report.outcome == "retried":
                item.ihook.pytest_runtest_logreport(report=report)
        if not is_tried_again:
            break
        _wait_for_quiet()
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    if call.excinfo is not None and METRONOME in item.stash:
        attempt, business = item.stash[ATTEMPT], item.stash[METRONOME].business
        call.excinfo.value.add_note(f"In real time, attempt {attempt} of {ATTEMPTS}: {business}.")
    return (yield)


def pytest_report_teststatus(report: pytest.TestReport) -> tuple[str, str, str] | None:
    return ("retried", "R", "RETRIED") if report.outcome == "retried" else None


def _give_way(config: pytest.Config) -> None:
    """Of several processes: which one gets the largest group, as its first, only xdist knows."""
    if hasattr(config, "workerinput") and not config.stash.get(GIVES_WAY, False):
        os.nice(10)
        config.stash[GIVES_WAY] = True


def _wait_for_quiet() -> None:
    end_s = time.monotonic() + WAIT_S
    while load() > cores() and time.monotonic() < end_s:
        pause(1.0)


class Metronome:
    """Sleeps for a moment again and again beside what is tested, and notes the latest that it was woken."""

    def __init__(self) -> None:
        self.latest_s = 0.0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._tick, daemon=True)

    @property
    def business(self) -> Business:
        return Business(load(), 1000.0 * self.latest_s)

    def __enter__(self) -> "Metronome":
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        self._thread.join()

    def _tick(self) -> None:
        due_s = time.monotonic()
        while not self._over.is_set():
            due_s += 0.005
            time.sleep(max(0.0, due_s - time.monotonic()))
            now_s = time.monotonic()
            self.latest_s = max(self.latest_s, now_s - due_s)
            due_s = max(due_s, now_s - 0.005)
