"""A lab of one's own: found, loaded, and everything wrong in it said in its place."""

import gc
import shutil
import weakref
from pathlib import Path

import pytest
from conftest import REPOSITORY, LabFolder, problems_of

from scuhand_bt.lab import find_lab, load_lab, starter_lab
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe


def test_the_nearest_lab_upward_from_the_recipe_is_used(lab_folder: LabFolder, tmp_path: Path) -> None:
    deep = lab_folder.folder / "recipes" / "2024" / "may"
    deep.mkdir(parents=True)
    assert find_lab(deep / "x.yaml") == lab_folder.folder
    assert find_lab(tmp_path / "x.yaml") == starter_lab()
    assert find_lab(tmp_path / ("n" * 300) / "x.yaml") == starter_lab()
    assert find_lab(deep / "x.yaml", REPOSITORY) == REPOSITORY


def test_a_chosen_folder_that_is_no_lab_is_refused(tmp_path: Path) -> None:
    (problem,) = problems_of(lambda: find_lab(None, tmp_path))
    assert "is not a lab; a lab has robot/cell.yaml; `scuhand-bt init DIR` makes one" in problem


def test_a_copy_of_the_starter_lab_loads(lab_folder: LabFolder) -> None:
    lab = lab_folder.load()
    assert {"scoop", "dispense", "move_over"} <= set(lab.library.skills)
    assert {"fill", "change_powder"} <= set(lab.library.workflows)
    assert lab.urdf.startswith("<?xml") or "<robot" in lab.urdf


@pytest.mark.parametrize(
    ("file", "old", "new", "said"),
    [
        ("cell", "period: 100 ms", "period: 100 mg", "robot/cell.yaml:6:94: 'period': 'mg' is a unit of mass, not of"),
        ("cell", "readability: 0.1 mg", "readabilty: 0.1 mg", "unknown key 'readabilty'"),
        ("cell", "readability: 0.1 mg", "readabilty: 0.1 mg", "did you mean 'readability'?"),
        ("cell", "kind: mortar,", "kind: mortr,", "'kind': 'mortr' is not accepted"),
        ("cell", "[200 mm,  240 mm, 0 mm]", "[200 mm,  240 mm]", "'position' has 2 values, and needs more"),
        ("cell", "[200 mm,  240 mm, 0 mm]", "[200 mm]", "'position' has 1 value, and needs more"),
        ("cell", "[200 mm,  240 mm, 0 mm]", "[200 mm,  240, 0 mm]", "'position': '240' has no unit"),
        ("cell", "{kind: park, ", "{kind: service, ", "the cell has no station of kind 'park'"),
        ("cell", "stations:", "geometri:", "the cell has no station of kind 'balance'"),
        (
            "cell",
            "{name: table,        box:",
            "{name: table,        bx:",
            "unknown key 'bx'; known: at, box, cylinder, frame, mesh",
        ),
        (
            "cell",
            "{name: table,        box: [1.2 m, 1.2 m, 20 mm], ",
            "{name: table, ",
            "it has one shape: a box, a cylinder, or a mesh",
        ),
        (
            "powders",
            "repose: 25 deg",
            "repose: 95 deg",
            "'repose': '95 deg' is not accepted; less than 90 deg",
        ),
        (
            "powders",
            "repose: 25 deg",
            "repose: 25 deg\n  max_opening: 0.05 mm",
            "'max_opening' is 0.05 mm, and nothing flows up to the belief's 'threshold', 0.05 mm",
        ),
        (
            "powders",
            "paper: {gain: 0.33, max_opening: 2.4 mm}",
            "paper: {gain: 0.33, max_opening: 0.1 mm}",
            "'max_opening' of 'paper' is 0.1 mm, and little flows up to the belief's 'threshold', 0.05 mm, and",
        ),
        (
            "powders",
            "threshold: 0.05 mm,",
            "threshold: 0.05 mm, narrowest: 5 mm,",
            "'max_opening' is 2.4 mm, and little flows up to the belief's 'threshold', 0.05 mm, and 'narrowest', 5 mm",
        ),
        ("powders", "repose: 25 deg", "repose: 25 %", "'%' is a unit of ratio, not of angle"),
        ("powders", "repose: 25 deg", "name: x", "unknown key 'name'"),
        ("powders", "gain: 0.33", "gain: .nan", "'gain': '.nan' is not accepted"),
        ("cell", "box: [6 mm,", "box: [-6 mm,", "'box': '-6 mm' is not accepted; more than 0"),
        (
            "powders",
            "coefficient: 50",
            "coefficient: inf",
            "'coefficient': 'inf' is not accepted; a plain number",
        ),
        (
            "powders",
            "coefficient: 50",
            "coefficient: 1e300",
            "'coefficient': '1e300' is not accepted; at most 1000000000",
        ),
        ("powders", "coefficient: 50", "coefficient: 1e-12", "'coefficient': '1e-12' is not accepted; at least 0.001"),
        ("powders", "coefficient: 50", "exponent: 0.01", "'exponent': '0.01' is not accepted; at least 0.5"),
        ("powders", "coefficient: 50", "gap: 1 um", "'gap': '1 um' is not accepted; at least 10 um"),
        ("powders", "coefficient: 50", "gap: 1 km", "'gap': '1 km' is not accepted; at most 0.0001 km"),
        ("powders", "surge: 0.1 mg}", "surge: 1 kg}", "'surge': '1 kg' is not accepted; at most 0.1 kg"),
        ("containers", "mortars:", "mortar:", "robot/containers.yaml:2:1: 'mortars' is missing"),
        ("containers", "mortars:", "mortar:", "unknown key 'mortar'"),
        ("containers", "depth: 30 mm", "depth: 60 mm", "its depth is at most half its bore"),
        ("containers", "depth: 30 mm", "depth: 60 mm", "a beaker or a jar has a 'corner'"),
        ("containers", "depth: 30 mm", "depth: 30 mm\n    corner: 31 mm", "at most the depth, and half the bore"),
        ("containers", "depth: 30 mm", "depth: 30 mm\n    corner: 0 mm", "39:13: 'corner': '0 mm' is not accepted"),
        ("containers", "depth: 30 mm", "depth: 30 mm\n    corner:", "39:12: 'corner' is empty"),
        ("containers", "capacity: 4 cm^3", "capacity: 4 cm^2", "'cm^2' is not a unit of volume"),
    ],
)
def test_what_is_wrong_in_the_robot_folder_is_said_in_its_place(
    lab_folder: LabFolder, file: str, old: str, new: str, said: str
) -> None:
    lab_folder.replace(f"robot/{file}.yaml", old, new)
    problems = lab_folder.problems()
    assert any(said in problem for problem in problems), problems
    assert all(problem.startswith(f"robot/{file}.yaml:") for problem in problems)


