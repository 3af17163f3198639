"""The inventory held against a recipe: what agrees is believed, what does not is refused or asked."""

from dataclasses import replace
from pathlib import Path

import pytest
from conftest import Desk, problems_of
from inventory_bench import AMOUNT, RECIPE, SOURCE, Answering, powder
from running import dry_run

from scuhand_bt.cell.cell import Cell
from scuhand_bt.failures import SkillFailed
from scuhand_bt.lab_state.inventory import Inventory, Stock, StockEntry
from scuhand_bt.recipe.plan import Plan, make_plan
from scuhand_bt.run.inventory_conflicts import Conflict, about_rim, conflicts, recall, require_resolvable, resolve


def plan_of(desk: Desk, recipe: str = RECIPE) -> Plan:
    return make_plan(desk.load(recipe), desk.lab)


def stock_of(*entries: StockEntry) -> Stock:
    """What run r1 has left, of which only the changer's time counts."""
    at = {"changer": "2026-11-01T09:00:00+00:00"}
    return {(one.kind, one.name): replace(one, run="r1", at=at.get(one.kind, "today")) for one in entries}


def noted(desk: Desk, *entries: StockEntry, recipe: str = RECIPE) -> list[str]:
    found = conflicts(plan_of(desk, recipe), desk.lab.cell, stock_of(*entries))
    return [f"{conflict.mark.line}:{conflict.mark.column}: {conflict.what}" for conflict in found]


def test_powder_is_told_with_about_where_a_run_says_how_much_and_as_it_was_entered_where_a_person_does() -> None:
    by_run = replace(powder(4300.0), run="r1")
    assert by_run.in_words == "about 4.3000 g"
    assert replace(by_run, run=None, operator="Eve").in_words == "4.3000 g"
    assert StockEntry("cone", mass_mg=0.0, run="r1").in_words == "0.0 mg", "it was seen to be emptied"


@pytest.mark.parametrize("mass_mg", [5000.0, 4800.0, 5200.0])
def test_amounts_that_agree_are_no_doubt(desk: Desk, mass_mg: float) -> None:
    assert noted(desk, powder(mass_mg)) == []


def test_a_recipe_that_says_more_is_told_where_and_who_says_otherwise(desk: Desk) -> None:
    assert noted(desk, powder(4300.0)) == [
        f"{AMOUNT}: 'beads' holds about 4.3000 g of glass_beads/L7 by the inventory (run r1, today); "
        "the recipe says 5.0000 g"
    ]
    (refilled,) = noted(desk, powder(9000.0))
    assert refilled.endswith("the recipe says 5.0000 g")


def test_what_is_discarded_of_the_inventorys_figure_is_told_where_it_is_asked_which_is_right(desk: Desk) -> None:
    discarding = RECIPE.replace("samples:", "leftover: discard\nsamples:")
    gone = "its samples need 150.0 mg with losses, and because scoops bring more than a dose, "
    gone += "about 0.6 g are discarded before"
    (doubt,) = _doubts(desk, powder(600.0), recipe=discarding)
    assert f"600.0 mg of glass_beads/L7 by the inventory (run r1, today), {gone}" in doubt.what
    assert doubt.question.endswith(
        f"or about 600.0 mg (inventory)? Of about 600.0 mg {gone} the last one: it may run out."
    )
    assert [name for name, _ in doubt.answers] == ["recipe", "inventory"]
    assert gone not in noted(desk, powder(800.0), recipe=discarding)[0]
    assert gone not in noted(desk, powder(100.0), recipe=discarding)[0], "that is too little whatever is discarded"


def test_too_little_for_the_samples_is_said(desk: Desk) -> None:
    (asked,) = noted(desk, powder(100.0))
    assert "100.0 mg of glass_beads/L7 by the inventory (run r1, today), too little: its samples need 1" in asked
    scarce = RECIPE.replace("amount: 5 g", "amount: 150 mg")
    (refused,) = noted(desk, powder(140.0), recipe=scarce)
    assert refused.endswith(
        "refill it, and enter that: scuhand-bt inventory set mortar_bay '150 mg' --powder glass_beads --lot L7"
    )
    assert problems_of(lambda: require_resolvable(_doubts(desk, powder(140.0), recipe=scarce), unattended=False))


