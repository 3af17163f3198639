"""What a lab holds, to be listed and shown: skills, workflows, failures, and what can go wrong in a simulation."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scuhand_bt.lab import Lab, find_lab, load_lab, starter_lab
from scuhand_bt.problems import Problems
from scuhand_bt.quantity import Unit
from scuhand_bt.recipe.recipe import ACTIONS, DEFAULT_ON_FAILURE
from scuhand_bt.skill import Skill
from scuhand_bt.skill_files.facts import OF_RUNS
from scuhand_bt.tree.btxml import from_xml, to_xml
from scuhand_bt.tree.check import check_workflows
from scuhand_bt.tree.drawing import drawn
from scuhand_bt.tree.library import Library
from scuhand_bt.tree.wires import of_field
from scuhand_bt.tree.workflow import Branch, Decorator, walk
from scuhand_bt.yaml_source import read_text

__all__ = [
    "ACTIONS",
    "Explained",
    "FaultListed",
    "ParameterShown",
    "checked_lab",
    "drawn",
    "explained",
    "faults",
    "imported",
    "parameters",
    "result_type",
    "starter_lab",
    "to_xml",
]


@dataclass(frozen=True)
class Explained:
    """A failure code: what it means, what to do, where it comes from."""

    meaning: str
    remedy: str
    defined_by: list[str]
    """The lab's skills that add it to the catalogue."""
    raised_by: list[str]
    """Skills."""
    raised_in: list[str]
    """Rooms of the engine, from within any skill."""
    retried_by: list[str]
    """Workflows."""
    on_failure: str
    """What a recipe does about it that says nothing; empty where none is asked: it ends a run, or is told of a sample
    when its job is over."""


@dataclass(frozen=True)
class ParameterShown:
    """What a skill takes under one name; `default` with its unit, None where it is required."""

    name: str
    type: str
    default: str | None


@dataclass(frozen=True)
class FaultListed:
    """One kind of fault of a simulated cell (`docs/faults.md`)."""

    name: str
    summary: str
    lasts: str
    begins: str


def checked_lab(folder: Path | None = None) -> Lab:
    """A lab of which every workflow is checked. SourceError with all that is wrong."""
    lab = load_lab(find_lab(None, folder))
    problems = Problems(list(lab.problems))
    check_workflows(lab.library, lab.library.workflows, problems)
    problems.raise_any()
    return lab


def result_type(skill: type[Skill[Any]]) -> str:
    """What a skill gives, by the name that workflows have for it."""
    return of_field(skill.result_type()).name


def parameters(lab: Lab, name: str) -> Iterator[ParameterShown]:
    """What the skill `name` takes."""
    fields = {info.alias or field: info for field, info in lab.library.skills[name].model_fields.items()}
    for key, parameter in lab.library.parameters(name).items():
        unit = next((f" {mark.unit}" for mark in fields[key].metadata if isinstance(mark, Unit)), "")
        yield ParameterShown(key, parameter.wire.name, None if parameter.required else f"{fields[key].default}{unit}")


def imported(path: Path) -> Mapping[str, str]:
    """The workflows of a file of BehaviorTree.CPP or Groot2, as a lab's files have them, by name. SourceError."""
    return from_xml(read_text(path, "a file of BehaviorTree.CPP"), str(path))


def explained(library: Library | None = None) -> dict[str, Explained]:
    """Every failure code, in order; without a library what no lab adds is left out."""
    library = library if library is not None else Library()
    retried = {
        name: {code for node in walk(workflow.tree) if isinstance(node, Branch | Decorator) for code in node.codes}
        for name, workflow in library.workflows.items()
    }
    return {
        code: Explained(
            meaning=failure.meaning,
            remedy=failure.remedy,
            defined_by=[name for name, made in library.skills.items() if code in made.failures],
            raised_by=[name for name, made in library.skills.items() if code in made.raises],
            raised_in=[f"scuhand_bt/{room}" for room in failure.raised_in],
            retried_by=[workflow for workflow, codes in retried.items() if code in codes],
            on_failure="" if code in OF_RUNS else DEFAULT_ON_FAILURE.get(code, DEFAULT_ON_FAILURE["otherwise"]),
        )
        for code, failure in sorted(library.failures().items())
    }


def faults() -> Iterator[FaultListed]:
    """What can go wrong in a simulated cell, as a fault file has it."""
    from scuhand_bt.sim.fault_rules import KINDS, OPPORTUNITIES, TO_THE_END

    for name, kind in KINDS.items():
        lasts = "once" if kind.is_momentary else "to the end" if kind.lasts_s == TO_THE_END else f"{kind.lasts_s:g} s"
        yield FaultListed(name, kind.summary, lasts, OPPORTUNITIES[kind.opportunity])
