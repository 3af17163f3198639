"""One workflow, run once on simulated devices for a test: what was called, what came of it."""

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scuhand_bt.journal.reader import open_contents
from scuhand_bt.journal.results import SampleResult
from scuhand_bt.lab import Lab
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.recipe.plan import Plan
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.run.options import Options
from scuhand_bt.run.prepared_motion import places_of, prepared_motion
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun
from scuhand_bt.sim.fault_rules import FaultFile
from scuhand_bt.tree.substitutes import Substitutes


@dataclass(frozen=True)
class Called:
    """One action of the job, as its journal has it."""

    path: str
    skill: str
    visit: int
    inputs: Mapping[str, Any]
    outcome: str
    code: str | None
    result: Any


@dataclass(frozen=True)
class Rehearsed:
    """What a workflow did."""

    calls: tuple[Called, ...]
    sample: SampleResult
    reason: str
    """Why the run ended, where it did not come to its end."""

    @property
    def outcome(self) -> str:
        """`success`, the code of the failure, or what broke the run."""
        broken = self.sample.verdict in ("not run", "interrupted") or (self.reason and self.sample.code is None)
        return self.sample.code or (self.reason if broken else "success")

    @property
    def skills(self) -> list[str]:
        """The names of the skills that were called, in order."""
        return [call.skill for call in self.calls]

    def value(self, name: str) -> Any:
        """A value of the last result of a skill (`tare`), or of a part of it (`dispense.dispensed_mg`); KeyError."""
        skill, *parts = name.split(".")
        value = [call for call in self.calls if call.skill == skill and call.outcome == "done"][-1:]
        if not value:
            raise KeyError(name)
        found = value[0].result
        for part in parts:
            found = found[part]
        return found

    def trace(self) -> str:
        """The calls as lines that can be compared: place, visit, skill, inputs, and what came of it."""
        lines = []
        for call in self.calls:
            given = ", ".join(f"{key}={value}" for key, value in sorted(call.inputs.items()))
            came = call.code or call.outcome
            lines.append(f"{call.path}#{call.visit}({given}) -> {came}")
        return "\n".join(lines) + "\n"


@dataclass
class Rehearser:
    """Runs workflows of a lab; the arm's ways are planned once for the same places."""

    lab: Lab
    _planners: dict[str, MotionPlanner] = field(default_factory=dict)

    def run(self, plan: Plan, substitutes: Substitutes, faults: FaultFile | None = None, seed: int = 0) -> Rehearsed:
        """Run the one sample of a plan dry. SourceError, SkillFailed as a run refuses it."""
        with tempfile.TemporaryDirectory() as folder:
            session = self.session(plan, Path(folder), substitutes, faults, seed)
            try:
                result = session.run(BatchObserver())
            finally:
                session.close()
            with open_contents(session.journal.path) as contents:
                jobs = [row["id"] for row in contents.rows("job") if row["sample"] == plan.recipe.samples[0].id]
                rows = [row for row in contents.rows("action") if row["job"] in jobs[:1]]
        calls = tuple(Called(**{name: row[name] for name in Called.__dataclass_fields__}) for row in rows)
        return Rehearsed(calls, result.samples[0], result.reason)

    def session(
        self,
        plan: Plan,
        folder: Path,
        substitutes: Substitutes | None = None,
        faults: FaultFile | None = None,
        seed: int = 0,
    ) -> Session:
        """A dry run of a plan made ready; its journal goes below `folder`."""
        key = f"{self.lab.cell} {sorted(places_of(plan, self.lab).items())}"
        if key not in self._planners:
            self._planners[key] = prepared_motion(plan, self.lab)
        options = Options(DryRun(seed, faults=faults), folder=folder / "runs")
        return Session(plan, self.lab, options, self._planners[key], substitutes=substitutes)


def leaves_of(lab: Lab, workflow: str) -> Sequence[str]:
    """The places of all skills in a workflow's tree, as a run's journal names them."""
    from scuhand_bt.tree.workflow import Branch, Call, Choice, Decorator, TreeNode

    library, found = lab.library, list[str]()

    def walk(node: TreeNode, path: str) -> None:
        if isinstance(node, Branch):
            for number, child in enumerate(node.children):
                walk(child, f"{path}/{node.kind}.{number}")
        elif isinstance(node, Decorator):
            walk(node.child, f"{path}/{node.kind}")
        elif isinstance(node, Choice):
            for case in node.cases:
                walk(case.child, f"{path}/{node.kind}.{case.label}")
        elif isinstance(node, Call) and node.name in library.skills:
            found.append(f"{path}/{node.name}")
        else:
            walk(library.workflows[node.name].tree, f"{path}/{node.name}")

    walk(library.workflows[workflow].tree, workflow)
    return found
