"""A sample's result: by what the recipe asks, for every powder lot, and after its container has gone."""

import io
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from dose_bench import DISH
from rich.console import Console
from running import dry_run, make_lab

from scuhand_bt.cell.pan_bracket import ClosedBracket
from scuhand_bt.dosing.bracket import Net
from scuhand_bt.dosing.verdict import judge
from scuhand_bt.events.doses import Dose
from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.failures import SkillFailed
from scuhand_bt.journal.results import SampleResult, SampleVerdict, SoFar
from scuhand_bt.problems import Mark
from scuhand_bt.recipe.composition import ComposedPowder, Composition, ElementShare
from scuhand_bt.recipe.sample import Sample
from scuhand_bt.report.doses import doses_table, said_of
from scuhand_bt.report.live import PlainLines
from scuhand_bt.report.picture import in_words
from scuhand_bt.run.outcome import confirmed, doubted, inputs_for, sample_result
from scuhand_bt.specs import Container

A = DISH.model_copy(update={"id": "a"})
BEADS, SALT = "glass_beads", "monosodium_glutamate"


FIRST, SECOND = (A.model_copy(update={"id": f"a/{name}"}) for name in ("first", "second"))


def sample(mass_mg: float | None = 50.0, tolerance_mg: float | None = 2.0, **containers: Container) -> Sample:
    asked = {"mass": mass_mg, "tolerance": tolerance_mg}
    inputs = {name: value for name, value in asked.items() if value is not None}
    return Sample(Mark("recipe"), "a", "blend", {**(containers or {"container": A}), **inputs}, ())


def dose(
    dispensed_mg: float,
    target_mg: float = 50.0,
    *,
    tolerance_mg: float = 2.0,
    lot: str = BEADS,
    container: str = "a",
    uncertainty_mg: float = 0.25,
) -> Dose:
    return Dose(
        container=container,
        lot=lot,
        target_mg=target_mg,
        tolerance_mg=tolerance_mg,
        dispensed_mg=dispensed_mg,
        uncertainty_mg=uncertainty_mg,
        pulses=3,
        vibration_s=1.5,
        duration_s=20.0,
        controller="adaptive",
        verdict=judge(target_mg, tolerance_mg, dispensed_mg, uncertainty_mg),
    )


COUNTS: Any = {"scoops": 1, "duration_s": 60.0, "true_mg": {}}


def result(
    *doses: Dose,
    of: Sample | None = None,
    verdict: SampleVerdict | None = None,
    failure: SkillFailed | None = None,
) -> SampleResult:
    return sample_result(of or sample(), SoFar(list(doses)), verdict, failure, **COUNTS, attempt=1)


def gone(closes: bool = True, container: str = "a", **masses_mg: float) -> ClosedBracket:
    """What the bare pan made of a container's doses."""
    nets = {lot: Net(mass_mg, 0.1) for lot, mass_mg in masses_mg.items()}
    return ClosedBracket(container, nets, closes, 0.0, "3 mg are nobody's")


def test_what_is_over_or_under_only_for_what_is_not_known_of_it_is_said_to_be_so() -> None:
    sure, unsure, under = dose(55.0), dose(50.0, uncertainty_mg=17.0), dose(48.9, uncertainty_mg=0.5)
    assert [said_of(result(one)) for one in (sure, unsure, under)] == ["over", "under, not surely", "under, not surely"]
    both = result(dose(50.0), dose(500.3, 500.0, lot=SALT, uncertainty_mg=3.0))
    assert (both.verdict, said_of(both)) == ("over", "over, not surely"), "which of its doses are not known"
    assert said_of(result(sure, dose(500.3, 500.0, lot=SALT, uncertainty_mg=3.0))) == "over", "one of which surely is"
    assert said_of(result(dose(50.4))) == "in tolerance"
    assert "-1.1 mg) in 3 pulses, 1 min 00 s: under, not surely" in in_words(result(under))


