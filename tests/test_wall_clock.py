"""A computer whose clock is set: it is noticed and noted, within a run and between runs."""

import time
from datetime import datetime, timedelta
from pathlib import Path

import pytest
from running import dry_run

from scuhand_bt.journal.reader import read
from scuhand_bt.lab_state.ledger import Ledger
from scuhand_bt.run import wall_clock
from scuhand_bt.run.wall_clock import ClockWatch, disagreement

DOSE = """
recipe: one
workflow: fill_xrd_holder
defaults: {container: xrd_holder, source: beads}
samples: [{id: a, mass: 30 mg}]
"""
YEARS = 30 * 365.25 * 86400.0


def troubles(journal: Path) -> list[str]:
    return [event["payload"]["what"] for event in read(journal, "event") if event["kind"] == "trouble"]


@pytest.mark.parametrize(("by_s", "way"), [(YEARS, "forward"), (-YEARS, "back"), (-61.0, "back")])
def test_a_clock_that_is_set_within_a_run_is_noted_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, by_s: float, way: str
) -> None:
    real = time.time
    ticks = 0

    def at_tick(root: object) -> None:
        nonlocal ticks
        ticks += 1
        if ticks == 5:
            monkeypatch.setattr(wall_clock.time, "time", lambda: real() + by_s)

    ran = dry_run(tmp_path, DOSE, at_tick=at_tick)
    (said,) = troubles(ran.journal)
    assert f"clock was set {way} by" in said
    assert ran.result.exit_code == 0


@pytest.mark.parametrize("by_s", [0.0, 59.0, -59.0])
def test_a_clock_that_is_corrected_a_little_is_not_noted(monkeypatch: pytest.MonkeyPatch, by_s: float) -> None:
    watch, real = ClockWatch(), time.time
    monkeypatch.setattr(wall_clock.time, "time", lambda: real() + by_s)
    assert watch.jump() is None


def test_the_clock_is_held_against_the_time_since_the_computer_was_started() -> None:
    up_s = float(Path("/proc/uptime").read_text().split()[0])
    assert wall_clock._now()[1] == pytest.approx(up_s, abs=5.0)


def test_a_computer_that_slept_has_a_clock_that_is_right(monkeypatch: pytest.MonkeyPatch) -> None:
    watch, now = ClockWatch(), wall_clock._now()
    monkeypatch.setattr(wall_clock, "_now", lambda: (now[0] + 9000.0, now[1] + 9000.0))
    assert watch.jump() is None


@pytest.mark.parametrize(
    ("since", "odd"),
    [
        (timedelta(days=-9000), "earlier than"),
        (timedelta(minutes=-2), "earlier than"),
        (timedelta(days=300), None),
        (timedelta(days=367), "more than a year after"),
    ],
)
def test_a_clock_is_held_against_what_was_written_last(since: timedelta, odd: str | None) -> None:
    said = disagreement((datetime.now().astimezone() - since).isoformat())
    assert odd in said if odd and said else said is odd


def test_a_run_before_the_ledgers_last_line_says_so_in_its_journal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from scuhand_bt import clock

    class Later(datetime):
        @classmethod
        def now(cls, tz: object = None) -> datetime:  # type: ignore[override]
            return datetime.now() + timedelta(days=9000)

    with monkeypatch.context() as patch:
        patch.setattr(clock, "datetime", Later)
        Ledger(tmp_path).add("before", "ended", 1, "0" * 64, durable=False)
    ran = dry_run(tmp_path, DOSE)
    assert any("earlier than the last time that this lab has recorded" in said for said in troubles(ran.journal))
    assert any("earlier than the last" in said for said in ran.session.warnings)
