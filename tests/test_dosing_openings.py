"""How wide `adaptive` opens: by what may come unseen, by what the powder needs, and by what nothing came of."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from knowledge_bench import BEADS, PERIOD_S, QUICK, Scale, request

from scuhand_bt.dosing import Observation
from scuhand_bt.dosing.constraint import NARROWEST_MM
from scuhand_bt.dosing.knowledge import SLACK_S, Knowledge
from scuhand_bt.dosing.unseen import STUCK_MM, begins_mm, seen_s, stuck_mg
from scuhand_bt.dosing.valve import FlowShape, ValvePath
from scuhand_bt.specs import PowderBelief


def test_a_first_opening_that_was_held_up_leaves_the_next_as_careful_and_one_that_was_not_does_not() -> None:
    held_up, free = Knowledge(request(powder=BEADS)), Knowledge(request(powder=BEADS))
    before_mm, as_wide = begins_mm(free, 480.0), Knowledge(request(powder=BEADS))
    Scale(held_up, 0.2 * BEADS.coefficient).opening(1.0, 2.0)
    Scale(free, 0.8 * BEADS.coefficient).opening(1.0, 2.0)
    as_wide.gap_mm = held_up.gap_mm
    assert before_mm <= begins_mm(held_up, 480.0) < 1.15 * begins_mm(as_wide, 480.0), "weaker by belief"
    assert begins_mm(free, 480.0) > 1.3 * before_mm


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


def test_the_nearer_the_target_is_the_less_they_grow() -> None:
    near = Knowledge(request(target_mg=3.0, powder=FAST))
    grown_mm = narrowest_after_nothing(3.0, 0.15, FAST)
    assert grown_mm < narrowest_after_nothing(500.0, 0.15, FAST)
    until_answered_s = PERIOD_S + SLACK_S + near.request.valve_dead_time_s
    assert near.reference * grown_mm**near.shape.exponent * until_answered_s < near.most_mg


def test_the_farther_beyond_what_was_seen_the_more_carefully_it_is_opened() -> None:
    near, far = (Knowledge(request(powder=BEADS.model_copy(update={"gap_mm": gap_mm}))) for gap_mm in (2.0, 0.5))
    assert begins_mm(far, 480.0) < 0.9 * begins_mm(near, 480.0)
