"""A lab: the folder with `robot/`, `skills/`, `trees/` and `recipes/` that a user edits; found and loaded.

A lab's skills are imported under one constant package name, `scuhand_lab`, whose `__path__` is the lab.
"""

import ast
import importlib
import inspect
import os
import sys
import traceback
import types
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from scuhand_bt.cell_spec import CellSpec, Station
from scuhand_bt.failures import CATALOGUE, Code, Failure, SkillFailed
from scuhand_bt.problems import Mark, Problem, Problems, SourceError, shorten
from scuhand_bt.skill import DEVICES, Condition, Skill
from scuhand_bt.specs import ContainerKind, Mortar, Powder, Spec
from scuhand_bt.tree.check import Library, check_workflows
from scuhand_bt.tree.grammar import KEYWORDS, Call, Workflow, read_workflow, walk
from scuhand_bt.validation import validate
from scuhand_bt.yaml_source import Entries, Node, describe, load, read_text

if TYPE_CHECKING:
    from scuhand_bt.motion import MotionPlanner

S = TypeVar("S", bound=Spec)

PACKAGE = "scuhand_lab"
CELL_FILE = Path("robot") / "cell.yaml"
STATE = ".scuhand"


@dataclass(frozen=True)
class Lab:
    """A loaded lab. `library` is all that workflows can name; workflows are read, and checked when used."""

    folder: Path
    cell: CellSpec
    library: Library

    @property
    def urdf(self) -> str:
        """The text of the arm's URDF; SourceError if the file is missing."""
        return read_text(self._urdf_path, "the arm's URDF")

    @property
    def _urdf_path(self) -> Path:
        return self.folder / "robot" / self.cell.arm.urdf

    def motion_planner(self, mortars: Mapping[str, Mortar]) -> "MotionPlanner":
        """A motion planner of this cell; SourceError where the URDF or the geometry is not this arm's."""
        from scuhand_bt.motion import MotionPlanner

        try:
            return MotionPlanner(self.urdf, self.cell, mortars)
        except ValueError as error:
            raise SourceError([Problem(Mark(str(self._urdf_path)), str(error))]) from None


def starter_lab() -> Path:
    """The lab that comes with scuhand_bt: in the wheel, or the repository that this is a checkout of."""
    package = Path(__file__).parent
    packed = package / "starter_lab"
    return packed if packed.is_dir() else package.parent


def state_folder(lab: Lab) -> Path:
    """Where journals, the inventory and what is learnt go: the lab's `.scuhand`.

    The working folder's for the packed starter lab, and for one that cannot be written.
    """
    return _state_of(lab.folder)


def _state_of(folder: Path) -> Path:
    packed = folder == starter_lab() and folder.name == "starter_lab"
    home = Path.cwd() if packed or not os.access(folder, os.W_OK) else folder
    return home / STATE


def find_state(chosen: Path | None = None) -> Path:
    """Where a lab's journals are, to look at or to stop a run: nothing of the lab is read, which may be broken or gone.

    Raises SourceError if the chosen folder is no lab and was none.
    """
    here = Path().resolve()
    for folder in (here, *here.parents) if chosen is None else (chosen,):
        if (folder / STATE).is_dir():
            return folder / STATE
        if is_lab(folder):
            break
    return _state_of(find_lab(None, chosen))


def find_lab(recipe: Path | None = None, chosen: Path | None = None) -> Path:
    """The lab to use: the chosen one, else the nearest folder upward from the recipe, else the starter lab.

    Raises SourceError if the chosen folder is no lab.
    """
    if chosen is not None:
        if not is_lab(chosen):
            problems = Problems()
            problems.add(Mark(str(chosen)), "is no lab", f"a lab has {CELL_FILE}; `scuhand-bt init DIR` makes one")
            problems.raise_any()
        return chosen
    start = (recipe.parent if recipe is not None else Path()).resolve()
    for folder in (start, *start.parents):
        if is_lab(folder):
            return folder
    return starter_lab()


