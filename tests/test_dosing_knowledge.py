"""What `adaptive` learns within a dose and keeps of it, and how it opens where nothing comes."""

import itertools
import math
from collections.abc import Callable, Generator, Iterator

import pytest
from dose_bench import dose_request, shipped_powders
from hypothesis import given
from hypothesis import strategies as st

from scuhand_bt.dosing import DoseRequest, Finish, Observation, Stream, Weigh, new_controller
from scuhand_bt.dosing.adaptive import Adaptive, Ended
from scuhand_bt.dosing.constraint import NARROWEST_MM
from scuhand_bt.dosing.controller import Command, Doubt
from scuhand_bt.dosing.knowledge import SLACK_S, Knowledge
from scuhand_bt.dosing.opening import Opening
from scuhand_bt.dosing.unseen import SEEN_S, STUCK_MM, begins_mm, seen_s, stuck_mg
from scuhand_bt.dosing.valve import FlowShape, ValvePath
from scuhand_bt.specs import GAPS_MM, BalanceBelief, PowderBelief

BEADS = shipped_powders()["glass_beads"].belief
QUICK = BalanceBelief(lag_s=0.05, doubt=0.08, fits=3, noise_mg=0.05)
PERIOD_S = 0.1


def request(**changes: object) -> DoseRequest:
    return dose_request(**({"powder": BEADS.model_copy(update={"doses": 3}), "balance": QUICK} | changes))


class Scale:
    """A powder of this coefficient, and a balance that shows it as it leaves."""

    def __init__(self, known: Knowledge, coefficient: float) -> None:
        self.known, self.coefficient = known, coefficient
        self.left_mg = known.begin_mg

    def act(self, opening_mm: float, duration_s: float) -> None:
        for _ in range(round(duration_s / PERIOD_S)):
            step = self.known.act(opening_mm, 0.0)
            next(step)
            time_s = self.known.time_s + PERIOD_S
            # The valve is where it is reckoned to be: the coefficient alone is in question.
            self.left_mg += self.coefficient * PERIOD_S * self.known.shape.value(self.known.valve.opening_mm)
            with pytest.raises(StopIteration):
                step.send(Observation(time_s, self.left_mg, 0.05, False))

    def opening(self, opening_mm: float, duration_s: float) -> float:
        """The reference after it."""
        self.act(opening_mm, duration_s)
        self.act(0.0, 2.0)
        self.known.learn(self.left_mg - self.known.begin_mg)
        self.known.begin(self.left_mg, 0.1)
        return self.known.reference


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


def test_a_first_opening_that_was_held_up_leaves_the_next_as_careful_and_one_that_was_not_does_not() -> None:
    held_up, free = Knowledge(request(powder=BEADS)), Knowledge(request(powder=BEADS))
    before_mm, as_wide = begins_mm(free, 480.0), Knowledge(request(powder=BEADS))
    Scale(held_up, 0.2 * BEADS.coefficient).opening(1.0, 2.0)
    Scale(free, 0.8 * BEADS.coefficient).opening(1.0, 2.0)
    as_wide.gap_mm = held_up.gap_mm
    assert before_mm <= begins_mm(held_up, 480.0) < 1.15 * begins_mm(as_wide, 480.0), "weaker by belief"
    assert begins_mm(free, 480.0) > 1.3 * before_mm


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


@given(st.floats(1.0, 3000.0), st.sampled_from([0.2, 0.6, 1.5]))
def test_an_opening_begins_so_that_a_sheet_which_sticks_then_lets_out_no_more_than_may_come(
    most_mg: float, lag_s: float
) -> None:
    known = Knowledge(request(balance=QUICK.model_copy(update={"lag_s": lag_s})))
    opening_mm = begins_mm(known, most_mg)
    assert stuck_mg(known, opening_mm, seen_s(known)) <= most_mg or opening_mm <= known.shape.threshold_mm + 0.0501
    assert seen_s(known) > 2.0 * lag_s
    assert stuck_mg(known, opening_mm, 1.0) > known.reference * known.shape.value(opening_mm + STUCK_MM)


