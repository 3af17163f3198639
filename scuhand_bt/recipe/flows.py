"""The flows of a recipe's samples: those that are alike but for their containers' ids are followed once."""

from collections.abc import Hashable, Mapping
from dataclasses import replace
from typing import Any

from scuhand_bt.problems import Problems
from scuhand_bt.recipe.flow import flow_of
from scuhand_bt.recipe.pour import Flow
from scuhand_bt.specs import Container, Powder, Source
from scuhand_bt.tree.library import Library
from scuhand_bt.tree.workflow import Call, TreeNode, arguments_of, references_of, walk


class Flows:
    """Of the samples of one recipe, whose sources are known by their names."""

    def __init__(self, library: Library) -> None:
        self._library = library
        self._found: dict[Hashable, tuple[Flow, list[str]]] = {}
        self._reading: dict[str, bool] = {}

    def of(self, workflow: str, inputs: Mapping[str, Any], problems: Problems) -> Flow:
        """As `flow_of`; what is wrong with several that are alike is noted once."""
        ids: list[str] = []
        by_id = self._reads_ids(workflow)
        kind = workflow, tuple((name, _told(value, ids, by_id=by_id)) for name, value in inputs.items())
        if kind not in self._found:
            self._found[kind] = flow_of(workflow, inputs, self._library, problems), ids
        flow, of_first = self._found[kind]
        return flow if ids == of_first else _renamed(flow, dict(zip(of_first, ids, strict=True)))

    def _reads_ids(self, workflow: str) -> bool:
        """Whether what it does may depend on what its containers are called."""
        if workflow not in self._reading:
            self._reading[workflow] = _reads_ids(self._library.workflows[workflow].tree, self._library)
        return self._reading[workflow]


def _told(value: Any, ids: list[str], *, by_id: bool) -> Hashable:
    """What tells an input from another one of its type; the ids of containers are noted."""
    if isinstance(value, tuple):
        return tuple(_told(one, ids, by_id=by_id) for one in value)
    if isinstance(value, Container):
        ids.append(value.id)
        return value.name, value.id if by_id else ""
    return value.name if isinstance(value, Source | Powder) else value


def _renamed(flow: Flow, names: Mapping[str, str]) -> Flow:
    pours = {pour: replace(pour, container=names.get(pour.container or "", pour.container)) for pour in flow.pours}
    return replace(
        flow, pours=tuple(pours[pour] for pour in flow.pours), last=frozenset(pours[pour] for pour in flow.last)
    )


def _reads_ids(tree: TreeNode, library: Library) -> bool:
    return any(
        any("id" in one.attributes for argument in arguments_of(node) for one in references_of(argument))
        or (
            isinstance(node, Call)
            and node.name in library.workflows
            and _reads_ids(library.workflows[node.name].tree, library)
        )
        for node in walk(tree)
    )
