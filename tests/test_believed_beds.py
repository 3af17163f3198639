"""What is believed of the powder that loads did not bring: barren sources, and what lies beside where strokes come."""

import math

import pytest
from believed_bench import BEADS

from scuhand_bt.cell.believed import Believed
from scuhand_bt.dosing.bed import Layer


@pytest.mark.parametrize("is_short", [True, False])
@pytest.mark.parametrize(("came_mg", "barren"), [(29.9, {"beads"}), (30.0, set())])
def test_two_loads_in_a_row_of_which_nothing_came_make_a_source_barren(
    came_mg: float, barren: set[str], is_short: bool
) -> None:
    believed = Believed()
    for came in (0.0, came_mg):
        believed.scooped(BEADS, 4000.0)
        believed.dosing_ended(came, 0.0)
        assert believed.barren_sources == set()
        believed.gave_out(is_short=is_short)
        believed.emptied()
    assert believed.barren_sources == barren
    believed.sources_mended()
    assert believed.barren_sources == set()


@pytest.mark.parametrize(("lacked_mg", "barren", "yields"), [(29.9, set(), {}), (30.0, {"beads"}, {"beads": 0.025})])
def test_loads_that_do_not_give_the_last_milligrams_of_a_dose_tell_nothing_of_their_source(
    lacked_mg: float, barren: set[str], yields: dict[str, float]
) -> None:
    believed = Believed()
    for came_mg in (100.0, 0.0, 0.0):
        believed.scooped(BEADS, 4000.0)
        believed.dosing_ended(came_mg, 0.0)
        believed.gave_out(is_short=True, lacked_mg=lacked_mg)
        assert believed.is_load_doubted
        believed.emptied()
    assert (believed.barren_sources, believed.yields) == (barren, yields)


def test_what_a_load_lacked_that_gave_nothing_of_a_doses_last_lies_beside_so_that_the_next_stroke_goes_deeper() -> None:
    """They went on at one gap, with 6 g left, until the dose was given up."""
    believed = Believed()
    believed.scooped(BEADS, 500.0, Layer(4.0, 6000.0))
    believed.gave_out(is_short=True, lacked_mg=8.0)
    assert believed.missed_mg == {"beads": 500.0}


def test_a_load_that_gives_makes_a_source_as_good_as_new_and_a_leftover_tells_nothing_of_scoops() -> None:
    believed = Believed()
    for came_mg in (0.0, 30.0, 0.0):
        believed.scooped(BEADS, 4000.0)
        believed.dosing_ended(came_mg, 0.0)
        if came_mg == 0.0:
            believed.gave_out(is_short=True)
        believed.emptied()
    believed.cone_holds(BEADS, 500.0)
    believed.gave_out(is_short=True)
    believed.dosing_ended(31.0, 0.0)
    believed.gave_out(is_short=True)
    assert (believed.barren, believed.yields, believed.is_load_doubted) == ({}, {}, True)


def barren(*loads_mg: float, there_mg: float = 20_000.0) -> Believed:
    """After loads that should have brought so much, and of which nothing has come."""
    believed = Believed()
    believed.source_holds("beads", there_mg)
    for mass_mg in loads_mg:
        believed.scooped(BEADS, mass_mg, Layer(4.0, 10_000.0, believed.missed_mg.get("beads", 0.0)))
        believed.gave_out(is_short=False)
        believed.emptied()
    return believed


@pytest.mark.parametrize(
    ("loads_mg", "is_given_up"),
    [
        ([13_000.0], False),
        ([6_000.0, 5_900.0], False),
        ([6_000.0, 6_100.0], True),
        ([1_000.0] * 5, False),
        ([1_000.0] * 6, True),
    ],
)
def test_a_source_is_given_up_when_most_of_it_was_not_found(loads_mg: list[float], is_given_up: bool) -> None:
    assert barren(*loads_mg).barren_sources == ({"beads"} if is_given_up else set())


def test_a_load_is_probing_while_another_may_follow_it() -> None:
    believed = barren()
    believed.scooped(BEADS, 6_000.0)
    assert not believed.is_probing, "the first one"
    believed = barren(6_000.0)
    believed.scooped(BEADS, 5_900.0)
    assert believed.is_probing
    believed = barren(6_000.0)
    believed.scooped(BEADS, 6_100.0)
    assert not believed.is_probing, "the last one"


def test_powder_below_strokes_that_brought_nothing_tells_that_less_is_there() -> None:
    """With half of what was written in it a mortar was given up, or scooped from at its top again and again."""
    believed = barren(2_000.0, 2_000.0)
    believed.scooped(BEADS, 1_500.0, Layer(3.0, 9_000.0, 4_500.0))
    believed.dosing_ended(1_000.0, 0.0)
    assert believed.barren == {}
    assert believed.sources_mg["beads"] == pytest.approx(20_000.0 - 4_000.0 - 1_500.0)
    assert believed.layers["beads"].beside_mg == pytest.approx(500.0)


