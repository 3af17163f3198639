"""The files of a lab's `robot/`: its cell, powders, containers and mortars, read and held against each other.

What is wrong in a file breaks only what uses it: the rest is given.
"""

import hashlib
import itertools
import math
from collections.abc import Collection
from pathlib import Path
from typing import TypeVar

from scuhand_bt.bench_spec import Obstacle, Station
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.device_sections import own_options
from scuhand_bt.problems import Broken, Mark, Problems, SourceError, shorten
from scuhand_bt.specs import ContainerKind, Mortar, Spec
from scuhand_bt.validation import validate
from scuhand_bt.yaml_source import Entries, Items, Node, describe, load

S = TypeVar("S", bound=Spec)


def check_slots(path: Path, cell: CellSpec, containers: Collection[str], problems: Problems, broken: Broken) -> None:
    """The kinds that the changer has slots for are the lab's."""
    for kind in cell.changer.kinds:
        if kind not in containers and not broken.of("container", kind):
            problems.add(
                place_in_cell(path, "changer", "slots", kind),
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
    problems.add(node.mark, f"expected a mapping (name: …), found {describe(node)}", code="wrong-shape")
    return None


def load_entries(
    model: type[S], path: Path, problems: Problems, broken: Broken, kind: str, node: Node | None = None
) -> dict[str, S]:
    """The entries of a file, or of a part of one, whose keys are their names; what is wrong is told and `broken`."""
    before = len(problems.found)
    node = node or _root(path, problems)
    if node is None or not isinstance(node, Entries):
        if node is not None:
            what = f"expected a mapping (name: …), found {describe(node)}"
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


def load_vessels(path: Path, problems: Problems, broken: Broken) -> tuple[dict[str, ContainerKind], dict[str, Mortar]]:
    """The containers and mortars that are right; what is wrong is told and `broken`."""
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
                    vessels.mark, f"'{key}' is missing", "write name: {…}, as in the starter lab", code="missing-key"
                )
    of_file = problems.found[before:]
    nodes = {key: vessels.get(key) if vessels is not None else None for key in kinds}
    for key, kind in kinds.items():
        if nodes[key] is None:
            broken.add(kind, "", of_file)
    containers, mortars = (nodes[key] for key in kinds)
    found = {} if containers is None else load_entries(ContainerKind, path, problems, broken, "container", containers)
    for name, container in found.items():
        _check_size(container, containers, name, problems)
    bowls = {} if mortars is None else load_entries(Mortar, path, problems, broken, "mortar", mortars)
    for name, mortar in list(bowls.items()):
        if mortar.corner_mm is None and (empty := _mark_of(mortars, name, "corner")) is not None:
            of_entry = Problems()
            of_entry.add(
                empty, "'corner' is empty", "write a radius, such as 5 mm, or leave it out for a bowl", code="bad-value"
            )
            problems.found += of_entry.found
            broken.add("mortar", name, of_entry.found)
            del bowls[name]
        if mortar.bore_mm >= mortar.outer_diameter_mm:
            what = f"the bore of '{name}', {mortar.bore_mm:g} mm, is not less than "
            what += f"its outer diameter, {mortar.outer_diameter_mm:g} mm"
            problems.warn(
                _mark_in(mortars, name, "bore"), what, "correct the bore or the outer diameter", code="implausible-size"
            )
        if mortar.corner_mm is None and mortar.depth_mm >= DEEP * mortar.bore_mm:
            steep_deg = math.degrees(2.0 * math.atan(2.0 * mortar.depth_mm / mortar.bore_mm))
            what = (
                f"'{name}' has no 'corner', so it counts as a bowl; but a bowl of {mortar.bore_mm:g} mm bore and "
                f"{mortar.depth_mm:g} mm depth would be {steep_deg:.0f}° steep at its edge, as few are"
            )
            add = "for a beaker or a jar, add the radius between its level floor and its wall, such as 'corner: 5 mm'"
            problems.warn(_mark_in(mortars, name, "depth"), what, add, code="implausible-size")
    return found, bowls


DEEP = 0.4
"""Of its bore: a bowl that is so deep is nearly half a sphere. A mortar's is about a third, most jars' are deeper."""
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
    return _mark_of(node, name, key) or node.values[name].mark


