"""Whether a workflow doses what a sample asks: its `mass`, within its `tolerance`, into its container.

The tree is followed with the values that are known before the run, along all of its ways at once: a sample is refused
where none of them leads to what it asks. What is known only when it runs is told then (`not as asked`, run/outcome.py).

What doses is a skill that commands the hand and the balance: its `mass`, within its `tolerance`. Where that goes to,
and of what, is told by the container and the source that were named last before it; as in a run, the last dose of a
lot into a container counts for both.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from scuhand_bt.problems import Mark, Problems
from scuhand_bt.recipe.sample import Sample
from scuhand_bt.recipe.takes import known
from scuhand_bt.specs import Container, Source
from scuhand_bt.tree.build import Scope, bound_inputs
from scuhand_bt.tree.check import Library
from scuhand_bt.tree.grammar import Branch, Call, Decorator, Reference, TreeNode

DOSING = {"hand", "balance"}
"""What a skill must command to dose: the valve, and what weighs the powder."""


@dataclass(frozen=True)
class _Aim:
    """What is dispensed towards, and where that is written; None for what is known only when it runs."""

    container: str | None
    lot: str | None
    mass_mg: float | None
    tolerance_mg: float | None
    mass_mark: Mark
    tolerance_mark: Mark

    @property
    def place(self) -> tuple[str | None, str | None]:
        return self.container, self.lot


@dataclass(frozen=True)
class _Reached:
    """What may hold at a place of the tree: the container and lot named last, and the last doses of each."""

    containers: frozenset[str | None] = frozenset({""})
    lots: frozenset[str | None] = frozenset({""})
    last: frozenset[_Aim] = frozenset()

    def __or__(self, other: "_Reached") -> "_Reached":
        return _Reached(self.containers | other.containers, self.lots | other.lots, self.last | other.last)


@dataclass(frozen=True)
class _Names:
    """The values that a workflow's names are known to have, and where those were written that it was given."""

    scope: Scope
    marks: Mapping[str, Mark]

    def mark_in(self, node: Call, key: str) -> Mark:
        """Where a value that is given to a call was written; the call itself, where it is given none."""
        argument = node.arguments.get(key)
        if argument is None:
            return node.mark
        if isinstance(argument, Reference) and not argument.attributes:
            return self.marks.get(argument.name, argument.mark)
        return argument.mark


def check_asked(samples: Sequence[Sample], library: Library, problems: Problems) -> None:
    """Note each place at which checked workflows dose otherwise than samples ask, once."""
    found: dict[tuple[Mark, str], list[str]] = {}
    for sample in samples:
        for mark, what, fix in _wrong(sample, library):
            found.setdefault((mark, fix), []).append(what)
    for (mark, fix), said in found.items():
        more = f" (and {len(said) - 1} more samples like it)" if len(said) > 1 else ""
        problems.add(mark, said[0] + more, fix)


def _wrong(sample: Sample, library: Library) -> Iterator[tuple[Mark, str, str]]:
    """Where a sample's workflow doses otherwise than it asks, how, and what to write."""
    if sample.mass_mg is None:
        return
    workflow = library.workflows[sample.workflow]
    follower = _Follower(library)
    reached = follower.of(workflow.tree, _Names(Scope(dict(sample.inputs)), {}), _Reached())
    asks = f"sample '{sample.id}' asks for"
    aims = [aim for aim in reached.last if aim.container is None or sample.is_dosed_into(aim.container)]
    if not aims:
        what = f"{asks} {sample.mass_mg:g} mg, and '{workflow.name}' doses nothing into its container"
        yield workflow.mark, what, "let it dispense $mass there"
    asked = [aim for aim in aims if aim.mass_mg is None or sample.is_mass(aim.mass_mg)]
    for aim in () if asked else aims:
        what = f"no dose is of the {sample.mass_mg:g} mg that {asks}; this one is of {aim.mass_mg:g} mg"
        yield aim.mass_mark, what, "write $mass"
    narrow = {aim.place for aim in asked if not _is_wider(aim, sample)}
    for aim in asked:
        if aim.place not in narrow:
            what = f"the dose is within {aim.tolerance_mg:g} mg, and {asks} {sample.tolerance_mg:g} mg"
            yield aim.tolerance_mark, what, "write $tolerance"


