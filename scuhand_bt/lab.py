"""A lab: the folder with `robot/`, `skills/`, `trees/` and `recipes/` that a user edits; found and loaded."""

import hashlib
import math
import os
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from scuhand_bt.bench_spec import Station
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.device_sections import own_options
from scuhand_bt.problems import Broken, Mark, Problem, Problems, SourceError, shorten
from scuhand_bt.skill_files.load import load_skills
from scuhand_bt.specs import ContainerKind, Mortar, Powder, Spec
from scuhand_bt.tree.grammar import KEYWORDS, RECORD, read_workflow
from scuhand_bt.tree.library import Library
from scuhand_bt.tree.record import Record
from scuhand_bt.tree.workflow import Workflow
from scuhand_bt.validation import validate
from scuhand_bt.yaml_source import Entries, Items, Node, describe, load, read_text

if TYPE_CHECKING:
    from scuhand_bt.motion import MotionPlanner, Mount

S = TypeVar("S", bound=Spec)

CELL_FILE = Path("robot") / "cell.yaml"
STATE = ".scuhand"
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
            where = _mark_of(self.folder, "arm", error.key)
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
                Mark(str(chosen)), "is no lab", f"a lab has {CELL_FILE}; `scuhand-bt init DIR` makes one", code="no-lab"
            )
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

    What is wrong in a file breaks only what uses it, and stands in the lab's `problems`. Raises SourceError with
    everything that is wrong where the cell's own file is, as nothing can do without it.
    """
    return with_cell(read_lab(folder))


def read_lab(folder: Path) -> Lab:
    """As `load_lab`; without a sound cell, one of what of it is sound, to check the rest against."""
    problems, broken = Problems(), Broken()
    cell, library, has_cell = _read_bench(folder, problems, broken)
    loaded = load_skills(folder, files_of(folder / "skills", "*.py"), cell.device_names, problems, broken)
    library.skills, library.facts = loaded.skills, loaded.facts
    library.workflows = _load_workflows(folder / "trees", problems, broken)
    _check_names(library, folder, problems)
    library.skills = {**library.skills, RECORD: Record}
    return Lab(folder, cell, library, tuple(problems.found), has_cell)


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
    cell = _load_cell(folder / CELL_FILE, problems, broken)
    has_cell = not problems.errors
    powders = _load_file(Powder, folder / "robot" / "powders.yaml", problems, broken, "powder")
    containers, mortars = _load_vessels(folder / "robot" / "containers.yaml", problems, broken)
    _check_slots(folder, cell, containers, problems, broken)
    return cell, Library({}, {}, powders, containers, mortars, zones=cell.zone_names, broken=broken), has_cell


def _check_slots(folder: Path, cell: CellSpec, containers: Collection[str], problems: Problems, broken: Broken) -> None:
    """The kinds that the changer has slots for are the lab's."""
    for kind in cell.changer.kinds:
        if kind not in containers and not broken.of("container", kind):
            problems.add(
                _mark_of(folder, "changer", "slots", kind),
                f"the changer has slots for the unknown container '{kind}'",
                unknown=kind,
                known=containers,
                code="unknown-name",
            )


def _root(path: Path, problems: Problems) -> Entries | None:
    try:
        node = load(path, f"the lab's {path.name}")
    except SourceError as error:
        problems.found.extend(error.problems)
        return None
    if isinstance(node, Entries):
        return node
    problems.add(node.mark, f"{describe(node)} stands where a mapping (name: …) should be", code="wrong-shape")
    return None


def _load_file(
    model: type[S], path: Path, problems: Problems, broken: Broken, kind: str, node: Node | None = None
) -> dict[str, S]:
    """The entries of a file, or of a part of one, whose keys are their names; what is wrong is told and `broken`."""
    before = len(problems.found)
    node = node or _root(path, problems)
    if node is None or not isinstance(node, Entries):
        if node is not None:
            what = f"{describe(node)} stands where a mapping (name: …) should be"
            problems.add(node.mark, what, code="wrong-shape")
        broken.add(kind, "", problems.found[before:])
        return {}
    found: dict[str, S] = {}
    for name, value in node.values.items():
        of_entry = Problems()
        spec = validate(model, value, of_entry, name=name)
        problems.found += of_entry.found
        if spec is not None:
            found[name] = spec
        else:
            broken.add(kind, name, of_entry.found)
    return found