def test_another_powder_or_lot_is_refused_by_a_real_run_with_what_to_say(desk: Desk) -> None:
    for entry in (powder(4000.0, lot="L8"), powder(4000.0, lot="", name="titanium_dioxide")):
        (problem,) = problems_of(lambda entry=entry: require_resolvable(_doubts(desk, entry), unattended=False))
        assert problem.startswith(f"{SOURCE}: by the inventory 'mortar_bay' holds about 4.0000 g of {entry.lot_key}")
        assert "scuhand-bt inventory set mortar_bay '5000 mg' --powder glass_beads --lot L7" in problem
    assert noted(desk, powder(0.0, lot="L8")) == []


def test_a_cone_or_a_sheet_of_another_lot_is_doubted(desk: Desk) -> None:
    cone = StockEntry("cone", "", "glass_beads", "L8", 300.0)
    sheet = StockEntry("sheet", "", "glass_beads", "L8", used=2)
    of_cone, of_sheet = noted(desk, cone, sheet)
    assert of_cone.startswith(f"{SOURCE}: by the inventory the cone holds about 300.0 mg of glass_beads/L8")
    assert "inventory set cone '0 mg'" in of_cone
    assert of_sheet.startswith(f"{SOURCE}: by the inventory the sheet has touched glass_beads/L8")
    assert noted(desk, replace(cone, lot="L7"), replace(sheet, lot="L7")) == []
    assert noted(desk, StockEntry("cone", mass_mg=0.0), StockEntry("sheet", used=3)) == []


def test_a_recipe_without_powder_needs_an_empty_cone(desk: Desk) -> None:
    check = "recipe: c\nworkflow: start_of_day\nsamples: [{id: a, weight: 20 g}]\n"
    (conflict,) = noted(
        desk, StockEntry("cone", "", "glass_beads", "L7", 300.0), StockEntry("sheet", "", "x", used=2), recipe=check
    )
    assert conflict.startswith(
        "1:1: by the inventory the cone holds about 300.0 mg of glass_beads/L7 (run r1, today); this rec"
    )


def test_a_changer_that_would_run_out_is_doubted(desk: Desk) -> None:
    assert noted(desk, StockEntry("changer", used=22)) == []
    (conflict,) = noted(desk, StockEntry("changer", used=23))
    assert conflict.endswith(
        "23 of the changer's 24 slots are used (run r1, 2026-11-01T09:00:00+00:00); the batch has 2 containers"
    )


def test_unattended_every_doubt_is_a_refusal(desk: Desk) -> None:
    found = _doubts(desk, powder(4000.0))
    require_resolvable(found, unattended=False)
    assert len(problems_of(lambda: require_resolvable(found, unattended=True))) == 1


def _doubts(desk: Desk, *entries: StockEntry, recipe: str = RECIPE) -> list[Conflict]:
    return conflicts(plan_of(desk, recipe), desk.lab.cell, stock_of(*entries))


def settled(cell: Cell, desk: Desk, operator: Answering, *entries: StockEntry) -> Cell:
    stock = stock_of(*entries)
    cell = replace(cell, operator=operator, believed=replace(cell.believed, sources_mg={"beads": 5000.0}))  # type: ignore[arg-type]
    recall(cell, stock)
    for _ in resolve(cell, conflicts(plan_of(desk), desk.lab.cell, stock)):
        pass
    return cell


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Cell:
    return dry_run(tmp_path_factory.mktemp("run"), RECIPE).session.cell


def test_a_real_run_believes_the_inventory_where_it_agrees(cell: Cell, desk: Desk) -> None:
    believed = settled(
        cell,
        desk,
        Answering(),
        powder(4900.0),
        StockEntry("cone", "", "glass_beads", "L7", 120.0),
        StockEntry("sheet", "", "glass_beads", "L7", used=4),
        StockEntry("changer", used=3),
        StockEntry("container", "pellet_die_13mm", used=8),
    ).believed
    assert believed.sources_mg == {"beads": 4900.0}
    assert (believed.cone_source, believed.cone_mg) == ("beads", 120.0)
    assert (believed.sheet, believed.sheets_used, believed.slots_used) == ("glass_beads/L7", 4, 3)
    assert believed.containers_used == {"pellet_die_13mm": 8, "xrd_holder": 2}, "what it does not say stays"


