"""What a run shows in another terminal than its own, or on a page: the same picture, from its journal."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import zip_longest
from typing import Any

from scuhand_bt.journal.events import JobEnded, TreeNode
from scuhand_bt.journal.follow import Follower
from scuhand_bt.journal.pace import time_left_s
from scuhand_bt.journal.run_events import RunBegun
from scuhand_bt.quantity import format_mass, format_tolerance
from scuhand_bt.report.picture import Asked, Node, Shown, in_grams
from scuhand_bt.tree.grammar import COMPOSITES

_STATES = {None: "running", "done": "done", "failed": "failed"}
_TURNED = {("invert", "done"): "failed", ("invert", "failed"): "done", ("optional", "failed"): "done"}
"""What a decorator makes of the state below it."""
_BEGINS_AGAIN = {("retry", "failed"), ("repeat", "done"), ("for_each", "done")}
"""Decorators that go on after what is below them has come to this."""
_ENDED = {"done": "done", "interrupted": "to come"}
"""The state of a tree by its job's outcome; by any other it has failed."""


def shown_of(now: Follower, run: RunBegun, balance: tuple[float, float, bool] | None = None) -> Shown:
    """What there is to see of a run that is followed; `balance` shows now: run time [s], gross [mg], is it stable."""
    name = now.path.stem
    waiting = now.waiting.asked
    asked = Asked(waiting.question, waiting.choices, now.waiting.at) if waiting is not None else None
    keys = f"scuhand-bt pause|stop {name}; Ctrl-C only ends watching"
    return Shown(
        recipe=run.recipe,
        mode=run.mode,
        total=len(run.samples or ()),
        results=list(now.samples.values()),
        run_time_s=now.time_s,
        left_s=time_left_s(now, run),
        job=about(now, run),
        tree=tree_of(now),
        readings=in_grams(balance[1], is_stable=balance[2]) if balance is not None else "",
        soon=str(now.soon or ""),
        state=f"Paused; `scuhand-bt resume {name}` continues" if now.is_paused else "",
        keys=f"scuhand-bt answer {name}" if asked is not None else keys,
        question=asked,
    )


def inputs_of(run: RunBegun, sample: str | None) -> Mapping[str, Any]:
    """What a sample was planned with; nothing for what is none."""
    return next((one.inputs for one in run.samples or () if one.id == sample), {})


