"""A sample's result once its container has gone: adjusted, confirmed or flagged by what the bare pan says."""

import math
from dataclasses import replace

import pytest
from outcome_bench import FIRST, SECOND, dose, gone, result, sample

from scuhand_bt.failures import SkillFailed
from scuhand_bt.run.outcome import confirmed, doubted


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


def test_a_dose_that_is_near_half_its_tolerance_from_the_bare_pans_word_is_flagged_whatever_chance_allows() -> None:
    near = replace(gone(glass_beads=50.4), difference_mg=1.0)
    assert confirmed(result(dose(50.4)), near).is_good
    far = confirmed(result(dose(50.4)), replace(near, difference_mg=1.01))
    assert (far.code, far.dispensed_mg, far.doses[0].bracket) == ("balance.bracket_open", 50.4, "does not close")