def test_what_the_recipe_asks_is_what_the_sample_has() -> None:
    had = result(dose(50.4))
    assert (had.target_mg, had.dispensed_mg, had.error_mg) == (50.0, 50.4, pytest.approx(0.4))
    assert (had.tolerance_mg, had.uncertainty_mg, had.verdict) == (2.0, 0.25, "in tolerance")
    assert (had.pulses, had.vibration_s, had.controller, had.container) == (3, 1.5, "adaptive", DISH.name)
    assert not had.is_good, "its container has not gone yet"
    assert confirmed(had, gone(glass_beads=50.4)).is_good


def test_a_dose_of_another_mass_than_the_recipe_asks_is_not_as_asked() -> None:
    had = result(dose(25.0, 25.0))
    assert (had.verdict, had.target_mg, had.dispensed_mg, had.error_mg) == ("not as asked", 50.0, 25.0, -25.0)
    after = confirmed(had, gone(glass_beads=25.1))
    assert (after.verdict, after.dispensed_mg, after.is_good) == ("not as asked", 25.1, False)
    assert after.error_mg == pytest.approx(-24.9)


def test_the_asked_mass_in_a_container_that_is_not_the_samples_own_is_not_as_asked() -> None:
    assert result(dose(50.0, container="b")).verdict == "not as asked"
    assert result(dose(50.0, container="b"), of=sample(container=A, waste=FIRST)).verdict == "not as asked"
    assert result(dose(50.0, container="a/first"), of=sample(container=A, waste=FIRST)).verdict == "not as asked"
    assert result(dose(50.0, container="a/second"), of=sample(first=FIRST, second=SECOND)).verdict == "in tolerance"
    none = replace(sample(), inputs={"mass": 50.0})
    assert result(dose(50.0, container="b"), of=none).verdict == "in tolerance", "it has no container of its own"
    again = sample_result(sample(), SoFar([dose(50.0, container="a#2")]), None, None, **COUNTS, attempt=2)
    assert again.verdict == "in tolerance"


def test_of_several_doses_that_are_not_as_asked_the_sample_stands_by_the_last() -> None:
    had = result(dose(20.0, 20.0), dose(31.0, 30.0, lot=SALT), dose(11.0, 10.0, lot="flour"))
    assert (had.verdict, had.dispensed_mg, had.error_mg) == ("not as asked", 11.0, -39.0)


def test_a_tolerance_that_the_workflow_loosened_is_held_against_the_recipes() -> None:
    had = result(dose(53.0, tolerance_mg=5.0))
    assert (had.verdict, had.tolerance_mg) == ("over", 2.0)
    assert result(dose(53.0, 50.0 * (1.0 + 1e-12), tolerance_mg=5.0)).verdict == "over", (
        "a rounding makes no other mass"
    )


def test_a_dose_that_the_recipe_does_not_ask_for_keeps_the_tolerance_that_it_was_given() -> None:
    had = result(dose(50.5), dose(44.0, 40.0, lot=SALT, tolerance_mg=5.0))
    assert [(one.tolerance_mg, one.verdict) for one in had.doses] == [(2.0, "in tolerance"), (5.0, "in tolerance")]


def test_a_tolerance_that_the_workflow_tightened_stays_tight() -> None:
    had = result(dose(51.2, tolerance_mg=1.0))
    assert (had.verdict, had.tolerance_mg) == ("over", 1.0)


def test_a_workflow_that_asks_no_mass_is_judged_by_its_own_doses() -> None:
    had = result(dose(25.0, 25.0, tolerance_mg=1.0), of=sample(None, None))
    assert (had.verdict, had.target_mg, had.tolerance_mg) == ("in tolerance", 25.0, 1.0)
    assert result(of=sample(None, None)).is_good
    assert not result().is_good, "a mass was asked"
    nothing = result()
    assert (nothing.verdict, nothing.target_mg, nothing.dispensed_mg) == ("no dose", 50.0, None)
    assert (nothing.pulses, nothing.vibration_s) == (0, 0.0)
    assert confirmed(nothing, gone()) == nothing


