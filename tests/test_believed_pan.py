"""What is believed of the container on the pan: its weighings, its doses, and what its bracket comes to."""

from contextlib import suppress
from dataclasses import replace

import pytest
from believed_bench import BEADS, SALT, STILL, gone, weighed
from dose_bench import DISH

from scuhand_bt.cell.believed import Believed
from scuhand_bt.dosing.bracket import Drift, Net


def test_a_container_is_in_the_way_as_soon_as_it_stands_there_and_counts_once_it_is_weighed() -> None:
    believed = Believed()
    believed.brought(DISH, from_changer=False)
    assert (believed.pan, believed.weighed_container, believed.slots_used) == (DISH, None, 0)
    with pytest.raises(ValueError, match="weighed"):
        believed.tared(weighed(1.0))
    believed.placed(weighed(0.0), weighed(20_000.0))
    assert believed.weighed_container == DISH
    believed.tared(weighed(20_000.0))
    believed.changing_container()
    assert (believed.pan, believed.weighed_container, believed.pan_empty_mg) == (DISH, None, None)
    believed.removed()
    assert believed.pan is None


def test_a_changer_that_was_filled_begins_anew_and_what_was_used_of_a_kind_is_counted_on() -> None:
    believed = Believed()
    for _ in range(2):
        believed.brought(DISH, from_changer=True)
    believed.slots_refilled()
    assert (believed.slots_used, believed.containers_used) == (0, {DISH.name: 2})
    believed.containers_taken(3, {"die": 8})
    assert (believed.slots_used, believed.containers_used) == (3, {"die": 8})


def on_the_pan() -> Believed:
    """A dish that was weighed on its pan, and tared, under a cone with 100 mg of beads."""
    believed = Believed()
    believed.scooped(BEADS, 100.0)
    believed.brought(DISH, from_changer=True)
    believed.placed(weighed(10.0, 1.0), weighed(20_010.0, 3.0))
    believed.tared(weighed(20_010.5, 4.0))
    return believed


def test_a_container_that_was_not_weighed_has_no_dose() -> None:
    believed = Believed()
    believed.brought(DISH, from_changer=True)
    for verb in (
        lambda: believed.dosing_towards(50.0, BEADS.sheet_key, weighed(0.0)),
        lambda: believed.dosed(Net(1.0, 0.1), STILL, weighed(0.0), 1, 0.5),
        lambda: believed.reweighed(Net(1.0, 0.1), weighed(0.0)),
        lambda: believed.lifted(weighed(0.0)),
    ):
        with pytest.raises(ValueError, match="was weighed"):
            verb()
    with pytest.raises(ValueError, match="no container stands"):
        Believed().placed(weighed(0.0), weighed(20_000.0))


def test_what_a_dose_that_broke_off_has_brought_is_of_its_lot_and_left_no_other_powder_in_the_cone() -> None:
    believed = on_the_pan()
    believed.dosing_towards(50.0, BEADS.sheet_key, weighed(20_010.5))
    believed.dosing_ended(25.0, 20_035.5)
    believed.dose_began(9.0)
    assert believed.dosing.is_unweighed, "the next job does not forget it"
    believed.sheet_swapped()
    believed.scooped(SALT, 80.0)
    believed.reweighed(Net(30.0, 0.2), weighed(20_040.5, 20.0))
    assert believed.bracket is not None
    assert (believed.bracket.holds, believed.cone_mg) == ({BEADS.sheet_key: Net(30.0, 0.2)}, 80.0)


def test_a_container_that_comes_again_holds_what_it_got_but_in_another_job() -> None:
    believed = on_the_pan()
    believed.removed()
    believed.bracket_closed(gone())
    believed.brought(DISH, from_changer=True)
    believed.placed(weighed(10.0, 1.0), weighed(20_060.0, 3.0))
    assert believed.bracket is not None
    assert believed.bracket.holds == {"glass_beads/L7": Net(50.0, 0.1)}
    believed.dose_began(9.0)
    assert believed.had_gone(DISH.id) is None


