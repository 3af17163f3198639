"""What a cell is believed to hold: no sequence of verbs breaks its invariants, and nothing else changes it."""

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import FrozenInstanceError, fields, replace
from typing import Any

import pytest
from dose_bench import DISH, MORTAR, shipped_powders
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter

from scuhand_bt.cell.believed import Believed
from scuhand_bt.cell.believed_powder import InVessel
from scuhand_bt.cell.pan_bracket import ClosedBracket
from scuhand_bt.dosing.bed import Layer
from scuhand_bt.dosing.bracket import Drift, Gross, Net
from scuhand_bt.specs import Source

POWDERS = shipped_powders()


def source(name: str, powder: str, lot: str) -> Source:
    return Source(name=name, station=name, mortar=MORTAR, powder=POWDERS[powder], amount_mg=5000.0, lot=lot)


BEADS = source("beads", "glass_beads", "L7")
MORE_BEADS = source("more", "glass_beads", "L7")
OLD_BEADS = source("old", "glass_beads", "L6")
SALT = source("salt", "monosodium_glutamate", "")
SOURCES = {one.name: one for one in (BEADS, MORE_BEADS, OLD_BEADS, SALT)}
JSON = TypeAdapter(Believed)

STILL = Drift(0.0, 0.005)


def weighed(gross_mg: float, time_s: float = 2.0) -> Gross:
    return Gross(gross_mg, 0.05, time_s)


def gone(container: str = DISH.id) -> ClosedBracket:
    """What a container came to that has gone."""
    return ClosedBracket(container, {"glass_beads/L7": Net(50.0, 0.1)}, True, 0.0, "it closes")


masses_mg = st.sampled_from([-10.0, 0.0, 30.0, 3000.0])
grosses_mg = st.sampled_from([-50.0, 20_000.0, 20_030.0])
weighings = st.builds(weighed, grosses_mg)
nets = st.builds(lambda m: Net(m, 0.1), masses_mg)
lots = st.sampled_from([BEADS.sheet_key, SALT.sheet_key])
sources = st.sampled_from(list(SOURCES.values()))
names = st.sampled_from(list(SOURCES))