def test_a_urdf_without_one_of_its_shapes_is_said_in_one_line(lab_folder: LabFolder) -> None:
    lab_folder.replace("robot/crane_x7_scuhand_sv.urdf", 'version="1.1"', 'version="1.0"')
    (problem,) = problems_of(lambda: lab_folder.load().motion_planner({}))
    assert "1:1: Pinocchio loaded 4 of the URDF's 10 collision shapes" in problem


def test_problems_of_all_files_are_said_at_once(lab_folder: LabFolder) -> None:
    lab_folder.replace("robot/cell.yaml", "slots: 24", "slots: many")
    lab_folder.replace("robot/powders.yaml", "gain: 0.33", "gain: 3")
    lab_folder.replace("trees/fill.yaml", "attempts: 24", "atempts: 8")
    lab_folder.write("skills/broken.py", "def (:\n")
    files = [problem.split(":")[0] for problem in lab_folder.problems()]
    assert files == ["robot/cell.yaml", "robot/powders.yaml", "skills/broken.py", "trees/fill.yaml", "trees/fill.yaml"]


def test_wrong_grammar_hides_no_wrong_wire_of_the_same_file(lab_folder: LabFolder) -> None:
    lab_folder.replace("trees/fill_xrd_holder.yaml", "duration: 30 min", "duration: 30 kg")
    placing = "    - place_and_scoop: {source: $source, container: $container, mass: $mass}"
    lab_folder.replace("trees/fill_xrd_holder.yaml", placing, "    - park\n    - wait: {duration: $nothing}")
    assert [problem.split(": ", 1)[0] for problem in lab_folder.problems()] == [
        "trees/fill_xrd_holder.yaml:8:7",
        "trees/fill_xrd_holder.yaml:11:19",  # and nothing of $nothing, which could be what was not read
    ]
    lab_folder.replace("trees/fill.yaml", "attempts: 24", "attemps: 8")
    said = [problem.split(": ", 1)[0] for problem in lab_folder.problems()]
    assert "trees/fill_xrd_holder.yaml:11:19" in said, "what is wrong here is so whatever is wrong with `fill`"


