"""The order of a batch's samples: how often the sheet is changed, and when a person has to."""

from collections import Counter
from collections.abc import Iterable
from itertools import pairwise, permutations
from types import SimpleNamespace
from typing import Any

import pytest
from conftest import Call, LabFolder
from hypothesis import given
from hypothesis import strategies as st

from scuhand_bt.recipe.order import ORDERS, in_order
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe

MIX = """workflow: mix
inputs: {first: Source, second: Source, container: Container, mass: Mass, tolerance: {type: Mass, default: 2 mg}}
tree:
  sequence:
    - place_container: {container: $container}
    - tare:
    - fill: {source: $first, container: $container, mass: $mass, tolerance: $tolerance}
    - change_powder: {source: $first}
    - tare:
    - fill: {source: $second, container: $container, mass: $mass, tolerance: $tolerance}
    - park:
"""
MIXED = """recipe: mixed
workflow: mix
order: ORDER
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 5 g}
  msg: {station: mortar_bay_2, container: agate_mortar, powder: monosodium_glutamate, amount: 5 g}
defaults: {container: xrd_holder, mass: 50 mg}
samples:
  - {id: bm-1, first: beads, second: msg}
  - {id: b, workflow: scoop_and_dispense, source: beads}
  - {id: mb-1, first: msg, second: beads}
  - {id: bm-2, first: beads, second: msg}
  - {id: m, workflow: scoop_and_dispense, source: msg}
"""


def sample(name: str, first: str, last: str) -> Any:
    lots = [SimpleNamespace(sheet_key=lot) for lot in (first, last)]
    return SimpleNamespace(id=name, sources=lots, last_source=lots[1])


def changes(order: Iterable[Any]) -> int:
    return sum(a.last_source.sheet_key != b.sources[0].sheet_key for a, b in pairwise(order))


@pytest.mark.parametrize(("order", "swaps"), [("as_written", 2), ("by_powder", 2), ("fastest", 0)])
def test_the_fastest_order_goes_on_with_the_sheet_that_is_in_the_hand(
    lab_folder: LabFolder, order: str, swaps: int
) -> None:
    lab_folder.write("trees/mix.yaml", MIX)
    lab = lab_folder.load()
    plan = make_plan(load_recipe(lab_folder.write("recipes/mixed.yaml", MIXED.replace("ORDER", order)), lab), lab)
    assert sorted(job.sample.id for job in plan.jobs if job.sample) == ["b", "bm-1", "bm-2", "m", "mb-1"]
    assert plan.swaps == swaps
    assert plan.fewest_swaps == 0


def test_a_plan_tells_with_which_order_the_sheet_is_swapped_less_often(lab_folder: LabFolder, command: Call) -> None:
    lab_folder.write("trees/mix.yaml", MIX)

    def planned(order: str) -> str:
        recipe = lab_folder.write(f"recipes/{order}.yaml", MIXED.replace("ORDER", order))
        return command("plan", recipe, "--trials", 0).stdout

    assert "Sheet swaps between samples: 2 (0 with `order: fastest`)." in planned("as_written")
    assert "Sheet swaps between samples: 0." in planned("fastest")


@given(st.lists(st.tuples(st.sampled_from("abcd"), st.sampled_from("abcd")), max_size=6))
def test_no_order_changes_the_sheet_less_often_than_the_fastest(ends: list[tuple[str, str]]) -> None:
    samples = [sample(str(number), *lots) for number, lots in enumerate(ends)]
    found = in_order("fastest", samples, lambda _: 1.0)
    assert sorted(map(id, found)) == sorted(map(id, samples))
    assert changes(found) == min(map(changes, permutations(samples)))


@pytest.mark.parametrize("order", ["by_powder", "fastest"])
def test_an_order_that_saves_no_change_of_the_sheet_has_the_changer_filled_no_more_often(
    lab_folder: LabFolder, order: str
) -> None:
    lab_folder.replace("robot/cell.yaml", "slots: 24", "slots: {xrd_holder: 3, alumina_crucible: 2}")
    lab_folder.write("trees/mix.yaml", MIX)
    samples = """samples:
  - {id: s0, workflow: scoop_and_dispense, source: beads}
  - {id: s1, workflow: scoop_and_dispense, source: msg, container: alumina_crucible}
  - {id: s2, workflow: scoop_and_dispense, source: beads, container: alumina_crucible}
  - {id: s3, first: beads, second: msg, container: alumina_crucible, repeat: 2}
"""
    recipe = MIXED.partition("samples:")[0].replace("ORDER", order) + samples
    lab = lab_folder.load()
    plan = make_plan(load_recipe(lab_folder.write("recipes/mixed.yaml", recipe), lab), lab)
    assert plan.swaps == 1
    visits = {person.job: person.what for person in plan.persons if person.job is not None}
    assert len(visits) == 3, "in an order of the same number of changes the changer is filled when no sheet is due"


