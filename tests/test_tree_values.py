"""Values in a tree: results that are kept and read again, nested workflows' own, and ones that are not accepted."""

from typing import Any

import pytest
from conftest import Bench
from tree_skills import SKILLS, names

from scuhand_bt.skill import Seconds, Skill, Steps


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
