"""A file of a lab that is wrong breaks what uses it and nothing else, and is told of wherever the lab is loaded."""

import shutil
from pathlib import Path

import pytest
from conftest import Call, LabFolder

RECIPE = """\
recipe: one
workflow: scoop_and_dispense
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 5 g}
samples:
  - {id: a, source: beads, container: xrd_holder, mass: 50 mg}
"""
SKILL = "from scuhand_bt.skill import Skill\n\nclass Sieve(Skill[None]):\n    pass\n"
BREAKS = {
    "an empty sequence": ("trees/half.yaml", "workflow: half\ntree:\n  sequence:\n", "trees/half.yaml:3:12: "),
    "no YAML": ("trees/half.yaml", "workflow: half\ntree: {a: [\n", "trees/half.yaml:3:1: is not valid YAML"),
    "a skill": ("skills/sieve.py", SKILL, "skills/sieve.py:3:1: Sieve has no docstring"),
    "a skill that is no Python": ("skills/sieve.py", "def (:\n", "skills/sieve.py:1:5: the skill cannot be loaded"),
}


@pytest.fixture
def recipe(lab_folder: LabFolder) -> Path:
    return lab_folder.write("recipes/one.yaml", RECIPE)


@pytest.mark.parametrize(("file", "text", "said"), BREAKS.values(), ids=BREAKS)
def test_a_file_that_nothing_uses_is_told_of_and_stops_nothing(
    command: Call, lab_folder: LabFolder, recipe: Path, file: str, text: str, said: str
) -> None:
    lab_folder.write(file, text)
    for arguments in (
        ["plan", recipe, "--trials", 0],
        ["skills", "--lab", lab_folder.folder],
        ["powders", "--lab", lab_folder.folder],
    ):
        ended = command(*arguments)
        assert ended.returncode == 0, ended.stderr
        assert f"Note: {lab_folder.folder}/{said}" in ended.stderr
    assert said in "\n".join(map(str, lab_folder.load().problems))
    assert command("run", recipe, "--dry-run", "--quiet").returncode in (0, 1)


@pytest.mark.parametrize(
    ("file", "old", "new", "said"),
    [
        ("trees/fill.yaml", "retry:\n", "retry:\n    x: 1\n", "5: unknown key 'x'"),
        ("skills/tare.py", "class Tare", "clas Tare", "6: the skill cannot be loaded: SyntaxError"),
        (
            "skills/dispense.py",
            "verdict import judge",
            "verdict import judged",
            "1: the skill cannot be loaded: ImportError",
        ),
        ("robot/powders.yaml", "repose: 25 deg", "repose: 25 kg", "11: 'repose': 'kg' is a unit"),
        ("robot/containers.yaml", "mouth: 20 mm", "mouth: 20 s", "12: 'mouth': 's' is a unit"),
        ("robot/containers.yaml", "bore: 90 mm", "bore: 90 s", "11: 'bore': 's' is a unit"),
        ("robot/powders.yaml", "1.5 g/cm^3\n  repose:", "[1.5 g/cm^3\n  repose:", "9: is not valid YAML"),
    ],
)
def test_what_uses_it_is_refused_with_what_is_wrong_in_it_and_nothing_beside_the_point(
    command: Call, lab_folder: LabFolder, recipe: Path, file: str, old: str, new: str, said: str
) -> None:
    lab_folder.replace(file, old, new)
    before, _ = (lab_folder.folder / file).read_text().split(new, 1)
    line = (before + new.rstrip()).count("\n") + 1
    ended = command("run", recipe, "--dry-run", "--quiet")
    assert ended.returncode == 2
    (problem,) = (told for told in ended.stderr.splitlines() if "nothing was moved" not in told)
    assert problem.startswith(f"{lab_folder.folder}/{file}:{line}:{said}")