def test_pulses_and_vibration_are_those_of_all_doses_whichever_the_recipe_asks_for() -> None:
    asked = dose(50.4)
    second = dose(40.2, 40.0, lot=SALT).model_copy(update={"pulses": 5, "vibration_s": 9.5})  # those before it counted
    had = result(asked, second)
    assert (had.dispensed_mg, had.pulses, had.vibration_s) == (50.4, 5, 9.5)
    other = dose(50.1, container="a/second").model_copy(update={"pulses": 2, "vibration_s": 0.5})
    two = result(dose(50.0, container="a/first"), other, of=sample(first=FIRST, second=SECOND))
    assert (two.pulses, two.vibration_s) == (5, 2.0)


def test_the_last_dose_of_a_lot_counts_for_all_of_its_parts() -> None:
    had = result(dose(20.0), dose(50.5))
    assert [(one.lot, one.dispensed_mg) for one in had.doses] == [(BEADS, 50.5)]
    assert had.verdict == "in tolerance"


def test_every_lot_has_a_row_and_the_sample_stands_by_the_one_that_the_recipe_asks_for() -> None:
    had = result(dose(50.5), dose(40.2, 40.0, lot=SALT))
    assert [(one.container, one.lot, one.target_mg) for one in had.doses] == [("a", BEADS, 50.0), ("a", SALT, 40.0)]
    assert (had.target_mg, had.dispensed_mg, had.verdict) == (50.0, 50.5, "in tolerance")


def test_a_sample_is_good_only_when_all_of_its_lots_are() -> None:
    had = result(dose(50.5), dose(45.0, 40.0, lot=SALT))
    assert [one.verdict for one in had.doses] == ["in tolerance", "over"]
    assert had.verdict == "over"
    assert not confirmed(had, gone(glass_beads=50.5, monosodium_glutamate=45.0)).is_good
    both = result(dose(50.5), dose(40.2, 40.0, lot=SALT))
    assert confirmed(both, gone(glass_beads=50.5, monosodium_glutamate=40.2)).is_good


def test_each_of_two_containers_has_to_be_seen_to_go() -> None:
    had = result(
        dose(50.5, container="a/first"), dose(50.1, container="a/second"), of=sample(first=FIRST, second=SECOND)
    )
    assert [one.container for one in had.doses] == ["a/first", "a/second"]
    one = confirmed(had, gone(container="a/first", glass_beads=50.6))
    assert [(dose.bracket, dose.dispensed_mg) for dose in one.doses] == [("closed", 50.6), ("open", 50.1)]
    assert (one.is_good, one.dispensed_mg) == (False, 50.1)
    both = confirmed(one, gone(container="a/second", glass_beads=50.2))
    assert (both.is_good, both.dispensed_mg, both.uncertainty_mg) == (True, 50.2, 0.1)


@pytest.mark.parametrize("first_mg", [45.0, 55.0])
def test_a_sample_with_a_dose_too_large_and_one_too_small_is_over(first_mg: float) -> None:
    found = result(dose(first_mg), dose(100.0 - first_mg, lot=SALT))
    assert [one.verdict for one in found.doses] in (["under", "over"], ["over", "under"])
    assert found.verdict == "over"


def test_the_bare_pan_adjusts_the_mass_and_may_change_the_verdict() -> None:
    had = result(dose(51.6))
    assert had.verdict == "over"
    after = confirmed(had, gone(glass_beads=51.4))
    assert (after.dispensed_mg, after.error_mg, after.uncertainty_mg) == (51.4, pytest.approx(1.4), 0.1)
    assert (after.verdict, after.code, after.is_good) == ("in tolerance", None, True)
    assert after.doses[0].verdict == "in tolerance"
    assert confirmed(result(dose(51.4)), gone(glass_beads=51.9)).verdict == "over"


def test_a_bracket_that_does_not_close_flags_the_sample_and_says_why() -> None:
    after = confirmed(result(dose(50.0)), gone(closes=False, glass_beads=51.0))
    assert (after.code, after.detail) == ("balance.bracket_open", "3 mg are nobody's")
    assert (after.verdict, after.doses[0].bracket, after.is_good) == ("in tolerance", "does not close", False)


