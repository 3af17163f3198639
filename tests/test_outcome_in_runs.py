"""What the samples of whole dry runs come to: other doses than asked, broken off, of two containers, done again."""

import re
from pathlib import Path

import pytest
from running import dry_run, make_lab

from scuhand_bt.exit_codes import ExitCode

MEASURED = """
workflow: measured
inputs: {source: Source, container: Container, mass: Mass, tolerance: Mass}
tree:
  sequence:
    - place_container: {container: $container}
    - tare:
    - fill: {source: $source, container: $container, mass: 25 mg, as: dose}
    - fill: {source: $source, container: $container, mass: $dose.target}
    - return_leftover: {source: $source}
    - park:
"""
TWIN = """
workflow: twin
inputs: {source: Source, first: Container, second: Container, mass: Mass, tolerance: Mass}
tree:
  sequence:
    - place_container: {container: $first}
    - tare:
    - fill: {source: $source, container: $first, mass: $mass, tolerance: $tolerance}
    - park:
    - place_container: {container: $second}
    - tare:
    - fill: {source: $source, container: $second, mass: $mass, tolerance: $tolerance}
    - return_leftover: {source: $source}
    - park:
    - remove_container:
"""
BROKEN_OFF = """
workflow: broken_off
inputs: {source: Source, container: Container, portion: Mass}
tree:
  sequence:
    - place_container: {container: $container}
    - tare:
    - scoop: {source: $source, wanted: $portion}
    - move_over: {container: $container}
    - WAY
    - park:
"""
LEFT_STANDING = """
workflow: finish_batch
inputs: {source: Source}
tree:
  sequence:
    - return_leftover: {source: $source}
    - park:
"""
RECIPE = """
recipe: outcome
workflow: WORKFLOW
samples: [{id: a, source: beads, container: xrd_holder, mass: 50 mg, tolerance: 2 mg}]
on_failure: {otherwise: flag}
"""


def test_a_workflow_that_dispenses_25_mg_for_a_sample_of_50_mg_is_not_good(tmp_path: Path) -> None:
    """What it was measured to be is known only in the run; what is known before is in test_asked.py."""
    lab = make_lab(tmp_path / "lab", trees__measured=MEASURED)
    ran = dry_run(tmp_path, RECIPE.replace("WORKFLOW", "measured"), lab=lab)
    had = ran.sample("a")
    assert (had.verdict, had.target_mg, had.is_good) == ("not as asked", 50.0, False)
    assert had.dispensed_mg == pytest.approx(25.0, abs=2.0)
    assert [(one.target_mg, one.bracket) for one in had.doses] == [(25.0, "closed")]
    assert ran.result.exit_code == ExitCode.FLAGGED


@pytest.mark.parametrize(
    ("way", "code", "detail"),
    [
        ("optional: {child: TIMED}", "dose.not_reached", "a dose"),
        ("TIMED", "workflow.timeout", "not done after 6 s; a dose"),
    ],
)
def test_a_container_that_a_dose_broke_off_in_is_told_to_hold_powder_and_is_never_good(
    tmp_path: Path, way: str, code: str, detail: str
) -> None:
    """A workflow may go on as if nothing had come, and asks for no mass: no row would tell of it."""
    way = way.replace("TIMED", "{timeout: {duration: 6 s, child: {dispense: {mass: $portion}}}}")
    lab = make_lab(tmp_path / "lab", trees__broken_off=BROKEN_OFF.replace("WAY", way))
    recipe = RECIPE.replace("WORKFLOW", "broken_off").replace("mass: 50 mg, tolerance: 2 mg", "portion: 50 mg")
    ran = dry_run(tmp_path, recipe, lab=lab, controller="adaptive")
    had = ran.sample("a")
    assert (had.verdict, had.code, had.is_good) == ("no dose", code, False)
    seen = "was not weighed; at the balance's last reading it had brought (.+) mg"
    told = re.fullmatch(
        f"{detail} broke off, and {seen}; 'a' holds (.+) mg of glass_beads from a dose that broke off", str(had.detail)
    )
    assert told is not None
    assert had.true_mg is not None
    assert 10.0 < float(told[1]) <= had.true_mg < 50.0
    assert float(told[2]) == pytest.approx(ran.session.world.masses_mg["container:a"], abs=0.5)
    assert ran.result.exit_code == ExitCode.FLAGGED


