"""`check`: everything at once, warnings beside errors, and what a run would refuse before it moves."""

import json
from pathlib import Path

import pytest
from conftest import Call, Desk, LabFolder
from running import dry_run

from harness.own_workflow import RECIPE, TREE, write_own
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.findings import FINDINGS
from scuhand_bt.lab import read_lab
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.checking import check


@pytest.fixture
def lab(lab_folder: LabFolder) -> LabFolder:
    write_own(lab_folder.folder)
    return lab_folder


def checked(command: Call, lab: LabFolder, *options: str) -> tuple[int, list[tuple[str, str, str]]]:
    """The exit code, and what is found: severity, code, and place within the lab."""
    ended = command("check", lab.folder / "recipes" / "one.yaml", "--fast", "--json", *options)
    found = json.loads(ended.stdout)
    assert found["ok"] == (ended.returncode == 0)
    home = f"{lab.folder}/"
    return ended.returncode, [
        (p["severity"], p["code"], f"{p['file'].removeprefix(home)}:{p['line']}:{p['column']}")
        for p in found["problems"]
    ]


def test_a_warning_stops_nothing_and_counts_as_an_error_if_wished(command: Call, lab: LabFolder) -> None:
    lab.write("trees/mine.yaml", TREE.replace("- tare:", "- tare: {as: gross}"))
    warning = ("warning", "unused-result", "trees/mine.yaml:6:18")
    assert checked(command, lab) == (0, [warning])
    assert checked(command, lab, "--strict") == (2, [warning])
    shown = command("check", lab.folder / "recipes" / "one.yaml", "--fast").stdout
    assert (
        "trees/mine.yaml:6:18: warning: the result 'gross' is not used; use $gross, or leave 'as' out [unused-result]"
        in shown
    )
    assert "1 sample, no problem found; 1 warning." in shown


def test_of_many_problems_the_first_are_told_and_the_others_counted(command: Call, lab: LabFolder) -> None:
    rows = [f"  - {{id: s{number}, source: beads, container: xrd_holder, mass: 50}}" for number in range(60)]
    head = (
        "recipe: many\nworkflow: fill_xrd_holder\nsources:\n"
        "  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 5 g}\nsamples:\n"
    )
    recipe = lab.write("recipes/many.yaml", head + "\n".join(rows) + "\n")
    *told, rest, count = command("check", recipe, "--fast").stdout.splitlines()
    assert len(told) == 50
    assert all("'50' has no unit" in line for line in told)
    assert "10 more" in rest
    assert count == "60 problems; nothing was moved."
    assert len(json.loads(command("check", recipe, "--fast", "--json").stdout)["problems"]) == 60
    *told, rest, count = command("run", recipe, "--dry-run").stderr.splitlines()
    assert (len(told), count) == (50, "60 problems; nothing was moved.")


def test_a_warning_is_silenced_on_its_own_line_only(command: Call, lab: LabFolder) -> None:
    silenced = TREE.replace("- tare:", "- tare: {as: gross}   # ok: unused-result")
    lab.write("trees/mine.yaml", silenced)
    assert checked(command, lab, "--strict") == (0, [])
    lab.write("trees/mine.yaml", TREE.replace("- tare:", "# ok: unused-result\n    - tare: {as: gross}"))
    assert [code for _, code, _ in checked(command, lab)[1]] == ["unused-silencer", "unused-result"]


def test_no_timeout_is_too_short_for_a_skill_that_says_nothing_of_its_time(command: Call, lab: LabFolder) -> None:
    text = (lab.folder / "skills/wait.py").read_text(encoding="utf-8").replace("class Wait", "class Blink")
    begin, end = text.index("    @classmethod"), text.index("    def run")
    silent = text[:begin] + text[end:].replace("self.duration_s", "1.0")
    silent = silent.replace("    duration_s: Annotated[Seconds, Field(ge=0)]\n", "")
    tree = "workflow: t\ntree: {timeout: {duration: 1 s, child: {blink: }}}\n"
    lab.write("trees/t.yaml", tree)
    for skill, is_warned in (
        (silent, False),
        (silent.replace("    def run", "    typical_s = 5.0\n\n    def run"), True),
    ):
        lab.write("skills/blink.py", skill)
        assert ("[short-timeout]" in command("check", "--lab", lab.folder).stdout) == is_warned