def test_a_sheet_may_stick_when_powder_flows_as_strongly_as_it_was_ever_seen_to() -> None:
    """A weak opening since, which a bridge may have held up, makes none begin wider."""
    known, weak = Knowledge(request()), Knowledge(request())
    Scale(known, 3.0 * BEADS.coefficient).opening(1.0, 2.0)
    known.reference, known.spread = weak.reference, weak.spread
    assert begins_mm(known, 60.0) < 0.9 * begins_mm(weak, 60.0)


def test_far_from_the_target_a_sheet_that_sticks_limits_no_opening() -> None:
    known = Knowledge(request())
    known.gap_mm = 1.5
    assert begins_mm(known, 3000.0) == 2.4


def test_a_flow_that_only_narrow_openings_have_shown_limits_how_wide_one_begins() -> None:
    """After 100 mg, 2 g began at a width at which seven times as much flowed as was believed, on a balance 3 s late."""
    known = Knowledge(request())
    real = FlowShape(known.shape.threshold_mm + 0.2, 3.0)
    seen_mm = known.shape.threshold_mm + known.gap_mm
    coefficient = known.reference * known.shape.value(seen_mm) / real.value(seen_mm)
    came_mg = coefficient * ValvePath(real, 0.05, 4.0).passes(begins_mm(known, 500.0), seen_s(known))
    assert 100.0 < came_mg <= 500.0


@given(most_mg=st.floats(5.0, 500.0), spread=st.floats(0.2, 1.5))
def test_an_opening_begins_so_narrow_that_a_flow_which_is_much_stronger_is_seen_in_time(
    most_mg: float, spread: float
) -> None:
    known = Knowledge(request(balance=QUICK.model_copy(update={"lag_s": 0.4})))
    known.spread = spread
    gap_mm = begins_mm(known, most_mg) - known.shape.threshold_mm
    unseen_mg = known.reference * (1.0 + 2.6 * spread) * gap_mm**known.shape.exponent * seen_s(known)
    assert unseen_mg <= most_mg or gap_mm <= 0.0501


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


FAST = BEADS.model_copy(update={"coefficient": 500.0, "doses": 3})


def narrowest_after_nothing(target_mg: float, opening_mm: float, powder: PowderBelief = BEADS) -> float:
    """The narrowest opening, above the threshold, when such openings have brought nothing again and again."""
    known = Knowledge(request(target_mg=target_mg, powder=powder))
    scale = Scale(known, 0.0)
    for _ in range(50):
        scale.act(max(opening_mm, known.shape.threshold_mm + known.narrowest_mm), 0.5)
        known.little_came()
        known.begin(0.0, 0.1)
    return known.narrowest_mm


def test_narrow_openings_that_bring_nothing_again_and_again_grow_wider_but_not_for_ever() -> None:
    assert 0.3 < narrowest_after_nothing(500.0, 0.15) <= 0.5
    assert narrowest_after_nothing(500.0, 1.5) == Knowledge(request()).narrowest_mm, "it was not for being narrow"


def test_what_was_too_narrow_for_a_powder_is_kept_and_tried_again_a_little_narrower() -> None:
    known = Knowledge(request())
    scale = Scale(known, BEADS.coefficient)
    scale.act(known.shape.threshold_mm + 0.2, 0.5)
    known.little_came()
    scale.opening(1.0, 2.0)
    kept = known.finish("reached", Observation(9.0, 0.0, 0.05, True)).powder
    assert kept is not None
    assert kept.narrowest_mm == pytest.approx(0.28, abs=0.01)
    assert Knowledge(request(powder=kept)).narrowest_mm == pytest.approx(0.2, abs=0.01)


def test_near_the_target_no_opening_is_wider_for_what_the_powder_needs_than_what_may_come() -> None:
    """A load that primed late had taught that it needs 0.6 mm, and then let 9 mg out at once where 3 were missing."""
    known = Knowledge(request(powder=FAST.model_copy(update={"narrowest_mm": 0.5})))
    needed_mm = known.narrowest_mm
    known.begin(499.0, 0.1)
    assert NARROWEST_MM < known.narrowest_mm < needed_mm
    until_answered_s = PERIOD_S + SLACK_S + known.request.valve_dead_time_s
    assert known.reference * known.narrowest_mm**known.shape.exponent * until_answered_s < known.most_mg - 499.0
    Scale(known, 0.0).act(known.least_mm, 0.5)
    known.reference *= 0.2  # as nothing has come, so that a wider one may let out no more
    known.little_came()
    known.begin(100.0, 0.1)
    assert known.narrowest_mm == needed_mm, "it needs no less for that"


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


