"""What sequence, fallback, parallel, retry, repeat, invert and optional do when they run."""

from typing import Any

import pytest
from conftest import Bench
from tree_skills import SKILLS, names

from scuhand_bt.failures import SkillFailed
from scuhand_bt.skill import Skill, Steps


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


def test_repeat_runs_its_child_so_many_times(bench: Bench) -> None:
    assert bench.run("repeat: {times: 3, child: {work: }}", SKILLS).failure is None
    assert names(bench).count("work ends") == 3


def test_repeat_ends_at_a_failure(bench: Bench) -> None:
    assert bench.run("repeat: {times: 3, child: {fail: }}", SKILLS).failure is not None
    assert len(names(bench)) == 1


def test_invert_turns_a_failure_into_success(bench: Bench) -> None:
    assert bench.run("invert: {fail: }", SKILLS).failure is None


def test_invert_turns_success_into_a_failure_with_its_own_code(bench: Bench) -> None:
    outcome = bench.run("invert: {child: {work: }}", SKILLS)
    assert outcome.failure is not None
    assert outcome.failure.code == "workflow.inverted"


def test_optional_goes_on_after_a_failure(bench: Bench) -> None:
    assert bench.run("sequence: [{optional: {fail: }}, {work: }]", SKILLS).failure is None
    assert names(bench) == ["fails: hand.cone_empty", "work begins", "work ends"]
