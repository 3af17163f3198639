"""What a run shows in another terminal than its own: the same picture, from its journal."""

from collections.abc import Mapping
from typing import Any

from scuhand_bt.journal.events import RunBegun
from scuhand_bt.journal.follow import Follower
from scuhand_bt.quantity import format_mass
from scuhand_bt.report.picture import Asked, Node, Shown

_STATES = {None: "running", "done": "done", "failed": "failed"}


def shown_of(now: Follower, run: RunBegun) -> Shown:
    """What there is to see of a run that is followed."""
    total = len(run.samples or ())
    name = now.path.stem
    waiting = now.waiting.asked
    asked = Asked(waiting.question, waiting.choices, now.waiting.at) if waiting is not None else None
    keys = f"scuhand-bt pause|stop {name}; Ctrl-C only ends watching"
    return Shown(
        recipe=run.recipe,
        mode=run.mode,
        total=total,
        results=list(now.samples.values()),
        run_time_s=now.time_s,
        left_s=time_left_s(now, run),
        job=about(now, run),
        tree=[
            Node(0, one.skill, _STATES.get(one.outcome, "to come"), str(one.failure) if one.failure else "")
            for one in now.actions.values()
        ],
        state=f"Paused; `scuhand-bt resume {name}` continues" if now.is_paused else "",
        keys=f"scuhand-bt answer {name}" if asked is not None else keys,
        question=asked,
    )


def time_left_s(now: Follower, run: RunBegun) -> float | None:
    """Run time that is left: the mean of the samples until now, for those left. None where that cannot be told."""
    total, done = len(run.samples or ()), len(now.samples)
    return now.time_s / done * (total - done) if done and now.ended is None else None


def about(now: Follower, run: RunBegun) -> str:
    """What is under way: a sample with what it asks for, or a job between samples."""
    if now.job is None:
        return ""
    again = f", attempt {now.job.attempt}" if now.job.attempt > 1 else ""
    inputs: Mapping[str, Any] = next((one.inputs for one in run.samples or () if one.id == now.job.sample), {})
    if not isinstance(mass_mg := inputs.get("mass"), float | int):
        return f"{now.job.name}{again}"
    tolerance_mg, source = inputs.get("tolerance"), run.sources.get(str(inputs.get("source")))
    tolerance = f" ± {format_mass(tolerance_mg)}" if isinstance(tolerance_mg, float | int) else ""
    of = f" of {source.powder}" if source is not None else ""
    into = f" into {inputs['container']}" if "container" in inputs else ""
    return f"{now.job.name}{again}: {format_mass(mass_mg)}{tolerance}{of}{into}"