def _load_vessels(path: Path, problems: Problems, broken: Broken) -> tuple[dict[str, ContainerKind], dict[str, Mortar]]:
    kinds = {"containers": "container", "mortars": "mortar"}
    before = len(problems.found)
    vessels = _root(path, problems)
    if vessels is not None:
        for key, mark in vessels.keys.items():
            if key not in kinds:
                problems.add(mark, f"unknown key '{shorten(key)}'", unknown=key, known=kinds, code="unknown-key")
        for key in kinds:
            if key not in vessels.keys:
                problems.add(
                    vessels.mark, f"'{key}' is missing", "name: {…}, as in the starter lab", code="missing-key"
                )
    of_file = problems.found[before:]
    nodes = {key: vessels.get(key) if vessels is not None else None for key in kinds}
    for key, kind in kinds.items():
        if nodes[key] is None:
            broken.add(kind, "", of_file)
    containers, mortars = (nodes[key] for key in kinds)
    found = {} if containers is None else _load_file(ContainerKind, path, problems, broken, "container", containers)
    for name, container in found.items():
        _check_size(container, containers, name, problems)
    bowls = {} if mortars is None else _load_file(Mortar, path, problems, broken, "mortar", mortars)
    for name, mortar in bowls.items():
        if mortar.bore_mm >= mortar.outer_diameter_mm:
            what = (
                f"the bore of '{name}', {mortar.bore_mm:g} mm, is as wide as all of it, {mortar.outer_diameter_mm:g} mm"
            )
            problems.warn(
                _mark_in(mortars, name, "bore"), what, "correct the bore or the outer diameter", code="implausible-size"
            )
    return found, bowls


ROOMY = 20.0
"""No vessel holds so many times what a tube of its mouth and height would, nor a tube so many times what it holds that
this is `NARROW` of it: a slip of units does."""
NARROW = 0.01


def _check_size(container: ContainerKind, node: Node | None, name: str, problems: Problems) -> None:
    tube_mm3 = math.pi / 4 * container.mouth_mm**2 * container.height_mm
    if not NARROW * tube_mm3 <= container.capacity_mm3 <= ROOMY * tube_mm3:
        mark = _mark_in(node, name, "capacity")
        what = f"'{name}' holds {container.capacity_mm3 / 1000:g} cm³, with a mouth of {container.mouth_mm:g} mm and "
        what += f"a height of {container.height_mm:g} mm: a tube of that size holds {tube_mm3 / 1000:.2f} cm³"
        problems.warn(mark, what, "correct the capacity, the mouth or the height", code="implausible-size")


def _mark_in(node: Node | None, name: str, key: str) -> Mark:
    """Where a value of a named entry stands, else the entry's own place."""
    assert isinstance(node, Entries)
    entry = node.values[name]
    return entry.values[key].mark if isinstance(entry, Entries) and key in entry.values else entry.mark


def _load_cell(path: Path, problems: Problems, broken: Broken) -> CellSpec:
    """The cell; where its file is wrong, what of it is sound."""
    root = _root(path, problems)
    if root is None:
        for kind in ("station", "zone"):
            broken.add(kind, "", problems.found)
        return CellSpec(cell="none", stations={})
    nodes = root.get("stations")
    stations = {} if nodes is None else _load_file(Station, path, problems, broken, "station", nodes)
    is_complete = not problems.found
    root, own = own_options(root, path.parent.parent, problems)
    cell = validate(CellSpec, root.without("stations"), problems, stations=stations, own_options=own)
    for kind in ("balance", "waste", "park"):
        if is_complete and not any(station.kind == kind for station in stations.values()):
            what = f"the cell has no station of kind '{kind}'"
            problems.add(root.mark, what, "it needs a balance, a waste and a park", code="missing-station")
    if nodes is None:
        broken.add("station", "", problems.found)
    if cell is None:
        sound = (key for key in CellSpec.model_fields if key in root.keys and key not in ("cell", "stations"))
        parts = {key: _part(root, key, *(("frames",) if key in ("geometry", "zones") else ())) for key in sound}
        none = "none"
        stations = {name: station.model_copy(update={"frame": None}) for name, station in stations.items()}
        kept = {key: validate(CellSpec, part, Problems(), cell=none, stations=stations) for key, part in parts.items()}
        if "zones" in kept and kept["zones"] is None:
            broken.add("zone", "", problems.found)
        return CellSpec(
            cell=none, stations=stations, **{key: getattr(made, key) for key, made in kept.items() if made is not None}
        )
    _find_meshes(cell, root, path.parent, problems)
    _check_ports(cell, root, problems)
    return cell


