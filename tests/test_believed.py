"""What a cell is believed to hold: no sequence of verbs breaks its invariants, nothing else changes it, it is kept."""

from collections.abc import Callable
from dataclasses import FrozenInstanceError, fields
from typing import Any

import pytest
from believed_bench import BEADS, MORE_BEADS, SALT, STILL, gone, source, weighed
from dose_bench import DISH
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter

from scuhand_bt.cell.believed import Believed
from scuhand_bt.cell.believed_powder import InVessel
from scuhand_bt.dosing.bed import Layer
from scuhand_bt.dosing.bracket import Gross, Net

OLD_BEADS = source("old", "glass_beads", "L6")
SOURCES = {one.name: one for one in (BEADS, MORE_BEADS, OLD_BEADS, SALT)}
JSON = TypeAdapter(Believed)

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
