"""Meshes among what stands in a cell: kept away from as a box of their shape is, and told of where they are wrong."""

from pathlib import Path

import numpy as np
import pytest
from conftest import LabFolder, problems_of

from scuhand_bt.bench_spec import Obstacle
from scuhand_bt.lab import load_lab, read_lab, starter_lab
from scuhand_bt.motion import ApexPose, MotionPlanner
from scuhand_bt.motion.kinematics import LIMITS_RAD
from scuhand_bt.report.cell_mesh import shape_mesh

LAB = load_lab(starter_lab())
SIZE_MM, AT_MM, YAW_DEG = (60.0, 120.0, 160.0), (230.0, 150.0, 90.0), 25.0
LINE = "  - {{name: fixture, mesh: {mesh}, at: [230 mm, 150 mm, 90 mm], yaw: 25 deg{more}}}\n"


def corners_and_sides() -> tuple[np.ndarray, list[tuple[int, int, int]]]:
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * np.array(SIZE_MM) / 2
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, [side for a, b, c, d in quads for side in ((a, b, c), (a, c, d))]


def write_stl(path: Path, scale: float = 1.0) -> Path:
    corners, sides = corners_and_sides()
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in scale * corners[list(side)])
        + "endloop\nendfacet\n"
        for side in sides
    )
    path.write_text(f"solid fixture\n{facets}endsolid fixture\n", encoding="ascii")
    return path


def write_obj(path: Path, scale: float = 1.0) -> Path:
    corners, sides = corners_and_sides()
    lines = [f"v {x} {y} {z}" for x, y, z in scale * corners] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in sides]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    return path


def planner(*obstacles: Obstacle) -> MotionPlanner:
    return MotionPlanner(LAB.urdf, LAB.cell.model_copy(update={"geometry": [*LAB.cell.geometry, *obstacles]}), {})


@pytest.mark.parametrize(("write", "name", "scale"), [(write_stl, "a.stl", 1.0), (write_obj, "a.obj", 1e-3)])
def test_a_mesh_is_kept_away_from_as_the_box_it_is_the_surface_of(
    tmp_path: Path, write, name: str, scale: float
) -> None:
    mesh = str(write(tmp_path / name, scale))
    box = planner(Obstacle(name="it", box_mm=SIZE_MM, at_mm=AT_MM, yaw_deg=YAW_DEG)).scene()
    same = planner(
        Obstacle(name="it", mesh=mesh, mesh_unit_mm=1.0 / scale, at_mm=AT_MM, yaw_deg=YAW_DEG, mesh_digest=name)
    ).scene()
    q = np.random.default_rng(3).uniform(LIMITS_RAD[0], LIMITS_RAD[1], (3000, 7))
    alone = planner().scene().hits(q)
    assert (box.hits(q) & ~alone).sum() > 50, "the box is in the way"
    differ = box.hits(q) != same.hits(q)
    # Where nothing but the inside of the box is touched the surface is not; nothing comes there from outside.
    assert differ.mean() < 0.002
    assert not (same.hits(q) & ~box.hits(q)).any()


def test_a_way_around_a_mesh_is_planned_and_is_free_of_the_box(tmp_path: Path) -> None:
    at_mm, file = (180.0, 160.0, 150.0), str(write_stl(tmp_path / "b.stl"))
    mesh = Obstacle(name="it", mesh=file, at_mm=at_mm, yaw_deg=YAW_DEG, mesh_digest="b")
    box = Obstacle(name="it", box_mm=SIZE_MM, at_mm=at_mm, yaw_deg=YAW_DEG)
    around, judge, beyond = planner(mesh), planner(box).scene(), ApexPose(np.array([0.12, 0.29, 0.15]))
    straight, motion = (one.move(one.home(), beyond) for one in (planner(), around))
    assert judge.any_hit(straight.at(np.linspace(0, straight.duration_s, 400))), "the box is in the way"
    assert not judge.any_hit(motion.at(np.linspace(0, motion.duration_s, 400)))


