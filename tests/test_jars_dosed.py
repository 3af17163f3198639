"""A beaker or a jar as a source, from its file to its doses: what check says of it, and what a run does."""

import re
from collections import Counter
from pathlib import Path

import pytest
from conftest import LabFolder, read
from running import Ran, dry_run, make_lab
from test_poor_scoops import PoorScoops

from scuhand_bt.dosing.jars import along_floor
from scuhand_bt.lab import read_lab
from scuhand_bt.problems import Problem
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.checking import check

JAR = "  jar: {bore: BORE mm, depth: DEPTH mm, height: HEIGHT mm, outer_diameter: 120 mm, corner: 5 mm}\n"
RECIPE = """
recipe: jar
workflow: scoop_and_dispense
sources:
  msg: {station: mortar_bay, container: jar, powder: monosodium_glutamate, amount: AMOUNT g, lot: L-1}
defaults: {container: pellet_die_13mm, tolerance: 5 mg}
samples:
"""


class HalfScoops(PoorScoops):
    """A plant whose scoops bring half of what they should."""

    share = 0.5


def recipe(masses_mg: list[float], amount_g: float = 12.0) -> str:
    samples = "".join(f"  - {{id: s{n}, source: msg, mass: {mass:g} mg}}\n" for n, mass in enumerate(masses_mg))
    return RECIPE.replace("AMOUNT", f"{amount_g:g}") + samples


def jar(bore_mm: float = 95.0, depth_mm: float = 40.0, floor_mm: float = 15.0) -> str:
    sizes = {"BORE": bore_mm, "DEPTH": depth_mm, "HEIGHT": depth_mm + floor_mm}
    return re.sub("BORE|DEPTH|HEIGHT", lambda found: f"{sizes[found[0]]:g}", JAR)


def dosed(tmp_path: Path, text: str, plant: str | None = None) -> Ran:
    lab = make_lab(tmp_path / "lab")
    kinds = lab / "robot" / "containers.yaml"
    kinds.write_text(kinds.read_text() + jar())
    return dry_run(tmp_path, text, lab=lab, controller="adaptive", plant=plant)


def failures(ran: Ran) -> Counter[str]:
    return Counter(row["code"] for row in read(ran.journal, "action") if row["outcome"] == "failed")


def found(lab_folder: LabFolder, kind: str, text: str, *, fast: bool = False) -> list[Problem]:
    kinds = lab_folder.folder / "robot" / "containers.yaml"
    lab_folder.write("robot/containers.yaml", kinds.read_text() + kind)
    lab_folder.write("recipes/jar.yaml", text)
    problems = check(read_lab(lab_folder.folder), lab_folder.folder / "recipes" / "jar.yaml", fast=fast).problems
    return [problem for problem in problems if problem.code in ("no-path", "poor-strokes")]


@pytest.mark.slow
def test_doses_of_a_jar_are_good_as_long_as_check_says_that_it_has_enough(tmp_path: Path) -> None:
    ran = dosed(tmp_path, recipe([500.0, 500.0, 500.0, 250.0, 250.0, 500.0]))
    assert {sample.verdict for sample in ran.result.samples} == {"in tolerance"}
    assert failures(ran)["hand.no_flow"] == 0
    world = ran.session.world
    assert world is not None
    assert world.masses_mg["spilled"] == 0.0


@pytest.mark.slow
def test_a_stroke_begins_with_the_rim_that_the_cone_was_formed_to(tmp_path: Path) -> None:
    """In a jar the sheet must pass the wall: the lip comes to the floor where the rim has closed by some of its way."""
    ran = dosed(tmp_path, recipe([300.0]))
    assert ran.sample("s0").verdict == "in tolerance"
    events = read(ran.journal, "event")
    turned = [row["payload"]["rims_mm"] for row in events if row["kind"] == "arm_moves" and row["payload"]["rims_mm"]]
    forming, stroke, _ = turned
    (scooped,) = [row["payload"] for row in events if row["kind"] == "scoop"]
    assert forming[-1] == stroke[0] == pytest.approx(scooped["open_mm"], abs=0.01)
    assert scooped["open_mm"] < along_floor(ran.session.cell.sources["msg"].mortar, 50.0).open_mm - 1.0