def files_of(folder: Path, pattern: str) -> list[Path]:
    """The files of a lab's folder, in order; not what an editor leaves beside them (`x~`, `#x#`, `.x.swp`, `.#x`)."""
    found = folder.glob(pattern)
    return sorted(path for path in found if not (path.name.startswith((".", "#")) or path.name.endswith("~")))


def is_lab(folder: Path) -> bool:
    """Whether a folder is a lab."""
    try:
        return (folder / CELL_FILE).is_file()
    except OSError:  # not ours to read, or a name that cannot be
        return False


def load_lab(folder: Path) -> Lab:
    """Load a lab's cell, powders, containers, skills and workflows.

    Raises SourceError with everything that is wrong in any of its files.
    """
    problems = Problems()
    cell = _load_cell(folder / CELL_FILE, problems)
    powders = _load_named(Powder, _root(folder / "robot" / "powders.yaml", problems), problems)
    containers: dict[str, ContainerKind] = {}
    mortars: dict[str, Mortar] = {}
    if (vessels := _root(folder / "robot" / "containers.yaml", problems)) is not None:
        kinds = ("containers", "mortars")
        for key, mark in vessels.keys.items():
            if key not in kinds:
                problems.add(mark, f"unknown key '{shorten(key)}'", unknown=key, known=kinds)
        for key in kinds:
            if key not in vessels.keys:
                problems.add(vessels.mark, f"'{key}' is missing", "name: {…}, as in the starter lab")
        containers = _load_named(ContainerKind, vessels.get("containers"), problems)
        mortars = _load_named(Mortar, vessels.get("mortars"), problems)
    if cell is not None:
        _check_balance_driver(cell, folder, problems)
    library = Library(_load_skills(folder, problems), {}, powders, containers, mortars)
    is_sound = not problems.found
    library.workflows = _load_workflows(folder / "trees", problems)
    if is_sound:
        _check_what_was_read(library, folder, problems)
    _check_names(library, folder, problems)
    _check_codes(library, folder, problems)
    problems.raise_any()
    assert cell is not None
    return Lab(folder, cell, library)


def _check_balance_driver(cell: CellSpec, folder: Path, problems: Problems) -> None:
    """A balance of somebody else's package is met before anything moves; its module may be the lab's."""
    if ":" not in cell.balance.driver:
        return
    from scuhand_bt.devices.balances import dialect_of
    from scuhand_bt.devices.plugged import NotPluggable

    if str(folder) not in sys.path:
        sys.path.append(str(folder))  # last, so that it hides nothing
    try:
        dialect_of(cell.balance.driver)
    except NotPluggable as error:
        problems.add(_mark_of(folder, "balance", "driver"), f"driver {error}")


def _root(path: Path, problems: Problems) -> Entries | None:
    try:
        node = load(path, f"the lab's {path.name}")
    except SourceError as error:
        problems.found.extend(error.problems)
        return None
    if isinstance(node, Entries):
        return node
    problems.add(node.mark, f"{describe(node)} stands where a mapping (name: …) should be")
    return None


def _load_named(model: type[S], node: Node | None, problems: Problems) -> dict[str, S]:
    """Entries whose key is their name."""
    if node is None:
        return {}
    if not isinstance(node, Entries):
        problems.add(node.mark, f"{describe(node)} stands where a mapping (name: …) should be")
        return {}
    found = {name: validate(model, value, problems, name=name) for name, value in node.values.items()}
    return {name: spec for name, spec in found.items() if spec is not None}


def _load_cell(path: Path, problems: Problems) -> CellSpec | None:
    root = _root(path, problems)
    if root is None:
        return None
    found_before = len(problems.found)
    stations = _load_named(Station, root.get("stations"), problems)
    is_complete = len(problems.found) == found_before
    cell = validate(CellSpec, root.without("stations"), problems, stations=stations)
    for kind in ("balance", "waste", "park"):
        if is_complete and not any(station.kind == kind for station in stations.values()):
            problems.add(
                root.mark, f"the cell has no station of kind '{kind}'", "it needs a balance, a waste and a park"
            )
    return cell


