"""What a composed sample comes to: its verdict and the composition that its doses make."""

from dataclasses import replace

import pytest
from outcome_bench import BEADS, COUNTS, SALT, dose, gone, result, sample

from scuhand_bt.journal.results import SampleResult, SoFar
from scuhand_bt.recipe.composition import ComposedPowder, Composition, ElementShare
from scuhand_bt.run.outcome import confirmed, doubted, sample_result

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
