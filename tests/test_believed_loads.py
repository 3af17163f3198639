"""What a load of the cone is believed to be, by what comes of it, and what the next scoop will bring."""

import pytest
from believed_bench import BEADS

from scuhand_bt.cell.believed import Believed
from scuhand_bt.dosing.bed import Layer


def test_a_scoop_takes_from_its_source_what_it_brings_and_an_empty_cone_gives_it_back() -> None:
    believed = Believed()
    believed.source_holds("beads", 5000.0)
    believed.scooped(BEADS, 3000.0)
    believed.dosing_ended(1000.0, 21_000.0)
    assert (believed.cone_mg, believed.sources_mg, believed.dosing.scoops) == (2000.0, {"beads": 2000.0}, 1)
    believed.gave_out(is_short=False)
    assert (believed.cone_mg, believed.cone_source, believed.sources_mg) == (0.0, None, {"beads": 4000.0})
    believed.returned("beads", 100.0)
    assert believed.sources_mg == {"beads": 4100.0}
    assert believed.sheet == "glass_beads/L7"
    assert believed.has_rest, "who tips it spills what did not come"
    believed.emptied()
    assert not believed.has_rest


def test_no_scoop_is_believed_to_bring_more_than_its_source_holds() -> None:
    """Of a rich source 2.7 g were, out of the last 1.5 g."""
    believed = Believed()
    believed.source_holds("beads", 1500.0)
    believed.scoops_bring("beads", 2.0)
    believed.scooped(BEADS, 1400.0)
    assert (believed.cone_mg, believed.sources_mg["beads"]) == (1500.0, 0.0)


def test_a_load_that_gave_less_tells_what_the_next_one_will_bring_and_is_let_out_first() -> None:
    believed = Believed()
    believed.source_holds("beads", 20_000.0)
    believed.scooped(BEADS, 4000.0)
    believed.dosing_ended(400.0, 0.0)
    believed.dosing_ended(600.0, 0.0)
    believed.gave_out(is_short=True)
    assert (believed.yields, believed.is_load_doubted, believed.cone_mg) == ({"beads": 0.25}, True, 3000.0)
    believed.emptied()
    believed.returned("beads", 3000.0)
    assert not believed.is_load_doubted
    believed.scooped(BEADS, 4000.0)
    assert (believed.cone_mg, believed.sources_mg) == (1000.0, {"beads": 18_000.0})
    believed.dosing_ended(900.0, 0.0)
    believed.gave_out(is_short=False)
    assert (believed.yields, believed.cone_source) == ({"beads": 0.225}, None)
    assert believed.sources_mg == {"beads": 18_100.0}


def test_a_load_that_gives_more_than_it_should_holds_some_more_until_it_gives_out() -> None:
    believed = Believed()
    believed.source_holds("beads", 20_000.0)
    believed.scooped(BEADS, 4000.0)
    believed.dosing_ended(4300.0, 0.0)
    assert (believed.yields, believed.cone_mg) == ({}, 0.0), "it may be so much by chance"
    believed.dosing_ended(700.0, 0.0)
    assert (believed.yields, believed.cone_mg) == ({"beads": 1.25 * 5000.0 / 4000.0}, 1250.0)
    assert believed.sources_mg == {"beads": 20_000.0 - 6250.0}
    believed.dosing_ended(3000.0, 0.0)
    assert (believed.yields, believed.cone_mg) == ({"beads": 2.5}, 2000.0)
    assert not believed.is_load_doubted
    believed.gave_out(is_short=True)
    assert believed.yields == {"beads": 2.0}
    believed.emptied()
    believed.scooped(BEADS, 4000.0)
    assert believed.cone_mg == 8000.0


@pytest.mark.parametrize(
    ("came_mg", "told", "is_seen"),
    [
        (1900.0, 1900.0 / 0.85 / 4000.0, True),  # a poor scoop
        (2100.0, 1.0, True),
        (4300.0, 4300.0 / 4000.0, True),
        (4900.0, 4900.0 / 4000.0, False),  # more than was thought: only its end tells how much
        (5100.0, 5100.0 / 0.85 / 4000.0, False),
    ],
)
def test_when_the_rest_of_a_load_begins_to_come_only_shaken_tells_a_poor_scoop_and_a_far_larger_one(
    came_mg: float, told: float, is_seen: bool
) -> None:
    believed = Believed()
    believed.scooped(BEADS, 4000.0)
    believed.dosing_ended(came_mg, 0.0)
    believed.rest_left()
    assert believed.yields == {"beads": pytest.approx(told)}
    assert ("beads" in believed.seen_yields) == is_seen


@pytest.mark.parametrize(
    ("shaken_mg", "rest", "there_mg"),
    [
        (100.0, {}, 4000.0),  # a drop that hung: it is what it was thought to be
        (300.0, {"beads": 0.1 + 0.4 / 3}, 2700.0 / (1.0 - 0.1 - 0.4 / 3)),  # more would have come
        (1200.0, {"beads": 0.4 + 0.1 / 3}, 1800.0 / (1.0 - 0.4 - 0.1 / 3)),
        (1500.0, {"beads": 0.5}, 3000.0),  # as much as a rest may be
        (1600.0, {}, None),  # it bridges
    ],
)
def test_what_came_only_shaken_tells_what_a_rest_is_and_that_how_much_there_was(
    shaken_mg: float, rest: dict[str, float], there_mg: float | None
) -> None:
    believed = Believed()
    believed.source_holds("beads", 20_000.0)
    believed.scooped(BEADS, 4000.0)
    believed.dosing_ended(1000.0, 0.0)
    believed.dosing_ended(2000.0, 0.0)
    believed.flowed(shaken_mg)
    believed.rest_left()
    assert believed.rests == pytest.approx(rest)
    assert believed.yields == ({} if there_mg is None else {"beads": pytest.approx(there_mg / 4000.0)})
    there_mg = there_mg or 4000.0
    assert believed.cone_mg == pytest.approx(there_mg - 3000.0)
    assert believed.sources_mg == {"beads": pytest.approx(20_000.0 - there_mg)}


