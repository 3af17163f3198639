"""What a sample takes from its sources, in the order in which its workflow takes it.

With one source that is the sample's `mass`, whatever the workflow does. With several, the workflow's tree is followed
with the values that are known before the run: every workflow below that is called with one source and a `mass` takes
that mass from it. That is the most it can take, as a dose counts what is in the container already.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from scuhand_bt.failures import Code
from scuhand_bt.problems import Problems
from scuhand_bt.specs import Source
from scuhand_bt.tree.build import Scope, bound_inputs
from scuhand_bt.tree.check import Library, literal, resolve_percent
from scuhand_bt.tree.grammar import PARAMETERS, Argument, Branch, Call, Decorator, Reference, TreeNode, Workflow

TAKES_ITS_MASS = "let a workflow do it that has one input of type Source and an input 'mass'"


@dataclass(frozen=True)
class Take:
    """So much powder out of a source; None where no mass is known."""

    source: Source
    mass_mg: float | None

    @property
    def needed_mg(self) -> float:
        """The mass, and what each scoop for it loses."""
        if self.mass_mg is None:
            return 0.0
        powder = self.source.powder
        return self.mass_mg + math.ceil(self.mass_mg / powder.load_limit_mg) * powder.scoop_loss_mg


def sources_of(inputs: Mapping[str, Any]) -> list[Source]:
    """The sources among the inputs of a workflow, each once."""
    return list({value.name: value for value in inputs.values() if isinstance(value, Source)}.values())


def takes_of(workflow: Workflow, inputs: Mapping[str, Any], library: Library, problems: Problems) -> tuple[Take, ...]:
    """What a checked workflow takes with these inputs; notes what of it cannot be told before the run."""
    sources = sources_of(inputs)
    if len(sources) < 2:
        mass_mg = inputs.get("mass")
        return tuple(Take(source, mass_mg if isinstance(mass_mg, float) else None) for source in sources)
    return tuple(_Follower(library, problems).of(workflow.tree, Scope(dict(inputs))))


def known(arguments: Mapping[str, Argument], scope: Scope, library: Library, name: str | None = None) -> dict[str, Any]:
    """The arguments whose values are known before the run: literals, and what stems from the workflow's inputs.

    They are those of a call of the skill or workflow `name`; of a decorator, without one.
    """
    wires = PARAMETERS if name is None else {key: p.wire for key, p in library.parameters(name).items()}
    values: dict[str, Any] = {}
    for key, argument in arguments.items():
        if not isinstance(argument, Reference):
            values[key] = literal(key, wires[key], argument, library)
        elif argument.name in scope.values:
            values[key] = scope.read(argument)
    return resolve_percent(values)


class _Follower:
    def __init__(self, library: Library, problems: Problems) -> None:
        self._library = library
        self._problems = problems

    def of(self, node: TreeNode, scope: Scope) -> list[Take]:
        if isinstance(node, Branch):
            found = [self.of(child, scope) for child in node.children]
            if node.kind == "fallback":
                self._require_one_lot(node, found)
            return [take for child in found for take in child]
        if isinstance(node, Decorator):
            return self._repeated(node, self.of(node.child, scope), scope)
        return self._of_call(node, scope)

    def _of_call(self, node: Call, scope: Scope) -> list[Take]:
        library = self._library
        inputs = known(node.arguments, scope, library, node.name)
        given = [key for key, p in library.parameters(node.name).items() if p.wire.python is Source]
        for key in set(given) & (node.arguments.keys() - inputs.keys()):
            what = f"which source '{node.name}' is given is known only when it runs: {node.arguments[key]}"
            self._problems.add(node.argument_marks[key], what, "an input of this workflow can be told before")
        sources = sources_of({key: inputs.get(key) for key in given})
        if node.name in library.skills:
            if sources and Code.SOURCE_EMPTY in library.skills[node.name].raises:
                self._refuse_amount(node)
            return []
        workflow = library.workflows[node.name]
        inputs = bound_inputs(workflow, inputs, library, node.arguments.keys() - inputs.keys())
        if len(sources) != 1 or "mass" not in workflow.inputs:
            return self.of(workflow.tree, Scope(inputs)) if sources else []
        if "mass" not in inputs:
            self._refuse_amount(node)
            return []
        return [Take(sources[0], inputs["mass"])]

    def _repeated(self, node: Decorator, takes: list[Take], scope: Scope) -> list[Take]:
        if node.kind != "repeat" or not takes:
            return takes
        times = known(node.arguments, scope, self._library).get("times")
        if times is None:
            what = "how often powder is taken from one of several sources is known only when it runs"
            self._problems.add(node.mark, what, "a number, or an input of this workflow")
            return takes
        return [replace(take, mass_mg=take.mass_mg and take.mass_mg * times) for take in takes]

    def _require_one_lot(self, node: Branch, found: list[list[Take]]) -> None:
        """Which of its children ends a fallback is not known; what the sheet has touched then must be."""
        taking = [takes for takes in found if takes]
        lots = sorted({take.source.sheet_key for takes in taking for take in takes})
        if len(taking) > 1 and len(lots) > 1:
            what = f"which of {', '.join(lots)} the sheet has touched after this fallback is known only when it runs"
            self._problems.add(node.mark, what, "sources of one powder and lot, or a sequence")

    def _refuse_amount(self, node: Call) -> None:
        what = f"how much '{node.name}' takes from one of several sources cannot be told before the run"
        self._problems.add(node.mark, what, TAKES_ITS_MASS)