VERBS: dict[str, st.SearchStrategy[Callable[[Believed], object]]] = {
    "source_holds": st.builds(lambda n, m: lambda b: b.source_holds(n, m), names, masses_mg),
    "scoops_bring": st.builds(lambda n, share: lambda b: b.scoops_bring(n, share), names, st.floats(-1.0, 3.0)),
    "scoops_forgotten": st.builds(lambda n: lambda b: b.scoops_forgotten(n), names),
    "cone_holds": st.builds(lambda s, m: lambda b: b.cone_holds(s, m), sources, masses_mg),
    "vessel_holds": st.builds(lambda lot, m: lambda b: b.vessel_holds("jar", lot, m), st.none() | lots, masses_mg),
    "let_into": st.builds(lambda s, m: lambda b: b.let_into("jar", s, m), sources, masses_mg),
    "touched": st.builds(lambda s: lambda b: b.touched(s), sources),
    "scooped": st.builds(lambda s, m: lambda b: b.scooped(s, m), sources, masses_mg),
    "emptied": st.just(Believed.emptied),
    "returned": st.builds(lambda n, m: lambda b: b.returned(n, m), names, masses_mg),
    "gave_out": st.builds(
        lambda is_short, m: lambda b: b.gave_out(is_short=is_short, lacked_mg=m), st.booleans(), masses_mg
    ),
    "rest_left": st.just(Believed.rest_left),
    "flowed": st.builds(lambda m: lambda b: b.flowed(m), masses_mg),
    "cone_spilled": st.just(Believed.cone_spilled),
    "source_refilled": st.builds(
        lambda n, m: lambda b: b.source_refilled(n, m), st.sampled_from([*SOURCES]), masses_mg
    ),
    "sources_mended": st.just(Believed.sources_mended),
    "sheet_swapped": st.just(Believed.sheet_swapped),
    "sheet_is": st.builds(lambda s, n: lambda b: b.sheet_is(s.sheet_key, n), sources, st.integers(-1, 9)),
    "changing_container": st.just(Believed.changing_container),
    "removed": st.just(Believed.removed),
    "brought": st.builds(lambda by: lambda b: b.brought(DISH, from_changer=by), st.booleans()),
    "placed": st.builds(lambda bare, loaded: lambda b: b.placed(bare, loaded), weighings, weighings),
    "rebracketed": st.builds(
        lambda bare, loaded, held, left: lambda b: b.rebracketed(bare, loaded, Net(20_000.0, 0.1), held, left),
        weighings,
        weighings,
        nets,
        masses_mg,
    ),
    "container_given_up": st.just(lambda b: b.container_given_up("it is another one")),
    "discarded": st.just(Believed.discarded),
    "slots_refilled": st.just(Believed.slots_refilled),
    "slots_taken": st.builds(lambda n: lambda b: b.slots_taken({"die": n}), st.integers(-1, 9)),
    "containers_taken": st.builds(lambda n: lambda b: b.containers_taken(n, {"die": n}), st.integers(-1, 9)),
    "dose_began": st.just(lambda b: b.dose_began(1.0)),
    "tared": st.builds(lambda g: lambda b: b.tared(g), weighings),
    "dosing_towards": st.builds(lambda m, lot, g: lambda b: b.dosing_towards(m, lot, g), masses_mg, lots, weighings),
    "dosing_ended": st.builds(lambda m, g: lambda b: b.dosing_ended(m, g), masses_mg, grosses_mg),
    "dosed": st.builds(lambda n, g: lambda b: b.dosed(n, STILL, g, 1, 0.5), nets, weighings),
    "reweighed": st.builds(lambda n, g: lambda b: b.reweighed(n, g), nets, weighings),
    "dripped": st.builds(lambda m: lambda b: b.dripped(m), masses_mg),
    "zero_stepped": st.builds(lambda m: lambda b: b.zero_stepped(m), masses_mg),
    "drifted": st.builds(lambda m: lambda b: b.drifted(m), masses_mg),
    "zero_moved": st.builds(lambda d, g: lambda b: b.zero_moved(d, g), masses_mg, weighings),
    "lifted": st.builds(lambda g: lambda b: b.lifted(g), weighings),
    "bracket_closed": st.sampled_from([None, gone()]).map(lambda one: lambda b: b.bracket_closed(one)),
    "noted": st.just(lambda b: b.noted(b.closed[0] if b.closed else gone())),
}


QUESTIONS = {"had_gone"}
"""Methods that change nothing."""


def verbs_of(kind: type) -> set[str]:
    public = {name for name in dir(kind) if callable(getattr(kind, name)) and not name.startswith("_")}
    return public - {field.name for field in fields(kind)} - QUESTIONS


def holds_its_invariants(believed: Believed) -> None:
    assert believed.cone_mg >= 0.0
    assert all(mass_mg >= 0.0 for mass_mg in believed.sources_mg.values())
    assert min(believed.sheets_used, believed.slots_used, *believed.containers_used.values(), 0) == 0
    if believed.cone_mg > 0.0:
        assert believed.cone_source is not None
        assert believed.sheet == SOURCES[believed.cone_source].sheet_key
    if believed.sheet is None:
        assert (believed.cone_mg, believed.cone_source) == (0.0, None)
    if believed.pan is None:
        assert (believed.pan_empty_mg, believed.pan_gross_mg, believed.weighed_container) == (None, None, None)
    if believed.pan_empty_mg is not None:
        assert believed.pan_gross_mg is not None


def test_every_verb_is_tried() -> None:
    assert VERBS.keys() == verbs_of(Believed)