@pytest.mark.slow
def test_a_jar_that_gives_no_more_is_told_to_be_out_of_reach_and_not_of_no_flow(tmp_path: Path) -> None:
    ran = dosed(tmp_path, recipe([500.0] * 9), plant=f"{__name__}:HalfScoops")
    *good, last = [sample for sample in ran.result.samples if sample.verdict != "not run"]
    assert len(good) >= 4
    assert {sample.verdict for sample in good} == {"in tolerance"}
    assert last.code == "source.empty"
    assert "in front of the jar's wall and beside the strokes" in (last.detail or "")
    assert "inventory set mortar_bay MASS --powder monosodium_glutamate --lot L-1" in (last.detail or "")
    assert failures(ran)["hand.no_flow"] == 0


@pytest.mark.slow
@pytest.mark.parametrize(("doses", "is_enough"), [(5, True), (7, False)])
def test_check_counts_on_no_more_of_a_jar_than_its_strokes_bring(
    lab_folder: LabFolder, doses: int, is_enough: bool
) -> None:
    problems = found(lab_folder, jar(), recipe([500.0] * doses))
    assert [problem.mark.file.endswith("jar.yaml") for problem in problems] == [True] * (not is_enough)
    for problem in problems:
        assert re.search(r"are sure to bring 5 of its doses \(2\.6.* of 12\.0000 g in this jar, ", problem.message)
        assert "but 7 (3.6400 g) are needed. The rest lies in front of the wall" in problem.message


@pytest.mark.slow
@pytest.mark.parametrize(("doses", "is_enough"), [(3, True), (4, False)])
def test_check_counts_what_is_thrown_away_of_a_jar(lab_folder: LabFolder, doses: int, is_enough: bool) -> None:
    """Of such a jar three doses came in each of eight dry runs, and four in one that asked for nine."""
    problems = found(lab_folder, jar(), recipe([300.0] * doses) + "leftover: discard\n")
    assert len(problems) == (not is_enough)
    for problem in problems:
        assert "bring 3 of its doses (" in problem.message
        assert "are needed, and what is left of each load is thrown away" in problem.message
        assert "Write `leftover: return`, with which all doses are sure, fill in more" in problem.message


def test_a_jar_is_refilled_before_the_first_dose_that_is_not_sure_to_come(lab_folder: LabFolder) -> None:
    """Not when a fifth of it is left: by then no stroke brings anything."""
    kinds = lab_folder.folder / "robot" / "containers.yaml"
    lab_folder.write("robot/containers.yaml", kinds.read_text() + jar())
    text = recipe([300.0] * 12).replace("amount: 12 g", "amount: 12 g, refill: 6 g")
    lab_folder.write("recipes/jar.yaml", text)
    lab_folder.write("recipes/gone.yaml", text + "leftover: discard\n")
    lab = read_lab(lab_folder.folder)
    first = {}
    for name in ("jar", "gone"):
        plan = make_plan(load_recipe(lab_folder.folder / "recipes" / f"{name}.yaml", lab), lab)
        first[name] = next(job.name for job in plan.jobs if job.workflow == "refill")
    assert first == {"jar": "refill msg for s8", "gone": "refill msg for s3"}


@pytest.mark.slow
def test_a_jar_that_is_refilled_loses_no_dose(tmp_path: Path) -> None:
    text = recipe([300.0] * 12).replace("amount: 12 g", "amount: 12 g, refill: 6 g")
    ran = dosed(tmp_path, text)
    assert {sample.verdict for sample in ran.result.samples} == {"in tolerance"}
    assert [event["payload"]["mass_mg"] for event in read(ran.journal, "event") if event["kind"] == "refilled"] == [6e3]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "said"),
    [
        (
            jar(bore_mm=60.0),
            "cannot move along the floor of a jar of 60 mm bore .*; a bore of 75 mm \\(if there is room for it\\)",
        ),
        (jar(depth_mm=70.0), "flange and mortar_bay wall"),
        (jar(floor_mm=3.0), r"With 'mortar_bay' at \[200 mm, 240 mm, 20 mm\], on a stand of 20 mm, it can scoop there"),
    ],
    ids=["narrow", "deep", "low"],
)
def test_check_says_why_a_jar_cannot_be_scooped_and_what_would_do(lab_folder: LabFolder, kind: str, said: str) -> None:
    (problem,) = found(lab_folder, kind, recipe([100.0]))
    assert re.search(said, problem.message), problem.message


def test_a_jar_with_a_thin_layer_is_warned_of(lab_folder: LabFolder) -> None:
    (problem,) = found(lab_folder, jar(), recipe([300.0], amount_g=3.0), fast=True)
    assert "the first stroke in this jar brings" in problem.message
    assert problem.is_warning