def test_a_container_that_was_changed_on_the_pan_is_known_to_hold_something() -> None:
    believed = on_the_pan()
    believed.dosing_towards(50.0, BEADS.sheet_key, weighed(20_010.5))
    believed.container_given_up("it is another one")
    before = believed.had_gone(DISH.id)
    assert before is not None
    assert (dict(before.doses), before.detail) == ({}, "it is another one")


def test_a_container_that_was_thrown_away_holds_nothing_that_is_known_and_one_without_powder_may_come_again() -> None:
    believed = on_the_pan()
    believed.discarded()
    assert believed.had_gone(DISH.id) is None, "an empty one"
    believed.dosing_towards(50.0, BEADS.sheet_key, weighed(20_010.5))
    believed.discarded()
    believed.removed()
    believed.bracket_closed(gone())
    before = believed.had_gone(DISH.id)
    assert before is not None
    assert (dict(before.doses), before.detail) == ({}, "it was thrown away")
    assert [one.is_discarded for one in believed.closed] == [True]


def test_the_last_bracket_of_a_container_tells_of_all_visits_but_of_those_that_did_not_close() -> None:
    believed = on_the_pan()
    visits = [
        replace(gone(), difference_mg=mg, closes=closes) for mg, closes in ((1.5, True), (-0.2, True), (0.1, False))
    ]
    for visit in (visits[0], visits[1]):
        believed.bracket_closed(visit)
    (told,) = believed.closed
    assert (told.difference_mg, told.detail) == (1.5, "it closes; then it closes")
    believed.bracket_closed(visits[2])
    believed.bracket_closed(visits[1])
    assert [one.closes for one in believed.closed] == [False, False], "the zero is doubted after it"


def test_how_long_doses_took_to_come_is_over_all_visits() -> None:
    believed = on_the_pan()
    believed.removed()
    believed.bracket_closed(replace(gone(), lasted_s={BEADS.sheet_key: 20.0}))
    believed.brought(DISH, from_changer=True)
    believed.placed(weighed(10.0, 1.0), weighed(20_060.0, 3.0))
    believed.dosing_towards(90.0, BEADS.sheet_key, weighed(20_060.0, 5.0))
    believed.dosed(Net(40.0, 0.1), STILL, weighed(20_100.0, 12.0), 3, 1.5)
    assert believed.bracket is not None
    assert believed.bracket.lasted_s == {BEADS.sheet_key: 27.0}


def test_what_arrived_since_the_valve_opened_has_left_the_cone_and_is_in_the_container() -> None:
    believed = on_the_pan()
    believed.dosing_towards(50.0, BEADS.sheet_key, weighed(20_010.5))
    believed.reweighed(Net(30.0, 0.2), weighed(20_040.5, 20.0))
    assert (believed.cone_mg, believed.pan_gross_mg, believed.dosing.is_unweighed) == (70.0, 20_040.5, False)
    assert believed.bracket is not None
    assert believed.bracket.dosed_mg(BEADS.sheet_key) == Net(30.0, 0.2)
    assert believed.bracket.last == weighed(20_040.5, 20.0)
    assert believed.bracket.drift == Drift(0.0, 0.0), "nobody has watched the zero"


@pytest.mark.parametrize(
    ("drift", "drifted"),
    [
        (Drift(0.02, 0.005), Net(0.4, 0.1)),
        (Drift(0.0, 0.005, is_doubted=True), Net(0.0, 0.1)),
        (Drift(0.0, 0.005), Net(0.0, 0.0)),
    ],
)
def test_what_a_drift_that_was_seen_or_doubted_may_have_made_of_a_dose_stays_its_doubt(
    drift: Drift, drifted: Net
) -> None:
    believed = on_the_pan()
    believed.dosing_towards(50.0, BEADS.sheet_key, weighed(20_010.5, 10.0))
    believed.dosed(Net(20.0, 0.3), drift, weighed(20_030.5, 30.0), 3, 1.5)
    assert believed.bracket is not None
    assert believed.bracket.drifted == {BEADS.sheet_key: drifted}


