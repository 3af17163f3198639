"""What a while does: its child goes on as long as its guards hold, which look again on news."""

from typing import Any

import pytest
from conftest import Bench, wait_until
from tree_skills import SKILLS, Hand, names

from scuhand_bt.skill import Condition, Seconds, Skill, Steps


def test_a_while_succeeds_with_its_child_as_long_as_its_guards_hold(bench: Bench) -> None:
    assert bench.run("while: {guards: [{calm: }], child: {work: {duration: 9 s}}}", SKILLS).failure is None
    assert names(bench) == ["work begins", "work ends"]


def test_a_while_whose_guard_fails_at_once_never_begins_its_child(bench: Bench) -> None:
    bench.cell.note("alarm")
    outcome = bench.run("while: {guards: [{calm: }], child: {work: }}", SKILLS)
    assert outcome.failure is not None
    assert outcome.failure.code == "balance.unstable"
    assert names(bench) == ["alarm"]


@pytest.mark.parametrize(
    "around",
    [
        "{}",
        "sequence: [{{work: {{duration: 0 s, name: before}}}}, {{{}}}]",
        "fallback: [{{{}}}, {{fail: }}]",
        "parallel: [{{{}}}, {{arm: {{duration: 50 s}}}}]",
        "retry: {{attempts: 1, child: {{{}}}}}",
        "timeout: {{duration: 1 h, child: {{sequence: [{{{}}}]}}}}",
    ],
)
def test_a_while_looks_again_on_the_devices_news_wherever_it_stands(bench: Bench, around: str) -> None:
    balance = bench.cell.device("balance")

    def alarm() -> None:
        bench.cell.log.append((7.0, "alarm"))
        balance.news.fire()

    bench.agenda.at(7.0, alarm)
    tree = around.format("while: {guards: [{calm: }], child: {hand: {duration: 100 s, name: guarded}}}")
    outcome = bench.run(tree, SKILLS)
    assert outcome.failure is not None
    assert (7.0, "guarded halted") in bench.log


class Alarming(Hand):
    """Note an alarm after a second, of which no device tells, and go on for one more."""

    def run(self, cell: Any) -> Steps[str]:
        yield from wait_until(cell, cell.clock.now_s + 1.0)
        cell.note("alarm")
        return (yield from super().run(cell))


def test_a_while_looks_again_whenever_what_it_guards_goes_on(bench: Bench) -> None:
    tree = "while: {guards: [{calm: }], child: {alarming: {name: guarded}}}"
    outcome = bench.run(tree, {**SKILLS, "alarming": Alarming})
    assert outcome.failure is not None
    assert outcome.failure.detail == "alarm"
    assert bench.log == [(1.0, "alarm"), (1.0, "guarded begins"), (2.0, "guarded halted")]


def test_news_while_the_guards_hold_changes_nothing(bench: Bench) -> None:
    for time_s in range(1, 20):
        bench.agenda.at(float(time_s), bench.cell.device("balance").news.fire)
    outcome = bench.run("sequence: [{while: {guards: [{calm: }], child: {work: {duration: 30 s}}}}]", SKILLS)
    assert outcome.failure is None
    assert bench.log == [(0.0, "work begins"), (30.0, "work ends")]


def test_a_guard_with_a_value_it_does_not_accept_fails_as_a_skill_would(bench: Bench) -> None:
    class Longer(Condition):
        """Hold if the time is short."""

        duration_s: Seconds

        def check(self, cell: Any) -> None:
            pass

    class Long(Skill[Seconds]):
        """Give a time that is none."""

        def run(self, cell: Any) -> Steps[float]:
            return float("nan")
            yield

    tree = """
sequence:
  - long: {as: t}
  - while: {guards: [{longer: {duration: $t}}], child: {work: }}
"""
    outcome = bench.run(tree, {**SKILLS, "longer": Longer, "long": Long})
    assert outcome.failure is not None
    assert outcome.failure.code == "workflow.bad_value"