def test_the_nearer_the_target_is_the_less_they_grow() -> None:
    near = Knowledge(request(target_mg=3.0, powder=FAST))
    grown_mm = narrowest_after_nothing(3.0, 0.15, FAST)
    assert grown_mm < narrowest_after_nothing(500.0, 0.15, FAST)
    until_answered_s = PERIOD_S + SLACK_S + near.request.valve_dead_time_s
    assert near.reference * grown_mm**near.shape.exponent * until_answered_s < near.most_mg


# --- the policy


def openings_of_nothing(target_mg: float, **changes: object) -> Iterator[tuple[float, float]]:
    """The widest and the vibration of each opening while the balance shows nothing."""
    controller = new_controller("adaptive", request(target_mg=target_mg, **changes))
    command, time_s, widest_mm = controller.decide(None), 0.0, 0.0
    while not isinstance(command, Finish):
        if isinstance(command, Stream) and command.opening_mm > 0.0:
            widest_mm, vibration = max(widest_mm, command.opening_mm), command.vibration
        elif widest_mm > 0.0:
            yield widest_mm, vibration
            widest_mm = 0.0
        time_s += PERIOD_S
        command = controller.decide(Observation(time_s, 0.0, 0.05, isinstance(command, Weigh)))


def test_where_nothing_comes_it_is_tried_again_then_shaken_and_not_opened_wider() -> None:
    openings = [opening for _, opening in zip(range(4), openings_of_nothing(500.0), strict=False)]
    widths_mm, vibrations = zip(*openings, strict=True)
    assert vibrations == (0.0, 0.0, 0.4, 1.0)
    assert max(widths_mm) <= 1.01 * widths_mm[0]


def test_a_fresh_load_that_has_yet_to_prime_is_not_opened_wider() -> None:
    """It may give nothing for ten seconds, open and fully shaken; after that its flow is weaker than believed."""
    powder = BEADS.model_copy(update={"vibration": 1.0, "doses": 3, "coefficient": 20.0})
    widths_mm = [opening[0] for _, opening in zip(range(30), openings_of_nothing(50.0, powder=powder), strict=False)]
    assert max(widths_mm[:8]) <= 1.01 * widths_mm[0]
    assert widths_mm[-1] > 1.1 * widths_mm[0]


def test_near_the_target_a_bridge_is_tried_five_times_before_it_is_shaken() -> None:
    vibrations = [opening[1] for _, opening in zip(range(9), openings_of_nothing(15.0), strict=False)]
    assert vibrations == [0.0] * 5 + [0.4] * 3 + [1.0]


def vibrations_at_the_end_of_a_load(came_mg: float, left_mg: float) -> list[float]:
    """Of each opening once a load of 1000 mg has given so much towards a target of `came_mg + left_mg`, and no more."""
    controller = new_controller("adaptive", request(target_mg=came_mg + left_mg, cone_mg=1000.0))
    command, time_s, given_mg, vibrations = controller.decide(None), 0.0, 0.0, list[float]()
    was_open = False
    while not isinstance(command, Finish):
        is_open = isinstance(command, Stream) and command.opening_mm > 0.0
        if is_open and not was_open and given_mg >= came_mg:
            vibrations.append(command.vibration)
        if is_open:
            given_mg = min(came_mg, given_mg + 20.0)
        was_open, time_s = is_open, time_s + PERIOD_S
        command = controller.decide(Observation(time_s, given_mg, 0.05, isinstance(command, Weigh)))
    assert command.reason == "empty"
    return vibrations


def test_a_load_that_gives_no_more_than_half_of_what_is_wanted_is_shaken_at_once_and_soon_given_up() -> None:
    """It is scooped for in any case; where little is missing it is not shaken so soon, and goes on for longer."""
    far, near = (vibrations_at_the_end_of_a_load(900.0, left_mg) for left_mg in (700.0, 100.0))
    assert 1.0 in far[:2]
    assert near[:2] != far[:2]
    assert 1.0 not in near[:2]
    assert len(far) < len(near)


