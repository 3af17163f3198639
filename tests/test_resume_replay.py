"""A job that was interrupted is replayed, on a bench of fake devices."""

from pathlib import Path
from typing import Any, ClassVar

import pytest
from conftest import Bench

from scuhand_bt.clock import Steps
from scuhand_bt.run.control import Control
from scuhand_bt.skill import Condition, Ratio, Seconds, Skill, SkillFailed, pause


class Work(Skill[float]):
    """Take a while; give the time at which it was done."""

    devices = ("hand",)
    interrupted = "repeat"
    duration_s: Seconds = 1.0

    def run(self, cell: Any) -> Steps[float]:
        yield from pause(cell, self.duration_s)
        cell.note("worked")
        return float(cell.clock.now_s)


class Move(Work):
    """The same with another device."""

    devices = ("arm",)


class Fail(Skill[None]):
    """Fail after a while, until it has failed often enough."""

    interrupted = "repeat"
    times_ratio: Ratio = 2.0
    failed: ClassVar[list[float]] = []

    def run(self, cell: Any) -> Steps[None]:
        yield from pause(cell, 0.5)
        if len(self.failed) < self.times_ratio:
            self.failed.append(cell.clock.now_s)
            raise SkillFailed("hand.cone_empty", "again")


class Early(Condition):
    """Hold in the first ten seconds."""

    watches = ("balance",)

    def check(self, cell: Any) -> None:
        if cell.clock.now_s > 10.0:
            raise SkillFailed("hand.no_flow", "late")


SKILLS: dict[str, type[Skill[Any]]] = {"work": Work, "move": Move, "fail": Fail, "early": Early}
TREES = {
    "sequence": "sequence: [{work: }, {early: }, {move: }, {work: }]",
    "retry": "retry: {attempts: 4, child: {sequence: [{work: }, {fail: }, {move: }]}}",
    "repeat": "repeat: {times: 3, child: {sequence: [{work: }, {move: }]}}",
    "parallel": "sequence: [{parallel: [{work: {duration: 3 s}}, {sequence: [{move: }, {move: }]}]}, {work: }]",
    "timeout": "fallback: [{timeout: {duration: 2 s, child: {repeat: {times: 9, child: {work: }}}}}, {move: }]",
    "while": "fallback: [{while: {guards: [{early: }], child: {repeat: {times: 99, child: {work: }}}}}, {move: }]",
}


def outcomes(bench: Bench) -> list[tuple[str, str]]:
    return [action for action in bench.actions() if action[1] in ("done", "failed")]


@pytest.mark.parametrize("tree", TREES)
def test_a_job_stopped_at_any_tick_repeats_no_finished_action(tree: str, tmp_path: Path) -> None:
    def bench(name: str) -> Bench:
        Fail.failed.clear()
        folder = tmp_path / name
        folder.mkdir()
        made = Bench(folder)
        for beat in range(40):
            made.agenda.at(0.5 * beat, made.cell.devices["balance"].news.fire)
        return made

    whole = bench("whole")
    ended = whole.run(TREES[tree], SKILLS)
    for tick in range(1, len(whole.trees), max(1, len(whole.trees) // 12)):
        stopped = bench(f"stopped-{tick}")

        def ticked(root: Any, stopped: Bench = stopped, tick: int = tick) -> None:
            stopped.trees.append(root)
            if len(stopped.trees) == tick:
                stopped.control.wish("stop_now")

        stopped.ticked = ticked
        first = stopped.run(TREES[tree], SKILLS)
        finished = outcomes(stopped)
        stopped.control = Control()
        if first.interrupted is None:
            continue
        again = stopped.run(TREES[tree], SKILLS, resumes=True)
        assert (again.failure is None) == (ended.failure is None)
        assert outcomes(stopped)[: len(finished)] == finished
        if tree not in ("timeout", "while"):  # which begin anew, so that what they bound may do more
            assert sorted(outcomes(stopped)) == sorted(outcomes(whole))


def test_an_action_that_only_a_person_can_settle_is_asked_about(tmp_path: Path) -> None:
    class Press(Skill[None]):
        """Press a pellet: nobody should do that twice."""

        def run(self, cell: Any) -> Steps[None]:
            yield from pause(cell, 5.0)
            cell.note("pressed")

    class Answers:
        def __init__(self) -> None:
            self.asked: list[str] = []

        def ask(self, question: str, choices: Any) -> Steps[str]:
            self.asked.append(question)
            yield from ()
            return "done"

    bench = Bench(tmp_path)
    bench.agenda.at(3.0, lambda: bench.control.wish("stop_now"))
    bench.run("press:", {"press": Press})
    bench.control, operator = Control(), Answers()
    bench.cell.operator = operator  # type: ignore[attr-defined]
    outcome = bench.run("press:", {"press": Press}, resumes=True)
    assert outcome.failure is None
    assert "is it done" in operator.asked[0]
    assert not bench.log


@pytest.mark.parametrize(("duration", "failed"), [("8 s", None), ("4 s", "workflow.timeout")])
def test_a_timeout_counts_from_where_an_interrupted_action_goes_on(
    tmp_path: Path, duration: str, failed: str | None
) -> None:
    """Not from where a person was asked what became of it."""

    class Press(Skill[None]):
        """Press a pellet: nobody should do that twice."""

        def run(self, cell: Any) -> Steps[None]:
            yield from pause(cell, 5.0)
            cell.note("pressed")

    class Thinks:
        def ask(self, question: str, choices: Any) -> Steps[str]:
            yield from pause(bench.cell, 60.0)  # type: ignore[arg-type]
            return "again"

    bench, tree = Bench(tmp_path), f"timeout: {{duration: {duration}, child: {{press: }}}}"
    bench.agenda.at(3.0, lambda: bench.control.wish("stop_now"))
    bench.run(tree, {"press": Press})
    bench.control = Control()
    bench.cell.operator = Thinks()  # type: ignore[attr-defined]
    outcome = bench.run(tree, {"press": Press}, resumes=True)
    assert (outcome.failure and outcome.failure.code) == failed
    assert bench.cell.clock.now_s == 3.0 + 60.0 + (5.0 if failed is None else 4.0)


def test_what_a_workflow_kept_is_kept_over_an_interruption(tmp_path: Path) -> None:
    class Say(Skill[None]):
        """Note a duration."""

        interrupted = "repeat"
        duration_s: Seconds

        def run(self, cell: Any) -> Steps[None]:
            yield from pause(cell, 1.0)
            cell.note(f"{self.duration_s:g}")

    class Give(Skill[Seconds]):
        """Give a duration."""

        interrupted = "repeat"

        def run(self, cell: Any) -> Steps[float]:
            yield from pause(cell, 1.0)
            return 4.5

    bench = Bench(tmp_path)
    bench.agenda.at(1.5, lambda: bench.control.wish("stop_now"))
    tree = "sequence: [{give: {as: long}}, {say: {duration: $long}}]"
    bench.run(tree, {"say": Say, "give": Give})
    bench.control = Control()
    bench.run(tree, {"say": Say, "give": Give}, resumes=True)
    assert [what for _, what in bench.log] == ["4.5"]
