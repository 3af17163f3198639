"""Changes figures of a recipe and its lab: a copy of the files with other values at some places.

A place is named by its file and its keys, joined by dots: `recipe.samples.0.mass`,
`powders.glass_beads.simulation.flow_coefficient`, `cell.balance.readability`. The copy is read and checked like any
recipe and lab.
"""

import hashlib
import json
import re
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import yaml

from scuhand_bt.lab import CELL_FILE, lab_files
from scuhand_bt.problems import Mark, Problem, SourceError
from scuhand_bt.recipe.expansion import tables_named
from scuhand_bt.run.own_modules import digests, lab_modules, plant_files

Value: TypeAlias = float | str
Changes: TypeAlias = tuple[tuple[str, Value], ...]
"""New values, by place."""

FOLDERS = ("robot", "trees", "skills")
FILES = {"powders": "robot/powders.yaml", "containers": "robot/containers.yaml", "cell": str(CELL_FILE)}


def files_hash(recipe: Path, lab: Path) -> str:
    """SHA-256 of a recipe, its tables and all files of its lab that a run depends on, as written."""
    text = recipe.read_text(encoding="utf-8")
    tables = {str(table.text): recipe.parent / str(table.text) for table in tables_named(text, str(recipe))}
    found = {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in tables.items() if path.is_file()}
    return hashlib.sha256(json.dumps([text, found, lab_files(lab)], sort_keys=True).encode()).hexdigest()


def modules_hash(plant: str | None, lab: Path) -> str:
    """SHA-256 of the user's own modules behind a plant (`module:Class`) and a lab; "" if there are none."""
    with suppress(OSError):  # the first dry run reports an unreadable lab
        if not (files := (plant_files(plant) if plant is not None else {}) | lab_modules(lab)):
            return ""
        return hashlib.sha256(json.dumps(digests(files), sort_keys=True).encode()).hexdigest()
    return ""


@contextmanager
def changed(recipe: Path, lab: Path, changes: Changes) -> Iterator[tuple[Path, Path]]:
    """Temporary copies of a recipe and its lab with these changes; the originals if there are none.

    Raises SourceError for a place that does not exist. A SourceError raised while the copies exist is rewritten to
    name the original files.
    """
    if not changes:
        yield recipe, lab
        return
    with tempfile.TemporaryDirectory(prefix="scuhand-study-") as folder:
        copy = Path(folder) / "lab"
        for name in FOLDERS:
            if (lab / name).is_dir():
                shutil.copytree(lab / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
        here = lab.absolute()
        for path in lab_modules(here).values():  # skills may import modules from elsewhere in the lab
            if path.is_relative_to(here) and not (at := copy / path.relative_to(here)).exists():
                at.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(path, at)
        real, of = recipe.parent.resolve(), lab.resolve()  # as `..` would lead out of the copy
        beside = copy / (real.relative_to(of) if real.is_relative_to(of) else "recipes")
        beside.mkdir(parents=True, exist_ok=True)
        copied = beside / recipe.name
        shutil.copy(recipe, copied)
        for place, value in changes:
            path = file_of(place, copied, copy)
            path.write_text(with_value(path.read_text(encoding="utf-8"), place, value), encoding="utf-8")
        for table in tables_named(copied.read_text(encoding="utf-8"), str(copied)):
            given, path = recipe.parent / str(table.text), beside / str(table.text)
            if given.is_file() and path.resolve().is_relative_to(copy.resolve()):
                path.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(given, path)
        try:
            yield copied, copy
        except SourceError as error:
            originals = ((beside, recipe.parent), (copy, lab))
            raise SourceError([_of_original(problem, originals, changes) for problem in error.problems]) from None


def _of_original(problem: Problem, originals: Iterable[tuple[Path, Path]], changes: Changes) -> Problem:
    """A problem in a copy, rewritten to name the original file and the changes."""
    file, message = problem.mark.file, problem.message
    for at, of in originals:
        file, message = (text.replace(f"{at}/", f"{of}/") for text in (file, message))
    where = ", ".join(f"{place}: {value}" for place, value in changes)
    return replace(problem, mark=replace(problem.mark, file=file), message=f"{message} (with {where})")


def with_value(text: str, place: str, value: Value) -> str:
    """A file's text with another value at a place (`FILE.KEY.KEY`). Everything else keeps its exact text.

    Raises SourceError for a place that does not exist, or that cannot be changed by itself.
    """
    node: Any = yaml.compose(text, yaml.BaseLoader)
    keys = place[place.index(".") :]
    while keys:
        key, node = _below(node, keys[1:], place)
        keys = keys[1 + len(key) :]
        if text.startswith("&", node.start_mark.index):  # an alias is composed to its anchor's node, too
            raise _refused(
                place, f"'{key}' has an anchor (&), and would change wherever its alias (*) is; write it out"
            )
    is_block = node.style in ("|", ">") if isinstance(node, yaml.ScalarNode) else not node.flow_style
    if is_block:  # its end mark is where the next node begins
        raise _refused(place, "it has several lines; name a value in it, or write it in one line")
    if node.start_mark.index == node.end_mark.index:
        raise _refused(place, "it has no value; write one, which is then varied")
    new = str(value)
    if not re.fullmatch(r"-?[\w.+/^°][\w.+/^° -]*", new):  # "- 5" would be a list
        new = json.dumps(new, ensure_ascii=False)
    return text[: node.start_mark.index] + new + text[node.end_mark.index :]


def _below(node: Any, keys: str, place: str) -> tuple[str, Any]:
    """The first of `keys`, and what it names: the longest that is there, as failure codes have dots."""
    if isinstance(node, yaml.MappingNode):
        found = {name.value: child for name, child in node.value}
    else:
        children = node.value if isinstance(node, yaml.SequenceNode) else ()
        found = {str(number): child for number, child in enumerate(children)}
    fit = [key for key in found if f"{keys}.".startswith(f"{key}.")]
    if not fit:
        raise _no_such(place, list(found), keys.partition(".")[0])
    return (key := max(fit, key=len)), found[key]


def _no_such(place: str, known: list[str], key: str = "") -> SourceError:
    what = f"'{key}' is not there" if key else "a place begins with its file"
    return _refused(place, f"{what}; known: {', '.join(known) or 'nothing'}")


def _refused(place: str, what: str) -> SourceError:
    return SourceError([Problem(Mark(place, 0), what)])


def file_of(place: str, recipe: Path, lab: Path) -> Path:
    """The file that a place is in. Raises SourceError if it does not begin with a file."""
    file, _, keys = place.partition(".")
    path = recipe if file == "recipe" else lab / FILES.get(file, "")
    if not path.is_file() or not keys:
        raise _no_such(place, ["recipe", *FILES])
    return path