def _mark_of(node: Node | None, name: str, key: str) -> Mark | None:
    """Where a value of a named entry stands, if it is there."""
    assert isinstance(node, Entries)
    entry = node.values[name]
    return entry.values[key].mark if isinstance(entry, Entries) and key in entry.values else None


def load_cell(path: Path, problems: Problems, broken: Broken) -> CellSpec:
    """The cell; where its file is wrong, what of it is sound."""
    root = _root(path, problems)
    if root is None:
        for kind in ("station", "zone"):
            broken.add(kind, "", problems.found)
        return CellSpec(cell="none", stations={})
    nodes = root.get("stations")
    stations = {} if nodes is None else load_entries(Station, path, problems, broken, "station", nodes)
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
    _check_zones(cell, root, problems)
    _check_ports(cell, root, problems)
    return cell


def _part(root: Entries, *keys: str) -> Entries:
    there = [key for key in keys if key in root.keys]
    return Entries(root.mark, {key: root.keys[key] for key in there}, {key: root.values[key] for key in there})


TOUCHING_M = 1e-4
"""Zones side by side may overlap by so much: figures are rounded."""


def _check_zones(cell: CellSpec, root: Entries, problems: Problems) -> None:
    """No two are one place: each is leased by itself, and two would move there at once."""
    nodes = root.get("zones")
    for (_, first), (number, second) in itertools.combinations(enumerate(cell.zones), 2):
        mark = nodes.items[number].mark if isinstance(nodes, Items) else root.mark
        if second.name == first.name:
            problems.add(
                mark, f"there are two zones '{second.name}'", "give each a name of its own", code="zones-overlap"
            )
        elif None is first.mesh is second.mesh and _overlap_m(first, second) > TOUCHING_M:
            what = f"the zones '{first.name}' and '{second.name}' overlap: two may move there at once"
            problems.add(mark, what, "set them apart, or make them one", code="zones-overlap")


def _overlap_m(first: Obstacle, second: Obstacle) -> float:
    """By how much two are in each other [m]; less than 0 where they are apart."""
    import coal  # a quarter of a second, for what most cells have one of

    from scuhand_bt.motion.cell_solids import solids_of

    request, result = coal.DistanceRequest(), coal.DistanceResult()
    one, other = (next(iter(solids_of([zone]))) for zone in (first, second))
    places = [coal.Transform3s(solid.placement().rotation, solid.placement().translation) for solid in (one, other)]
    return -float(coal.distance(one.shape(), places[0], other.shape(), places[1], request, result))


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
            problems.add(mark, f"'{shorten(obstacle.mesh)}' is neither an STL nor an OBJ file", code="bad-value")
            continue
        try:
            if path.stat().st_size > LARGEST_MESH_BYTES:
                what = f"'{shorten(obstacle.mesh)}' is larger than {LARGEST_MESH_BYTES / 1e6:g} MB"
                problems.add(mark, what, "use a coarser mesh: planning looks at every triangle", code="unreadable")
                continue
            digest = hashlib.sha256(path.read_bytes()).hexdigest()
        except OSError as error:
            what = f"'{shorten(obstacle.mesh)}' cannot be read: {error.strerror}"
            problems.add(mark, what, "write its path from cell.yaml's folder", code="unreadable")
            continue
        cell.geometry[number] = obstacle.model_copy(update={"mesh": str(path), "mesh_digest": digest})


def _check_ports(cell: CellSpec, root: Entries, problems: Problems) -> None:
    taken: dict[str, str] = {}
    named = root.get("devices")
    for device in cell.device_names:
        port = cell.section(device).port
        node = root.get(device) or (named.get(device) if isinstance(named, Entries) else None)
        if port in taken and isinstance(node, Entries):
            what = f"the {device} and the {taken[port]} are both on {port}"
            problems.add(node.values["port"].mark, what, "give each device a port of its own", code="port-taken")
        elif port:
            taken[port] = device


def place_in_cell(path: Path, *keys: str) -> Mark:
    """Where a value of the cell's file stands; for one that it leaves out, what would hold it."""
    node = load(path, "the lab's cell.yaml")
    for key in keys:
        node = (node.get(key) if isinstance(node, Entries) else None) or node
    return node.mark