def test_a_second_container_that_closes_does_not_take_back_what_the_first_has_shown() -> None:
    two = sample(first=FIRST, second=SECOND)
    had = result(dose(50.0, container="a/first"), dose(50.0, container="a/second"), of=two)
    after = confirmed(had, gone(closes=False, container="a/first", glass_beads=51.0))
    after = confirmed(after, gone(container="a/second", glass_beads=50.0))
    assert (after.code, after.is_good) == ("balance.bracket_open", False)


def test_a_container_that_has_gone_twice_has_to_close_both_times() -> None:
    after = confirmed(result(dose(50.0)), gone(closes=False, glass_beads=40.0))
    after = confirmed(after, gone(glass_beads=50.0))
    assert (after.code, after.doses[0].bracket, after.is_good) == ("balance.bracket_open", "does not close", False)


def test_a_sample_flagged_while_its_bracket_was_open_is_good_when_it_has_closed() -> None:
    had = result(dose(50.0)).model_copy(update={"code": "balance.bracket_open", "detail": "it was not taken off"})
    after = confirmed(had, gone(glass_beads=50.1))
    assert (after.code, after.detail, after.is_good) == (None, None, True)


def test_a_sample_flagged_while_its_brackets_were_open_stays_so_until_all_have_closed() -> None:
    two = sample(first=FIRST, second=SECOND)
    had = result(dose(50.0, container="a/first"), dose(50.0, container="a/second"), of=two)
    had = had.model_copy(update={"code": "balance.bracket_open", "detail": "it was not taken off"})
    one = confirmed(had, gone(container="a/first", glass_beads=50.1))
    assert (one.code, one.detail) == ("balance.bracket_open", "it was not taken off")
    assert confirmed(one, gone(container="a/second", glass_beads=50.1)).is_good


def test_a_step_that_the_run_has_seen_is_in_the_uncertainty_of_a_dose_and_may_change_its_verdict() -> None:
    had = confirmed(result(dose(50.4)), gone(glass_beads=50.4))
    small = doubted(had, 0.2, 0.0)
    assert (small.uncertainty_mg, small.verdict) == (pytest.approx(math.hypot(0.1, 0.43)), "in tolerance")
    assert (small.code, small.is_good, small.dispensed_mg) == (None, True, 50.4)
    large = doubted(small, 0.5, 0.0)
    assert (large.uncertainty_mg, large.verdict) == (pytest.approx(math.hypot(0.1, 1.075)), "over")
    assert (large.code, large.doses[0].verdict, large.is_good) == ("balance.bracket_open", "over", False)
    assert large.detail == (
        "the balance's zero was seen to step by 0.50 mg (or its display held back that much) in this run, "
        "and may have done so in this dose, too"
    )
    assert large.doses[0].uncertainty_mg == large.uncertainty_mg
    assert doubted(large, 0.3, 0.0) is large, "what was seen stays seen"


def test_a_drift_that_the_run_has_seen_counts_by_how_long_a_dose_took() -> None:
    had = confirmed(result(dose(50.4).model_copy(update={"lasted_s": 20.0})), gone(glass_beads=50.4))
    slow = doubted(had, 0.0, 0.01)
    assert (slow.uncertainty_mg, slow.verdict) == (pytest.approx(math.hypot(0.1, 0.43)), "in tolerance")
    fast = doubted(slow, 0.0, 0.04)
    assert (fast.verdict, fast.code) == ("over", "balance.bracket_open")
    seen = "the balance's zero was seen to drift by 0.040 mg/s in this run"
    assert fast.detail == f"{seen}, and may have done so in this dose, too"


def test_a_drift_longer_than_from_one_look_at_the_pan_to_the_next_would_have_shown_in_the_dose_itself() -> None:
    """Doses of a quarter of an hour were uncertain by 30 to 200 mg as a few milligrams had dripped in another one."""
    had = confirmed(result(dose(50.4).model_copy(update={"lasted_s": 900.0})), gone(glass_beads=50.4))
    seen = doubted(had, 0.0, 0.01)
    assert seen.uncertainty_mg == pytest.approx(math.hypot(0.1, 2.15 * 0.01 * 38.0))


