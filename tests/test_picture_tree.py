"""What the picture of a tree says of each node: at work, over, failed, skipped or to come."""

from collections.abc import Sequence
from pathlib import Path

import pytest
from py_trees.behaviour import Behaviour
from running import dry_run, make_lab

from scuhand_bt.failures import SkillFailed
from scuhand_bt.journal.events import JobStarted, TreeNode
from scuhand_bt.journal.follow import ActionNow, Follower
from scuhand_bt.journal.reader import read
from scuhand_bt.report.live import nodes_of
from scuhand_bt.report.watching import tree_of

WORK = ("scoop", "return_leftover")
TWICE = """\
workflow: twice
inputs: {source: Source}
tree:
  sequence:
    - fallback: [{cone_holds: {powder: $source.powder}}, {scoop: {source: $source}}]
    - fallback: [{cone_holds: {powder: $source.powder}}, {park: }]
    - return_leftover: {source: $source}
"""


def test_what_a_fallback_has_tried_has_failed_and_what_it_did_not_come_to_is_skipped(tmp_path: Path) -> None:
    lab = make_lab(tmp_path / "lab", trees__twice=TWICE)
    here: dict[str, list[tuple[str, str]]] = {}

    def look(root: Behaviour) -> None:
        nodes = list(nodes_of(root))
        if at_work := next((node.name for node in nodes if node.state == "running" and node.name in WORK), None):
            here.setdefault(at_work, [(node.name, f"{node.state} {node.why[:15]}".strip()) for node in nodes])

    ran = dry_run(tmp_path, "recipe: r\nworkflow: twice\nsamples: [{id: a, source: beads}]\n", lab=lab, at_tick=look)
    assert here["scoop"] == [
        ("sequence", "running"),
        ("fallback", "running"),
        ("cone_holds", "failed hand.cone_empty"),
        ("scoop", "running"),
        ("fallback", "to come"),
        ("cone_holds", "to come"),
        ("park", "to come"),
        ("return_leftover", "to come"),
    ]
    assert here["return_leftover"][4:] == [
        ("fallback", "done"),
        ("cone_holds", "done"),
        ("park", "skipped"),
        ("return_leftover", "running"),
    ]
    for at_work in WORK:
        began_s = next(row["started_s"] for row in read(ran.journal, "action") if row["skill"] == at_work)
        now = Follower(ran.journal, until_s=began_s)
        now.look()
        from_elsewhere = [(node.name, f"{node.state} {node.why[:15]}".strip()) for node in tree_of(now)]
        assert from_elsewhere == here[at_work], "another terminal, and a page, tell the same"
        now.actions = {
            seq: one for seq, one in now.actions.items() if one.outcome is not None
        }  # as if paused before it
        assert tree_of(now)[0].state == "running", "what is still to come of a job is not done"


AGAIN = (
    *((0, "sequence", ""), (1, "optional", ""), (2, "retry", ""), (3, "inner", ""), (4, "sequence", "")),
    *((5, "tare", "tare"), (5, "cone_holds", "holds"), (1, "repeat", ""), (2, "park", "park"), (1, "wait", "wait")),
)
FAILED = SkillFailed("hand.cone_empty", "it is empty")


@pytest.mark.parametrize(
    ("ended", "said"),
    [
        ([], "· · · · · · · · · ·"),
        (["tare", "holds"], "▶ ▶ ▶ ✗ ✗ ✓ ✗ · · ·"),  # as py_trees has it in between
        (["tare", "holds", "tare"], "▶ ▶ ▶ ▶ ▶ ✓ · · · ·"),
        (["tare", "holds", "tare", "holds", "park"], "▶ ✓ ✗ ✗ ✗ ✓ ✗ ▶ ✓ ·"),
        (["tare", "holds", "tare", "holds", "park", "park", "wait"], "✓ ✓ ✗ ✗ ✗ ✓ ✗ ✓ ✓ ✓"),
    ],
)
def test_what_may_begin_anew_goes_on_until_something_else_has_acted(ended: Sequence[str], said: str) -> None:
    """While nothing acts, as in a pause between two attempts."""
    now = Follower(
        Path("run.sqlite"),
        trees={"again": [TreeNode(depth=depth, name=name, path=path) for depth, name, path in AGAIN]},
        job=JobStarted(name="a", workflow="again", sample="a", attempt=1),
    )
    for seq, path in enumerate(ended):
        failure = FAILED if path == "holds" else None
        now.actions[seq] = ActionNow(path, path, "done" if failure is None else "failed", failure)
    signs = {"running": "▶", "done": "✓", "failed": "✗", "to come": "·"}
    assert " ".join(signs[node.state] for node in tree_of(now)) == said
