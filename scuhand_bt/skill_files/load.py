"""A lab's skills, imported from its files under one constant package name, `scuhand_lab`, whose `__path__` is the lab.

A file that is wrong takes its own skill away and no other.
"""

import ast
import hashlib
import importlib
import importlib.util
import inspect
import sys
import traceback
import types
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from scuhand_bt.failures import CATALOGUE, Failure
from scuhand_bt.problems import Broken, Mark, Problem, Problems, shorten
from scuhand_bt.skill import Condition, Skill
from scuhand_bt.skill_files.facts import SkillFacts, Syntax, facts_of, parsed, raised_codes
from scuhand_bt.skill_files.source_check import check_shared, check_source
from scuhand_bt.skill_files.versions import taken_there, with_remedy

PACKAGE = "scuhand_lab"
_Text = tuple[str, bytes | None, frozenset[tuple[str, bytes | None]], frozenset[str]]
"""A skill's name, its file and those that skills share as hashes, and the devices of the cell."""
SOUND_KEPT = 256
_SOUND: dict[_Text, SkillFacts] = {}
"""Skills in which nothing was found: looking takes longer than all else of loading a lab, and programs load labs again
and again."""


@dataclass
class LoadedSkills:
    """The skills that can be used, and what their files say of them."""

    skills: dict[str, type[Skill[Any]]] = field(default_factory=dict)
    facts: dict[str, SkillFacts] = field(default_factory=dict)
    taken_there: dict[str, frozenset[str]] = field(default_factory=dict)
    """What the starter lab's skills of these names take, where they are others."""


def load_skills(
    folder: Path, paths: list[Path], devices: Collection[str], problems: Problems, broken: Broken, starter: Path
) -> LoadedSkills:
    """Import the skills of a lab's folder from these files; what is wrong with one is noted, and the skill `broken`.

    `devices` are those of the lab's cell, by the names that skills lease them under; `starter` is the starter lab.
    """
    files = _files_read(folder)
    _mount(folder, files)
    loaded, shared = LoadedSkills(), _Shared([path for path in paths if path.stem.startswith("_")])
    of_shared = frozenset((path.name, files.get(path)) for path in shared.paths)
    for path in (path for path in paths if not path.stem.startswith("_")):
        text = path.stem, files.get(path), of_shared, frozenset(devices)
        of_file = Problems()
        skill, facts = _load(path, of_file), _SOUND.get(text)
        if skill is not None and facts is None:
            facts, stands_alone = _looked_through(skill, path, devices, shared, of_file)
            if facts is not None and not of_file.found and shared.stands_alone and stands_alone:
                _keep_sound(text, facts)
        if facts is not None:
            loaded.facts[path.stem] = facts
        if of_file.found:
            beside = shared.imported_by(path)
            of_file.found = [with_remedy(one, path, beside, starter) for one in of_file.found]
        problems.found += of_file.found
        if of_file.errors or skill is None:
            broken.add("skill", path.stem, of_file.errors)
        else:
            loaded.skills[path.stem] = skill
            loaded.taken_there[path.stem] = taken_there(path, starter)
    return loaded


class _Shared:
    """The files that a lab's skills share, read when they are asked for."""

    def __init__(self, paths: list[Path]) -> None:
        self.paths = paths
        self._problems: dict[str, list[Problem]] = {}

    @cached_property
    def codes(self) -> set[str]:
        """What they raise."""
        return {code for syntax in self._read.values() for code in raised_codes(syntax, "")}

    @cached_property
    def stands_alone(self) -> bool:
        return all(map(_stands_alone, self._read.values()))

    def problems_of(self, name: str) -> list[Problem]:
        """What is wrong with one, once a skill has imported it."""
        module, syntax = sys.modules.get(f"{PACKAGE}.skills.{name}"), self._read.get(name)
        if module is None or syntax is None:
            return []
        if name not in self._problems:
            path = next(path for path in self.paths if path.stem == name)
            self._problems[name] = check_shared(syntax, module, str(path)).found
        return self._problems[name]

    def imported_by(self, skill: Path) -> list[Path]:
        """Those that a skill imports from, or one of these does."""
        found, waiting = list[Path](), [skill]
        while waiting:
            with suppress(SyntaxError, ValueError, OSError):
                names = set(_shared_by(parsed(waiting.pop())))
                more = [path for path in self.paths if path.stem in names and path not in found]
                found += more
                waiting += more
        return found

    @cached_property
    def _read(self) -> dict[str, Syntax]:
        found = {}
        for path in self.paths:
            with suppress(SyntaxError, ValueError, OSError):  # said of each skill that imports it
                found[path.stem] = parsed(path)
        return found