def test_without_a_step_or_while_the_container_still_stands_a_result_is_as_it_was() -> None:
    had = result(dose(50.4))
    assert doubted(had, 3.0, 0.0) is had
    closed = confirmed(had, gone(glass_beads=50.4))
    assert doubted(closed, 0.0, 0.0) is closed


def test_a_dose_that_a_step_makes_doubtful_keeps_the_code_that_it_had() -> None:
    had = confirmed(result(dose(50.0)), gone(closes=False, glass_beads=51.0))
    assert (doubted(had, 3.0, 0.0).code, doubted(had, 3.0, 0.0).detail) == (had.code, had.detail)
    halted = confirmed(result(dose(50.0), verdict="interrupted"), gone(glass_beads=50.1))
    assert (doubted(halted, 3.0, 0.0).verdict, doubted(halted, 3.0, 0.0).code) == ("interrupted", None)


def test_what_failed_otherwise_keeps_its_own_code_and_verdict() -> None:
    failure = SkillFailed("dose.overshoot", "too much")
    over = confirmed(result(dose(53.0), failure=failure), gone(closes=False, glass_beads=53.1))
    assert (over.code, over.detail, over.verdict) == ("dose.overshoot", "too much", "over")
    closed = confirmed(result(dose(53.0), failure=failure), gone(glass_beads=53.1))
    assert (closed.code, closed.doses[0].bracket, closed.is_good) == ("dose.overshoot", "closed", False)
    halted = confirmed(result(dose(50.0), verdict="interrupted"), gone(glass_beads=50.1))
    assert (halted.verdict, halted.dispensed_mg, halted.is_good) == ("interrupted", 50.1, False)


def test_a_second_attempt_is_for_containers_with_ids_of_their_own() -> None:
    two = sample(first=A, second=SECOND)
    ids = [
        [value.id for value in inputs_for(two, attempt).values() if isinstance(value, Container)] for attempt in (1, 2)
    ]
    assert ids == [["a", "a/second"], ["a#2", "a/second#2"]]


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


def test_plain_lines_tell_a_sample_once_and_again_only_when_its_bracket_flags_it() -> None:
    lines: list[str] = []
    observer, had = PlainLines(lines.append, 1), result(dose(50.4))
    observer.sample_ended(had)
    observer.sample_ended(confirmed(had, gone(glass_beads=50.4)))
    assert lines == ["[1/1] a: 50.4 mg of 50.0 mg (+0.4 mg) in 3 pulses, 1 min 00 s: in tolerance"]
    observer.sample_ended(confirmed(had, gone(closes=False, glass_beads=53.4)))
    assert lines[1:] == [f"{lines[0]} (balance.bracket_open: 3 mg are nobody's)"]


def test_plain_lines_tell_a_bad_sample_again_only_when_there_is_something_else_to_tell() -> None:
    lines: list[str] = []
    observer, had = PlainLines(lines.append, 1), result(dose(90.4))
    observer.sample_ended(had)
    observer.sample_ended(confirmed(had, gone(glass_beads=90.4)))
    assert lines == ["[1/1] a: 90.4 mg of 50.0 mg (+40.4 mg) in 3 pulses, 1 min 00 s: over"]
    observer.sample_ended(confirmed(had, gone(glass_beads=90.1)))
    assert [line.split(" mg")[0] for line in lines[1:]] == ["[1/1] a: 90.1"]


def test_plain_lines_tell_that_a_sample_which_was_not_surely_in_tolerance_is() -> None:
    """The bare pan is surer than the dose was, and without it the log ended with a sample that was good as `under`."""
    lines: list[str] = []
    observer, unsure = PlainLines(lines.append, 1), result(dose(48.5, uncertainty_mg=0.4))
    observer.sample_ended(unsure)
    observer.sample_ended(confirmed(unsure, gone(glass_beads=48.5)))
    assert [line.rpartition(": ")[2] for line in lines] == ["under, not surely", "in tolerance"]


