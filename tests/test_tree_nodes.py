"""What every node of a workflow does when it runs: on the run's clock, with devices that only report."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from conftest import Bench, wait_until

from scuhand_bt.clock import Wake
from scuhand_bt.failures import SkillFailed
from scuhand_bt.journal.events import JobEnded
from scuhand_bt.journal.follow import Follower
from scuhand_bt.journal.reader import read
from scuhand_bt.problems import SourceError
from scuhand_bt.report.watching import tree_of
from scuhand_bt.run.clock import VirtualClock
from scuhand_bt.run.runner import SkillBug
from scuhand_bt.skill import Condition, Seconds, Skill, Steps


class Work(Skill[str]):
    """Take some time and note begin, end and halt."""

    name: str = "work"
    duration_s: Seconds = 1.0

    def run(self, cell: Any) -> Steps[str]:
        cell.note(f"{self.name} begins")
        is_done = False
        try:
            yield from wait_until(cell, cell.clock.now_s + self.duration_s)
            is_done = True
        finally:
            cell.note(f"{self.name} ends" if is_done else f"{self.name} halted")
        return self.name


class Arm(Work):
    """Work that commands the arm."""

    devices = ("arm",)


class Hand(Work):
    """Work that commands the hand."""

    devices = ("hand",)


class Fail(Skill[None]):
    """Fail with a code, after some time."""

    code: str = "hand.cone_empty"
    after_s: Seconds = 0.0

    def run(self, cell: Any) -> Steps[None]:
        cell.note(f"fails: {self.code}")
        yield from wait_until(cell, cell.clock.now_s + self.after_s)
        raise SkillFailed(self.code, "as it was told")


class Calm(Condition):
    """Hold until something was noted."""

    watches = ("balance",)

    noted: str = "alarm"

    def check(self, cell: Any) -> None:
        if any(what == self.noted for _, what in cell.log):
            raise SkillFailed("balance.unstable", self.noted)


SKILLS = {"work": Work, "arm": Arm, "hand": Hand, "fail": Fail, "calm": Calm}


def names(bench: Bench) -> list[str]:
    return [what for _, what in bench.log]


# --- sequence and fallback


def test_a_sequence_runs_its_children_one_after_the_other(bench: Bench) -> None:
    outcome = bench.run("sequence: [{work: {name: a, duration: 2 s}}, {work: {name: b}}]", SKILLS)
    assert outcome.failure is None
    assert bench.log == [(0.0, "a begins"), (2.0, "a ends"), (2.0, "b begins"), (3.0, "b ends")]


def test_a_sequence_stops_at_the_first_failure_and_gives_its_code(bench: Bench) -> None:
    outcome = bench.run("sequence: [{work: }, {fail: {code: dose.overshoot}}, {work: {name: never}}]", SKILLS)
    assert outcome.failure is not None
    assert outcome.failure.code == "dose.overshoot"
    assert "never begins" not in names(bench)


def test_a_fallback_tries_children_until_one_succeeds(bench: Bench) -> None:
    outcome = bench.run("fallback: [{fail: }, {work: {name: b}}, {work: {name: c}}]", SKILLS)
    assert outcome.failure is None
    assert names(bench) == ["fails: hand.cone_empty", "b begins", "b ends"]


def test_a_fallback_in_which_all_fail_gives_the_last_failure(bench: Bench) -> None:
    outcome = bench.run("fallback: [{fail: {code: hand.cone_empty}}, {fail: {code: source.empty}}]", SKILLS)
    assert outcome.failure is not None
    assert outcome.failure.code == "source.empty"


class FailsAnew(Skill[None]):
    """Fails with one code the first time, and with another one from then on."""

    def run(self, cell: Any) -> Steps[None]:
        code = "arm.no_path" if any(what == "anew" for _, what in cell.log) else "hand.cone_empty"
        cell.note("anew")
        yield from ()
        raise SkillFailed(code, "as it was told")


def test_a_fallback_that_begins_again_fails_by_what_came_of_it_this_time(bench: Bench) -> None:
    """What the second child had failed with the time before is not why."""
    tree = (
        "retry: {attempts: 2, child: {fallback: {on: [hand.cone_empty], "
        "children: [{fails_anew: }, {fail: {code: source.empty}}]}}}"
    )
    outcome = bench.run(tree, {**SKILLS, "fails_anew": FailsAnew})
    assert outcome.failure is not None
    assert outcome.failure.code == "arm.no_path"


# --- parallel


def test_parallel_children_run_side_by_side_and_each_runs_once(bench: Bench) -> None:
    outcome = bench.run("parallel: [{arm: {name: short}}, {hand: {name: long, duration: 10 s}}]", SKILLS)
    assert outcome.failure is None
    assert bench.log == [(0.0, "short begins"), (0.0, "long begins"), (1.0, "short ends"), (10.0, "long ends")]


def test_a_failure_in_parallel_halts_the_siblings(bench: Bench) -> None:
    tree = "parallel: [{hand: {duration: 10 s}}, {fail: {code: arm.no_path, after: 3 s}}]"
    outcome = bench.run(tree, SKILLS)
    assert outcome.failure is not None
    assert outcome.failure.code == "arm.no_path"
    assert bench.log[-1] == (3.0, "work halted")
    assert bench.actions() == [("hand", "halted"), ("fail", "failed")]


def test_parallel_can_be_repeated(bench: Bench) -> None:
    bench.run("repeat: {times: 2, child: {parallel: [{arm: {name: a}}, {hand: {name: b}}]}}", SKILLS)
    assert names(bench).count("a ends") == names(bench).count("b ends") == 2


# --- retry and repeat


@pytest.mark.parametrize("attempts", [1, 2, 5])
def test_retry_makes_no_more_attempts_than_it_may(bench: Bench, attempts: int) -> None:
    outcome = bench.run(f"retry: {{attempts: {attempts}, child: {{fail: }}}}", SKILLS)
    assert outcome.failure is not None
    assert outcome.failure.code == "hand.cone_empty"
    assert names(bench) == ["fails: hand.cone_empty"] * attempts


def test_retry_ends_with_the_first_success(bench: Bench) -> None:
    tree = "retry: {attempts: 5, child: {sequence: [{work: {name: a}}, {calm: {noted: nothing}}]}}"
    assert bench.run(tree, SKILLS).failure is None
    assert names(bench) == ["a begins", "a ends"]


def test_retry_on_codes_leaves_other_failures_alone(bench: Bench) -> None:
    tree = "retry: {attempts: 5, on: [hand.cone_empty, scoop.nothing], child: {fail: {code: arm.no_path}}}"
    outcome = bench.run(tree, SKILLS)
    assert outcome.failure is not None
    assert outcome.failure.code == "arm.no_path"
    assert names(bench) == ["fails: arm.no_path"]


def test_retry_begins_its_child_from_the_start(bench: Bench) -> None:
    tree = "retry: {attempts: 2, on: hand.cone_empty, child: {sequence: [{work: {name: a}}, {fail: }]}}"
    bench.run(tree, SKILLS)
    assert names(bench) == ["a begins", "a ends", "fails: hand.cone_empty"] * 2


def test_retry_sees_the_code_through_workflows_and_decorators(bench: Bench) -> None:
    inner = "workflow: inner\ntree: {timeout: {duration: 1 h, child: {sequence: [{fail: {code: scoop.nothing}}]}}}"
    bench.run("retry: {attempts: 3, on: [scoop.nothing], child: {inner: }}", SKILLS, {"inner": inner})
    assert names(bench) == ["fails: scoop.nothing"] * 3


def test_a_second_round_of_a_retry_has_all_its_attempts_again(bench: Bench) -> None:
    bench.run("repeat: {times: 2, child: {optional: {retry: {attempts: 3, child: {fail: }}}}}", SKILLS)
    assert len(names(bench)) == 6


@pytest.mark.parametrize(
    ("tree", "states"),
    [
        ("retry: {attempts: 2, child: {fail: {after: 3 s}}}", {4.0: "running", 7.0: "failed", 29.0: "failed"}),
        ("retry: {attempts: 9, on: [hand.no_flow], child: {fail: {after: 3 s}}}", {2.0: "running", 4.0: "failed"}),
        (
            "repeat: {times: 2, child: {optional: {retry: {attempts: 2, child: {fail: {after: 3 s}}}}}}",
            {5.0: "running", 7.0: "running", 11.0: "running", 13.0: "failed"},
        ),
    ],
)
def test_who_watches_sees_when_a_retry_begins_its_child_no_more(
    bench: Bench, tmp_path: Path, tree: str, states: dict[float, str]
) -> None:
    """What goes on beside it does not tell."""
    bench.run(f"parallel: [{{arm: {{duration: 30 s}}}}, {{optional: {{{tree}}}}}]", SKILLS)
    for until_s, state in states.items():
        now = Follower(tmp_path / "journal.sqlite", until_s=until_s)
        now.look()
        assert [node.state for node in tree_of(now) if node.name == "retry"] == [state], until_s
        assert bool(now.over) == (state == "failed"), "of a round before is nothing known any more"


@pytest.mark.parametrize("loop", ["repeat: {times: 2", "for_each: {items: {one: $each}"])
def test_who_watches_sees_when_all_rounds_are_done(bench: Bench, tmp_path: Path, loop: str) -> None:
    """What goes on beside them does not tell; and where they are come to again, they go on again."""
    rounds = f"workflow: rounds\ninputs: {{each: [Duration]}}\ntree: {{{loop}, child: {{hand: {{duration: 2 s}}}}}}}}\n"
    beside = "parallel: [{arm: {duration: 6 s}}, {rounds: {each: [1 s, 2 s]}}]"
    bench.run(
        f"optional: {{retry: {{attempts: 2, child: {{sequence: [{{{beside}}}, {{fail: }}]}}}}}}",
        SKILLS,
        {"rounds": rounds},
    )
    name = loop.split(":")[0]
    for until_s, state in {3.0: "running", 4.5: "done", 7.0: "running", 9.0: "running", 10.5: "done"}.items():
        now = Follower(tmp_path / "journal.sqlite", until_s=until_s)
        now.look()
        assert [node.state for node in tree_of(now) if node.name == name] == [state], until_s


HALTED = {
    "between two rounds": "repeat: {times: 9, child: {hand: {duration: 1 s}}}",
    "in a round": "repeat: {times: 9, child: {sequence: [{hand: {duration: 1 s}}, {work: {duration: 4 s}}]}}",
    "between two attempts": "retry: {attempts: 9, child: {fail: {after: 1 s}}}",
}


@pytest.mark.parametrize("loop", HALTED.values(), ids=HALTED)
@pytest.mark.parametrize("around", ["parallel: [{%s}, {fail: {after: 3 s}}]", "timeout: {duration: 3 s, child: {%s}}"])
def test_what_is_ended_from_outside_does_not_go_on_for_who_watches(
    bench: Bench, tmp_path: Path, around: str, loop: str
) -> None:
    """Neither while something goes on beside it, nor when its job is over, which is as its outcome says."""
    tree = around % loop
    bench.run(f"parallel: [{{arm: {{duration: 30 s}}}}, {{optional: {{{tree}}}}}]", SKILLS)
    kind, within = tree.split(":")[0], loop.split(":")[0]
    for until_s in (2.5, 3.5, 29.0):
        now = Follower(tmp_path / "journal.sqlite", until_s=until_s)
        now.look()
        states = [(node.name, node.state) for node in tree_of(now) if node.name in ("arm", kind, within)]
        failed = [("parallel", "running"), ("arm", "running"), (kind, "failed"), (within, "skipped")]
        going_on = [("parallel", "running"), ("arm", "running"), (kind, "running"), (within, "running")]
        expected = going_on if until_s < 3.0 else failed
        assert states == [one for one in expected if kind == "parallel" or one[0] != "parallel"], until_s
    now = Follower(tmp_path / "journal.sqlite")
    now.look()
    now.job_ended = JobEnded(outcome="done")
    states = [(node.name, node.state) for node in tree_of(now)]
    assert states[:3] == [("parallel", "done"), ("arm", "done"), ("optional", "done")]
    assert states[3:5] == [(kind, "failed"), (within, "skipped")]


@pytest.mark.parametrize(
    ("outcome", "states"),
    [("done", ["done"] * 5), ("failed", ["failed", "skipped", "done", "skipped", "done"])],
)
def test_a_loop_that_is_over_beside_what_went_on_is_as_its_job_came_out(
    bench: Bench, tmp_path: Path, outcome: str, states: list[str]
) -> None:
    bench.run("sequence: [{parallel: [{arm: }, {repeat: {times: 2, child: {hand: {duration: 5 s}}}}]}]", SKILLS)
    now = Follower(tmp_path / "journal.sqlite")
    now.look()
    now.job_ended = JobEnded(outcome=outcome)
    now.over.clear()  # an older journal does not say that all rounds were done
    assert [node.state for node in tree_of(now)] == states


def test_of_an_interrupted_job_all_that_is_not_over_is_to_come(bench: Bench, tmp_path: Path) -> None:
    bench.run("sequence: [{work: }, {optional: {sequence: [{arm: }, {hand: {duration: 9 s}}]}}]", SKILLS)
    now = Follower(tmp_path / "journal.sqlite", until_s=3.0)
    now.look()
    now.job_ended = JobEnded(outcome="interrupted")
    now.actions[max(now.actions)].outcome = "interrupted"
    states = [node.state for node in tree_of(now)]
    assert states == ["to come", "done", "to come", "to come", "done", "to come"]


def test_repeat_runs_its_child_so_many_times(bench: Bench) -> None:
    assert bench.run("repeat: {times: 3, child: {work: }}", SKILLS).failure is None
    assert names(bench).count("work ends") == 3


def test_repeat_ends_at_a_failure(bench: Bench) -> None:
    assert bench.run("repeat: {times: 3, child: {fail: }}", SKILLS).failure is not None
    assert len(names(bench)) == 1


# --- timeout


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


# --- while


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


# --- invert and optional


def test_invert_turns_a_failure_into_success(bench: Bench) -> None:
    assert bench.run("invert: {fail: }", SKILLS).failure is None


def test_invert_turns_success_into_a_failure_with_its_own_code(bench: Bench) -> None:
    outcome = bench.run("invert: {child: {work: }}", SKILLS)
    assert outcome.failure is not None
    assert outcome.failure.code == "workflow.inverted"


def test_optional_goes_on_after_a_failure(bench: Bench) -> None:
    assert bench.run("sequence: [{optional: {fail: }}, {work: }]", SKILLS).failure is None
    assert names(bench) == ["fails: hand.cone_empty", "work begins", "work ends"]


# --- values


class Twice(Skill[Seconds]):
    """Give twice a time."""

    duration_s: Seconds

    def run(self, cell: Any) -> Steps[float]:
        cell.note(f"twice {self.duration_s:g}")
        return 2 * self.duration_s
        yield


def test_a_result_kept_with_as_is_read_with_a_dollar(bench: Bench) -> None:
    tree = "sequence: [{twice: {duration: 2 s, as: t}}, {work: {duration: $t}}]"
    assert bench.run(tree, {**SKILLS, "twice": Twice}).failure is None
    assert bench.cell.clock.now_s == 4.0


def test_a_nested_workflow_gives_its_result_and_its_defaults_count(bench: Bench) -> None:
    inner = """