def test_a_missing_or_empty_file_is_one_line(lab_folder: LabFolder) -> None:
    (lab_folder.folder / "robot" / "powders.yaml").unlink()
    lab_folder.write("trees/empty.yaml", "")
    assert lab_folder.problems() == [
        "robot/powders.yaml:1:1: does not exist; expected the lab's powders.yaml",
        "trees/empty.yaml:1:1: is empty; expected a workflow",
    ]


HEAD = "from scuhand_bt.skill import Cell, Condition, Seconds, Skill, Steps\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x = 1\n1 / 0\n", "skills/sieve.py:2:1: the skill cannot be loaded: ZeroDivisionError: division by zero"),
        ("x = 1\ndef f(:\n", "skills/sieve.py:2:7: the skill cannot be loaded: SyntaxError"),
        ("import nosuchmodule\n", "skills/sieve.py:1:1: the skill cannot be loaded: ModuleNotFoundError"),
        ("import sys\nsys.exit(3)\n", "skills/sieve.py:2:1: the skill cannot be loaded: SystemExit: 3"),
        ("x = 1\n", "a skill's file must have exactly one Skill class; this one has: none"),
        (
            HEAD + "class A(Skill[None]):\n    'a'\n    def run(self, cell): yield from ()\nclass B(A):\n    'b'\n",
            "this one has: A, B",
        ),
        (
            HEAD + "class A(Skill[None]):\n    def run(self, cell): yield from ()\n",
            "skills/sieve.py:2:1: A has no docstring",
        ),
        (HEAD + "class A(Skill[None]):\n    'a'\n", "skills/sieve.py:2:1: A has no 'run'; def run(self, cell: Cell)"),
        (HEAD + "class A(Condition):\n    'a'\n", "A has no 'check'"),
        (
            HEAD + "class A(Skill[None]):\n    'a'\n    devices = ('hand')\n    def run(self, cell): yield from ()\n",
            "'devices' of A is not a tuple; devices = (\"hand\",), with the comma",
        ),
        (
            HEAD + "class A(Skill[None]):\n    'a'\n    devices = ('hnd',)\n    def run(self, cell): yield from ()\n",
            "names an unknown device 'hnd'; known: arm, balance, changer, hand; did you mean 'hand'?",
        ),
        (
            HEAD + "class A(Condition):\n    'a'\n    watches = ('robot',)\n    def check(self, cell): pass\n",
            "'watches' of A names an unknown device 'robot'",
        ),
        (
            HEAD + "class A(Condition):\n    'a'\n    devices = ('arm',)\n    def check(self, cell): pass\n",
            "A is a condition and commands nothing, but has devices; use 'watches'",
        ),
        (
            HEAD + "class A(Skill[None]):\n    'a'\n    t_s = 1.0\n    def run(self, cell): yield from ()\n",
            "cannot be loaded",
        ),
    ],
)
def test_what_is_wrong_with_a_skills_file_is_said_in_its_place(lab_folder: LabFolder, text: str, said: str) -> None:
    lab_folder.write("skills/sieve.py", text)
    problems = lab_folder.problems()
    assert any(said in problem for problem in problems), problems
    assert all("\n" not in problem for problem in problems)


def test_names_are_given_once(lab_folder: LabFolder) -> None:
    lab_folder.write("trees/park.yaml", "workflow: park\ntree: {tare: }\n")
    lab_folder.write("trees/retry.yaml", "workflow: retry\ntree: {tare: }\n")
    lab_folder.write(
        "skills/repeat.py", HEAD + "class R(Skill[None]):\n    'r'\n    def run(self, cell): yield from ()\n"
    )
    assert [problem.split(":", 3)[0] + problem.split(":", 3)[3].split(";")[0] for problem in lab_folder.problems()] == [
        "skills/repeat.py 'repeat' is a word of the workflow language",
        "trees/park.yaml 'park' is already a skill",
        "trees/retry.yaml 'retry' is a word of the workflow language",
    ]


def test_a_new_skill_and_workflow_are_part_of_the_lab(lab_folder: LabFolder) -> None:
    text = "class Sieve(Skill[None]):\n    'Sieve.'\n    duration_s: Seconds = 5.0\n"
    text += "    def run(self, cell): yield from ()\n"
    lab_folder.write("skills/sieve.py", HEAD + text)
    lab_folder.write("skills/_shared.py", "raise RuntimeError('only when imported')\n")
    lab_folder.write("trees/sift.yaml", "workflow: sift\ntree: {sieve: {duration: 1 min}}\n")
    library = lab_folder.load().library
    assert library.skills["sieve"].summary() == "Sieve."
    assert list(library.parameters("sieve")) == ["duration"]
    assert "sift" in library.workflows


