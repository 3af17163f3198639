"""Figures of a recipe and its lab, changed: a copy of the files with other values at some places.

A place is named by its file and its keys, with dots between them: `recipe.samples.0.mass`,
`powders.glass_beads.simulation.flow_coefficient`, `cell.balance.readability`. What is changed is read and checked as
any recipe and any lab is.
"""

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias

import yaml

from scuhand_bt.lab import CELL_FILE
from scuhand_bt.problems import Mark, Problem, SourceError

Value: TypeAlias = float | str
Changes: TypeAlias = tuple[tuple[str, Value], ...]
"""New values by place."""

FOLDERS = ("robot", "trees", "skills")
FILES = {"powders": "robot/powders.yaml", "containers": "robot/containers.yaml", "cell": str(CELL_FILE)}


@contextmanager
def changed(recipe: Path, lab: Path, changes: Changes) -> Iterator[tuple[Path, Path]]:
    """A recipe and its lab with these changes, as files for a while: the very ones where nothing is changed.

    Raises SourceError for a place that there is not.
    """
    if not changes:
        yield recipe, lab
        return
    with tempfile.TemporaryDirectory(prefix="scuhand-study-") as folder:
        copy = Path(folder) / "lab"
        for name in FOLDERS:
            if (lab / name).is_dir():
                shutil.copytree(lab / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
        beside = copy / "recipes"
        beside.mkdir()
        for path in recipe.parent.iterdir():  # its tables
            if path.is_file():
                shutil.copy(path, beside)
        copied = beside / recipe.name
        for place, value in changes:
            file, *keys = place.split(".")
            path = copied if file == "recipe" else copy / FILES.get(file, "")
            if not path.is_file() or not keys:
                raise _no_such(place, ["recipe", *FILES])
            path.write_text(_with(path.read_text(encoding="utf-8"), place, keys, value), encoding="utf-8")
        yield copied, copy


def _with(text: str, place: str, keys: list[str], value: Value) -> str:
    root = inner = yaml.load(text, yaml.BaseLoader)  # every scalar stays text, as the house reads it
    for key in keys[:-1]:
        inner = inner[_key(inner, key, place)]
    inner[_key(inner, keys[-1], place)] = str(value)
    return yaml.safe_dump(root, sort_keys=False, allow_unicode=True)


def _key(inner: Any, key: str, place: str) -> str | int:
    if isinstance(inner, dict) and key in inner:
        return key
    if isinstance(inner, list) and key.isdecimal() and int(key) < len(inner):
        return int(key)
    known = list(inner) if isinstance(inner, dict) else [str(number) for number in range(len(inner or ()))]
    raise _no_such(place, known, key)


def _no_such(place: str, known: list[str], key: str = "") -> SourceError:
    what = f"'{key}' is not there" if key else "a place begins with its file"
    return SourceError([Problem(Mark(place, 0), f"{what}; known: {', '.join(map(str, known)) or 'nothing'}")])