def _looked_through(
    skill: type[Skill[Any]],
    path: Path,
    devices: Collection[str],
    shared: _Shared,
    problems: Problems,
) -> tuple[SkillFacts | None, bool]:
    """What a skill's file says of it, and whether it stands alone; nothing of one whose class is wrong."""
    _check_class(skill, Mark(str(path), inspect.findsource(skill)[1] + 1), devices, problems)
    if problems.errors:
        return None, False
    syntax = parsed(path)
    problems.found += check_source(skill, syntax, sys.modules[f"{PACKAGE}.skills.{path.stem}"], str(path)).found
    _check_codes(skill, raised_codes(syntax, str(path)), problems)
    problems.found += [problem for name in _shared_by(syntax) for problem in shared.problems_of(name)]
    return facts_of(skill, syntax, shared.codes), _stands_alone(syntax)


def _stands_alone(syntax: Syntax) -> bool:
    """Whether a file has nothing of its lab but what is shared."""
    relative = [node for node in syntax.nodes if isinstance(node, ast.ImportFrom) and node.level]
    return all(node.level == 1 and (node.module or "").startswith("_") for node in relative)


def _keep_sound(text: _Text, facts: SkillFacts) -> None:
    _SOUND[text] = facts
    while len(_SOUND) > SOUND_KEPT:
        del _SOUND[next(iter(_SOUND))]


def _shared_by(syntax: Syntax) -> Iterator[str]:
    """The files beside it that a skill imports from."""
    for node in syntax.nodes:
        if isinstance(node, ast.ImportFrom) and node.level == 1 and node.module is not None:
            yield node.module


def _load(path: Path, problems: Problems) -> type[Skill[Any]] | None:
    module_name = f"{PACKAGE}.skills.{path.stem}"
    try:
        path.open("rb").close()  # one not to be read may still be imported, from what Python has compiled of it
        module = importlib.import_module(module_name)
    except (Exception, SystemExit) as error:  # a lab's file may fail in any way; the user is told where
        what = f"the skill cannot be loaded: {type(error).__name__}: {error}"
        problems.add(_where(error, path), what, code="skill-import")
        return None
    found = [
        value
        for value in vars(module).values()
        if isinstance(value, type)
        and issubclass(value, Skill)
        and value.__module__ == module_name
        and not value.__pydantic_generic_metadata__["args"]  # pydantic's own class for Skill[Dose]
    ]
    if len(found) != 1:
        names = ", ".join(cls.__name__ for cls in found) or "none"
        problems.add(
            Mark(str(path)),
            f"a skill's file must have exactly one Skill class; this one has: {names}",
            code="skill-class",
        )
        return None
    return found[0]


