"""Everything that a workflow can name (skills, workflows, powders, vessels, zones), and the parameters of each."""

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
"""How many skills' parameters are cached. A study loads the lab again for each draw, with new classes each time."""


@dataclass(frozen=True)
class Parameter:
    """One parameter of a skill or workflow."""

    wire: WireType
    required: bool


@dataclass
class Library:
    """Everything that a workflow can name."""

    skills: Mapping[str, type[Skill[Any]]] = field(default_factory=dict)
    workflows: Mapping[str, Workflow] = field(default_factory=dict)
    powders: Mapping[str, Powder] = field(default_factory=dict)
    containers: Mapping[str, ContainerKind] = field(default_factory=dict)
    mortars: Mapping[str, Mortar] = field(default_factory=dict)
    facts: Mapping[str, SkillFacts] = field(default_factory=dict)
    """What static analysis finds in the skills' files."""
    taken_there: Mapping[str, Collection[str]] = field(default_factory=dict)
    """Parameters of the starter lab's skills of these names, where the lab's own version differs."""
    zones: Collection[str] = ()
    """Zones of `robot/cell.yaml`: spaces in which only one thing may move at a time."""
    broken: Broken = field(default_factory=Broken)
    """What the lab's files name but cannot be used."""
    recorded: dict[Mark, Mapping[str, WireType]] = field(default_factory=dict)
    """For each `record` in checked workflows, by its place: the types of its parameters."""

    chosen_by: dict[Mark, WireType] = field(default_factory=dict)
    """For each `switch` in checked workflows, by its place: the type of its value."""

    def wires(self, call: Call) -> Mapping[str, WireType]:
        """The types of the parameters of a call in a checked workflow."""
        if call.name == RECORD:
            return self.recorded.get(call.mark, {})
        if call.name in self.skills:
            return _wires_of(self.skills[call.name])
        return {key: declared.type for key, declared in self.workflows[call.name].inputs.items()}

    def failures(self) -> Mapping[str, Failure]:
        """All failure codes: the catalogue's and the lab's own."""
        return {
            **CATALOGUE,
            **{code: entry for skill in self.skills.values() for code, entry in skill.failures.items()},
        }

    def parameters(self, name: str) -> Mapping[str, Parameter]:
        """The parameters of the skill or workflow `name`."""
        if name in self.skills:
            return parameters_of(self.skills[name])
        inputs = self.workflows[name].inputs
        return {key: Parameter(declared.type, declared.default is None) for key, declared in inputs.items()}


@lru_cache(maxsize=SKILLS_KEPT)
def parameters_of(skill: type[Skill[Any]]) -> Mapping[str, Parameter]:
    """A skill's parameters, by their names in YAML."""
    return {
        info.alias or field_name: Parameter(of_field(info.annotation, info.metadata), info.is_required())
        for field_name, info in skill.model_fields.items()
    }


@lru_cache(maxsize=SKILLS_KEPT)
def units_of(skill: type[Skill[Any]]) -> Mapping[str, str]:
    """The units of a skill's parameters that are quantities or lists of quantities."""
    wires = {key: wire.item or wire for key, wire in _wires_of(skill).items()}
    symbols = {key: QUANTITIES[wire.name].symbol for key, wire in wires.items() if wire.name in QUANTITIES}
    return {key: symbol for key, symbol in symbols.items() if symbol}


@lru_cache(maxsize=SKILLS_KEPT)
def _wires_of(skill: type[Skill[Any]]) -> Mapping[str, WireType]:
    return {key: parameter.wire for key, parameter in parameters_of(skill).items()}


@dataclass(frozen=True)
class Percent:
    """A tolerance written as a percentage of the mass in the same call."""

    ratio: float


def literal(name: str, wire: WireType, node: Node, library: Library) -> Any:
    """The value of a literal for the parameter `name`. Raises ValueError, worded for the user, if it is wrong."""
    value = plain(node)
    if wire.item is not None:
        if not isinstance(node, Items):
            raise ValueError(f"{describe(node)} is not a list; write [one, another]")
        return tuple(literal("", wire.item, item, library) for item in node.items)
    if wire.is_class:
        if value is None and wire.optional:
            return None
        if wire.python is Powder and isinstance(value, str):
            if value in library.powders:
                return library.powders[value]
            raise ValueError(f"no powder '{shorten(value)}' in robot/powders.yaml")
        raise ValueError(f"{describe(node)} cannot be a {wire.name}; wire it from an input, as ${name}")
    if name == "tolerance" and wire.name == "Mass" and isinstance(value, str) and value.rstrip().endswith("%"):
        ratio = parse(value, RATIO)
        if not 0 < ratio <= 1:
            raise ValueError(f"'{shorten(value)}' is not a tolerance; write more than 0 % and at most 100 %")
        return Percent(ratio)
    return wire.read(value)


def resolve_percent(values: dict[str, Any]) -> dict[str, Any]:
    """Convert a tolerance in percent to milligrams of the mass beside it, in place."""
    tolerance, mass_mg = values.get("tolerance"), values.get("mass")
    if isinstance(tolerance, Percent) and mass_mg is not None:
        values["tolerance"] = tolerance.ratio * mass_mg
    return values


def devices_of(node: TreeNode, library: Library) -> set[str]:
    """The devices that a tree commands, including everything that it calls."""
    return {device for skill in skills_of(node, library) for device in skill.devices}


def skills_of(node: TreeNode, library: Library, seen: set[str] | None = None) -> set[type[Skill[Any]]]:
    """The skills of a tree, including everything that it calls (`seen`: workflows already visited)."""
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