def asked_of(inputs: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """What a planned sample asks for, dose by dose: mass and tolerance in words, and the source's name; '' for none."""
    if isinstance(inputs.get("masses"), list):  # side by side, as `compose` gives them
        lists = [inputs.get(name) or [] for name in ("masses", "tolerances", "sources")]
        doses = [*zip_longest(*lists)][: len(lists[0])]
    else:
        doses = [(inputs.get("mass"), inputs.get("tolerance"), inputs.get("source"))]
    for mass_mg, tolerance_mg, source in doses:
        within = f" ± {format_tolerance(tolerance_mg)} mg" if isinstance(tolerance_mg, float | int) else ""
        yield f"{format_mass(mass_mg)}{within}" if isinstance(mass_mg, float | int) else "", str(source or "")


def about(now: Follower, run: RunBegun) -> str:
    """What is under way: a sample with what it asks for, or a job between samples."""
    if now.job is None:
        return ""
    again = f", attempt {now.job.attempt}" if now.job.attempt > 1 else ""
    inputs = inputs_of(run, now.job.sample)
    powders = {name: f" of {source.powder}" for name, source in run.sources.items()}
    doses = " + ".join(f"{mass}{powders.get(source, '')}" for mass, source in asked_of(inputs) if mass)
    if not doses:
        return f"{now.job.name}{again}"
    into = f" into {inputs['container']}" if "container" in inputs else ""
    return f"{now.job.name}{again}: {doses}{into}"


def tree_of(now: Follower) -> Sequence[Node]:
    """The tree of the job that is under way, each node with its state; of an older journal what has acted, in order."""
    drawn = now.trees.get(now.job.workflow) if now.job is not None else None
    if drawn is None:
        return [
            Node(0, one.skill, _STATES.get(one.outcome, "to come"), str(one.failure) if one.failure else "")
            for one in now.actions.values()
        ]
    return _nodes(now, drawn)


def _nodes(now: Follower, drawn: Sequence[TreeNode]) -> Sequence[Node]:
    """A leaf's state is its last action's; that of a node above, of the last that acted below it.

    What stands behind the leaf at work, or the last that was, not beside it, and acted before it, is to come again.
    What stands before the last that acted, and did not act itself, was passed by. What is above others is what they
    make of it: a sequence is not done before the last of it, also while nothing acts. One that begins anew what is
    below it is over when something else has acted since, when what is above it is, or the journal says so.
    """
    last = {one.path: (seq, one) for seq, one in now.actions.items()}
    at_work = [place for place, node in enumerate(drawn) if node.path in last and last[node.path][1].outcome is None]
    reached = (
        max((last[node.path][0], place) for place, node in enumerate(drawn) if node.path in last)[1] if last else 0
    )
    front = at_work[-1] if at_work else reached
    nodes: dict[int, Node] = {}

    def is_left(place: int, below: Sequence[TreeNode]) -> bool:
        """Whether something else, that is not beside it, has acted since what is below it did."""
        inside = {one.path for one in below}
        since = max(last[path][0] for path in inside if path in last)
        others = [k for k, one in enumerate(drawn) if one.path in last and one.path not in inside]
        return any(last[drawn[k].path][0] > since and not _is_beside(drawn, *sorted((place, k))) for k in others)

    def state_of(place: int, below: Sequence[TreeNode]) -> tuple[str, str]:
        """With why it failed."""
        node = drawn[place]
        if last and place > front and not _is_beside(drawn, front, place):
            began = last[drawn[front].path][0]
            acted = [last[one.path] for one in below if one.path in last and last[one.path][0] > began]
        else:
            acted = [last[one.path] for one in below if one.path in last]
        failed = now.decided.get(node.path) if node.path else None
        if any(one.outcome is None for _, one in acted):
            return "running", ""
        if failed is not None:
            return "failed", str(failed)
        if not acted:
            is_passed = place < reached and not _is_beside(drawn, place, reached)
            return ("skipped" if is_passed else "to come"), ""
        if len(below) > 1:
            children = [nodes[place + k].state for k, one in enumerate(below) if one.depth == node.depth + 1]
            state = _above(node.name, children)
            is_over = node.path in now.over or is_left(place, below)
            begins_again = (node.name, state) in _BEGINS_AGAIN and not is_over
            return ("running" if begins_again else state), ""
        _, one = max(acted, key=lambda pair: pair[0])
        state = _STATES.get(one.outcome, "to come")
        return state, str(one.failure) if one.failure is not None else ""

    for place in reversed(range(len(drawn))):
        deep = drawn[place].depth
        end = next((k for k in range(place + 1, len(drawn)) if drawn[k].depth <= deep), len(drawn))
        nodes[place] = Node(deep, drawn[place].name, *state_of(place, drawn[place:end]))
    return list(_ended_with_what_is_above((nodes[place] for place in range(len(drawn))), now.job_ended))


def _ended_with_what_is_above(nodes: Iterable[Node], ended: JobEnded | None) -> Iterator[Node]:
    """Nothing goes on below what is over: of what is done it is done, else it was halted, or is not come to."""
    above = list[str]()
    for node in nodes:
        state = node.state
        del above[node.depth :]
        if not above:
            state = state if ended is None else _ENDED.get(ended.outcome, "failed")
        elif state in ("running", "to come") and above[-1] != "running":
            passed = "to come" if above[-1] == "to come" else "skipped"
            state = "done" if (above[-1], state) == ("done", "running") else passed
        above.append(state)
        yield replace(node, state=state)


def _above(name: str, children: Sequence[str]) -> str:
    """The state of a node of a job that goes on, by those of its children, some of which have acted."""
    if name not in COMPOSITES:
        state = next((child for child in reversed(children) if child not in ("to come", "skipped")), "to come")
        return _TURNED.get((name, state), state)
    ends, other = ("done", "failed") if name == "fallback" else ("failed", "done")
    if ends in children:
        return ends
    return "running" if {"running", "to come"} & set(children) else other


def _is_beside(drawn: Sequence[TreeNode], place: int, later: int) -> bool:
    """Whether two nodes of a tree go on at once: whether what holds both of them is a parallel."""
    lowest = min(node.depth for node in drawn[place : later + 1])
    above = [node for node in drawn[:place] if node.depth < lowest]
    return bool(above) and above[-1].name == "parallel"
