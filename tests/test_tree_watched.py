"""What who watches sees of a tree that runs: which node is at work, over, skipped or to come."""

from pathlib import Path

import pytest
from conftest import Bench
from tree_skills import SKILLS

from scuhand_bt.journal.events import JobEnded
from scuhand_bt.journal.follow import Follower
from scuhand_bt.report.watching import tree_of


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
