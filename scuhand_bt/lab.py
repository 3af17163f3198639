"""A lab: the folder with `robot/`, `skills/`, `trees/` and `recipes/` that a user edits; found and loaded."""

import hashlib
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from scuhand_bt.bench_files import check_slots, load_cell, load_entries, load_vessels, place_in_cell
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.problems import Broken, Mark, Problem, Problems, SourceError
from scuhand_bt.skill_files.load import load_skills
from scuhand_bt.specs import Mortar, Powder
from scuhand_bt.tree.grammar import KEYWORDS, RECORD, read_workflow
from scuhand_bt.tree.library import Library
from scuhand_bt.tree.record import Record
from scuhand_bt.tree.workflow import Workflow
from scuhand_bt.yaml_source import load, read_text

if TYPE_CHECKING:
    from scuhand_bt.motion import MotionPlanner, Mount

CELL_FILE = Path("robot") / "cell.yaml"
STATE = ".scuhand"
LAB_FOLDERS = ("robot", "skills", "trees")
TEST_SUFFIX = ".test.yaml"
"""Of the files beside workflows that say how they are tested."""


@dataclass(frozen=True)
class Lab:
    """A loaded lab. `library` is all that workflows can name; workflows are read, and checked when used."""

    folder: Path
    cell: CellSpec
    library: Library
    problems: tuple[Problem, ...] = ()
    """What is wrong in its files; each breaks only what uses it."""
    has_cell: bool = True
    """False where the cell's own file is wrong: `cell` is then of its sound parts, to check against, not to run on."""
    files: Mapping[str, str] = field(default_factory=dict)
    """`lab_files` as they were read: somebody may edit them before a run of this lab begins."""

    @property
    def urdf(self) -> str:
        """The text of the arm's URDF; SourceError if the file is missing."""
        return read_text(self._urdf_path, "the arm's URDF")

    @property
    def _urdf_path(self) -> Path:
        return self.folder / "robot" / self.cell.arm.urdf

    def motion_planner(self, mortars: Mapping[str, Mortar], plans: Path | None = None) -> "MotionPlanner":
        """A motion planner of this cell, its plans kept in the folder `plans` if one is given.

        SourceError where the URDF or the geometry is not this arm's.
        """
        from scuhand_bt.motion import MotionPlanner
        from scuhand_bt.motion.arm_model import MismatchedCellError

        try:
            return MotionPlanner(self.urdf, self.cell, mortars, plans)
        except MismatchedCellError as error:
            problems = Problems()
            where = place_in_cell(self.folder / CELL_FILE, "arm", error.key)
            problems.add(where, str(error), unknown=error.unknown, known=error.known, code="bad-value")
            raise SourceError(problems.found) from None
        except ValueError as error:
            raise SourceError([Problem(Mark(str(self._urdf_path)), str(error))]) from None


def read_mount(lab: Lab) -> "Mount":
    """How the lab's hand holds the cone that loads are carried in, and what arm holds the hand.

    SourceError where the URDF of an arm other than the CRANE-X7 is not what the cell says.
    """
    from scuhand_bt.motion import Mount

    if lab.cell.arm.kinematics == "crane_x7":
        return Mount.of(lab.cell.hand)
    return lab.motion_planner({}).mount()


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
            problems.add(
                Mark(str(chosen)),
                "is not a lab",
                f"a lab has {CELL_FILE}; `scuhand-bt init DIR` makes one",
                code="no-lab",
            )
            problems.raise_any()
        return chosen
    start = (recipe.parent if recipe is not None else Path()).resolve()
    for folder in (start, *start.parents):
        if is_lab(folder):
            return folder
    return starter_lab()


def files_of(folder: Path, pattern: str) -> list[Path]:
    """The files of a lab's folder, in order; not what an editor leaves beside them (`x~`, `#x#`, `.x.swp`, `.#x`).

    SourceError for a folder that is not ours to read, in which `glob` finds nothing.
    """
    if folder.is_dir() and not os.access(folder, os.R_OK | os.X_OK):
        raise SourceError([Problem(Mark(str(folder)), "cannot be read: Permission denied", "unreadable")])
    found = folder.glob(pattern)
    return sorted(path for path in found if not (path.name.startswith((".", "#")) or path.name.endswith("~")))


