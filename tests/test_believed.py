"""What a cell is believed to hold: no sequence of verbs breaks its invariants, and nothing else changes it."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import FrozenInstanceError, fields
from typing import Any

import pytest
from dose_bench import DISH, MORTAR, shipped_powders
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter

from scuhand_bt.cell.believed import Believed
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

masses_mg = st.sampled_from([-10.0, 0.0, 30.0, 3000.0])
grosses_mg = st.sampled_from([-50.0, 20_000.0, 20_030.0])
sources = st.sampled_from(list(SOURCES.values()))
names = st.sampled_from(list(SOURCES))

VERBS: dict[str, st.SearchStrategy[Callable[[Believed], object]]] = {
    "source_holds": st.builds(lambda n, m: lambda b: b.source_holds(n, m), names, masses_mg),
    "cone_holds": st.builds(lambda s, m: lambda b: b.cone_holds(s, m), sources, masses_mg),
    "touched": st.builds(lambda s: lambda b: b.touched(s), sources),
    "scooped": st.builds(lambda s, m: lambda b: b.scooped(s, m), sources, masses_mg),
    "emptied": st.just(Believed.emptied),
    "returned": st.builds(lambda n, m: lambda b: b.returned(n, m), names, masses_mg),
    "cone_ran_empty": st.just(Believed.cone_ran_empty),
    "sheet_swapped": st.just(Believed.sheet_swapped),
    "sheet_is": st.builds(lambda s, n: lambda b: b.sheet_is(s.sheet_key, n), sources, st.integers(-1, 9)),
    "changing_container": st.just(Believed.changing_container),
    "removed": st.just(Believed.removed),
    "brought": st.builds(lambda by: lambda b: b.brought(DISH, from_changer=by), st.booleans()),
    "placed": st.builds(lambda g: lambda b: b.placed(g), grosses_mg),
    "slots_refilled": st.just(Believed.slots_refilled),
    "containers_taken": st.builds(lambda n: lambda b: b.containers_taken(n, {"die": n}), st.integers(-1, 9)),
    "dose_began": st.just(lambda b: b.dose_began(1.0)),
    "tared": st.builds(lambda g: lambda b: b.tared(g, 2.0), grosses_mg),
    "dosing_towards": st.builds(lambda m: lambda b: b.dosing_towards(m), masses_mg),
    "dosing_ended": st.builds(lambda m, g: lambda b: b.dosing_ended(m, g), masses_mg, grosses_mg),
    "dosed": st.builds(lambda g: lambda b: b.dosed(g, 1, 0.5), grosses_mg),
    "reweighed": st.builds(lambda g: lambda b: b.reweighed(g), grosses_mg),
    "zero_moved": st.builds(lambda d, g: lambda b: b.zero_moved(d, g), masses_mg, grosses_mg),
}


def verbs_of(kind: type) -> set[str]:
    public = {name for name, value in vars(kind).items() if callable(value) and not name.startswith("_")}
    return public - {field.name for field in fields(kind)}


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


def test_it_is_written_to_the_journal_as_it_always_was() -> None:
    believed = Believed()
    believed.source_holds("beads", 5000.0)
    believed.scooped(BEADS, 3000.0)
    believed.brought(DISH, from_changer=True)
    believed.placed(20_010.0)
    believed.tared(20_010.5, 4.0)
    believed.dosing_towards(50.0)
    written: dict[str, Any] = JSON.dump_python(believed, mode="json", by_alias=False)
    pan = written.pop("pan")
    assert (pan["id"], pan["empty_mass_mg"]) == (DISH.id, DISH.empty_mass_mg)
    assert written == {
        "cone_mg": 3000.0,
        "cone_source": "beads",
        "sheet": "glass_beads/L7",
        "sheets_used": 1,
        "slots_used": 1,
        "containers_used": {DISH.name: 1},
        "pan_empty_mg": 20_010.5,
        "pan_gross_mg": 20_010.5,
        "sources_mg": {"beads": 2000.0},
        "dosing": {
            "began_s": 4.0,
            "pulses": 0,
            "scoops": 0,
            "vibration_s": 0.0,
            "target_mg": 50.0,
            "is_unweighed": True,
        },
    }
    assert JSON.validate_python({**written, "pan": pan}, by_name=True, by_alias=False) == believed


def test_a_scoop_takes_from_its_source_what_it_brings_and_an_empty_cone_gives_it_back() -> None:
    believed = Believed()
    believed.source_holds("beads", 5000.0)
    believed.scooped(BEADS, 3000.0)
    believed.dosing_ended(1000.0, 21_000.0)
    assert (believed.cone_mg, believed.sources_mg, believed.dosing.scoops) == (2000.0, {"beads": 2000.0}, 1)
    believed.cone_ran_empty()
    assert (believed.cone_mg, believed.cone_source, believed.sources_mg) == (0.0, None, {"beads": 4000.0})
    believed.returned("beads", 100.0)
    assert believed.sources_mg == {"beads": 4100.0}
    assert believed.sheet == "glass_beads/L7"


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
        believed.tared(1.0, 0.0)
    believed.placed(20_000.0)
    assert believed.weighed_container == DISH
    believed.tared(20_000.0, 0.0)
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


def test_what_arrived_since_the_last_weighing_has_left_the_cone() -> None:
    believed = Believed()
    with pytest.raises(ValueError, match="weighed before"):
        believed.reweighed(5.0)
    believed.scooped(BEADS, 100.0)
    believed.brought(DISH, from_changer=True)
    believed.placed(20_000.0)
    believed.tared(20_000.0, 0.0)
    believed.dosing_towards(50.0)
    believed.reweighed(20_030.0)
    assert (believed.cone_mg, believed.pan_gross_mg, believed.dosing.is_unweighed) == (70.0, 20_030.0, False)
    believed.zero_moved(2.0, 20_032.0)
    assert (believed.pan_empty_mg, believed.pan_gross_mg, believed.cone_mg) == (20_002.0, 20_032.0, 70.0)


def test_a_dose_counts_what_it_cost_over_all_of_its_parts() -> None:
    believed = Believed()
    believed.dose_began(3.0)
    with suppress(ValueError):
        believed.dosing_towards(float("nan"))
    assert not believed.dosing.is_unweighed
    for _ in range(2):
        believed.dosing_towards(50.0)
        believed.dosing_ended(10.0, 0.0)
        assert (believed.dosing.target_mg, believed.dosing.is_unweighed) == (None, True)
        believed.dosed(0.0, 3, 1.5)
    assert (believed.dosing.pulses, believed.dosing.vibration_s, believed.dosing.is_unweighed) == (6, 3.0, False)
    assert believed.dosing.began_s == 3.0