@settings(max_examples=500, deadline=None)
@given(st.lists(st.one_of(*VERBS.values()), min_size=10, max_size=30))
def test_no_sequence_of_verbs_breaks_an_invariant_and_a_refused_one_changes_nothing(
    verbs: list[Callable[[Believed], object]],
) -> None:
    believed = Believed()
    for verb in verbs:
        before = JSON.dump_python(believed)
        try:
            verb(believed)
        except ValueError:
            assert JSON.dump_python(believed) == before
        holds_its_invariants(believed)


def test_what_is_let_into_a_vessel_is_of_one_lot_until_that_is_empty() -> None:
    believed = Believed()
    believed.let_into("jar", BEADS, 300.0)
    believed.let_into("jar", BEADS, 200.0)
    with pytest.raises(ValueError, match="the vessel at 'jar' holds glass_beads/L7, and "):
        believed.let_into("jar", SALT, 0.0)
    assert believed.vessels["jar"] == InVessel(BEADS.sheet_key, 500.0)
    believed.vessel_holds("jar", None, 0.0)
    believed.let_into("jar", SALT, 0.0)
    assert believed.vessels["jar"] == InVessel(SALT.sheet_key, 0.0)


@pytest.mark.parametrize("name", [field.name for field in fields(Believed)])
def test_nothing_but_a_verb_changes_what_is_believed(name: str) -> None:
    with pytest.raises(FrozenInstanceError):
        setattr(Believed(), name, None)


def test_not_even_one_source_is_changed_by_hand_whether_told_or_restored() -> None:
    told = Believed()
    told.source_holds("beads", 5000.0)
    for believed in (told, JSON.validate_python(JSON.dump_python(told, mode="json"))):
        with pytest.raises(TypeError):
            believed.sources_mg["beads"] = 0.0
        with pytest.raises(FrozenInstanceError):
            believed.dosing.scoops = 3  # type: ignore[misc]


def written_as(believed: Believed) -> dict[str, Any]:
    written: dict[str, Any] = JSON.dump_python(believed, mode="json", by_alias=False)
    return written


def as_gross(weighing: Gross) -> dict[str, float]:
    return {
        "gross_mg": weighing.gross_mg,
        "uncertainty_mg": weighing.uncertainty_mg,
        "time_s": weighing.time_s,
    }