def _part(root: Entries, *keys: str) -> Entries:
    there = [key for key in keys if key in root.keys]
    return Entries(root.mark, {key: root.keys[key] for key in there}, {key: root.values[key] for key in there})


MESHES = (".stl", ".obj")
LARGEST_MESH_BYTES = 50_000_000


def _find_meshes(cell: CellSpec, root: Entries, folder: Path, problems: Problems) -> None:
    """The obstacles' mesh files by their absolute paths, with what is in them told by a hash."""
    for zone in cell.zones:
        if zone.mesh is not None:
            what = f"the zone '{zone.name}' is a mesh, which has no inside"
            problems.add(root.keys["zones"], what, "write it as a box or a cylinder", code="bad-value")
    nodes = root.get("geometry")
    for number, obstacle in enumerate(cell.geometry):
        node = nodes.items[number] if isinstance(nodes, Items) else root
        if isinstance(node, Entries) and "mesh_digest" in node.keys:
            problems.add(node.keys["mesh_digest"], "unknown key 'mesh_digest'", "leave it out", code="unknown-key")
        if obstacle.mesh is None:
            continue
        path = (folder / obstacle.mesh).resolve()
        mark = node.values["mesh"].mark if isinstance(node, Entries) and "mesh" in node.values else node.mark
        if path.suffix.lower() not in MESHES:
            problems.add(mark, f"'{shorten(obstacle.mesh)}' is no STL and no OBJ file", code="bad-value")
            continue
        try:
            if path.stat().st_size > LARGEST_MESH_BYTES:
                what = f"'{shorten(obstacle.mesh)}' is larger than {LARGEST_MESH_BYTES / 1e6:g} MB"
                problems.add(mark, what, "a coarser mesh will do: planning looks at every triangle", code="unreadable")
                continue
            digest = hashlib.sha256(path.read_bytes()).hexdigest()
        except OSError as error:
            what = f"'{shorten(obstacle.mesh)}' cannot be read: {error.strerror}"
            problems.add(mark, what, "its path is from cell.yaml's folder", code="unreadable")
            continue
        cell.geometry[number] = obstacle.model_copy(update={"mesh": str(path), "mesh_digest": digest})


def _check_ports(cell: CellSpec, root: Entries, problems: Problems) -> None:
    taken: dict[str, str] = {}
    named = root.get("devices")
    for device in cell.device_names:
        port = cell.section(device).port
        node = root.get(device) or (named.get(device) if isinstance(named, Entries) else None)
        if port in taken and isinstance(node, Entries):
            what = f"the {device} is on {port}, and so is the {taken[port]}"
            problems.add(node.values["port"].mark, what, "each device has a port of its own", code="port-taken")
        elif port:
            taken[port] = device


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
    if lab.cell.changer.driver == "operator" or lab.cell.changer.port:
        return []
    problems = Problems()
    what = f"the changer '{lab.cell.changer.driver}' has no port, it is there in dry runs and rehearsals only"
    problems.add(
        cell_mark(lab, "changer", "driver"),
        what,
        "name its `port`, or write `changer: {driver: operator}`: a person changes containers",
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
            what = f"'{name}' is a skill already"
            problems.add(workflow.mark, what, "give the workflow another name", code="name-taken")
