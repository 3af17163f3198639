"""What `adaptive` learns within a dose of its powder and its balance, and what it keeps."""

import math

import pytest
from knowledge_bench import BEADS, PERIOD_S, QUICK, Scale, request

from scuhand_bt.dosing import Observation
from scuhand_bt.dosing.controller import Doubt
from scuhand_bt.dosing.knowledge import Knowledge
from scuhand_bt.dosing.opening import Opening
from scuhand_bt.dosing.unseen import begins_mm
from scuhand_bt.specs import GAPS_MM, BalanceBelief, PowderBelief


def test_of_a_flow_a_hundred_times_the_believed_one_no_lumps_explain_anything() -> None:
    known = Knowledge(request(powder=BEADS.model_copy(update={"coefficient": BEADS.coefficient / 100.0})))
    assert Scale(known, BEADS.coefficient).opening(1.0, 2.0) > 0.5 * BEADS.coefficient


def test_a_single_lump_teaches_no_stronger_flow() -> None:
    known = Knowledge(request(powder=BEADS.model_copy(update={"doses": 3, "surge_mg": 2.5})))
    scale = Scale(known, 0.2 * BEADS.coefficient)
    scale.act(0.35, 0.5)
    scale.left_mg += 7.0
    assert scale.opening(0.0, 0.0) < 1.2 * BEADS.coefficient


def test_a_stronger_flow_is_believed_at_once_and_a_weaker_one_little_by_little() -> None:
    known = Knowledge(request())
    assert Scale(known, 2.0 * BEADS.coefficient).opening(1.0, 2.0) > 1.7 * BEADS.coefficient
    known = Knowledge(request())
    assert (
        0.69 * BEADS.coefficient < Scale(known, 0.25 * BEADS.coefficient).opening(1.0, 3.0) < 0.75 * BEADS.coefficient
    )


def test_what_a_balance_shows_when_the_valve_has_long_been_shut_is_no_stronger_flow() -> None:
    known = Knowledge(request(powder=BEADS, balance=QUICK.model_copy(update={"lag_s": 0.5})))
    scale = Scale(known, 0.0)
    scale.act(1.0, 0.5)
    scale.act(0.0, 2.5)
    surely = known.surely
    for _ in range(20):
        scale.left_mg += 20.0
        scale.act(0.0, 0.1)
    assert known.bank.coefficient - known.bank.coefficient_sd > surely
    assert known.surely == surely


def test_powder_that_primed_late_is_known_for_how_it_flows_though_it_shows_when_the_valve_is_shut() -> None:
    late = BalanceBelief(lag_s=0.5, doubt=0.08, shape="delay", fits=3, noise_mg=0.05)
    known = Knowledge(request(powder=BEADS, balance=late))
    scale = Scale(known, 0.0)
    scale.act(1.0, 1.5)
    per_reading_mg = 2.0 * BEADS.coefficient * PERIOD_S * known.shape.value(1.0)
    scale.act(0.0, 0.5)
    for _ in range(6):
        scale.left_mg += per_reading_mg
        scale.act(0.0, PERIOD_S)
    scale.act(0.0, 1.0)
    known.learn(scale.left_mg - known.begin_mg)
    assert known.reference > 1.5 * BEADS.coefficient, "a third of the time it came, twice as strongly as believed"


@pytest.mark.parametrize(("share", "forgets"), [(0.0, True), (0.5, False), (0.9, False)])
def test_where_nothing_comes_the_strongest_flow_seen_counts_for_less_but_not_where_little_should(
    share: float, forgets: bool
) -> None:
    known = Knowledge(request())
    Scale(known, 1.6 * BEADS.coefficient).opening(1.0, 2.0)
    seen, reference, before_mg = known.seen, known.reference, known.begin_mg
    scale = Scale(known, share * known.reference)
    scale.opening(known.shape.threshold_mm + 0.3, 0.6)
    assert known.reference < reference, "it was enough to tell something"
    assert scale.left_mg - before_mg < 2.0
    assert (known.seen < seen) is forgets


def test_an_opening_that_need_not_have_brought_anything_teaches_nothing() -> None:
    known = Knowledge(request())
    assert Scale(known, 0.25 * BEADS.coefficient).opening(0.15, 0.5) == BEADS.coefficient
    assert known.finish("reached", Observation(9.0, 0.0, 0.05, True)).powder == known.belief