def lab_files(folder: Path) -> dict[str, str]:
    """SHA-256 of every file in a lab's folder that a run depends on, besides its recipe; "" of one not to be read."""
    files: dict[str, str] = {}
    for part in LAB_FOLDERS:
        for path in files_of(folder / part, "**/*"):
            if path.is_file() and "__pycache__" not in path.parts and not path.name.endswith(TEST_SUFFIX):
                name = path.relative_to(folder).as_posix()
                files[name] = ""
                with suppress(OSError):  # whoever needs it says so
                    files[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return files


def is_lab(folder: Path) -> bool:
    """Whether a folder is a lab."""
    try:
        return (folder / CELL_FILE).is_file()
    except PermissionError:  # `robot` is not ours to read, as whoever reads it says; no other lab is taken in its place
        return os.access(folder, os.X_OK)
    except OSError:  # a name that cannot be
        return False


def load_lab(folder: Path) -> Lab:
    """Load a lab's cell, powders, containers, skills and workflows.

    What is wrong in a file breaks only what uses it, and stands in the lab's `problems`. Raises SourceError with
    everything that is wrong where the cell's own file is, as nothing can do without it.
    """
    return with_cell(read_lab(folder))


def read_lab(folder: Path) -> Lab:
    """As `load_lab`; without a sound cell, one of what of it is sound, to check the rest against."""
    problems, broken, as_read = Problems(), Broken(), lab_files(folder)
    cell, library, has_cell = _read_bench(folder, problems, broken)
    files = files_of(folder / "skills", "*.py")
    loaded = load_skills(folder, files, cell.device_names, problems, broken, starter_lab())
    library.skills, library.facts, library.taken_there = loaded.skills, loaded.facts, loaded.taken_there
    library.workflows = _load_workflows(folder / "trees", problems, broken)
    _check_names(library, folder, problems)
    library.skills = {**library.skills, RECORD: Record}
    return Lab(folder, cell, library, tuple(problems.found), has_cell, as_read)


def load_bench(folder: Path) -> Lab:
    """A lab's cell, powders and vessels alone: none of its skills is imported, and none of its workflows read.

    Raises SourceError as `load_lab` does.
    """
    problems = Problems()
    cell, library, has_cell = _read_bench(folder, problems, Broken())
    return with_cell(Lab(folder, cell, library, tuple(problems.found), has_cell))


def with_cell(lab: Lab) -> Lab:
    """The lab, where its cell's own file is sound. SourceError with all that is wrong where it is not."""
    if not lab.has_cell:
        raise SourceError([problem for problem in lab.problems if not problem.is_warning])
    return lab


def _read_bench(folder: Path, problems: Problems, broken: Broken) -> tuple[CellSpec, Library, bool]:
    """The cell, what stands in it and is used in it, and whether the cell's own file is sound."""
    cell = load_cell(folder / CELL_FILE, problems, broken)
    has_cell = not problems.errors
    powders = load_entries(Powder, folder / "robot" / "powders.yaml", problems, broken, "powder")
    containers, mortars = load_vessels(folder / "robot" / "containers.yaml", problems, broken)
    check_slots(folder / CELL_FILE, cell, containers, problems, broken)
    return cell, Library({}, {}, powders, containers, mortars, zones=cell.zone_names, broken=broken), has_cell


def _load_workflows(folder: Path, problems: Problems, broken: Broken) -> dict[str, Workflow]:
    workflows: dict[str, Workflow] = {}
    for path in files_of(folder, "*.yaml"):
        if path.name.endswith(TEST_SUFFIX):
            continue
        of_file = Problems()
        try:
            workflow = read_workflow(load(path, "a workflow"), path.stem, of_file)
        except SourceError as error:
            of_file.found += error.problems
            workflow = None
        if workflow is not None:
            workflows[path.stem] = workflow
        if of_file.errors:
            broken.add("workflow", path.stem, of_file.errors)
        problems.found += of_file.found
    return workflows


def kept_by_changing(lab: Lab) -> dict[str, tuple[str, ...]]:
    """The zones of the cell that each skill leases which commands the changer, by its name."""
    skills = {name: skill for name, skill in lab.library.skills.items() if "changer" in skill.devices}
    known = lab.cell.zone_names
    return {name: tuple(sorted({*skill.zones}.intersection(known))) for name, skill in skills.items()}


def cell_mark(lab: Lab, *keys: str) -> Mark:
    """Where a value of the cell's file stands; for one that it leaves out, what would hold it."""
    return place_in_cell(lab.folder / CELL_FILE, *keys)


def without_driver(lab: Lab) -> list[Problem]:
    """What the cell's file names and only a simulation has, located; a run on the real cell is refused with it."""
    if lab.cell.changer.driver == "operator" or lab.cell.changer.port:
        return []
    problems = Problems()
    what = f"the changer '{lab.cell.changer.driver}' has no port, so it exists only in dry runs and rehearsals"
    problems.add(
        cell_mark(lab, "changer", "driver"),
        what,
        "name its `port`, or write `changer: {driver: operator}` if a person changes containers",
        code="no-driver",
    )
    return problems.found


def _check_names(library: Library, folder: Path, problems: Problems) -> None:
    """A word of the language, and a skill, are what is meant by a name that a workflow has, too."""
    for name in library.skills:
        if name in (*KEYWORDS, RECORD):
            mark = Mark(str(folder / "skills" / f"{name}.py"))
            problems.add(mark, f"'{name}' is a word of the workflow language", code="name-taken")
    for name, workflow in list(library.workflows.items()):
        if name in (*KEYWORDS, RECORD):
            problems.add(workflow.mark, f"'{name}' is a word of the workflow language", code="name-taken")
        if name in library.skills:
            what = f"'{name}' is already a skill"
            problems.add(workflow.mark, what, "give the workflow another name", code="name-taken")
