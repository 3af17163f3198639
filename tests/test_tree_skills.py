"""How a tree runs its skills: none before its devices stand, all halted with the run, and no bug unnamed."""

from typing import Any

import pytest
from conftest import Bench, wait_until
from tree_skills import SKILLS, names

from scuhand_bt.clock import Wake
from scuhand_bt.problems import SourceError
from scuhand_bt.run.runner import SkillBug
from scuhand_bt.skill import Seconds, Skill, Steps


def test_the_next_skill_waits_until_the_device_reports_that_it_has_stopped(bench: Bench) -> None:
    arm = bench.cell.device("arm")

    class Push(Skill[None]):
        """Set the arm going and end before it stands."""

        devices = ("arm",)

        def run(self, cell: Any) -> Steps[None]:
            arm.is_stopped = False
            cell.note("pushed")
            return
            yield

    def stands() -> None:
        arm.is_stopped = True
        arm.news.fire()

    bench.agenda.at(0.8, stands)
    assert bench.run("sequence: [{push: }, {arm: {name: next}}]", {**SKILLS, "push": Push}).failure is None
    assert bench.log[:2] == [(0.0, "pushed"), (0.8, "next begins")]


def test_a_halted_skills_device_is_waited_for_too(bench: Bench) -> None:
    arm = bench.cell.device("arm")

    class Swing(Skill[None]):
        """Move for long; when halted, tell the arm to stop, which takes a while."""

        devices = ("arm",)

        def run(self, cell: Any) -> Steps[None]:
            arm.is_stopped = False
            try:
                yield from wait_until(cell, 3600.0)
            finally:
                cell.note("told to stop")

    def stands() -> None:
        arm.is_stopped = True
        arm.news.fire()

    bench.agenda.at(7.5, stands)
    tree = "fallback: [{timeout: {duration: 5 s, child: {swing: }}}, {arm: {name: other}}]"
    assert bench.run(tree, {**SKILLS, "swing": Swing}).failure is None
    assert bench.log[:2] == [(5.0, "told to stop"), (7.5, "other begins")]


def test_a_device_that_never_stops_is_a_failure_and_the_skill_is_not_begun(bench: Bench) -> None:
    bench.cell.device("arm").is_stopped = False

    class Push(Skill[None]):
        """Move, and when halted move on."""

        devices = ("arm",)

        def run(self, cell: Any) -> Steps[None]:
            bench.cell.device("arm").is_stopped = False
            yield from wait_until(cell, 3600.0)

    bench.cell.device("arm").is_stopped = True
    tree = "fallback: [{timeout: {duration: 1 s, child: {push: }}}, {arm: }]"
    outcome = bench.run(tree, {**SKILLS, "push": Push})
    assert outcome.failure is not None
    assert outcome.failure.code == "device.busy"
    assert "arm" in outcome.failure.detail
    assert bench.log == []


def test_skills_without_devices_wait_for_nobody(bench: Bench) -> None:
    assert bench.run("parallel: [{arm: {duration: 5 s}}, {work: {name: free}}]", SKILLS).failure is None
    assert (0.0, "free begins") in bench.log


def test_stopping_the_run_halts_every_running_skill(bench: Bench) -> None:
    bench.agenda.at(3.0, lambda: bench.control.wish("stop_now"))
    outcome = bench.run("parallel: [{arm: {name: a, duration: 1 h}}, {hand: {name: b, duration: 1 h}}]", SKILLS)
    assert outcome.interrupted == "stopped"
    assert {(3.0, "a halted"), (3.0, "b halted")} <= set(bench.log)
    assert bench.actions() == [("arm", "interrupted"), ("hand", "interrupted")]


class Buggy(Skill[None]):
    """Break."""

    after_s: Seconds = 0.0

    def run(self, cell: Any) -> Steps[None]:
        yield from wait_until(cell, cell.clock.now_s + self.after_s)
        raise ZeroDivisionError("one by none")


@pytest.mark.parametrize("after", ["0 s", "2 s"])
def test_a_bug_in_a_skill_names_the_skill_and_halts_the_others(bench: Bench, after: str) -> None:
    with pytest.raises(SkillBug, match="buggy broke: ZeroDivisionError: one by none"):
        bench.run(f"parallel: [{{hand: {{duration: 1 h}}}}, {{buggy: {{after: {after}}}}}]", {**SKILLS, "buggy": Buggy})
    assert names(bench)[-1] == "work halted"
    assert bench.actions() == [("hand", "interrupted"), ("buggy", "broken")]


def test_a_skill_that_yields_for_ever_without_waiting_is_found_out(bench: Bench) -> None:
    class Spin(Skill[None]):
        """Yield for ever."""

        def run(self, cell: Any) -> Steps[None]:
            while True:
                yield Wake(cell.clock.now_s)

    with pytest.raises(SkillBug, match="spin"):
        bench.run("spin:", {"spin": Spin})


def test_a_skill_that_waits_for_what_never_comes_is_found_out(bench: Bench) -> None:
    class Hang(Skill[None]):
        """Wait for ever."""

        def run(self, cell: Any) -> Steps[None]:
            yield Wake()

    with pytest.raises(SkillBug, match="hang"):
        bench.run("hang:", {"hang": Hang})


class Stubborn(Skill[None]):
    """Yield while being halted, which a skill must not."""

    devices = ("hand",)

    def run(self, cell: Any) -> Steps[None]:
        try:
            yield from wait_until(cell, 3600.0)
        finally:
            yield Wake(cell.clock.now_s + 1.0)


class Clumsy(Skill[None]):
    """Break while being halted."""

    devices = ("hand",)

    def run(self, cell: Any) -> Steps[None]:
        try:
            yield from wait_until(cell, 3600.0)
        finally:
            raise ZeroDivisionError("in finally")


@pytest.mark.parametrize("skill", [Stubborn, Clumsy])
def test_a_skill_that_breaks_while_being_halted_is_named_and_the_others_are_halted_too(
    bench: Bench, skill: type[Skill[None]]
) -> None:
    tree = "timeout: {duration: 5 s, child: {parallel: [{bad: }, {arm: {duration: 1 h}}]}}"
    with pytest.raises(SkillBug, match="bad"):
        bench.run(tree, {**SKILLS, "bad": skill})
    assert (5.0, "work halted") in bench.log
    assert dict(bench.actions()) == {"bad": "broken", "arm": "halted"}


@pytest.mark.parametrize("skill", [Stubborn, Clumsy])
def test_a_skill_that_breaks_while_the_run_is_stopped_is_named(bench: Bench, skill: type[Skill[None]]) -> None:
    bench.agenda.at(3.0, lambda: bench.control.wish("stop_now"))
    with pytest.raises(SkillBug, match="bad"):
        bench.run("parallel: [{bad: }, {arm: {duration: 1 h}}]", {**SKILLS, "bad": skill})
    assert (3.0, "work halted") in bench.log


def test_a_skill_whose_run_is_no_generator_is_a_bug(bench: Bench) -> None:
    class Plain(Skill[None]):
        """Forget to yield."""

        def run(self, cell: Any) -> None:  # type: ignore[override]
            cell.note("done at once")

    with pytest.raises(SkillBug, match="plain"):
        bench.run("plain:", {"plain": Plain})


def test_a_workflow_that_does_not_pass_its_check_is_not_run(bench: Bench) -> None:
    with pytest.raises(SourceError):
        bench.run("work: {duration: 3 mg}", SKILLS)