def test_an_error_cannot_be_silenced(command: Call, lab: LabFolder) -> None:
    lab.write("trees/mine.yaml", TREE.replace("- park:", "- prk:   # ok: unknown-name"))
    assert checked(command, lab) == (2, [("error", "unknown-name", "trees/mine.yaml:8:7")])


def test_problems_of_recipe_tables_workflows_skills_and_lab_are_told_in_one_pass(command: Call, lab: LabFolder) -> None:
    lab.write("recipes/one.yaml", RECIPE.replace("50 mg", "50") + "  - {table: t.csv}\nfoo: 1\n")
    lab.write("recipes/t.csv", "id,source,container,mass [mg]\nb,beads,bottle,60\n")
    lab.write("trees/mine.yaml", TREE.replace("$source,", "$sorce,").replace("    - park:\n", "    - prk:\n"))
    lab.replace("robot/cell.yaml", "slots: 24", "slots: many")
    lab.replace("robot/powders.yaml", "repose: 25 deg", "repose: 25 mm")
    lab.replace("skills/tare.py", "yield from weigh_until", "yield weigh_until")
    code, found = checked(command, lab)
    assert code == 2
    assert {(severity, one, place.rsplit(":", 2)[0]) for severity, one, place in found} == {
        ("error", "bad-value", "recipes/one.yaml"),
        ("error", "unknown-key", "recipes/one.yaml"),
        ("error", "unknown-name", "recipes/t.csv"),
        ("error", "unknown-value", "trees/mine.yaml"),
        ("error", "unknown-name", "trees/mine.yaml"),
        ("error", "bad-value", "robot/cell.yaml"),
        ("error", "bad-unit", "robot/powders.yaml"),
        ("error", "skill-yield", "skills/tare.py"),
    }


def test_what_is_wrong_where_the_recipe_does_not_look_is_a_warning(command: Call, lab: LabFolder) -> None:
    lab.write("trees/half.yaml", "workflow: half\ntree:\n  sequence:\n")
    assert checked(command, lab) == (0, [("warning", "bad-node", "trees/half.yaml:3:12")])
    assert command("check", "--lab", lab.folder).returncode == 2, "the lab by itself is checked whole"


def test_every_finding_is_explained_and_has_its_section(command: Call) -> None:
    for code in ("no-tare", "skill-lease"):
        assert FINDINGS[code].meaning in command("explain", code).stdout
    assert json.loads(command("explain", "no-tare", "--json").stdout)["no-tare"]["is_warning"] is True


@pytest.mark.slow
def test_a_mortar_half_in_the_shield_is_found_before_a_run_refuses_it(command: Call, lab: LabFolder) -> None:
    shield = "  - {name: shield, box: [6 mm, 300 mm, 400 mm], at: [200 mm, 240 mm, 200 mm]}\n"
    cell = (lab.folder / "robot" / "cell.yaml").read_text(encoding="utf-8")
    lab.write("robot/cell.yaml", cell + shield)
    recipe = lab.folder / "recipes" / "one.yaml"
    assert command("run", recipe, "--dry-run", "--quiet").returncode == 2
    ended = command("check", recipe)
    assert ended.returncode == 2
    assert "robot/cell.yaml:13:43: the arm cannot stand at mortar_bay" in ended.stdout
    assert "[no-path]" in ended.stdout
    assert command("check", recipe, "--fast").returncode == 0, "the ways are what it leaves out"