def test_a_look_goes_on_while_readings_rise_whatever_is_believed_of_the_balance() -> None:
    """It is believed to be quick, and creeps for three seconds."""
    controller = new_controller("adaptive", request())
    command, time_s, shown_mg, shut_s, looked = controller.decide(None), 0.0, 0.0, -1.0, list[object]()
    while not 3.0 <= time_s - shut_s < 4.0 or shut_s < 0.0:
        time_s += PERIOD_S
        is_open = isinstance(command, Stream) and command.opening_mm > 0.0
        shown_mg += 10.0 if is_open else 0.5 * (shown_mg > 0.0)
        if shut_s < 0.0 < shown_mg and not is_open:
            shut_s = time_s
        looked += [command] * (shut_s > 0.0)
        command = controller.decide(Observation(time_s, shown_mg, 0.05, isinstance(command, Weigh)))
    assert set(looked) == {Stream(0.0)}


class Openings(Adaptive):
    """Keeps why its openings ended, and what was missing then."""

    def __init__(self, request: DoseRequest) -> None:
        super().__init__(request)
        self.ended: list[tuple[str, float]] = []

    def _open(self) -> Generator[Command, Observation, Ended]:
        ended = yield from super()._open()
        self.ended.append((ended, self._known.request.target_mg - self.estimate_mg))
        return ended


@pytest.mark.parametrize(
    ("adapts", "target_mg", "is_apart"), [(True, 500.0, True), (True, 35.0, False), (False, 500.0, False)]
)
def test_on_a_balance_that_adapts_the_last_of_a_dose_comes_out_of_another_opening(
    adapts: bool, target_mg: float, is_apart: bool
) -> None:
    controller = Openings(request(target_mg=target_mg, balance=QUICK.model_copy(update={"adapts": adapts})))
    known, command, shown_mg = controller._known, controller.decide(None), 0.0
    while not isinstance(command, Finish):
        time_s, is_stream = known.time_s + PERIOD_S, isinstance(command, Stream)
        command = controller.decide(Observation(time_s, shown_mg, 0.05, not is_stream))
        shown_mg += BEADS.coefficient * known.rows[-1].phi_s if is_stream and known.rows else 0.0
    near_mg = [left_mg for ended, left_mg in controller.ended if ended == "near"]
    assert len(near_mg) == is_apart
    assert all(15.0 < left_mg < 30.0 for left_mg in near_mg)
    assert shown_mg == pytest.approx(target_mg, abs=2.0)


@pytest.mark.parametrize(
    ("share", "target_mg", "is_shut"), [(0.5, 3000.0, True), (1.0, 3000.0, False), (0.5, 180.0, False)]
)
def test_the_first_powder_of_a_dose_is_looked_at_where_it_is_weak_and_much_is_missing(
    share: float, target_mg: float, is_shut: bool
) -> None:
    """A balance that was set slower shows a strong flow as a weak one, and by then it is too late."""
    controller = Openings(request(target_mg=target_mg, balance=QUICK.model_copy(update={"lag_s": 0.3})))
    known, command, shown_mg = controller._known, controller.decide(None), 0.0
    while not controller.ended and known.time_s < 6.0:
        time_s, is_stream = known.time_s + PERIOD_S, isinstance(command, Stream)
        command = controller.decide(Observation(time_s, shown_mg, 0.05, not is_stream))
        shown_mg += share * known.reference * known.rows[-1].phi_s if is_stream and known.rows else 0.0
    assert ("weak" in [ended for ended, _ in controller.ended]) is is_shut


def widths_shown(shown_mg: Callable[[float], float], **changes: object) -> list[float]:
    """What the valve is told in the first opening, by what the balance shows so long after it began."""
    controller = new_controller("adaptive", request(**changes))
    command, time_s, told_mm = controller.decide(None), 0.0, list[float]()
    while not told_mm or (isinstance(command, Stream) and command.opening_mm > 0.0):
        if isinstance(command, Stream) and command.opening_mm > 0.0:
            told_mm.append(command.opening_mm)
        time_s += PERIOD_S
        net_mg = shown_mg(PERIOD_S * len(told_mm))
        command = controller.decide(Observation(time_s, net_mg, 0.05, isinstance(command, Weigh)))
    return told_mm