def test_a_loads_end_tells_what_its_powders_rest_is_and_a_later_rest_only_that_it_is_more() -> None:
    believed = Believed()
    believed.scooped(BEADS, 4000.0)
    believed.dosing_ended(4000.0, 0.0)
    believed.flowed(80.0)
    believed.gave_out(is_short=False)
    assert believed.rests == {"beads": pytest.approx(0.02)}
    for shaken_mg, rest in ((0.0, 0.02), (200.0, 0.05)):
        believed.emptied()
        believed.scooped(BEADS, 4000.0)
        believed.dosing_ended(4000.0, 0.0)
        believed.flowed(shaken_mg)
        believed.rest_left()
        assert believed.rests == {"beads": pytest.approx(rest)}
        assert believed.yields == {"beads": pytest.approx((4000.0 - shaken_mg) / (1.0 - rest) / 4000.0)}


def test_a_bridge_tells_nothing_of_a_rest() -> None:
    believed = Believed()
    believed.scooped(BEADS, 4000.0)
    believed.dosing_ended(1000.0, 0.0)
    believed.flowed(300.0)
    believed.gave_out(is_short=True)
    assert believed.rests == {}


def test_a_load_that_ran_empty_tells_what_its_scoop_brought() -> None:
    believed = Believed()
    for came_mg in (3900.0, 4100.0):
        believed.scooped(BEADS, 4000.0)
        believed.dosing_ended(came_mg, 0.0)
        believed.gave_out(is_short=False)
        assert (believed.yields, believed.is_load_doubted) == ({"beads": came_mg / 4000.0}, False)


@pytest.mark.parametrize("came_mg", [3000.0, 4200.0, 5200.0])
def test_what_has_come_of_a_load_is_what_its_source_has_less_whatever_it_was_thought_to_hold(came_mg: float) -> None:
    believed = Believed()
    believed.source_holds("beads", 20_000.0)
    believed.scooped(BEADS, 4000.0)
    believed.dosing_ended(came_mg / 2, 0.0)
    believed.dosing_ended(came_mg / 2, 0.0)
    assert believed.cone_mg + believed.sources_mg["beads"] == pytest.approx(20_000.0 - came_mg)
    believed.gave_out(is_short=False)
    assert believed.sources_mg["beads"] == pytest.approx(20_000.0 - came_mg)


def may_use_up(believed: Believed, wanted_mg: float) -> bool:
    share = believed.seen_yields.get(believed.cone_source or "")
    return believed.load.may_be_used_up(wanted_mg, believed.cone_mg, share)


def test_a_load_is_used_up_by_doses_that_show_what_is_in_it() -> None:
    believed = Believed()
    assert not may_use_up(believed, 5000.0), "there is none"
    believed.scooped(BEADS, 4000.0)
    may = {wanted_mg: may_use_up(believed, wanted_mg) for wanted_mg in (900.0, 1100.0, 3100.0, 3300.0, 3500.0, 3700.0)}
    assert may == {900.0: False, 1100.0: True, 3100.0: True, 3300.0: False, 3500.0: False, 3700.0: True}, "near its end"
    believed.dosing_ended(4500.0, 0.0)
    assert believed.yields == {"beads": pytest.approx(1.25 * 4500.0 / 4000.0)}
    assert may_use_up(believed, 1100.0), "more has come than was in it: its end is still to be seen"


def test_a_source_whose_first_load_was_put_away_just_before_its_end_is_known_by_the_next_one() -> None:
    believed = Believed()
    for _ in range(2):
        believed.scooped(BEADS, 4000.0, Layer(2.5, 2000.0))
        was = may_use_up(believed, 3300.0)
        believed.emptied()
    assert was, "where its end comes, nobody knows"


@pytest.mark.parametrize(("came_mg", "is_used_up"), [(1900.0, True), (3100.0, False), (4500.0, False), (5100.0, True)])
def test_each_load_of_a_source_that_brings_other_than_it_should_is_used_up(came_mg: float, is_used_up: bool) -> None:
    """What that is changes as its bed does; the ends of others are not looked for, which takes time."""
    believed = Believed()
    believed.scooped(BEADS, 4000.0)
    believed.dosing_ended(came_mg, 0.0)
    believed.gave_out(is_short=False)
    believed.scooped(BEADS, 4000.0)
    assert may_use_up(believed, 5000.0) == is_used_up
    assert not may_use_up(believed, 900.0), "too small a dose to show it"
    assert not may_use_up(believed, believed.cone_mg - 600.0), "its end would come near the target"


def test_what_earlier_runs_have_seen_of_scoops_is_believed_until_this_one_has_seen_a_load() -> None:
    believed = Believed()
    believed.source_holds("beads", 20_000.0)
    believed.scoops_bring("beads", 0.5)
    believed.scooped(BEADS, 4000.0)
    assert believed.cone_mg == 2000.0
    believed.dosing_ended(3000.0, 0.0)
    assert believed.seen_yields == {}, "how much there is, only its end will tell"
    believed.gave_out(is_short=False)
    assert believed.seen_yields == {"beads": 0.75}
    believed.scoops_bring("beads", 0.5)
    assert believed.yields == {"beads": 0.75}