workflow: double
inputs: {duration: {type: Duration, default: 3 s}}
result: $t
tree: {twice: {duration: $duration, as: t}}
"""
    tree = "sequence: [{double: {as: a}}, {double: {duration: $a, as: b}}, {work: {duration: $b}}]"
    assert bench.run(tree, {**SKILLS, "twice": Twice}, {"double": inner}).failure is None
    assert names(bench)[:2] == ["twice 3", "twice 6"]
    assert bench.cell.clock.now_s == 12.0


def test_two_calls_of_one_workflow_do_not_see_each_others_values(bench: Bench) -> None:
    inner = "workflow: slow\ninputs: {t: Duration}\ntree: {sequence: [{work: {duration: $t}}]}"
    tree = "parallel: [{slow: {t: 2 s}}, {slow: {t: 5 s}}]"
    assert bench.run(tree, SKILLS, {"slow": inner}).failure is None
    assert [time_s for time_s, what in bench.log if what == "work ends"] == [2.0, 5.0]


def test_attempts_times_and_durations_can_be_values(bench: Bench) -> None:
    inner = """
workflow: inner
inputs: {n: Integer, limit: Duration}
tree:
  sequence:
    - repeat: {times: $n, child: {work: }}
    - timeout: {duration: $limit, child: {work: {duration: 1 h}}}
