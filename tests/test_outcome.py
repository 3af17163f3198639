"""A sample's result: by what the recipe asks, and for every powder lot."""

from dataclasses import replace

import pytest
from dose_bench import DISH
from outcome_bench import BEADS, COUNTS, FIRST, SALT, SECOND, A, dose, gone, result, sample

from scuhand_bt.journal.results import SoFar
from scuhand_bt.run.outcome import confirmed, inputs_for, sample_result
from scuhand_bt.specs import Container


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


@pytest.mark.parametrize("first_mg", [45.0, 55.0])
def test_a_sample_with_a_dose_too_large_and_one_too_small_is_over(first_mg: float) -> None:
    found = result(dose(first_mg), dose(100.0 - first_mg, lot=SALT))
    assert [one.verdict for one in found.doses] in (["under", "over"], ["over", "under"])
    assert found.verdict == "over"


def test_a_second_attempt_is_for_containers_with_ids_of_their_own() -> None:
    two = sample(first=A, second=SECOND)
    ids = [
        [value.id for value in inputs_for(two, attempt).values() if isinstance(value, Container)] for attempt in (1, 2)
    ]
    assert ids == [["a", "a/second"], ["a#2", "a/second#2"]]


def test_what_the_simulation_has_in_each_container_stands_by_its_doses() -> None:
    held = {"a/first": 51.0, "a/second": 49.0, "a/third": 0.0}
    two = sample(first=FIRST, second=SECOND)
    doses = [dose(50.0, container="a/second"), dose(25.0, 25.0, container="a/first")]
    had = sample_result(two, SoFar(list(doses)), None, None, **COUNTS | {"true_mg": held}, attempt=1)
    assert ([one.true_mg for one in had.doses], had.true_mg) == ([49.0, 51.0], 49.0)
    none = sample_result(two, SoFar(), None, None, **COUNTS | {"true_mg": held}, attempt=1)
    assert none.true_mg == 51.0, "the first container's, where nothing was dosed"
    assert result(dose(50.0)).true_mg is None