def _is_wider(aim: _Aim, sample: Sample) -> bool:
    """Whether a dose of the asked mass is told to be coarser than asked."""
    if aim.mass_mg is None or aim.tolerance_mg is None or sample.tolerance_mg is None:
        return False
    return aim.tolerance_mg > sample.tolerance_mg * (1.0 + 1e-9)


class _Follower:
    def __init__(self, library: Library) -> None:
        self._library = library

    def of(self, node: TreeNode, names: _Names, reached: _Reached) -> _Reached:
        """What may hold once a node has succeeded."""
        if isinstance(node, Call):
            return self._of_call(node, names, reached)
        if isinstance(node, Decorator):
            after = self.of(node.child, names, reached)
            return reached | after if node.kind in ("optional", "invert") else after
        if node.kind == "fallback":
            return self._of_fallback(node, names, reached)
        for child in node.children:
            reached = self.of(child, names, reached)
        return reached

    def _of_fallback(self, node: Branch, names: _Names, reached: _Reached) -> _Reached:
        """Any of its children may end it, after those before had failed at any of their steps."""
        ends: list[_Reached] = []
        for child in node.children:
            ends.append(self.of(child, names, reached))
            reached |= ends[-1]
        first, *others = ends
        for other in others:
            first |= other
        return first

    def _of_call(self, node: Call, names: _Names, reached: _Reached) -> _Reached:
        library = self._library
        given = known(node.arguments, names.scope, library, node.name)
        reached = self._named(node, given, reached)
        if node.name in library.skills:
            return self._of_skill(node, names, given, reached)
        workflow = library.workflows[node.name]
        unknown = node.arguments.keys() - given.keys()
        inner = Scope(bound_inputs(workflow, given, library, unknown))
        marks = {key: names.mark_in(node, key) for key in workflow.inputs}
        return self.of(workflow.tree, _Names(inner, marks), reached)

    def _named(self, node: Call, given: Mapping[str, Any], reached: _Reached) -> _Reached:
        """After the names of a container or a source in a call."""
        parameters = self._library.parameters(node.name)
        takes = {key: parameters[key].wire.python for key in node.arguments}
        containers = {_of(given, key, "id") for key, cls in takes.items() if cls is Container}
        lots = {_of(given, key, "sheet_key") for key, cls in takes.items() if cls is Source}
        return replace(
            reached,
            containers=frozenset(containers) or reached.containers,
            lots=frozenset(lots) or reached.lots,
        )

    def _of_skill(self, node: Call, names: _Names, given: Mapping[str, Any], reached: _Reached) -> _Reached:
        skill = self._library.skills[node.name]
        if not DOSING.issubset(skill.devices):
            return reached
        defaults = {info.alias or name: info.default for name, info in skill.model_fields.items()}
        values = {key: given.get(key) if key in node.arguments else defaults.get(key) for key in ("mass", "tolerance")}
        mass_mg, tolerance_mg = (value if isinstance(value, float) else None for value in values.values())
        mass_mark, tolerance_mark = (names.mark_in(node, key) for key in values)
        aims = frozenset(
            _Aim(container, lot, mass_mg, tolerance_mg, mass_mark, tolerance_mark)
            for container in reached.containers
            for lot in reached.lots
        )
        places = {aim.place for aim in aims}
        is_certain = len(places) == 1 and not any(None in place for place in places)
        return replace(reached, last=aims | {aim for aim in reached.last if not (is_certain and aim.place in places)})


def _of(given: Mapping[str, Any], key: str, attribute: str) -> str | None:
    """An attribute of a thing of the lab that a call is given; None where that is known only when it runs."""
    return getattr(given.get(key), attribute, None)
