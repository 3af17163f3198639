"""Runs the tests of a lab's workflows, and tells what is not as a case expects it."""

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scuhand_bt.events.doses import ValueRecorded
from scuhand_bt.kit.case_files import Case, Expectation
from scuhand_bt.kit.rehearsed import Rehearsed, Rehearser, leaves_of
from scuhand_bt.lab import Lab
from scuhand_bt.problems import SourceError
from scuhand_bt.quantity import counted, parse
from scuhand_bt.skill import SkillFailed
from scuhand_bt.tree.substitutes import Substitutes
from scuhand_bt.tree.wires import QUANTITIES, of_field


@dataclass(frozen=True)
class CaseResult:
    """What came of a test: nothing `wrong`, and it has passed."""

    case: Case
    wrong: tuple[str, ...]
    ran: Rehearsed | None


def run_case(case: Case, rehearser: Rehearser, *, update: bool = False, judged: bool = True) -> CaseResult:
    """Run a test; `update` writes its golden trace, else it is compared; what is not `judged` may come to anything."""
    substitutes = Substitutes(case.substitutes)
    try:
        ran = rehearser.run(case.plan, substitutes, case.faults, case.seed)
    except (SourceError, SkillFailed) as error:
        return CaseResult(case, (str(error),), None)
    wrong = _against(case.expect, ran, rehearser.lab) if judged else []
    for rule in substitutes.unused:
        which = f", call {rule.call}" if rule.call is not None else ""
        wrong.append(f"{rule.mark}: nothing was substituted: no call came to '{rule.at}'{which}")
    if case.trace is not None:
        wrong += _against_trace(case.trace, ran.trace(), update=update)
    return CaseResult(case, tuple(wrong), ran)


def _against(expect: Expectation, ran: Rehearsed, lab: Lab) -> list[str]:
    wrong = []
    if ran.outcome != expect.outcome:
        detail = f" ({ran.sample.detail})" if ran.sample.detail else ""
        wrong.append(f"expected {expect.outcome}, came to {ran.outcome}{detail}")
    if expect.verdict is not None and ran.sample.verdict != expect.verdict:
        wrong.append(f"expected the verdict '{expect.verdict}', it is '{ran.sample.verdict}'")
    if expect.calls is not None and list(expect.calls) != ran.skills:
        wrong.append(f"expected the calls {', '.join(expect.calls)}; there were {', '.join(ran.skills)}")
    for skill, times in expect.times.items():
        if (count := ran.skills.count(skill)) != times:
            wrong.append(f"expected {counted(times, 'call')} of {skill}, came to {count}")
    for name, wanted in expect.values.items():
        wrong += _against_value(name, wanted, ran, lab)
    recorded = {one.name: one for one in ran.sample.recorded}
    for name, wanted in expect.recorded.items():
        wrong += _against_recorded(name, wanted, recorded)
    return wrong


def _against_recorded(name: str, wanted: Any, recorded: Mapping[str, ValueRecorded]) -> list[str]:
    """A value of the sample's row; a number is read in the unit in which it stands there."""
    if (found := recorded.get(name)) is None:
        had = ", ".join(recorded) or "nothing"
        return [f"expected that {name} is recorded; there was {had}"]
    try:
        if isinstance(wanted, dict):
            about, within = _number(found, wanted["about"]), _number(found, wanted["within"])
            is_good = abs(_number(found, found.value) - about) <= within
        elif isinstance(found.value, bool):
            is_good = found.value == (str(wanted).lower() in ("yes", "true"))
        else:
            is_good = found.value == (wanted if isinstance(found.value, str) else _number(found, wanted))
    except (KeyError, ValueError) as error:
        return [f"expected {name} {wanted}, which is not as it is recorded ({found}): {error}"]
    shown = f"about {wanted['about']} within {wanted['within']}" if isinstance(wanted, dict) else wanted
    return [] if is_good else [f"expected {name} {shown}, it is {found}"]


def _number(recorded: ValueRecorded, value: Any) -> float:
    """A number as it is written in a test; ValueError for what is none in the unit of what was recorded."""
    unit = next((one for one in QUANTITIES.values() if one.symbol == recorded.unit), None)
    return parse(value, unit) if recorded.unit and unit is not None and isinstance(value, str) else float(value)


def _against_value(name: str, wanted: Any, ran: Rehearsed, lab: Lab) -> list[str]:
    """A value by the name that YAML has for it; a quantity is written with its unit."""
    skill, *parts = name.split(".")
    wire = of_field(lab.library.skills[skill].result_type())
    fields = [skill]
    for part in parts:
        field, wire = wire.attributes()[part]
        fields.append(field)
    try:
        found = ran.value(".".join(fields))
    except KeyError:
        return [f"expected {name}, and it was never given"]
    if isinstance(wanted, dict):
        about, within = wire.read(wanted["about"]), wire.read(wanted["within"])
        is_good = abs(found - about) <= within
    else:
        is_good = found == wire.read(wanted)
    shown = f"about {wanted['about']} within {wanted['within']}" if isinstance(wanted, dict) else wanted
    return [] if is_good else [f"expected {name} {shown}, it is {found}"]


def _against_trace(path: Path, trace: str, *, update: bool) -> list[str]:
    if update:
        path.write_text(trace, encoding="utf-8")
        return []
    if not path.is_file():
        return [f"{path} is not there; `scuhand-bt test --update` writes it"]
    golden = path.read_text(encoding="utf-8")
    lines = difflib.unified_diff(golden.splitlines(), trace.splitlines(), "golden", "now", lineterm="", n=1)
    return (
        [f"another trace than {path.name}:\n" + "\n".join(f"    {line}" for line in lines)] if golden != trace else []
    )


class Coverage:
    """Which places of a workflow's tree the cases of a lab have come to."""

    def __init__(self, lab: Lab) -> None:
        self._lab = lab
        self._seen: dict[str, set[str]] = {}

    def add(self, workflow: str, ran: Rehearsed) -> None:
        self._seen.setdefault(workflow, set()).update(call.path for call in ran.calls)

    def of(self, workflow: str) -> tuple[int, int, list[str]]:
        """Leaves come to, leaves in all, and those that were not; a branch is covered by the leaves in it."""
        leaves = leaves_of(self._lab, workflow)
        missed = [leaf for leaf in leaves if leaf not in self._seen.get(workflow, set())]
        return len(leaves) - len(missed), len(leaves), missed

    def branches(self, workflow: str) -> tuple[int, int]:
        """Children of fallbacks, parallels and choices come to, and all of them."""
        leaves = leaves_of(self._lab, workflow)
        every = {leaf[: leaf.index("/", i)] for leaf in leaves for kind in BRANCHING for i in _found(leaf, kind)}
        seen = self._seen.get(workflow, set())
        return sum(any(path.startswith(branch + "/") for path in seen) for branch in every), len(every)


BRANCHING = ("/fallback.", "/parallel.", "/if.", "/switch.")


def _found(text: str, part: str) -> Sequence[int]:
    return [i + 1 for i in range(len(text)) if text.startswith(part, i)]