def test_all_of_it_is_written_to_the_journal_and_read_again() -> None:
    bare, loaded, tare, before = weighed(10.0, 1.0), weighed(20_010.0, 3.0), weighed(20_010.5, 4.0), weighed(20_011.0)
    believed = Believed()
    believed.source_holds("beads", 5000.0)
    believed.scooped(BEADS, 3000.0, Layer(2.5, 2000.0))
    believed.brought(DISH, from_changer=True)
    believed.placed(bare, loaded)
    believed.tared(tare)
    believed.dosing_towards(50.0, BEADS.sheet_key, before)
    believed.bracket_closed(gone("before"))
    written = written_as(believed)
    assert written["bracket"] is None
    assert JSON.validate_python(written, by_name=True, by_alias=False) == believed
    believed.noted(believed.closed[0])
    believed.placed(bare, loaded)
    believed.tared(tare)
    believed.dosing_towards(50.0, BEADS.sheet_key, before)
    believed.dosed(Net(20.0, 0.1), STILL, weighed(20_031.0, 9.0), 3, 1.5)
    believed.dosing_towards(50.0, SALT.sheet_key, weighed(20_031.0, 9.5))
    written = written_as(believed)
    pan = written.pop("pan")
    assert (pan["id"], pan["empty_mass_mg"]) == (DISH.id, DISH.empty_mass_mg)
    assert written == {
        "cone_mg": 3000.0,
        "cone_source": "beads",
        "has_rest": False,
        "load": {
            "scooped_mg": 3000.0,
            "or_scooped_mg": 0.0,
            "not_there_mg": 0.0,
            "came_mg": 0.0,
            "is_first": True,
            "flowed_mg": 0.0,
            "is_rest": False,
            "is_larger": False,
        },
        "is_load_doubted": False,
        "yields": {},
        "rests": {},
        "barren": {},
        "sheet": "glass_beads/L7",
        "sheets_used": 1,
        "slots_used": 1,
        "slots_of_kinds": {DISH.name: 1},
        "slots": {DISH.id: 0},
        "containers_used": {DISH.name: 1},
        "pan_empty_mg": 20_031.0,
        "pan_gross_mg": 20_031.0,
        "sources_mg": {"beads": 2000.0},
        "vessels": {},
        "layers": {
            "beads": {
                "gap_mm": 2.5,
                "mass_mg": 2000.0,
                "beside_mg": 0.0,
                "missed_mg": 0.0,
                "more_mg": 0.0,
                "passes": [],
                "is_lens": False,
            }
        },
        "told_lots": ["glass_beads/L7"],
        "dosing": {
            "began_s": 4.0,
            "pulses": 3,
            "scoops": 1,
            "vibration_s": 1.5,
            "target_mg": 50.0,
            "is_unweighed": True,
            "in_vain": 0,
        },
        "bracket": {
            "container": DISH.id,
            "bare": as_gross(bare),
            "loaded": as_gross(tare),
            "last": as_gross(weighed(20_031.0, 9.5)),
            "doses": {"glass_beads/L7": {"mass_mg": 20.0, "uncertainty_mg": 0.1}},
            "drifted": {"glass_beads/L7": {"mass_mg": 0.0, "uncertainty_mg": 0.0}},
            "lasted_s": {"glass_beads/L7": 7.0},
            "drift": {"rate": 0.0, "uncertainty": 0.005, "is_doubted": False},
            "lot": SALT.sheet_key,
            "dripped_mg": 0.0,
            "lifted": None,
            "carried": {},
            "empty": None,
        },
        "closed": [],
        "gone": [
            {
                "container": "before",
                "doses": {"glass_beads/L7": {"mass_mg": 50.0, "uncertainty_mg": 0.1}},
                "closes": True,
                "difference_mg": 0.0,
                "detail": "it closes",
                "lasted_s": {},
                "is_discarded": False,
            }
        ],
        "is_zero_doubted": False,
        "given_up": "",
        "zero_stepped_mg": 0.0,
        "drift_mg_per_s": 0.0,
    }
    assert JSON.validate_python({**written, "pan": pan}, by_name=True, by_alias=False) == believed


def test_a_journal_of_before_brackets_is_read_without_one() -> None:
    believed = Believed()
    believed.scooped(BEADS, 3000.0)
    written = written_as(believed)
    del written["bracket"], written["closed"]
    assert JSON.validate_python(written, by_name=True, by_alias=False) == believed


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


def test_a_loaded_cone_goes_into_no_other_powder_and_an_emptied_one_may_have() -> None:
    believed = Believed()
    believed.scooped(BEADS, 10.0)
    believed.touched(MORE_BEADS)
    for verb in (believed.touched, lambda other: believed.scooped(other, 1.0)):
        with pytest.raises(ValueError, match="the cone holds powder of 'beads'"):
            verb(SALT)
    believed.dosing_ended(11.0, 0.0)
    assert (believed.cone_mg, believed.cone_source) == (0.0, "beads")
    believed.touched(SALT)
    believed.dosing_ended(-1.0, 0.0)
    assert (believed.cone_mg, believed.cone_source, believed.sheet) == (0.0, None, SALT.sheet_key)


def test_a_swapped_sheet_is_fresh_and_what_was_in_the_cone_is_gone() -> None:
    believed = Believed()
    believed.scooped(BEADS, 10.0)
    believed.sheet_swapped()
    assert (believed.sheet, believed.sheets_used, believed.cone_mg) == (None, 2, 0.0)


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
    assert told["a"][1] == "the balance's zero has stepped of late, or the bracket before did not close; it closes"


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