def test_ways_that_were_found_are_not_looked_for_again_until_the_cell_changes(
    lab: LabFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    recipe = lab.folder / "recipes" / "one.yaml"
    assert check(read_lab(lab.folder), recipe).problems == ()
    looked: list[object] = []

    def refused(*given: object, **_: object) -> None:
        looked.append(given)
        raise SkillFailed(Code.ARM_NO_PATH, "looked for")

    monkeypatch.setattr("scuhand_bt.run.prepared_motion.prepared_motion", refused)
    check(read_lab(lab.folder), recipe)
    assert looked == []
    lab.replace("robot/cell.yaml", "[180 mm, 0 mm, 180 mm]", "[181 mm, 0 mm, 180 mm]")
    check(read_lab(lab.folder), recipe)
    assert len(looked) == 1


# --- by types


BLEND = """\
workflow: blend
inputs: {first: Source, then: Source, vial: Container, mass_first: Mass, mass_then: Mass}
tree:
  sequence:
    - place_container: {container: $vial}
    - tare:
    - fill: {source: $then, container: $vial, mass: $mass_then}
    - change_powder: {source: $then}
    - fill: {source: $first, container: $vial, mass: $mass_first}
    - return_leftover: {source: $first}
    - park:
"""
TWO = """\
recipe: two
workflow: blend
order: as_written
sources:
  a: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 5 g}
  b: {station: mortar_bay_2, container: agate_mortar, powder: monosodium_glutamate, amount: 5 g}
defaults: {first: a, then: b, vial: alumina_crucible, mass_first: 600 mg, mass_then: 40 mg}
samples: [{id: x}, {id: y}]
"""


def test_demand_and_the_order_of_sheets_follow_the_wires_whatever_they_are_called(lab: LabFolder) -> None:
    lab.write("trees/blend.yaml", BLEND)
    loaded = lab.load()
    plan = make_plan(load_recipe(lab.write("recipes/two.yaml", TWO), loaded), loaded)
    needed = {demand.source.name: demand.needed_mg for demand in plan.demands}
    assert needed == {"a": 2 * 620.0, "b": 2 * 60.0}
    assert [job.name for job in plan.jobs] == [
        "x",
        "change powder to monosodium_glutamate for y",
        "y",
        "finish the batch",
    ]
    assert [job.inputs["source"].name for job in plan.jobs if job.sample is None] == ["a", "a"]


def test_two_containers_are_each_reckoned_by_what_goes_into_them(lab: LabFolder) -> None:
    lab.write(
        "trees/split.yaml",
        "workflow: split\ninputs: {from: Source, one: Container, other: Container, little: Mass, much: Mass}\n"
        "tree:\n  sequence:\n"
        + "".join(
            f"    - place_container: {{container: ${which}}}\n    - tare:\n"
            f"    - fill: {{source: $from, container: ${which}, mass: ${mass}}}\n"
            for which, mass in (("one", "little"), ("other", "much"))
        )
        + "    - park:\n",
    )
    source = RECIPE.split("samples:")[0].replace("mine", "split")
    sample = "samples:\n  - {id: a, from: beads, one: xrd_holder, other: alumina_crucible, little: 50 mg, much: 2 g}\n"
    path = lab.write("recipes/one.yaml", source + sample)
    assert check(read_lab(lab.folder), path, fast=True).problems == ()
    lab.write(
        "recipes/one.yaml",
        source + sample.replace("one: xrd_holder, other: alumina", "other: xrd_holder, one: alumina"),
    )
    (problem,) = check(read_lab(lab.folder), path, fast=True).problems
    assert problem.code == "container-overfull"
    assert "2.0000 g of glass_beads" in problem.message


# --- leases while a run goes on


GRAB = """\
from scuhand_bt.skill import Cell, Skill, Steps


class Grab(Skill[None]):
    \"\"\"Use a device by a way that no check follows.\"\"\"

    devices = ("hand",)

    def run(self, cell: Cell) -> Steps[None]:
        yield from ()
        getattr(cell, "USED")
"""


@pytest.mark.parametrize("used", ["arm", "balance", "move_to", "touch"])
def test_a_skill_that_gets_at_a_device_it_has_not_leased_breaks_the_run_by_name(
    lab: LabFolder, tmp_path: Path, used: str
) -> None:
    lab.write("skills/grab.py", GRAB.replace("USED", used))
    lab.write("trees/mine.yaml", TREE.replace("    - park:\n", "    - grab:\n    - park:\n"))
    ran = dry_run(tmp_path, RECIPE, lab=lab.folder)
    device = "balance" if used == "balance" else "arm"
    assert f"the skill grab broke: NotLeased: it uses the {device}" in str(ran.result.reason)


def test_a_skill_has_the_devices_that_it_leases(lab: LabFolder, tmp_path: Path) -> None:
    lab.write("skills/grab.py", GRAB.replace("USED", "hand"))
    lab.write("trees/mine.yaml", TREE.replace("    - park:\n", "    - grab:\n    - park:\n"))
    assert dry_run(tmp_path, RECIPE, lab=lab.folder).sample("a").dispensed_mg is not None


@pytest.mark.usefixtures("desk")
def test_a_default_that_belongs_at_the_top_is_sent_there(desk: Desk) -> None:
    text = RECIPE.replace("workflow: mine\n", "").replace("samples:", "defaults: {workflow: fill_xrd_holder}\nsamples:")
    assert any("write it at the top of the recipe" in problem for problem in desk.problems(text))