@given(st.lists(st.tuples(st.sampled_from("abcd"), st.floats(1.0, 100.0)), min_size=1, max_size=8))
def test_persons_are_needed_within_as_short_a_time_as_there_is(given_samples: list[tuple[str, float]]) -> None:
    samples = [sample(str(number), lot, lot) for number, (lot, _) in enumerate(given_samples)]

    def duration_s(one: Any) -> float:
        return given_samples[int(one.id)][1]

    def together_s(order: Iterable[Any]) -> float:
        now_s, swaps_s, last = 0.0, [], None
        for one in order:
            if last not in (None, one.sources[0].sheet_key):
                swaps_s.append(now_s)
            now_s, last = now_s + duration_s(one), one.sources[0].sheet_key
        return max(swaps_s, default=0.0) - min(swaps_s, default=0.0)

    lots = list(dict.fromkeys(lot for lot, _ in given_samples))
    grouped = [
        [one for lot in order for one in samples if one.sources[0].sheet_key == lot] for order in permutations(lots)
    ]
    found = in_order("persons_together", samples, duration_s)
    assert together_s(found) == pytest.approx(min(map(together_s, grouped)))
    assert changes(found) == len(lots) - 1


def test_a_lot_whose_samples_need_a_person_themselves_is_neither_first_nor_last() -> None:
    samples = [sample("m", "a", "b"), sample("n", "a", "b"), sample("c", "c", "c"), sample("d", "d", "d")]
    found = in_order("persons_together", samples, lambda one: 100.0 if one.id in "mn" else 1.0)
    assert [one.id for one in found] == ["c", "m", "n", "d"]


def test_a_mixture_does_not_bring_a_person_into_a_stretch_of_samples_of_one_lot() -> None:
    """Who came at both ends of a long stretch for one mixture of its lot, where in any other order once was enough."""
    samples = [sample("a-1", "a", "a"), sample("mix", "a", "b"), sample("a-2", "a", "a"), sample("b", "b", "b")]
    found = in_order("persons_together", samples, lambda one: 1.0 if one.id == "mix" else 3600.0)
    assert [one.id for one in found] == ["a-1", "a-2", "mix", "b"]


def test_a_sample_that_comes_back_to_its_first_lot_needs_a_person_all_the_same() -> None:
    back = sample("back", "a", "a")
    back.sources.append(SimpleNamespace(sheet_key="b"))
    found = in_order("persons_together", [back, sample("c", "c", "c"), sample("d", "d", "d")], lambda _: 1.0)
    assert [one.id for one in found] == ["c", "back", "d"]


@given(st.lists(st.tuples(st.sampled_from("abcd"), st.sampled_from("abcd")), max_size=7))
def test_what_needs_a_person_is_between_the_two_longest_stretches_with_as_few_changes_as_there_can_be(
    ends: list[tuple[str, str]],
) -> None:
    samples = [sample(str(number), *lots) for number, lots in enumerate(ends)]
    found = in_order("persons_together", samples, lambda _: 1.0)
    assert sorted(map(id, found)) == sorted(map(id, samples))
    alone = Counter(first for first, last in ends if first == last)
    lots = [lot for lot, _ in alone.most_common(2)]
    first, last = ([one for one in samples if lots[n:] and ends[int(one.id)] == (lots[n],) * 2] for n in (0, 1))
    between = [one for one in samples if one not in (*first, *last)]
    ways = [(first, last), (last, first)]
    assert any(found[: len(a)] == a and found[len(found) - len(b) :] == b for a, b in ways)
    assert changes(found) == min(changes([*a, *middle, *b]) for middle in permutations(between) for a, b in ways)


def test_the_longest_lot_comes_last_where_the_sheet_is_changed_less_often_so() -> None:
    samples = [sample("b", "b", "b"), sample("mix", "a", "b"), sample("a", "a", "a")]
    found = in_order("persons_together", samples, lambda one: 9.0 if one.id == "b" else 1.0)
    assert [one.id for one in found] == ["a", "mix", "b"], "of as many changes as by powder, where it was two"


def test_the_longest_lot_comes_first_behind_what_takes_no_powder() -> None:
    samples = [sample("a", "a", "a"), sample("b", "b", "b"), sample("c", "c", "c"), sample("d", "d", "d")]
    blank = SimpleNamespace(id="blank", sources=[], last_source=None)
    taken_s = {"a": 2.0, "b": 8.0, "c": 1.0, "d": 9.0, "blank": 20.0}
    found = in_order("persons_together", [*samples, blank], lambda one: taken_s[one.id])
    assert [one.id for one in found] == ["blank", "d", "a", "c", "b"]


@pytest.mark.parametrize("order", ORDERS)
def test_within_a_lot_samples_stay_as_written(order: str) -> None:
    samples = [sample(str(number), "a", "a") for number in range(5)]
    assert in_order(order, samples, lambda _: 1.0) == samples