def test_narrow_openings_tell_less_of_the_flow_than_wide_ones() -> None:
    wide, narrow = Knowledge(request()), Knowledge(request())
    at_wide = Scale(wide, 0.8 * BEADS.coefficient).opening(1.5, 1.0)
    at_narrow = Scale(narrow, 0.8 * BEADS.coefficient).opening(0.25, 20.0)
    kept = narrow.finish("reached", Observation(9.0, 0.0, 0.05, True)).powder
    assert kept is not None
    assert at_wide < 0.85 * BEADS.coefficient < at_narrow
    assert kept.gap_mm == pytest.approx(0.25 - BEADS.threshold_mm, abs=0.02)


def test_lumps_that_did_not_come_tell_less_of_the_flow() -> None:
    fine, lumpy = (
        Knowledge(request()),
        Knowledge(request(powder=BEADS.model_copy(update={"surge_mg": 5.0, "doses": 3}))),
    )
    weak = 0.8 * BEADS.coefficient
    at_fine, at_lumpy = (Scale(known, weak).opening(0.7, 1.0) for known in (fine, lumpy))
    assert at_fine < 0.85 * BEADS.coefficient
    assert 0.9 * BEADS.coefficient < at_lumpy < BEADS.coefficient


def test_what_a_dose_has_taught_is_kept_with_what_was_known_before() -> None:
    known = Knowledge(request())
    Scale(known, 1.5 * BEADS.coefficient).opening(1.0, 3.0)
    finish = known.finish("reached", Observation(9.0, 500.0, 0.05, True))
    assert finish.powder is not None
    assert BEADS.coefficient * 1.05 < finish.powder.coefficient < BEADS.coefficient * 1.2, "one dose of four"
    assert finish.powder.doses == 4
    assert finish.powder.spread > BEADS.spread, "doses differ by more than was believed"
    assert finish.powder.vibration == BEADS.vibration


@pytest.mark.parametrize("exponent", [0.5, 10.0])
@pytest.mark.parametrize("gap_mm", GAPS_MM)
@pytest.mark.parametrize("coefficient", [1e-3, 1e9])
@pytest.mark.parametrize("surge_mg", [0.0, 1e5])
def test_of_the_farthest_beliefs_numbers_are_made(
    exponent: float, gap_mm: float, coefficient: float, surge_mg: float
) -> None:
    """An exponent of 0.01, or a gap of a micrometre, ended a run with an OverflowError."""
    figures = {"exponent": exponent, "gap_mm": gap_mm, "coefficient": coefficient, "surge_mg": surge_mg}
    for doses in (0, 3):
        belief = PowderBelief.model_validate({"doses": doses, **figures}, by_name=True)
        known = Knowledge(request(powder=belief))
        assert known.least_mm <= begins_mm(known, 1.0) <= known.request.max_opening_mm
        assert math.isfinite(Opening(known, 1.0, known.surge_mg).width_mm())


def test_what_is_learnt_of_an_opening_may_be_believed() -> None:
    powder = BEADS.model_copy(update={"exponent": 0.5, "coefficient": 1e5, "doses": 3})
    known = Knowledge(request(powder=powder))
    Scale(known, powder.coefficient).opening(powder.threshold_mm + 0.05, 0.1)
    kept = known.finish("reached", Observation(9.0, 0.0, 0.05, True)).powder
    assert kept is not None
    assert kept.gap_mm == GAPS_MM[0], "the valve was that wide for a part of a reading only"


def test_the_first_dose_replaces_a_guess() -> None:
    known = Knowledge(request(powder=BEADS))
    Scale(known, 1.5 * BEADS.coefficient).opening(1.0, 3.0)
    kept = known.finish("reached", Observation(9.0, 500.0, 0.05, True)).powder
    assert kept is not None
    assert kept.coefficient == pytest.approx(1.5 * BEADS.coefficient, rel=0.1)


def test_only_what_came_more_than_predicted_makes_predictions_less_trusted() -> None:
    known = Knowledge(request())
    known.erratic = 2.0
    known.begin(100.0, 0.1)
    known.judge_prediction(150.0, 1.0)
    assert known.erratic == pytest.approx(1.8)
    known.judge_prediction(95.0, 1.0)
    assert known.erratic > 4.0
    for _ in range(100):
        known.judge_prediction(100.0, 1.0)
    assert known.erratic == 1.0
    known.judge_prediction(0.0, 0.01)
    assert known.erratic <= 3.5, "one bad one is not all"


def test_predictions_that_were_wrong_narrow_the_next_opening_and_are_kept() -> None:
    known = Knowledge(request())
    usual_mm = known.widest_mm(30.0)
    known.erratic = 20.0
    known.begin(0.0, 0.1)
    assert known.widest_mm(30.0) < usual_mm
    Scale(known, BEADS.coefficient).opening(1.0, 2.0)
    kept = known.finish("reached", Observation(9.0, 0.0, 0.05, True)).powder
    assert kept is not None
    assert kept.erratic == 20.0