def test_a_zero_that_moved_takes_every_weighing_with_it_and_no_dose() -> None:
    believed = on_the_pan()
    believed.dosing_towards(50.0, BEADS.sheet_key, weighed(20_010.5))
    believed.reweighed(Net(30.0, 0.2), weighed(20_040.5))
    believed.zero_moved(2.0, weighed(20_042.5, 30.0))
    assert (believed.pan_empty_mg, believed.pan_gross_mg, believed.cone_mg) == (20_012.5, 20_042.5, 70.0)
    bracket = believed.bracket
    assert bracket is not None
    assert (bracket.bare, bracket.loaded) == (weighed(12.0, 1.0), weighed(20_012.5, 4.0))
    assert (bracket.last, bracket.dosed_mg(BEADS.sheet_key)) == (weighed(20_042.5, 30.0), Net(30.0, 0.2))


def test_a_dose_counts_what_it_cost_and_what_it_brought_over_all_of_its_parts() -> None:
    believed = on_the_pan()
    believed.dose_began(3.0)
    with suppress(ValueError):
        believed.dosing_towards(float("nan"), BEADS.sheet_key, weighed(20_010.5))
    assert not believed.dosing.is_unweighed
    for before_mg in (20_010.5, 20_020.5):
        believed.dosing_towards(50.0, BEADS.sheet_key, weighed(before_mg))
        assert believed.pan_empty_mg == 20_010.5, "what it weighed before the first part"
        believed.dosing_ended(10.0, before_mg + 10.0)
        assert (believed.dosing.target_mg, believed.dosing.is_unweighed) == (None, True)
        believed.dosed(Net(10.0, 0.3), STILL, weighed(before_mg + 10.0), 3, 1.5)
    assert (believed.dosing.pulses, believed.dosing.vibration_s, believed.dosing.is_unweighed) == (6, 3.0, False)
    assert (believed.dosing.began_s, believed.cone_mg) == (3.0, 80.0)
    assert believed.bracket is not None
    both = believed.bracket.dosed_mg(BEADS.sheet_key)
    assert (both.mass_mg, both.uncertainty_mg) == (20.0, pytest.approx(0.3 * 2**0.5))


def test_every_powder_lot_has_what_was_dosed_of_it_and_a_second_tare_forgets_none() -> None:
    believed = on_the_pan()
    believed.dosing_towards(50.0, BEADS.sheet_key, weighed(20_010.5))
    believed.dosed(Net(49.0, 0.1), STILL, weighed(20_059.5), 3, 1.5)
    believed.tared(weighed(20_060.0, 40.0))
    assert believed.bracket is not None
    assert believed.bracket.loaded == weighed(20_010.5, 4.0), "without any powder"
    assert believed.bracket.last == weighed(20_060.0, 40.0)
    believed.dosing_towards(20.0, SALT.sheet_key, weighed(20_060.0))
    assert believed.pan_empty_mg == 20_060.0
    believed.dosed(Net(19.0, 0.2), STILL, weighed(20_079.0), 2, 0.5)
    assert believed.bracket.doses == {BEADS.sheet_key: Net(49.0, 0.1), SALT.sheet_key: Net(19.0, 0.2)}


def test_what_a_container_came_to_stays_until_it_is_noted_and_one_without_a_dose_came_to_nothing() -> None:
    believed = on_the_pan()
    believed.lifted(weighed(20_010.5))
    assert believed.bracket is not None
    assert believed.bracket.lifted == weighed(20_010.5)
    first, second = gone("first"), gone("second")
    for closed in (first, None, second):
        believed.bracket_closed(closed)
    assert (believed.bracket, believed.closed) == (None, (first, second))
    believed.noted(first)
    assert believed.closed == (second,)


def test_a_bracket_is_believed_only_once_one_has_closed_since_the_zero_stepped() -> None:
    believed = on_the_pan()
    believed.zero_stepped(0.4)
    for name, closes in (("a", True), ("b", True), ("c", False), ("d", True), ("e", True)):
        believed.bracket_closed(replace(gone(name), closes=closes))
    told = {one.container: (one.closes, one.detail) for one in believed.closed}
    assert {name: closes for name, (closes, _) in told.items()} == {
        "a": False,
        "b": True,
        "c": False,
        "d": False,
        "e": True,
    }
    assert told["a"][1] == "the balance's zero has stepped recently, or the bracket before did not close; it closes"