"""
    outcome = bench.run("inner: {n: 3, limit: 4 s}", SKILLS, {"inner": inner})
    assert outcome.failure is not None
    assert bench.cell.clock.now_s == 7.0


@pytest.mark.parametrize("tree", ["repeat: {times: $n, child: {work: }}", "retry: {attempts: $n, child: {work: }}"])
def test_a_count_that_turns_out_to_be_none_fails_before_anything_is_done(bench: Bench, tree: str) -> None:
    inner = f"workflow: inner\ninputs: {{n: Integer}}\ntree: {{{tree}}}"
    outcome = bench.run("inner: {n: 0}", SKILLS, {"inner": inner})
    assert outcome.failure is not None
    assert outcome.failure.code == "workflow.bad_value"
    assert bench.log == []


def test_a_value_that_a_skill_does_not_accept_is_a_failure_in_words(bench: Bench) -> None:
    class Picky(Skill[None]):
        """Take a short time only."""

        duration_s: Seconds = 1.0

        def model_post_init(self, context: Any) -> None:
            if self.duration_s > 5:
                raise ValueError("longer than 5 s")

        def run(self, cell: Any) -> Steps[None]:
            raise AssertionError
            yield

    tree = "sequence: [{twice: {duration: 20 s, as: t}}, {picky: {duration: $t}}]"
    outcome = bench.run(tree, {**SKILLS, "twice": Twice, "picky": Picky})
    assert outcome.failure is not None
    assert outcome.failure.code == "workflow.bad_value"
    assert outcome.failure.detail == "picky: this is not accepted; longer than 5 s"


# --- leases


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


# --- halting, and skills that break the rules


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