def test_a_skill_that_was_edited_is_read_anew_by_the_next_who_opens_the_lab(lab_folder: LabFolder) -> None:
    text = HEAD + "from ._shared import SAID\n\nclass Sieve(Skill[None]):\n    __doc__ = SAID\n"
    lab_folder.write("skills/sieve.py", text + "    def run(self, cell): yield from ()\n")
    before = None
    for said in ("Before", "Behind"):  # of one length, and within a second
        lab_folder.write("skills/_shared.py", f"SAID = '{said}.'\n")
        library = lab_folder.load().library
        assert library.skills["sieve"].summary() == f"{said}."
        assert lab_folder.load().library.skills["sieve"] is library.skills["sieve"] is not before
        before = library.skills["sieve"]


def test_a_process_that_loads_one_lab_after_another_keeps_few_of_them(lab_folder: LabFolder, tmp_path: Path) -> None:
    """A study loads a copy of the lab for each draw: all of their skills' classes stayed, half a megabyte each time."""
    loaded = list[weakref.ref[type]]()
    for number in range(12):
        lab = load_lab(shutil.copytree(lab_folder.folder, tmp_path / f"copy-{number}"))
        make_plan(load_recipe(REPOSITORY / "recipes" / "xrd_holders.yaml", lab), lab)
        loaded.append(weakref.ref(lab.library.skills["scoop"]))
    gc.collect()
    assert loaded[-1]() is not None
    assert loaded[0]() is None


def test_two_labs_do_not_share_skills(lab_folder: LabFolder, tmp_path: Path) -> None:
    text = HEAD + "class Shake(Skill[None]):\n    'Other.'\n    def run(self, cell): yield from ()\n"
    lab_folder.write("skills/shake.py", text)
    assert lab_folder.load().library.skills["shake"].summary() == "Other."
    from scuhand_bt.lab import load_lab

    assert load_lab(REPOSITORY).library.skills["shake"].summary() != "Other."


def test_a_lab_given_by_a_relative_path_has_the_right_lines(
    lab_folder: LabFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab_folder.write("skills/sieve.py", "x = 1\n1 / 0\n")
    monkeypatch.chdir(lab_folder.folder.parent)
    assert LabFolder(Path("lab")).problems()[0].startswith("skills/sieve.py:2:1: ")


PAN = "  - {name: pan, "


@pytest.mark.parametrize(
    ("zone", "said"),
    [
        ("name: front, box: [90 mm, 90 mm, 90 mm], at: [345 mm, 144 mm, 159 mm]", "'front' and 'pan' overlap"),
        ("name: front, box: [90 mm, 90 mm, 90 mm], at: [345 mm, 145 mm, 159 mm]", ""),
        ("name: front, box: [90 mm, 90 mm, 90 mm], at: [345 mm, 0 mm, 15 mm]", ""),
        ("name: front, cylinder: [90 mm, 90 mm], at: [484 mm, 134 mm, 159 mm]", ""),
        (
            "name: front, box: [90 mm, 90 mm, 90 mm], at: [345 mm, 145 mm, 159 mm], yaw: 45 deg",
            "'front' and 'pan' overlap",
        ),
        ("name: front, cylinder: [90 mm, 90 mm], at: [480 mm, 130 mm, 159 mm]", "'front' and 'pan' overlap"),
        ("name: front, box: [9 mm, 9 mm, 9 mm], at: [345 mm, 0 mm, 159 mm]", "'front' and 'pan' overlap"),
        ("name: pan, box: [9 mm, 9 mm, 9 mm], at: [0 mm, 500 mm, 159 mm]", "there are two zones 'pan'"),
    ],
)
def test_zones_that_are_in_part_one_place_are_refused(lab_folder: LabFolder, zone: str, said: str) -> None:
    """The shipped one goes from y -100 to 100 mm, x 240 to 450 mm, z 60 to 258 mm."""
    lab_folder.replace("robot/cell.yaml", PAN, f"  - {{{zone}, frame: balance}}\n{PAN}")
    told = lab_folder.problems()
    assert [problem.startswith("robot/cell.yaml:21:5: ") and said in problem for problem in told] == [True] * bool(said)