def test_plain_lines_tell_the_good_end_of_a_sample_that_was_done_again() -> None:
    """Whose container has gone within its own job, so that it is known to be good at once."""
    lines: list[str] = []
    observer = PlainLines(lines.append, 1)
    observer.sample_ended(result(dose(90.4)))
    again = confirmed(result(dose(50.4)), gone(glass_beads=50.4)).model_copy(update={"attempt": 2})
    observer.sample_ended(again)
    assert lines[1:] == ["[1/1] a: 50.4 mg of 50.0 mg (+0.4 mg) in 3 pulses, 1 min 00 s: in tolerance"]


def test_a_sample_of_several_doses_is_told_with_each_of_them() -> None:
    lines: list[str] = []
    of_lots, two = result(dose(50.4), dose(45.0, 40.0, lot=SALT)), sample(first=FIRST, second=SECOND)
    of_containers = result(dose(50.4, container="a/first"), dose(47.0, container="a/second"), of=two)
    for had in (of_lots, of_containers):
        PlainLines(lines.append, 1).sample_ended(had)
    assert lines == [
        "[1/1] a: glass_beads 50.4 mg of 50.0 mg (+0.4 mg), in tolerance; monosodium_glutamate 45.0 mg of 40.0 mg "
        "(+5.0 mg), over; in 3 pulses, 1 min 00 s: over",
        "[1/1] a: a/first: glass_beads 50.4 mg of 50.0 mg (+0.4 mg), in tolerance; a/second: glass_beads 47.0 mg of "
        "50.0 mg (-3.0 mg), under; in 6 pulses, 1 min 00 s: under",
    ]


def test_every_dose_has_its_row_in_a_narrow_terminal_too() -> None:
    console = Console(file=io.StringIO(), width=80)
    console.print(doses_table([result(dose(50.4), dose(45.0, 40.0, lot=SALT))], 80))
    rows = [line.split() for line in console.file.getvalue().splitlines()]  # type: ignore[attr-defined]
    assert rows[2:] == [
        ["a", "60", "over"],
        [BEADS, "50.0", "mg", "50.4", "mg", "+0.4", "±", "0.2", "in", "tolerance"],
        [SALT, "40.0", "mg", "45.0", "mg", "+5.0", "±", "0.2", "over"],
    ]


def test_what_the_simulation_has_in_each_container_stands_by_its_doses() -> None:
    held = {"a/first": 51.0, "a/second": 49.0, "a/third": 0.0}
    two = sample(first=FIRST, second=SECOND)
    doses = [dose(50.0, container="a/second"), dose(25.0, 25.0, container="a/first")]
    had = sample_result(two, SoFar(list(doses)), None, None, **COUNTS | {"true_mg": held}, attempt=1)
    assert ([one.true_mg for one in had.doses], had.true_mg) == ([49.0, 51.0], 49.0)
    none = sample_result(two, SoFar(), None, None, **COUNTS | {"true_mg": held}, attempt=1)
    assert none.true_mg == 51.0, "the first container's, where nothing was dosed"
    assert result(dose(50.0)).true_mg is None


def test_a_dose_that_is_near_half_its_tolerance_from_the_bare_pans_word_is_flagged_whatever_chance_allows() -> None:
    near = replace(gone(glass_beads=50.4), difference_mg=1.0)
    assert confirmed(result(dose(50.4)), near).is_good
    far = confirmed(result(dose(50.4)), replace(near, difference_mg=1.01))
    assert (far.code, far.dispensed_mg, far.doses[0].bracket) == ("balance.bracket_open", 50.4, "does not close")


# --- composed samples

COMPOSED = Composition(
    product="LiCoO2",
    tolerance=0.02,
    powders=tuple(
        ComposedPowder(
            lot=lot,
            formula="",
            target_mg=mass_mg,
            tolerance_mg=2.0,
            mg_per_mmol=50.0,
            assay_uncertainty=0.0,
            counts=counts,
        )
        for lot, mass_mg, counts in ((BEADS, 100.0, {"Li": 1.0}), (SALT, 200.0, {"Co": 0.5}))
    ),
    elements=(ElementShare(element="Li", asked=1.0), ElementShare(element="Co", asked=1.0)),
)
BLEND = replace(sample(None, None), composition=COMPOSED)
BOTH = (dose(100.4, 100.0, uncertainty_mg=0.1), dose(199.5, 200.0, lot=SALT, uncertainty_mg=0.1))


