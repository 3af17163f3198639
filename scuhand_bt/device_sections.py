"""The sections of robot/cell.yaml whose drivers bring a model of their own: it validates their `options`."""

import sys
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from scuhand_bt.cell_spec import DEVICES, CellSpec
from scuhand_bt.drivers import NAMED_KINDS, NotPluggable, driver_of, is_known, is_ours
from scuhand_bt.problems import Problems
from scuhand_bt.validation import validate
from scuhand_bt.yaml_source import Entries, Node, Scalar

Options = dict[str, BaseModel]


def own_options(root: Entries, folder: Path, problems: Problems) -> tuple[Entries, Options]:
    """The cell's file without the options that `CellSpec` has no model of, and those, by device.

    Drivers that are not the engine's are met here, before anything moves; they may be modules of the lab's `folder`.
    What is wrong with them is located.
    """
    options: Options = {}

    def without_own(name: str, kind: str, node: Node) -> Node:
        if ":" in _text(node, "driver") and str(folder) not in sys.path:
            sys.path.append(str(folder))  # last, so that it hides nothing
        return _without_own(name, kind, node, options, problems)

    values = dict(root.values)
    for kind in DEVICES:
        node = root.get(kind)
        if node is not None and (driver := _text(node, "driver")) and not is_ours(kind, driver):
            values[kind] = without_own(kind, kind, node)
    if isinstance(named := root.get("devices"), Entries):
        sections = {name: without_own(name, _text(node, "kind"), node) for name, node in named.values.items()}
        values["devices"] = Entries(named.mark, named.keys, sections)
    return Entries(root.mark, root.keys, values), options


def _without_own(name: str, kind: str, node: Node, options: Options, problems: Problems) -> Node:
    driver = _text(node, "driver")
    if not isinstance(node, Entries):
        return node
    if kind not in (*DEVICES, *NAMED_KINDS) or not is_known(kind, driver):
        return node.without("options")  # whose they would be is not known; that is said of kind or driver
    try:
        model = driver_of(kind, driver).Options
    except NotPluggable as error:
        problems.add(node.values["driver"].mark, f"driver {error}", code="bad-value")
        return node.without("options")
    if kind in DEVICES and model is CellSpec.options_model(kind):
        return node
    given = node.get("options") or Entries(node.mark, {}, {})
    if (made := validate(model, given, problems)) is not None:
        options[name] = made
    return node.without("options")


def _text(node: Any, key: str) -> str:
    value = node.get(key) if isinstance(node, Entries) else None
    return value.text or "" if isinstance(value, Scalar) else ""