def test_no_more_may_leave_than_a_stable_mean_would_call_in_tolerance() -> None:
    known = Knowledge(request(uncertainty_mg=0.3))
    assert known.most_mg == pytest.approx(501.4)
    assert known.least_mg == pytest.approx(498.6)
    assert known.least_mg < known.aim_mg < 500.0
    assert Knowledge(request(uncertainty_mg=5.0)).most_mg == pytest.approx(500.5), "doubtful: as near as it can"
    lumpy = Knowledge(request(uncertainty_mg=0.3, powder=BEADS.model_copy(update={"surge_mg": 1.0})))
    assert known.least_mg < lumpy.aim_mg < known.aim_mg, "a lump can be waited for"


def test_what_contradicts_what_was_known_of_the_balance_makes_it_doubtful() -> None:
    known = Knowledge(request())
    known.balance = QUICK.model_copy(update={"lag_s": 1.0})
    Scale(known, BEADS.coefficient).opening(1.0, 2.0)
    assert known.balance.fits == QUICK.fits + 1
    assert known.balance.doubt > 0.5
    assert 0.05 < known.balance.lag_s < 1.0


def test_a_balance_that_is_doubted_is_no_longer_known_and_the_next_dose_is_told() -> None:
    known = Knowledge(request())
    assert known.knows_balance
    known.doubt_balance(Doubt(5.0, 1.0))
    known.doubt_balance(Doubt(2.0, 1.0))
    assert not known.knows_balance
    finish = known.finish("reached", Observation(9.0, 0.0, 0.05, True))
    kept = finish.balance
    assert finish.doubt == Doubt(5.0, 1.0), "the first one"
    assert kept is not None
    assert kept.fits == 0
    assert kept.doubt == 1.0


@pytest.mark.parametrize(("shown_s", "fits", "is_known"), [(0.0, 1, False), (0.0, 2, True), (0.6, 1, True)])
def test_a_persons_container_alone_is_not_enough_to_open_wide(shown_s: float, fits: int, is_known: bool) -> None:
    """It hides a dead time: first doses of 50 mg were 10 and 22 mg too much."""
    adapting = QUICK.model_copy(update={"adapts": True, "shown_s": shown_s, "fits": fits})
    assert Knowledge(request(balance=adapting)).knows_balance == is_known


def test_a_balance_that_adapts_creeps_and_is_known_all_the_same() -> None:
    known = Knowledge(request(balance=QUICK.model_copy(update={"adapts": True, "doubt": 0.4})))
    known.doubt_balance(Doubt(5.0, 1.0))
    assert known.knows_balance
    assert known.doubt == Doubt(5.0, 1.0)


def test_the_last_of_a_dose_takes_either_face_of_a_balance_that_adapts_for_possible_whatever_was_read() -> None:
    adapting = QUICK.model_copy(update={"adapts": True, "doubt": 0.4})
    shifts = []
    for balance, begin_mg in ((adapting, 100.0), (adapting, 470.0), (QUICK, 470.0)):
        known = Knowledge(request(balance=balance))
        known.begin(begin_mg, 0.1)
        scale = Scale(known, BEADS.coefficient)
        scale.act(1.0, PERIOD_S)
        before_s = known.bank.delay_s
        scale.act(1.0, 0.5)
        shifts.append(abs(known.bank.delay_s - before_s) > 1e-6)
    assert shifts == [True, False, True]


def test_a_cone_that_ran_empty_teaches_nothing_of_the_powder() -> None:
    """Nothing came from several openings, however wide and narrow, and another load will flow as ever."""
    known = Knowledge(request())
    scale = Scale(known, 0.0)
    for width_mm in (1.0, 0.2, 0.2):
        scale.act(width_mm, 1.0)
        known.little_came()
        scale.opening(width_mm, 1.0)
    assert known.reference < 0.8 * BEADS.coefficient
    assert known.narrowest_mm > 0.2
    assert known.finish("empty", Observation(9.0, 0.0, 0.05, True)).powder == known.belief
    Scale(known, BEADS.coefficient).opening(1.0, 1.0)
    kept = known.finish("empty", Observation(9.0, 0.0, 0.05, True)).powder
    assert kept is not None
    assert kept.narrowest_mm == BEADS.narrowest_mm


def test_openings_that_bring_little_teach_together() -> None:
    known = Knowledge(request())
    scale = Scale(known, 0.25 * BEADS.coefficient)
    references = [scale.opening(0.3, 0.5) for _ in range(40)]
    assert references[0] == BEADS.coefficient, "one alone is too little"
    assert references[-1] < 0.6 * BEADS.coefficient
    assert len(set(references)) < 20
