"""A package for a device of one's own, as `scuhand-bt new device` writes it: driver, twin, protocol page, test."""

import re
from importlib.resources import files
from pathlib import Path

from scuhand_bt.kit import templates
from scuhand_bt.problems import Mark, Problem, SourceError

TEMPLATES = {
    "balance": "balance",
    "changer": "changer",
    "sensor": "sensor",
    "scanner": "scanner",
    "ioniser": "switch",
    "capper": "switch",
    "watcher": "watcher",
}
"""By kind of device, the module that is copied. An arm or a hand is not written line by line."""

_PYPROJECT = """\
[build-system]
requires = ["hatchling>=1.27,<2"]
build-backend = "hatchling.build"

[project]
name = "scuhand-{name}"
version = "0.1.0"
description = "{Name} for scuhand_bt: `driver: {name}` of a {kind}."
requires-python = ">=3.11"
dependencies = ["scuhand_bt"]

[project.entry-points."scuhand_bt.{kind}"]
{name} = "scuhand_{name}:DRIVER"

[tool.hatch.build.targets.wheel]
only-include = ["scuhand_{name}.py"]
"""
_TEST = '''\
"""The driver passes what the engine's own drivers pass."""

import pytest

from scuhand_bt.testing.conformance import conforms


@pytest.mark.real_time
def test_the_{kind}_conforms() -> None:
    conforms("{kind}", "scuhand_{name}:DRIVER")
'''
_PAGE = """\
# {Name}

Source: the manual, its edition and page. **It has not met its hardware yet.**

Line: 9600 baud, 8 data bits, no parity, 1 stop bit.

| what is sent | what is answered | what that means |
| --- | --- | --- |
| | | |

## Beware

What the manual leaves open, and what the driver does not assume.
"""


def write_device(name: str, kind: str, folder: Path) -> list[Path]:
    """Write the package `scuhand_<name>` for a device of this kind into a new folder; the files.

    SourceError for a kind without a template, a name that is none of a module, or a folder that is not empty.
    """
    if kind not in TEMPLATES:
        known = ", ".join(TEMPLATES)
        what = f"there is no template for a device of kind '{kind}'; known: {known}"
        raise SourceError([Problem(Mark(kind), what, "an arm or a hand is a class with `connect`: docs/devices.md")])
    if re.fullmatch(r"[a-z][a-z0-9_]*", name) is None:
        raise SourceError(
            [Problem(Mark(name), f"'{name}' is not a name of a module", "a small letter, then a-z, 0-9, _")]
        )
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise SourceError([Problem(Mark(str(folder)), "it exists, and is not empty")])
    title = name.replace("_", " ").title()
    said = {"name": name, "Name": title, "kind": kind}
    module = (files(templates) / f"{TEMPLATES[kind]}.py").read_text(encoding="utf-8")
    texts = {
        f"scuhand_{name}.py": module.replace("Template", title.replace(" ", "")),
        f"test_{name}.py": _TEST.format(**said),
        "protocol.md": _PAGE.format(**said),
        "pyproject.toml": _PYPROJECT.format(**said),
    }
    folder.mkdir(parents=True, exist_ok=True)
    for file, text in texts.items():
        (folder / file).write_text(text, encoding="utf-8")
    return [folder / file for file in texts]