def _load_skills(folder: Path, problems: Problems) -> dict[str, type[Skill[Any]]]:
    _mount(folder)
    skills: dict[str, type[Skill[Any]]] = {}
    for path in files_of(folder / "skills", "*.py"):
        if path.stem.startswith("_"):
            continue
        module_name = f"{PACKAGE}.skills.{path.stem}"
        try:
            module = importlib.import_module(module_name)
        except (Exception, SystemExit) as error:  # a lab's file may fail in any way; the user is told where
            problems.add(_where(error, path), f"the skill cannot be loaded: {type(error).__name__}: {error}")
            continue
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
            problems.add(Mark(str(path)), f"a skill's file holds one Skill class; here: {names}")
        else:
            _check_skill(found[0], Mark(str(path), inspect.findsource(found[0])[1] + 1), problems)
            skills[path.stem] = found[0]
    return skills


def _check_skill(skill: type[Skill[Any]], mark: Mark, problems: Problems) -> None:
    """What Python does not check of a skill's class, and would otherwise come up in the middle of a run."""
    name = skill.__name__
    if not skill.__doc__:
        problems.add(mark, f"{name} has no docstring", "one line that says what it is for")
    if inspect.isabstract(skill):
        missing = ", ".join(sorted(skill.__abstractmethods__))
        problems.add(mark, f"{name} has no '{missing}'", f"def {missing}(self, cell: Cell)")
    for code, failure in skill.failures.items() if isinstance(skill.failures, Mapping) else [("", None)]:
        if not isinstance(failure, Failure):
            problems.add(mark, f"'failures' of {name} is wrong", 'failures = {"device.what": Failure(meaning, remedy)}')
        elif code in CATALOGUE:
            problems.add(mark, f"'failures' of {name} has '{code}', which the catalogue has already", "name another")
    for code in skill.raises if isinstance(skill.raises, tuple) else (None,):
        if code not in CATALOGUE and code not in skill.failures:
            what = f"'raises' of {name} is wrong: {shorten(str(code))} is no code of the catalogue or of 'failures'"
            problems.add(mark, what, "raises = (Code.HAND_CONE_EMPTY,), with the comma")
    listed = {"devices": skill.devices}
    if issubclass(skill, Condition):
        listed["watches"] = skill.watches
        if skill.devices:
            problems.add(mark, f"{name} is a condition and commands nothing, but has devices", "use 'watches'")
    for key, devices in listed.items():
        if not isinstance(devices, tuple):
            problems.add(mark, f"'{key}' of {name} is no tuple", f'{key} = ("hand",), with the comma')
            continue
        for device in devices:
            if device not in DEVICES:
                what = f"'{key}' of {name} names an unknown device '{shorten(str(device))}'"
                problems.add(mark, what, unknown=str(device), known=DEVICES)


def _raised_codes(path: Path) -> dict[str, Mark]:
    """The failure codes that a lab's file raises, and where; those put together at run time are not seen.

    `Code.X` that there is not stands as it is written.
    """
    codes: dict[str, Mark] = {}
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8-sig"))):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == SkillFailed.__name__:
            code = node.args[0] if node.args else None
            if isinstance(code, ast.Constant) and isinstance(code.value, str):
                codes.setdefault(code.value, Mark(str(path), code.lineno, code.col_offset + 1))
            elif isinstance(code, ast.Attribute) and ast.unparse(code.value) == Code.__name__:
                name = Code.__members__.get(code.attr, ast.unparse(code))
                codes.setdefault(name, Mark(str(path), code.lineno, code.col_offset + 1))
    return codes


def _check_codes(library: Library, folder: Path, problems: Problems) -> None:
    """A skill may fail with what the catalogue or its own `failures` has, and with nothing else."""
    for name, skill in library.skills.items():
        for code, mark in _raised_codes(folder / "skills" / f"{name}.py").items():
            if code not in CATALOGUE and code not in skill.failures:
                what = f"'{shorten(code)}' is no failure code of the catalogue, nor of this skill's own 'failures'"
                hint = "`scuhand-bt explain` lists the catalogue; a code of its own stands in the skill's 'failures'"
                problems.add(mark, what, hint, unknown=code, known=[*CATALOGUE, *skill.failures])


