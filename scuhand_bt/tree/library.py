"""All that a workflow can name: skills, workflows, powders, vessels, zones, and what each of them takes."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from scuhand_bt.failures import CATALOGUE, Failure
from scuhand_bt.problems import Broken, Mark, shorten
from scuhand_bt.quantity import RATIO, parse
from scuhand_bt.skill import Skill
from scuhand_bt.skill_files.facts import SkillFacts
from scuhand_bt.specs import ContainerKind, Mortar, Powder
from scuhand_bt.tree.grammar import RECORD
from scuhand_bt.tree.wires import QUANTITIES, WireType, of_field
from scuhand_bt.tree.workflow import Call, TreeNode, Workflow, walk
from scuhand_bt.yaml_source import Items, Node, describe, plain

SKILLS_KEPT = 128
"""Of so many it is remembered what they take: a process that loads a lab anew for each draw of a study keeps few."""


@dataclass(frozen=True)
class Parameter:
    """What a skill or a workflow takes under one name."""

    wire: WireType
    required: bool


@dataclass
class Library:
    """All that a workflow can name."""

    skills: Mapping[str, type[Skill[Any]]] = field(default_factory=dict)
    workflows: Mapping[str, Workflow] = field(default_factory=dict)
    powders: Mapping[str, Powder] = field(default_factory=dict)
    containers: Mapping[str, ContainerKind] = field(default_factory=dict)
    mortars: Mapping[str, Mortar] = field(default_factory=dict)
    facts: Mapping[str, SkillFacts] = field(default_factory=dict)
    """What the skills' files say of them."""
    taken_there: Mapping[str, Collection[str]] = field(default_factory=dict)
    """What the starter lab's skills of these names take, where the lab has them in other words."""
    zones: Collection[str] = ()
    """The spaces that `robot/cell.yaml` says only one may move in at a time."""
    broken: Broken = field(default_factory=Broken)
    """What its files name and cannot be used."""
    recorded: dict[Mark, Mapping[str, WireType]] = field(default_factory=dict)
    """The types of what `record` is given, by where it stands, in workflows that were checked."""

    chosen_by: dict[Mark, WireType] = field(default_factory=dict)
    """The types of what each `switch` of such a workflow chooses by."""

    def wires(self, call: Call) -> Mapping[str, WireType]:
        """The types of what a call of a checked workflow can be given."""
        if call.name == RECORD:
            return self.recorded.get(call.mark, {})
        if call.name in self.skills:
            return _wires_of(self.skills[call.name])
        return {key: declared.type for key, declared in self.workflows[call.name].inputs.items()}

    def failures(self) -> Mapping[str, Failure]:
        """The catalogue with the lab's own codes."""
        return {
            **CATALOGUE,
            **{code: entry for skill in self.skills.values() for code, entry in skill.failures.items()},
        }

    def parameters(self, name: str) -> Mapping[str, Parameter]:
        """What the skill or workflow `name` takes."""
        if name in self.skills:
            return parameters_of(self.skills[name])
        inputs = self.workflows[name].inputs
        return {key: Parameter(declared.type, declared.default is None) for key, declared in inputs.items()}


@lru_cache(maxsize=SKILLS_KEPT)
def parameters_of(skill: type[Skill[Any]]) -> Mapping[str, Parameter]:
    """What a skill takes."""
    return {
        info.alias or field_name: Parameter(of_field(info.annotation, info.metadata), info.is_required())
        for field_name, info in skill.model_fields.items()
    }


@lru_cache(maxsize=SKILLS_KEPT)
def units_of(skill: type[Skill[Any]]) -> Mapping[str, str]:
    """The units in which a skill is given those of its parameters that are quantities, or lists of such."""
    wires = {key: wire.item or wire for key, wire in _wires_of(skill).items()}
    symbols = {key: QUANTITIES[wire.name].symbol for key, wire in wires.items() if wire.name in QUANTITIES}
    return {key: symbol for key, symbol in symbols.items() if symbol}


@lru_cache(maxsize=SKILLS_KEPT)
def _wires_of(skill: type[Skill[Any]]) -> Mapping[str, WireType]:
    return {key: parameter.wire for key, parameter in parameters_of(skill).items()}


@dataclass(frozen=True)
class Percent:
    """A tolerance written as a percentage: of the mass in the same call."""

    ratio: float


def literal(name: str, wire: WireType, node: Node, library: Library) -> Any:
    """The value of a literal for the parameter `name`; ValueError, worded for the user, if it has none."""
    value = plain(node)
    if wire.item is not None:
        if not isinstance(node, Items):
            raise ValueError(f"{describe(node)} is no list; write [one, another]")
        return tuple(literal("", wire.item, item, library) for item in node.items)
    if wire.is_class:
        if value is None and wire.optional:
            return None
        if wire.python is Powder and isinstance(value, str):
            if value in library.powders:
                return library.powders[value]
            raise ValueError(f"no powder '{shorten(value)}' in robot/powders.yaml")
        raise ValueError(f"{describe(node)} cannot stand for a {wire.name}; wire it from an input, as ${name}")
    if name == "tolerance" and wire.name == "Mass" and isinstance(value, str) and value.rstrip().endswith("%"):
        ratio = parse(value, RATIO)
        if not 0 < ratio <= 1:
            raise ValueError(f"'{shorten(value)}' is no tolerance; more than 0 % and at most 100 %")
        return Percent(ratio)
    return wire.read(value)


def resolve_percent(values: dict[str, Any]) -> dict[str, Any]:
    """Turn a tolerance in percent into milligrams, by the mass beside it."""
    tolerance, mass_mg = values.get("tolerance"), values.get("mass")
    if isinstance(tolerance, Percent) and mass_mg is not None:
        values["tolerance"] = tolerance.ratio * mass_mg
    return values


def devices_of(node: TreeNode, library: Library) -> set[str]:
    """The devices that a tree commands, through all that it calls."""
    return {device for skill in skills_of(node, library) for device in skill.devices}


def skills_of(node: TreeNode, library: Library, seen: set[str] | None = None) -> set[type[Skill[Any]]]:
    """The skills of a tree, through all that it calls (`seen`: workflows looked at already)."""
    skills: set[type[Skill[Any]]] = set()
    seen = set() if seen is None else seen
    for part in walk(node):
        if isinstance(part, Call):
            if part.name in library.skills:
                skills.add(library.skills[part.name])
            elif part.name in library.workflows and part.name not in seen:
                seen.add(part.name)
                skills |= skills_of(library.workflows[part.name].tree, library, seen)
    return skills