def _check_class(skill: type[Skill[Any]], mark: Mark, known: Collection[str], problems: Problems) -> None:
    """What Python does not check of a skill's class, and would otherwise come up in the middle of a run."""
    name = skill.__name__
    if not skill.__doc__:
        problems.add(
            mark, f"{name} has no docstring", "write one line that says what it is for", code="skill-docstring"
        )
    if inspect.isabstract(skill):
        missing = ", ".join(sorted(skill.__abstractmethods__))
        problems.add(mark, f"{name} has no '{missing}'", f"def {missing}(self, cell: Cell)", code="skill-class")
    for code, failure in skill.failures.items() if isinstance(skill.failures, Mapping) else [("", None)]:
        if not isinstance(failure, Failure):
            what, fix = f"'failures' of {name} is wrong", 'failures = {"device.what": Failure(meaning, remedy)}'
            problems.add(mark, what, fix, code="skill-failures")
        elif code in CATALOGUE:
            what = f"'failures' of {name} has '{code}', which is already in the catalogue"
            problems.add(mark, what, "name another", code="skill-failures")
    if not isinstance(skill.typical_s, int | float):
        what = f"'typical_s' of {name} is {skill.typical_s!r}, not a number of seconds"
        problems.add(mark, what, "typical_s = 4.0", code="skill-forecast")
    own = skill.failures if isinstance(skill.failures, Mapping) else {}
    for code in skill.raises if isinstance(skill.raises, tuple) else (None,):
        if code not in CATALOGUE and code not in own:
            what = f"'raises' of {name} is wrong: {shorten(str(code))} is neither in the catalogue nor in 'failures'"
            problems.add(mark, what, "raises = (Code.HAND_CONE_EMPTY,), with the comma", code="skill-failures")
    listed = {"devices": skill.devices}
    if issubclass(skill, Condition):
        listed["watches"] = skill.watches
        if skill.devices:
            what = f"{name} is a condition and commands nothing, but has devices"
            problems.add(mark, what, "use 'watches'", code="skill-devices")
    for key, devices in listed.items():
        if not isinstance(devices, tuple):
            what = f"'{key}' of {name} is not a tuple"
            problems.add(mark, what, f'{key} = ("hand",), with the comma', code="skill-devices")
            continue
        for device in devices:
            if device not in known:
                what = f"'{key}' of {name} names an unknown device '{shorten(str(device))}'"
                problems.add(mark, what, unknown=str(device), known=known, code="skill-devices")


def _check_codes(skill: type[Skill[Any]], codes: Mapping[str, Mark], problems: Problems) -> None:
    """A skill may fail with what the catalogue or its own `failures` has, and with nothing else."""
    for code, mark in codes.items():
        if code not in CATALOGUE and code not in skill.failures:
            what = (
                f"unknown failure code '{shorten(code)}': it is neither in the catalogue nor in this skill's 'failures'"
            )
            hint = "`scuhand-bt explain` lists the catalogue; add a code of your own to the skill's 'failures'"
            known = [*CATALOGUE, *skill.failures]
            problems.add(mark, what, hint, unknown=code, known=known, code="skill-failures")
        elif code not in skill.raises:
            what = f"it fails with {code}, which 'raises' does not name"
            problems.warn(mark, what, "add it to 'raises', which `explain` and the checks use", code="skill-raises")


def _files_read(folder: Path) -> dict[Path, bytes]:
    """What stands in the files that skills are imported from, as hashes; what cannot be read says so at its import."""
    found = {}
    for path in folder.glob("skills/*.py"):
        with suppress(OSError):
            found[path] = hashlib.sha256(path.read_bytes()).digest()
    return found


def _mount(folder: Path, files: Mapping[Path, bytes]) -> None:
    """Make `scuhand_lab` this folder, forgetting any other lab's modules, and this one's if a file has changed."""
    home = str(folder.absolute())
    package = sys.modules.get(PACKAGE)
    if package is not None and list(package.__path__) == [home]:
        before = vars(package)["files"]
        if before == files:
            return
        for path in (path for path in files if before.get(path) != files[path]):
            # Python tells a file that was written twice within a second by its size alone.
            Path(importlib.util.cache_from_source(str(path.absolute()))).unlink(missing_ok=True)
    for name in [name for name in sys.modules if name == PACKAGE or name.startswith(PACKAGE + ".")]:
        del sys.modules[name]
    package = types.ModuleType(PACKAGE)
    package.__path__ = [home]
    vars(package)["files"] = files
    sys.modules[PACKAGE] = package
    importlib.invalidate_caches()


def _where(error: BaseException, path: Path) -> Mark:
    """The line of the lab's file that an import failed at."""
    file = str(path.absolute())
    if isinstance(error, SyntaxError) and error.filename == file:
        return Mark(str(path), error.lineno or 1, error.offset or 1)
    lines = [frame.lineno or 1 for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    return Mark(str(path), lines[-1] if lines else 1)