def reached_by(result: SampleResult) -> tuple[str, list[float | None]]:
    assert result.composition is not None
    return result.composition.verdict, [one.reached for one in result.composition.elements]


def test_a_composed_sample_is_what_its_confirmed_doses_come_to() -> None:
    before = result(*BOTH, of=BLEND)
    whole = 100.4 + 0.5 * 199.5
    wanted = [pytest.approx(2 * part / whole) for part in (100.4, 0.5 * 199.5)]
    assert reached_by(before) == ("open", wanted)
    assert (before.verdict, before.is_open, before.is_good) == ("in tolerance", True, False)
    after = confirmed(before, gone(**{BEADS: 100.6, SALT: 199.5}))
    whole = 100.6 + 0.5 * 199.5
    assert reached_by(after) == ("in tolerance", [pytest.approx(2 * part / whole) for part in (100.6, 0.5 * 199.5)])
    assert after.is_good


def test_what_the_run_sees_of_the_zero_is_in_the_uncertainty_of_a_composition() -> None:
    before = confirmed(result(*BOTH, of=BLEND), gone(**{BEADS: 100.4, SALT: 199.5}))
    after = doubted(before, 3.0, 0.0)
    u = [[one.uncertainty for one in which.composition.elements] for which in (before, after) if which.composition]
    assert all(now > 10 * then for then, now in zip(*u, strict=True) if then and now)
    assert reached_by(after)[0] == "out of tolerance", "2 % is not told with 3 mg of 100"


def test_a_bracket_that_does_not_close_takes_back_what_was_said_of_a_composition() -> None:
    after = confirmed(result(*BOTH, of=BLEND), gone(closes=False, **{BEADS: 100.4, SALT: 199.5}))
    assert reached_by(after) == ("not known", [None, None])
    assert not after.is_good


def test_a_composed_sample_without_one_of_its_powders_is_not_as_asked() -> None:
    one = result(BOTH[0], of=BLEND)
    assert (one.verdict, reached_by(one)[0]) == ("not as asked", "not known")
    none = result(of=BLEND)
    assert (none.verdict, none.target_mg, none.is_good) == ("no dose", 200.0, False)
    wrong = result(BOTH[0], dose(150.0, 150.0, lot=SALT), of=BLEND)
    assert (wrong.verdict, reached_by(wrong)[0]) == ("not as asked", "out of tolerance")


def test_a_composed_sample_that_overshot_is_over_though_powders_are_missing() -> None:
    over = result(dose(110.0, 100.0), of=BLEND)
    assert (over.verdict, reached_by(over)[0]) == ("over", "not known")


def test_each_dose_of_a_composed_sample_is_held_to_its_own_tolerance() -> None:
    wide = result(dose(103.0, 100.0, tolerance_mg=9.0), BOTH[1], of=BLEND)
    assert [one.tolerance_mg for one in wide.doses] == [2.0, 2.0]
    assert wide.verdict == "over"


def test_what_is_dosed_elsewhere_is_not_of_the_composition() -> None:
    primed = result(*BOTH, dose(5.0, 5.0, container="waste"), of=BLEND)
    assert reached_by(primed) == reached_by(result(*BOTH, of=BLEND))
    foreign = result(*BOTH, dose(5.0, 5.0, lot="sand"), of=BLEND)
    assert reached_by(foreign)[0] == "not known"
    assert not confirmed(foreign, gone(**{BEADS: 100.4, SALT: 199.5, "sand": 5.0})).is_good


def test_a_second_attempts_composition_is_that_of_its_own_container() -> None:
    again = [one.model_copy(update={"container": "a#2"}) for one in BOTH]
    made = sample_result(BLEND, SoFar(again), None, None, **COUNTS, attempt=2)
    assert made.composition is not None
    assert (made.composition.container, made.composition.verdict) == ("a#2", "open")


def test_two_powders_that_were_taken_for_each_other_are_not_as_asked() -> None:
    swapped = result(dose(200.0, 200.0), dose(100.0, 100.0, lot=SALT), of=BLEND)
    assert swapped.verdict == "not as asked"