def _mount(folder: Path) -> None:
    """Make `scuhand_lab` this folder, forgetting any other lab's modules."""
    home = str(folder.absolute())
    package = sys.modules.get(PACKAGE)
    if package is not None and list(package.__path__) == [home]:
        return
    for name in [name for name in sys.modules if name == PACKAGE or name.startswith(PACKAGE + ".")]:
        del sys.modules[name]
    package = types.ModuleType(PACKAGE)
    package.__path__ = [home]
    sys.modules[PACKAGE] = package
    importlib.invalidate_caches()


def _where(error: BaseException, path: Path) -> Mark:
    """The line of the lab's file that an import failed at."""
    file = str(path.absolute())
    if isinstance(error, SyntaxError) and error.filename == file:
        return Mark(str(path), error.lineno or 1, error.offset or 1)
    lines = [frame.lineno or 1 for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    return Mark(str(path), lines[-1] if lines else 1)


def _load_workflows(folder: Path, problems: Problems) -> dict[str, Workflow]:
    workflows: dict[str, Workflow] = {}
    for path in files_of(folder, "*.yaml"):
        try:
            root = load(path, "a workflow")
        except SourceError as error:
            problems.found.extend(error.problems)
            continue
        workflow = read_workflow(root, path.stem, problems)
        if workflow is not None:
            workflows[path.stem] = workflow
    return workflows


def cell_mark(lab: Lab, *keys: str) -> Mark:
    """Where a value of the cell's file stands; for one that it leaves out, what would hold it."""
    return _mark_of(lab.folder, *keys)


def _mark_of(folder: Path, *keys: str) -> Mark:
    node = load(folder / CELL_FILE, "the lab's cell.yaml")
    for key in keys:
        node = (node.get(key) if isinstance(node, Entries) else None) or node
    return node.mark


def without_driver(lab: Lab) -> list[Problem]:
    """What the cell's file names and only a simulation has, located; a run on the real cell is refused with it."""
    if lab.cell.changer.driver == "operator":
        return []
    problems = Problems()
    what = f"the changer '{lab.cell.changer.driver}' has no driver yet, it is there in dry runs and rehearsals only"
    problems.add(
        cell_mark(lab, "changer", "driver"),
        what,
        "for the real cell write `changer: {driver: operator}`: a person changes containers",
    )
    return problems.found


def _check_what_was_read(library: Library, folder: Path, problems: Problems) -> None:
    """The wires of workflows whose files are wrong: all that is wrong with a file is told at once.

    Those that call one that is wrong are left out, as the mistake may be the other's.
    """
    workflows = library.workflows
    calls = {
        name: {part.name for part in walk(workflow.tree) if isinstance(part, Call)}
        for name, workflow in workflows.items()
    }
    wrong = {path.stem for path in files_of(folder / "trees", "*.yaml")}
    wrong -= {name for name, workflow in workflows.items() if workflow.is_whole}
    doubtful = set(wrong)
    while more := {name for name in calls if name not in doubtful and calls[name] & doubtful}:
        doubtful |= more
    check_workflows(library, sorted(name for name in wrong & set(calls) if not calls[name] & doubtful), problems)


def _check_names(library: Library, folder: Path, problems: Problems) -> None:
    for name in library.skills:
        if name in KEYWORDS:
            problems.add(Mark(str(folder / "skills" / f"{name}.py")), f"'{name}' is a word of the workflow language")
    for name, workflow in library.workflows.items():
        if name in KEYWORDS:
            problems.add(workflow.mark, f"'{name}' is a word of the workflow language")
        if name in library.skills:
            problems.add(workflow.mark, f"'{name}' is a skill already", "give the workflow another name")
