"""A job's tree in the form that a running BehaviorTree.CPP 4 sends to Groot2: instantiated, with every node numbered.

Each call of a workflow has its own `BehaviorTree`, named by `_fullpath`. Every node, `SubTree` included, has a `_uid`
from 1, in depth-first order. The model also declares the format's built-in nodes.
"""

from copy import deepcopy
from dataclasses import dataclass
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from scuhand_bt.tree.btxml import IF, to_xml
from scuhand_bt.tree.library import Library

CONDITION, FILLERS = "ScriptCondition", ("AlwaysSuccess", "AlwaysFailure")
"""Nodes that only the format has: the condition of an `if`, and the filler for a missing branch of `if` or `switch`."""
_PORTS: dict[str, tuple[str, dict[str, str]]] = {
    **dict.fromkeys(("Sequence", "Fallback", "ReactiveSequence", IF), ("Control", {})),
    "Parallel": ("Control", {"success_count": "int", "failure_count": "int"}),
    **dict.fromkeys(("Inverter", "ForceSuccess"), ("Decorator", {})),
    "RetryUntilSuccessful": ("Decorator", {"num_attempts": "int"}),
    "Repeat": ("Decorator", {"num_cycles": "int"}),
    "Timeout": ("Decorator", {"msec": "unsigned int"}),
    "LoopString": ("Decorator", {"queue": "BT::AnyTypeAllowed", "if_empty": "BT::NodeStatus", "value": "std::string"}),
    **dict.fromkeys(FILLERS, ("Action", {})),
    CONDITION: ("Condition", {"code": "std::string"}),
}


@dataclass(frozen=True)
class LiveNode:
    """A node of the file, and the index of ours that it stands for (depth-first from the root, from 0)."""

    number: int
    only_there: str = ""
    """For a node that only the format has, its kind; `number` is then that of its `if` or `switch`."""


@dataclass(frozen=True)
class LiveTree:
    """The file, its nodes in the order of their `_uid` (from 1), and the calls of workflows."""

    xml: str
    nodes: tuple[LiveNode, ...]
    scopes: tuple[str, ...]
    """The format's name for the values of each call: first the job's own workflow, then the others by their paths."""


def live_tree(library: Library, name: str) -> LiveTree:
    """A checked workflow as it runs. Raises SourceError for what the format cannot express."""
    source = ElementTree.fromstring(to_xml(library, name).encode())
    instances = _Instances({tree.get("ID", ""): tree for tree in source.iterfind("BehaviorTree")})
    instances.add(name, "", -1)
    root = Element("root", BTCPP_format="4", main_tree_to_execute=name)
    root.extend(instances.trees)
    model = SubElement(root, "TreeNodesModel")
    for tag in sorted({node.tag for tree in instances.trees for node in tree.iter()}):
        _model(model, tag)
    model.extend(source.iterfind("TreeNodesModel/*"))
    ElementTree.indent(root)
    return LiveTree(ElementTree.tostring(root, encoding="unicode"), tuple(instances.nodes), tuple(instances.scopes))


class _Instances:
    def __init__(self, trees: dict[str, Element]) -> None:
        self.trees: list[Element] = []
        self.nodes: list[LiveNode] = []
        self.scopes: list[str] = []
        self._of = trees
        self._ours = 0

    def add(self, name: str, path: str, above: int) -> None:
        """Add a call of a workflow, and everything below it."""
        tree = deepcopy(self._of[name])
        tree.set("_fullpath", path)
        self.trees.append(tree)
        self.scopes.append(path or name)
        self._number(tree[0], path, above)

    def _number(self, node: Element, path: str, above: int) -> None:
        if node.tag == CONDITION or node.tag in FILLERS:
            self.nodes.append(LiveNode(above, node.tag))
        else:
            self.nodes.append(LiveNode(self._ours))
            self._ours += 1
        node.set("_uid", str(len(self.nodes)))
        number = self._ours - 1
        if node.tag == "SubTree":
            called = node.get("ID", "")
            inner = f"{path}/{called}::{len(self.nodes)}".lstrip("/")
            node.set("_fullpath", inner)
            self.add(called, inner, number)
            return
        if "name" not in node.attrib:
            node.set("name", node.tag)
        for child in node:
            self._number(child, path, number)


def _model(model: Element, tag: str) -> None:
    if tag.startswith("Switch"):
        cases = {f"case_{number}": "std::string" for number in range(1, int(tag.removeprefix("Switch")) + 1)}
        kind, ports = "Control", {"variable": "std::string", **cases}
    elif tag in _PORTS:
        kind, ports = _PORTS[tag]
    else:
        return
    made = SubElement(model, kind, ID=tag)
    for name, type_ in ports.items():
        SubElement(made, "output_port" if name == "value" else "input_port", name=name, type=type_)