BROKE_OFF_BEFORE = """
workflow: again
inputs: {source: Source, container: Container, mass: Mass, tolerance: Mass}
tree:
  sequence:
    - place_container: {container: $container}
    - tare:
    - scoop: {source: $source, wanted: $mass}
    - move_over: {container: $container}
    - optional: {child: {timeout: {duration: 5 s, child: {dispense: {mass: $mass, tolerance: $tolerance}}}}}
    - park:
    - AGAIN
    - tare:
    - fill: {source: $source, container: $container, mass: $mass, tolerance: $tolerance}
    - return_leftover: {source: $source}
    - park:
"""


@pytest.mark.parametrize("again", ["wait: {duration: 1 s}", "place_container: {container: $container}"])
def test_what_a_dose_that_broke_off_has_brought_counts_after_a_tare_and_when_its_container_comes_again(
    tmp_path: Path, again: str
) -> None:
    """It was tared away, and the container told good with twice its mass."""
    lab = make_lab(tmp_path / "lab", trees__again=BROKE_OFF_BEFORE.replace("AGAIN", again))
    ran = dry_run(tmp_path, RECIPE.replace("WORKFLOW", "again"), lab=lab, controller="adaptive")
    had = ran.sample("a")
    assert (had.is_good, had.verdict) == (True, "in tolerance")
    assert {one.verdict for one in ran.watching.results} == {"in tolerance"}, (
        "never by what it was before the last dose"
    )
    assert had.true_mg == pytest.approx(50.0, abs=2.0)
    assert had.dispensed_mg == pytest.approx(had.true_mg, abs=0.5)


TWO_VISITS = """
workflow: two_visits
inputs: {source: Source, other: Source, container: Container, second: Container, mass: Mass, tolerance: Mass}
tree:
  sequence:
    - place_container: {container: $container}
    - tare:
    - FIRST
    - park:
    - place_container: {container: $second}
    - tare:
    - fill: {source: $source, container: $second, mass: $mass, tolerance: $tolerance}
    - return_leftover: {source: $source}
    - swap_sheet:
    - park:
    - place_container: {container: $container}
    - tare:
    - fill: {source: $other, container: $container, mass: $mass, tolerance: $tolerance}
    - return_leftover: {source: $other}
    - park:
"""
WHOLE = "fill: {source: $source, container: $container, mass: $mass, tolerance: $tolerance}"
BROKEN = """sequence:
        - scoop: {source: $source, wanted: $mass}
        - move_over: {container: $container}
        - optional: {child: {timeout: {duration: 6 s, child: {dispense: {mass: $mass, tolerance: $tolerance}}}}}"""


@pytest.mark.parametrize(
    ("first", "lots"), [(WHOLE, ["glass_beads", "monosodium_glutamate"]), (BROKEN, ["monosodium_glutamate"])]
)
def test_a_container_that_comes_again_for_another_powder_holds_both(
    tmp_path: Path, first: str, lots: list[str]
) -> None:
    """Of a dose that broke off in it no row tells: what it has brought was counted as the other powder."""
    lab = make_lab(tmp_path / "lab", trees__two_visits=TWO_VISITS.replace("FIRST", first))
    recipe = RECIPE.replace("WORKFLOW", "two_visits").replace(
        "source: beads, container: xrd_holder", "source: beads, other: msg, container: xrd_holder, second: xrd_holder"
    )
    ran = dry_run(tmp_path, recipe, lab=lab, controller="adaptive", seed=2)
    had, world_mg = ran.sample("a"), ran.session.world.masses_mg
    its = {dose.lot: dose for dose in had.doses if dose.container == "a/container"}
    assert list(its) == lots
    assert {dose.bracket for dose in had.doses} == {"closed"}
    assert its["monosodium_glutamate"].dispensed_mg == pytest.approx(50.0, abs=2.0)
    if first is WHOLE:
        assert had.is_good
        assert sum(dose.dispensed_mg for dose in its.values()) == pytest.approx(
            world_mg["container:a/container"], abs=0.6
        )
        return
    assert (had.verdict, had.code, had.is_good) == ("in tolerance", "dose.not_reached", False)
    told = re.fullmatch("'a/container' holds (.+) mg of glass_beads from a dose that broke off", str(had.detail))
    assert told is not None
    held_mg = world_mg["container:a/container"] - its["monosodium_glutamate"].dispensed_mg
    assert float(told[1]) == pytest.approx(held_mg, abs=0.6)