def test_a_cone_that_was_not_seen_to_be_empty_is_no_empty_one_for_the_next_run(tmp_path: Path, desk: Desk) -> None:
    """What it may hold after its arm was limp would fall out of it as the next scoop tips it."""
    before = dry_run(tmp_path, RECIPE).session.cell
    before.believed.cone_holds(before.sources["beads"], 2000.0)
    before.believed.cone_spilled()
    Inventory(tmp_path / "kept", "starter").keep(before, "r1")
    after = dry_run(tmp_path, RECIPE).session.cell
    recall(after, Inventory(tmp_path / "kept", "starter").stock(simulated=True))
    assert (after.believed.cone_source, after.believed.cone_mg) == ("beads", 0.0), "a scoop lets it out before"
    recall(after, stock_of(StockEntry("cone", mass_mg=0.0), StockEntry("sheet", "", "glass_beads", "L7", used=2)))
    assert after.believed.cone_source is None, "a person says that it is empty"


@pytest.mark.parametrize(("answer", "mass_mg"), [("recipe", 5000.0), ("inventory", 3000.0)])
def test_a_real_run_asks_how_much_there_is(cell: Cell, desk: Desk, answer: str, mass_mg: float) -> None:
    operator = Answering(answer)
    assert settled(cell, desk, operator, powder(3000.0)).believed.sources_mg == {"beads": mass_mg}
    question = "How much powder is at mortar_bay: 5.0000 g (recipe) or about 3.0000 g (inventory)?"
    assert operator.asked == [(question, ("recipe", "inventory", "stop"))]


def test_what_is_too_little_is_no_answer(cell: Cell, desk: Desk) -> None:
    operator = Answering("recipe")
    settled(cell, desk, operator, powder(50.0))
    assert operator.asked[0][1] == ("recipe", "stop")


def test_a_fresh_sheet_is_counted_and_stop_refuses(cell: Cell, desk: Desk) -> None:
    sheet = StockEntry("sheet", "", "glass_beads", "L8", used=4)
    believed = settled(cell, desk, Answering("fresh"), sheet).believed
    assert (believed.sheet, believed.sheets_used) == (None, 5)
    with pytest.raises(SkillFailed, match=r"operator\.refused"):
        settled(cell, desk, Answering("stop"), sheet)


def test_a_fresh_sheet_is_as_wide_as_it_is_mounted_whatever_the_roller_has_made_of_the_last_one(
    tmp_path: Path, desk: Desk
) -> None:
    """Else the one that is mounted would be opened beyond the flat sheet."""
    cell = dry_run(tmp_path, RECIPE).session.cell
    cell.hand.rim_is(48.0)
    operator = Answering("fresh")
    settled(cell, desk, operator, StockEntry("sheet", "", "glass_beads", "L8", used=4))
    assert cell.hand.cone_diameter_mm == 90.0
    assert operator.asked[0][0].endswith("Is a fresh sheet in the hand now, with a rim of 90 mm?")


@pytest.mark.slow
@pytest.mark.parametrize(("answer", "rim_mm"), [("mounted", 90.0), ("rolled", 48.0)])
def test_of_a_fresh_sheet_that_was_entered_it_is_asked_what_the_roller_has_made_of_it(
    tmp_path: Path, answer: str, rim_mm: float
) -> None:
    cell = dry_run(tmp_path, RECIPE).session.cell
    cell.operator = operator = Answering(answer)  # type: ignore[assignment]
    entered = StockEntry("sheet", "", used=2, operator="ada")
    assert about_rim(cell, stock_of(entered)) == [], "it is as wide as it is mounted"
    cell.hand.rim_is(48.0)
    assert about_rim(cell, stock_of(replace(entered, operator=None))) == [], "a run has swapped it"
    assert about_rim(cell, stock_of(replace(entered, powder="glass_beads"))) == [], "it is no fresh one"
    for _ in resolve(cell, about_rim(cell, stock_of(entered))):
        pass
    assert cell.hand.cone_diameter_mm == rim_mm
    question = "A fresh sheet was entered. How wide is its rim: 90 mm as mounted, or 48 mm as the roller says?"
    assert operator.asked == [(question, ("mounted", "rolled", "stop"))]