def test_a_mesh_is_drawn_in_pictures(tmp_path: Path) -> None:
    mesh = Obstacle(name="it", mesh=str(write_stl(tmp_path / "c.stl")), at_mm=AT_MM, mesh_digest="c")
    (thing,) = [one for one in planner(mesh).scene().shapes.geometryObjects if one.name == "it"]
    assert np.ptp(shape_mesh(thing).points_m, axis=0) == pytest.approx(np.array(SIZE_MM) / 1e3)


def test_a_lab_finds_its_mesh_beside_its_cell_and_plans_anew_when_the_file_changes(lab_folder: LabFolder) -> None:
    write_stl(lab_folder.folder / "robot" / "fixture.stl")
    cell = lab_folder.folder / "robot" / "cell.yaml"
    lab_folder.write("robot/cell.yaml", cell.read_text(encoding="utf-8") + LINE.format(mesh="fixture.stl", more=""))
    before = read_lab(lab_folder.folder)
    assert before.problems == ()
    hits = before.motion_planner({}).scene().hits
    q = np.random.default_rng(3).uniform(LIMITS_RAD[0], LIMITS_RAD[1], (2000, 7))
    assert (hits(q) & ~planner().scene().hits(q)).any()
    write_stl(lab_folder.folder / "robot" / "fixture.stl", 0.1)
    after = read_lab(lab_folder.folder)
    assert repr(after.cell) != repr(before.cell)
    assert after.motion_planner({}).scene().hits(q).sum() < hits(q).sum()


@pytest.mark.parametrize(
    ("mesh", "text", "said"),
    [
        ("none.stl", None, "'none.stl' cannot be read: No such file or directory"),
        ("fixture.step", "solid", "is neither an STL nor an OBJ file"),
    ],
)
def test_a_mesh_that_is_not_there_is_told_of_where_it_is_written(
    lab_folder: LabFolder, mesh: str, text: str | None, said: str
) -> None:
    cell = lab_folder.folder / "robot" / "cell.yaml"
    lines = cell.read_text(encoding="utf-8").count("\n") + 1
    lab_folder.write("robot/cell.yaml", cell.read_text(encoding="utf-8") + LINE.format(mesh=mesh, more=""))
    if text is not None:
        (lab_folder.folder / "robot" / mesh).write_text(text, encoding="ascii")
    (problem,) = read_lab(lab_folder.folder).problems
    assert problem.mark.line == lines
    assert said in problem.message


@pytest.mark.parametrize(
    ("text", "more", "said"),
    [
        ("rubbish", "", "cannot be read as a mesh"),
        (None, ", mesh_unit: 1 m", "160000 mm across: is `mesh_unit` what one unit of the file is?"),
    ],
)
def test_a_file_that_is_no_mesh_of_a_fixtures_size_ends_planning_in_words(
    lab_folder: LabFolder, text: str | None, more: str, said: str
) -> None:
    path = write_stl(lab_folder.folder / "robot" / "fixture.stl")
    if text is not None:
        path.write_text(text, encoding="ascii")
    cell = lab_folder.folder / "robot" / "cell.yaml"
    lab_folder.write("robot/cell.yaml", cell.read_text(encoding="utf-8") + LINE.format(mesh="fixture.stl", more=more))
    (message,) = problems_of(lambda: read_lab(lab_folder.folder).motion_planner({}))
    assert said in message


def test_the_digest_of_a_mesh_is_no_key_of_the_file(lab_folder):
    lab_folder.replace(
        "robot/cell.yaml", "box: [220 mm, 200 mm, 58 mm],", "box: [220 mm, 200 mm, 58 mm], mesh_digest: x,"
    )
    assert any("unknown key 'mesh_digest'" in one for one in lab_folder.problems())
    lab_folder.replace("robot/cell.yaml", "mesh_digest: x", "mash: x.stl")
    (told,) = (one for one in lab_folder.problems() if "mash" in one)
    assert "mesh" in told
    assert "mesh_digest" not in told