def test_a_sample_whose_container_still_stands_on_the_pan_at_the_end_is_flagged(tmp_path: Path) -> None:
    lab = make_lab(tmp_path / "lab", trees__finish_batch=LEFT_STANDING)
    ran = dry_run(tmp_path, RECIPE.replace("WORKFLOW", "scoop_and_dispense"), lab=lab)
    had = ran.sample("a")
    assert (had.verdict, had.code, had.doses[0].bracket) == ("in tolerance", "balance.bracket_open", "open")
    assert "was not taken off" in str(had.detail)
    assert ran.result.exit_code == ExitCode.FLAGGED
    gone_too = dry_run(tmp_path, RECIPE.replace("WORKFLOW", "scoop_and_dispense"))
    assert (gone_too.sample("a").is_good, gone_too.result.exit_code) == (True, ExitCode.OK)


def test_a_sample_of_two_containers_gives_each_an_id_and_a_result_of_its_own(tmp_path: Path) -> None:
    """Both go within the sample's own job: the bare pan's word waits for its result."""
    lab = make_lab(tmp_path / "lab", trees__twin=TWIN)
    text = RECIPE.replace("WORKFLOW", "twin").replace("container: xrd", "first: xrd_holder, second: xrd")
    ran = dry_run(tmp_path, text, lab=lab)
    had = ran.sample("a")
    assert [(one.container, one.bracket) for one in had.doses] == [("a/first", "closed"), ("a/second", "closed")]
    assert ran.session.world is not None
    for one in had.doses:
        assert ran.session.world.masses_mg[f"container:{one.container}"] == pytest.approx(one.dispensed_mg, abs=0.5)
    assert (had.code, had.is_good, ran.result.exit_code) == (None, True, ExitCode.OK)
    assert had.dispensed_mg == had.doses[1].dispensed_mg
    assert ran.session.cell.believed.closed == ()


SWEEP = """
workflow: finish_batch
inputs: {source: Source}
tree:
  sequence:
    - fill_up: {source: $source}
    - return_leftover: {source: $source}
    - park:
    - remove_container:
"""
FILL_UP = '''
from scuhand_bt.cell.places import over_balance
from scuhand_bt.skill import Cell, Skill, Source, Steps

from .dispense import Dispense
from .scoop import Scoop


class FillUp(Skill[None]):
    """Dose into whatever stands on the pan."""

    devices = ("arm", "hand", "balance")
    source: Source

    def run(self, cell: Cell) -> Steps[None]:
        container = cell.believed.pan
        yield from Scoop(source=self.source).run(cell)
        yield from cell.move_to(over_balance(cell.spec, container)[0])
        yield from Dispense(mass_mg=30.0).run(cell)
'''


UNFILLED = """
workflow: unfilled
inputs: {source: Source, container: Container}
tree: {sequence: [{place_container: {container: $container}}, {tare: }]}
"""


def test_what_a_job_between_samples_doses_is_no_samples_dose_and_waits_for_none(tmp_path: Path) -> None:
    files = {"trees__finish_batch": SWEEP, "trees__unfilled": UNFILLED, "skills__fill_up": FILL_UP}
    lab = make_lab(tmp_path / "lab", **files)
    text = RECIPE.replace("WORKFLOW", "unfilled").replace(", mass: 50 mg, tolerance: 2 mg", "")
    ran = dry_run(tmp_path, text, lab=lab)
    assert ran.session.world is not None
    assert ran.session.world.masses_mg["container:a"] == pytest.approx(30.0, abs=2.0)
    assert (ran.sample("a").verdict, ran.sample("a").doses) == ("no dose", ())
    assert ran.session.cell.believed.closed == ()


AGAIN = """
workflow: again
inputs: {source: Source, container: Container, mass: Mass, tolerance: Mass}
tree:
  sequence:
    - place_container: {container: $container}
    - tare:
    - first_fails: {container: $container}
    - fill: {source: $source, container: $container, mass: $mass, tolerance: $tolerance}
    - park:
    - remove_container:
"""
FIRST_FAILS = '''
from scuhand_bt.skill import Cell, Container, Skill, SkillFailed, Steps


class FirstFails(Skill[None]):
    """Fail with a sample's first container."""

    container: Container

    def run(self, cell: Cell) -> Steps[None]:
        yield from ()
        if "#" not in self.container.id:
            raise SkillFailed("operator.refused", "it has a crack")
'''


def test_a_second_attempt_whose_container_goes_within_its_own_job_is_confirmed(tmp_path: Path) -> None:
    lab = make_lab(tmp_path / "lab", trees__again=AGAIN, skills__first_fails=FIRST_FAILS)
    ran = dry_run(tmp_path, RECIPE.replace("WORKFLOW", "again").replace("flag", "redo"), lab=lab)
    had = ran.sample("a")
    assert (had.attempt, had.code, [(one.container, one.bracket) for one in had.doses]) == (
        2,
        None,
        [("a#2", "closed")],
    )
    assert had.is_good