def test_within_an_opening_nothing_that_comes_is_no_reason_to_open_wider() -> None:
    told_mm = widths_shown(lambda time_s: 0.0)
    assert len(told_mm) > 3
    assert all(after <= before for before, after in itertools.pairwise(told_mm))


def test_one_reading_far_above_prediction_shuts_the_valve() -> None:
    powder = BEADS.model_copy(update={"doses": 3, "gap_mm": 1.5})
    expected, surprising = (
        widths_shown(lambda time_s, mg=mg: mg * (time_s > 0.29), powder=powder) for mg in (5.0, 20.0)
    )
    assert len(surprising) == 3
    assert len(expected) > 10


def test_onto_a_balance_that_nothing_is_known_of_little_is_let_out_at_first() -> None:
    known, unknown = (
        next(iter(openings_of_nothing(3000.0, balance=balance)))[0] for balance in (QUICK, BalanceBelief())
    )
    assert unknown < 0.6 * known


def test_a_powder_that_must_be_shaken_is_shaken_from_the_first_opening_on() -> None:
    powder = PowderBelief(vibration=0.7, doses=3)
    vibrations = [opening[1] for _, opening in zip(range(4), openings_of_nothing(500.0, powder=powder), strict=False)]
    assert vibrations == [0.7, 0.7, 0.7, 1.0]


def test_an_opening_is_no_wider_than_a_sheet_that_sticks_allows_until_that_would_be_seen() -> None:
    settings: dict[str, object] = {"target_mg": 60.0, "balance": QUICK.model_copy(update={"lag_s": 0.3})}
    known = Knowledge(request(**settings))
    first_mm, widest_mm = begins_mm(known, known.most_mg), known.widest_mm(known.most_mg)
    assert first_mm < 0.9 * widest_mm
    told_mm = widths_shown(lambda time_s: 0.0, **settings)
    assert max(told_mm) <= first_mm, "nothing that has come shows nothing"
    comes_s = seen_s(known) + 0.3
    told_mm = widths_shown(lambda time_s: max(0.0, time_s - comes_s) * 5.0, **settings)
    first_seen = math.ceil((comes_s + SEEN_S) / PERIOD_S)
    assert max(told_mm[:first_seen]) <= first_mm < max(told_mm)


def test_the_farther_beyond_what_was_seen_the_more_carefully_it_is_opened() -> None:
    near, far = (Knowledge(request(powder=BEADS.model_copy(update={"gap_mm": gap_mm}))) for gap_mm in (2.0, 0.5))
    assert begins_mm(far, 480.0) < 0.9 * begins_mm(near, 480.0)


@pytest.mark.parametrize("streaming", [True, False])
def test_a_dose_that_nothing_can_tell_ends_where_it_has_come_to_its_aim(streaming: bool) -> None:
    """The zero has drifted for so long that no mass can be told in tolerance, and no time makes it surer."""
    controller = new_controller("adaptive", request(uncertainty_mg=1.1, streaming=streaming))
    seen, time_s = Observation(0.0, 500.0, 1.1, True), 0.0
    command = controller.decide(None)
    while not isinstance(command, Finish) and time_s < 60.0:
        assert isinstance(command, Weigh) or not command.opening_mm
        time_s += 5.0 if isinstance(command, Weigh) else PERIOD_S
        command = controller.decide(Observation(time_s, seen.net_mg, 1.1, isinstance(command, Weigh)))
    assert isinstance(command, Finish)
    assert command.reason == "reached"


def test_a_zero_that_comes_and_goes_is_not_weighed_for_longer_than_two_minutes() -> None:
    controller = new_controller("adaptive", request())
    command, time_s, shown_mg = controller.decide(None), 0.0, itertools.cycle((500.0, 508.0))
    while not isinstance(command, Finish) and time_s < 1000.0:
        is_weighed = isinstance(command, Weigh)
        time_s += 8.0 if is_weighed else PERIOD_S
        command = controller.decide(Observation(time_s, next(shown_mg) if is_weighed else 504.0, 0.1, is_weighed))
    assert isinstance(command, Finish)
    assert command.doubt is not None
    assert 120.0 < time_s < 140.0