def test_of_all_steps_that_were_seen_the_largest_stays() -> None:
    believed = on_the_pan()
    believed.zero_stepped(0.0)
    assert (believed.zero_stepped_mg, believed.is_zero_doubted) == (0.0, False)
    for by_mg in (0.4, 3.0, 1.0):
        believed.zero_stepped(by_mg)
    believed.bracket_closed(gone())
    assert (believed.zero_stepped_mg, believed.is_zero_doubted) == (3.0, False)


def test_after_an_outage_all_weighings_begin_anew_and_what_it_holds_is_what_was_weighed() -> None:
    believed = on_the_pan()
    believed.dosing_towards(50.0, BEADS.sheet_key, weighed(20_010.5))
    believed.dosed(Net(20.0, 0.1), STILL, weighed(20_030.5, 9.0), 3, 1.5)
    believed.dosing_towards(50.0, SALT.sheet_key, weighed(20_030.5, 10.0))
    believed.rebracketed(weighed(-20_000.0, 20.0), weighed(35.0, 30.0), Net(20_000.0, 0.1), Net(35.0, 0.3), 15.0)
    bracket = believed.bracket
    assert bracket is not None
    assert (bracket.bare, bracket.loaded, bracket.last) == (weighed(-20_000.0, 20.0), *2 * [weighed(35.0, 30.0)])
    assert (bracket.doses, bracket.empty, bracket.lifted) == ({}, Net(20_000.0, 0.1), None)
    assert bracket.dosed_mg(BEADS.sheet_key) == Net(20.0, 0.1), "as it was weighed before"
    assert bracket.dosed_mg(SALT.sheet_key) == Net(15.0, pytest.approx(0.1**0.5, rel=1e-6)), "what came since"
    assert (believed.pan_gross_mg, believed.pan_empty_mg, believed.cone_mg) == (35.0, 0.0, 85.0)
    assert not believed.dosing.is_unweighed
    believed.dosing_towards(50.0, SALT.sheet_key, weighed(35.5, 40.0))
    believed.dosed(Net(5.0, 0.1), STILL, weighed(40.5, 50.0), 1, 0.0)
    assert believed.bracket is not None
    assert believed.bracket.dosed_mg(SALT.sheet_key).mass_mg == 20.0


def test_an_outage_before_any_powder_leaves_none_in_the_container() -> None:
    believed = on_the_pan()
    believed.rebracketed(weighed(0.0, 20.0), weighed(20_000.1, 30.0), Net(20_000.0, 0.1), Net(0.1, 0.3), 0.1)
    assert believed.bracket is not None
    assert (believed.bracket.holds, believed.pan_empty_mg, believed.cone_mg) == ({}, 20_000.1, 100.0)


def test_a_container_that_is_given_up_confirms_no_dose_and_has_no_weight_until_another_is_placed() -> None:
    believed = on_the_pan()
    believed.dosing_towards(50.0, BEADS.sheet_key, weighed(20_010.5))
    believed.container_given_up("it is another one")
    (told,) = believed.closed
    assert (told.container, told.closes, told.detail) == (DISH.id, False, "it is another one")
    assert (believed.bracket, believed.weighed_container, believed.pan) == (None, None, DISH)
    assert (believed.given_up, believed.dosing.is_unweighed) == ("it is another one", False)
    believed.placed(weighed(10.0), weighed(20_010.0))
    assert believed.given_up == ""


def test_an_empty_container_that_is_given_up_has_no_dose_to_deny() -> None:
    believed = on_the_pan()
    believed.container_given_up("it is another one")
    assert (believed.closed, believed.given_up) == ((), "it is another one")


def test_what_the_last_reading_of_a_broken_dose_has_shown_was_seen() -> None:
    believed = on_the_pan()
    assert believed.seen_mg == 0.0
    believed.dosing_towards(50.0, BEADS.sheet_key, weighed(20_010.5))
    believed.dosing_ended(12.0, 20_022.5)
    assert believed.seen_mg == pytest.approx(12.0)
    believed.dosed(Net(12.0, 0.1), STILL, weighed(20_022.5, 9.0), 1, 0.5)
    assert believed.seen_mg == 0.0
