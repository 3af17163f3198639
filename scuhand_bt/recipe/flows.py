"""The flows (`recipe/flow.py`) of all samples; samples that differ only in the ids of their containers share one."""

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
    """Finds and caches the flows of one recipe's samples. Its sources are identified by name."""

    def __init__(self, library: Library) -> None:
        self._library = library
        self._found: dict[Hashable, tuple[Flow, list[str]]] = {}
        self._reading: dict[str, bool] = {}

    def of(self, workflow: str, inputs: Mapping[str, Any], problems: Problems) -> Flow:
        """As `flow_of`. A problem that several samples share is reported only for the first."""
        ids: list[str] = []
        by_id = self._reads_ids(workflow)
        kind = workflow, tuple((name, _told(value, ids, by_id=by_id)) for name, value in inputs.items())
        if kind not in self._found:
            self._found[kind] = flow_of(workflow, inputs, self._library, problems), ids
        flow, of_first = self._found[kind]
        return flow if ids == of_first else _renamed(flow, dict(zip(of_first, ids, strict=True)))

    def _reads_ids(self, workflow: str) -> bool:
        """Whether what the workflow does may depend on the ids of its containers."""
        if workflow not in self._reading:
            self._reading[workflow] = _reads_ids(self._library.workflows[workflow].tree, self._library)
        return self._reading[workflow]


def _told(value: Any, ids: list[str], *, by_id: bool) -> Hashable:
    """A hashable key for an input's value. Appends the ids of containers to `ids`."""
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