def test_what_a_stroke_missed_and_the_next_one_found_was_there() -> None:
    believed = barren(2_000.0)
    believed.scooped(BEADS, 700.0, Layer(3.0, 9_000.0, 2_500.0), or_mg=2_700.0)
    believed.dosing_ended(600.0, 0.0)
    assert believed.sources_mg["beads"] == pytest.approx(20_000.0 - 2_000.0 - 700.0)
    believed.dosing_ended(1_400.0, 0.0)
    assert believed.sources_mg["beads"] + believed.cone_mg == pytest.approx(20_000.0 - 2_000.0)
    believed.scooped(BEADS, 500.0, Layer(2.0, 8_000.0, 500.0), or_mg=1_500.0)
    believed.dosing_ended(1_900.0, 0.0)
    there_mg = believed.sources_mg["beads"] + believed.cone_mg + believed.load.came_mg
    assert there_mg == pytest.approx(20_000.0), "it is put back once"


def test_a_source_that_was_taken_to_yield_little_has_larger_loads_and_no_heap() -> None:
    believed = barren()
    believed.scoops_bring("beads", 0.1)
    believed.scooped(BEADS, 2_000.0, Layer(3.0, 9_000.0, 2_500.0), or_mg=4_000.0)
    believed.dosing_ended(600.0, 0.0)
    assert (believed.load.is_larger, believed.layers["beads"].beside_mg) == (True, 2_500.0)


def test_what_a_load_that_brought_nothing_was_to_take_lies_where_strokes_do_not_come() -> None:
    believed = Believed()
    believed.scooped(BEADS, 3000.0, Layer(2.5, 2000.0, 100.0))
    believed.gave_out(is_short=False)
    assert believed.layers["beads"] == Layer(2.5, 2000.0, 3100.0, 3000.0)


def test_a_load_that_finds_what_was_missed_tells_that_and_no_larger_yield() -> None:
    """Else the next loads were taken to be 2.8 g where 1.5 came, and more was believed to lie beside than there was."""
    believed = Believed()
    believed.source_holds("beads", 20_000.0)
    believed.scooped(BEADS, 700.0, Layer(5.0, 14_000.0, 3500.0), 3200.0)
    believed.dosing_ended(2000.0, 0.0)
    assert believed.yields == {}
    assert believed.cone_mg == pytest.approx(1200.0)
    assert believed.sources_mg["beads"] == pytest.approx(16_800.0)
    assert believed.layers["beads"].beside_mg == pytest.approx(1000.0)
    as_expected = Believed()
    as_expected.source_holds("beads", 20_000.0)
    as_expected.scooped(BEADS, 700.0, Layer(5.0, 14_000.0, 3500.0), 3200.0)
    as_expected.dosing_ended(700.0, 0.0)
    assert as_expected.layers["beads"].beside_mg == 3500.0, "it lies there still"


def given_out(believed: Believed, scooped_mg: float, came_mg: float, *, is_lens: bool = False) -> tuple[float, Layer]:
    """What is believed of scoops and bed once a load that should have been so much has given so much, and no more."""
    believed.emptied()
    believed.scooped(BEADS, scooped_mg, Layer(2.5, 2000.0, 100.0, is_lens=is_lens))
    believed.dosing_ended(came_mg, 0.0)
    believed.gave_out(is_short=False)
    return believed.yields["beads"], believed.layers["beads"]


@pytest.mark.parametrize(
    ("came_mg", "share", "missed_mg"),
    [(400.0, 0.4, 0.0), (301.0, 0.301, 0.0), (299.0, math.sqrt(0.4 * 0.299), 252.5), (100.0, 0.2, 750.0)],
)
def test_of_a_load_far_less_than_the_one_before_the_rest_lies_beside_and_the_next_brings_the_mean_of_both(
    came_mg: float, share: float, missed_mg: float
) -> None:
    believed = Believed()
    assert given_out(believed, 2000.0, 800.0) == (0.4, Layer(2.5, 2000.0, 100.0))
    found_share, layer = given_out(believed, 1000.0, came_mg)
    assert found_share == pytest.approx(share)
    assert (layer.beside_mg, layer.missed_mg) == pytest.approx((100.0 + missed_mg, missed_mg))


@pytest.mark.parametrize(
    ("came_mg", "share", "missed_mg"),
    [(200.0, math.sqrt(0.2), 800.0), (749.0, math.sqrt(0.749), 251.0), (751.0, 0.751, 0.0)],
)
def test_what_a_lens_lacks_is_at_the_sides_however_little_the_load_before_brought(
    came_mg: float, share: float, missed_mg: float
) -> None:
    """Of a bowl 70 % full loads became nothing with nine tenths left: it was taken to lie in the middle."""
    believed = Believed()
    given_out(believed, 2000.0, 500.0)
    found_share, layer = given_out(believed, 1000.0, came_mg, is_lens=True)
    assert found_share == pytest.approx(share)
    assert (layer.beside_mg, layer.missed_mg) == pytest.approx((100.0 + missed_mg, missed_mg))
    first = given_out(Believed(), 1000.0, came_mg, is_lens=True)
    assert first == (came_mg / 1000.0, Layer(2.5, 2000.0, 100.0, is_lens=True))


def test_a_first_load_however_small_tells_what_scoops_bring_and_nothing_of_where_powder_lies() -> None:
    assert given_out(Believed(), 1000.0, 100.0) == (0.1, Layer(2.5, 2000.0, 100.0))
