"""What a timeout does: it halts its child at its time on the run's clock, which no pause counts for."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from conftest import Bench, wait_until
from tree_skills import SKILLS

from scuhand_bt.clock import Wake
from scuhand_bt.journal.reader import read
from scuhand_bt.run.clock import VirtualClock
from scuhand_bt.skill import Skill, Steps


def test_a_timeout_halts_its_child_at_its_time_on_the_runs_clock(bench: Bench) -> None:
    outcome = bench.run("timeout: {duration: 5 s, child: {hand: {duration: 1 h}}}", SKILLS)
    assert outcome.failure is not None
    assert outcome.failure.code == "workflow.timeout"
    assert bench.log == [(0.0, "work begins"), (5.0, "work halted")]
    assert bench.actions() == [("hand", "halted")]


def test_that_a_timeout_has_ended_its_child_is_written_once_it_is_halted(bench: Bench, tmp_path: Path) -> None:
    bench.run("timeout: {duration: 5 s, child: {hand: {duration: 1 h}}}", SKILLS)
    kinds = [row["kind"] for row in read(tmp_path / "journal.sqlite", "entry")]
    assert kinds[-3:] == ["action_started", "action_ended", "decided"]


def test_a_child_that_ends_in_time_is_left_alone(bench: Bench) -> None:
    tree = "sequence: [{timeout: {duration: 5 s, child: {work: }}}, {work: {name: next, duration: 60 s}}]"
    assert bench.run(tree, SKILLS).failure is None
    assert bench.log[-1] == (61.0, "next ends")


def test_a_timeout_can_be_retried_and_begins_anew(bench: Bench) -> None:
    slow = "timeout: {duration: 3 s, child: {work: {duration: 1 h}}}"
    tree = f"retry: {{attempts: 2, on: [workflow.timeout], child: {{{slow}}}}}"
    assert bench.run(tree, SKILLS).failure is not None
    assert [time_s for time_s, what in bench.log if what == "work halted"] == [3.0, 6.0]


def test_the_inner_of_two_timeouts_halts_only_its_own_child(bench: Bench) -> None:
    tree = """
timeout:
  duration: 10 s
  child:
    fallback:
      - timeout: {duration: 2 s, child: {work: {name: slow, duration: 1 h}}}
      - work: {name: other}
"""
    assert bench.run(tree, SKILLS).failure is None
    assert bench.log[-1] == (3.0, "other ends")


class TimePasses(VirtualClock):
    """Virtual time that goes on while a run is paused, as real time does."""

    def hold(self, wakes: Sequence[Wake]) -> None:
        self.wait(wakes)


def paused(bench: Bench, *, from_s: float, until_s: float) -> None:
    bench.cell.clock = TimePasses(bench.agenda)
    bench.agenda.at(from_s, lambda: bench.control.wish("pause"))
    bench.agenda.at(until_s, lambda: bench.control.wish("continue"))


def test_a_timeout_counts_no_pause_neither_one_within_it_nor_one_before(bench: Bench) -> None:
    paused(bench, from_s=1.0, until_s=50.0)
    first = "timeout: {duration: 4 s, child: {sequence: [{work: {duration: 2 s}}, {work: {duration: 1 s}}]}}"
    tree = f"sequence: [{{{first}}}, {{timeout: {{duration: 4 s, child: {{work: {{name: slow, duration: 1 h}}}}}}}}]"
    outcome = bench.run(tree, SKILLS)
    assert outcome.failure is not None
    assert outcome.failure.code == "workflow.timeout"
    assert bench.log[2:] == [(50.0, "work begins"), (51.0, "work ends"), (51.0, "slow begins"), (55.0, "slow halted")]


@pytest.mark.parametrize(("lasts", "ended"), [("2 s", (32.0, "next ends")), ("1 h", (33.0, "next halted"))])
def test_a_timeout_counts_no_time_in_which_a_pause_keeps_its_next_action_from_beginning(
    bench: Bench, lasts: str, ended: tuple[float, str]
) -> None:
    """The pause itself begins when what goes on beside it has ended."""
    paused(bench, from_s=1.0, until_s=30.0)
    within = f"sequence: [{{hand: {{duration: 2 s}}}}, {{hand: {{name: next, duration: {lasts}}}}}]"
    bench.run(f"parallel: [{{arm: {{duration: 20 s}}}}, {{timeout: {{duration: 5 s, child: {{{within}}}}}}}]", SKILLS)
    assert bench.log[-2:] == [(30.0, "next begins"), ended]


class Pushed(Skill[None]):
    """Move the arm, and when halted move it on."""

    devices = ("arm",)

    def run(self, cell: Any) -> Steps[None]:
        cell.device("arm").is_stopped = False
        yield from wait_until(cell, 3600.0)


def test_a_timeout_counts_the_time_in_which_a_device_is_waited_for(bench: Bench) -> None:
    pushed, arm = "timeout: {duration: 1 s, child: {pushed: }}", "timeout: {duration: 3 s, child: {arm: }}"
    bench.agenda.at(4.5, lambda: setattr(bench.cell.device("arm"), "is_stopped", True))
    bench.run(f"fallback: [{{{pushed}}}, {{{arm}}}, {{hand: {{name: next}}}}]", {**SKILLS, "pushed": Pushed})
    assert bench.log[0] == (4.0, "next begins")


def test_what_is_at_work_when_a_pause_is_wished_has_no_more_time_for_it(bench: Bench) -> None:
    paused(bench, from_s=1.0, until_s=30.0)
    tree = "fallback: [{timeout: {duration: 5 s, child: {arm: {duration: 1 h}}}}, {hand: {name: next}}]"
    assert bench.run(tree, SKILLS).failure is None
    assert bench.log[1:3] == [(5.0, "work halted"), (30.0, "next begins")]