@pytest.mark.parametrize(
    ("old", "new"), [("verdict import judge", "verdict import judged"), ("free_flow(powder.", "free_flow(1, powder.")]
)
def test_a_skill_of_another_version_is_told_where_there_is_one_of_this(
    lab_folder: LabFolder, old: str, new: str
) -> None:
    lab_folder.replace("skills/dispense.py", old, new)
    shutil.copy(lab_folder.folder / "skills/dispense.py", lab_folder.folder / "skills/dose_it.py")
    theirs, own = lab_folder.load().problems
    assert theirs.message.endswith(
        "if it came with another version, take dispense.py from a new lab (`scuhand-bt init DIR`)"
    )
    assert "another version" not in own.message


def test_a_file_of_another_version_that_skills_share_is_named(lab_folder: LabFolder) -> None:
    lab_folder.replace("skills/_opening.py", "import Cell", "import Sell as Cell")
    found = {Path(one.mark.file).name: one.message for one in lab_folder.load().problems}
    assert {"open_cone.py", "discard.py"} <= found.keys(), "the one imports it, the other what imports it"
    assert all("if it came with another version, take _opening.py from" in message for message in found.values())


def test_a_skill_of_another_version_is_told_where_a_workflow_gives_it_what_it_does_not_take(
    lab_folder: LabFolder,
) -> None:
    lab_folder.replace("skills/return_leftover.py", "    keep: ", "    kept: ")
    lab_folder.replace("skills/return_leftover.py", "self.keep", "self.kept")
    lab_folder.replace("trees/fill_crucible.yaml", "return_leftover: {", "return_leftover: {keeep: any, ")
    found = [one for one in lab_folder.problems() if "has no parameter" in one]
    told = [one for one in found if "another version, take return_leftover.py from a new lab" in one]
    assert len(told) >= 2
    (own,) = (one for one in found if one not in told)
    assert own.startswith("trees/fill_crucible.yaml")


def test_another_powder_of_a_file_with_a_wrong_one_can_be_used(
    command: Call, lab_folder: LabFolder, recipe: Path
) -> None:
    lab_folder.replace("robot/powders.yaml", "repose: 37 deg", "repose: 37 kg")
    assert command("plan", recipe, "--trials", 0).returncode == 0
    lab_folder.write("recipes/one.yaml", RECIPE.replace("glass_beads", "monosodium_glutamate"))
    assert command("plan", recipe, "--trials", 0).returncode == 2


def test_a_service_workflow_that_is_wrong_stops_the_plans_that_need_it(
    command: Call, lab_folder: LabFolder, recipe: Path
) -> None:
    lab_folder.write("trees/clear_and_change_powder.yaml", "workflow: clear_and_change_powder\n")
    assert command("plan", recipe, "--trials", 0).returncode == 0, "one powder needs no change"
    two = RECIPE + "  - {id: b, source: msg, container: xrd_holder, mass: 50 mg}\n"
    msg = "  msg: {station: mortar_bay_2, container: agate_mortar, powder: monosodium_glutamate, amount: 5 g}\n"
    lab_folder.write("recipes/one.yaml", two.replace("samples:", msg + "samples:"))
    ended = command("plan", recipe, "--trials", 0)
    assert ended.returncode == 2
    assert "trees/clear_and_change_powder.yaml:1:1: 'tree' is missing" in ended.stderr
    assert "is missing; this plan needs it" not in ended.stderr


def test_a_skill_that_only_a_service_workflow_calls_stops_no_check_that_does_not_need_it(
    command: Call, lab_folder: LabFolder, recipe: Path
) -> None:
    lab_folder.write("recipes/one.yaml", RECIPE + "on_failure: {hand.cone_empty: flag}\n")
    lab_folder.replace("skills/swap_sheet.py", "class SwapSheet", "clas SwapSheet")
    ended = command("check", recipe, "--fast")
    assert ended.returncode == 0, ended.stderr
    assert "skills/swap_sheet.py" in ended.stdout
    assert "warning: the skill cannot be loaded: SyntaxError" in ended.stdout


def test_without_its_cell_no_lab_is_loaded(command: Call, lab_folder: LabFolder, recipe: Path) -> None:
    lab_folder.replace("robot/cell.yaml", "slots: 24", "slots: many")
    ended = command("plan", recipe, "--trials", 0)
    assert ended.returncode == 2
    assert "robot/cell.yaml:7:36: 'slots': 'many' is not accepted" in ended.stderr
