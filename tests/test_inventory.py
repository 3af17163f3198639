"""The inventory: kept from run to run by what was measured, corrected by people, held against recipes."""

import json
import sqlite3
import threading
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from conftest import Call, Desk, Ended, LabFolder, problems_of
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from running import Watching, dry_run, shared_planner

from scuhand_bt.bench_spec import Station
from scuhand_bt.cell.cell import Cell
from scuhand_bt.clock import Steps
from scuhand_bt.device_specs.balance import BalanceLimits
from scuhand_bt.failures import SkillFailed
from scuhand_bt.lab import Lab
from scuhand_bt.lab_state.beliefs import LabState
from scuhand_bt.lab_state.inventory import Inventory, Stock, StockEntry
from scuhand_bt.lab_state.lab_db import MIGRATIONS, reading_lab_db, writing_lab_db
from scuhand_bt.problems import SourceError
from scuhand_bt.recipe.plan import Plan, make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.inventory_conflicts import Conflict, about_rim, conflicts, recall, require_resolvable, resolve
from scuhand_bt.run.lab_records import LabRecords
from scuhand_bt.run.make_cell import Setup, set_up
from scuhand_bt.run.options import Options
from scuhand_bt.run.outcome import BatchResult
from scuhand_bt.run.resume import checked_history, resumable
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun

RECIPE = """\
recipe: one
workflow: fill_xrd_holder
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 5 g, lot: L7}
defaults: {source: beads, container: xrd_holder, tolerance: 5 mg}
samples: [{id: a, mass: 50 mg}, {id: b, mass: 60 mg}]
"""
AMOUNT, SOURCE = "4:86", "4:3"


# --- the lab's database


def learnt_before(folder: Path) -> None:
    """A database as the first version of the schema had it."""
    with closing(sqlite3.connect(folder / "lab.db")) as database, database:
        database.execute(MIGRATIONS[0])
        database.execute("PRAGMA user_version=1")
        belief = '{"coefficient": 70.5, "doses": 3}'
        row = ("powder", "glass_beads/L7", 0, "before", "2026-01-01T00:00:00+00:00", belief)
        database.execute("INSERT INTO learnt (kind, name, simulated, run, at, belief) VALUES (?,?,?,?,?,?)", row)


def test_a_database_of_the_first_schema_is_brought_up_to_date_with_what_it_holds(tmp_path: Path) -> None:
    learnt_before(tmp_path)
    assert LabState(tmp_path).powders(simulated=False)["glass_beads/L7"].belief.doses == 3
    Inventory(tmp_path, "starter").enter(StockEntry("cone", mass_mg=0.0))
    assert set(Inventory(tmp_path, "starter").stock(simulated=False)) == {("cone", "")}
    assert LabState(tmp_path).powders(simulated=False)["glass_beads/L7"].run == "before"


def test_a_migration_that_breaks_leaves_the_database_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    learnt_before(tmp_path)
    before = (tmp_path / "lab.db").read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr("scuhand_bt.lab_state.lab_db.MIGRATIONS", (*MIGRATIONS, "CREATE NONSENSE"))
        assert len(problems_of(lambda: LabState(tmp_path).powders(simulated=False))) == 1
    assert (tmp_path / "lab.db").read_bytes() == before
    assert LabState(tmp_path).powders(simulated=False)


def test_a_database_of_a_newer_program_is_refused_and_left_alone(tmp_path: Path) -> None:
    learnt_before(tmp_path)
    with closing(sqlite3.connect(tmp_path / "lab.db")) as database, database:
        database.execute("PRAGMA user_version=99")
    before = (tmp_path / "lab.db").read_bytes()
    with pytest.raises(SourceError, match=r"lab\.db:1:1: .* has the schema 99, and this program knows [0-9]+; a newer"):
        LabState(tmp_path).powders(simulated=False)
    assert (tmp_path / "lab.db").read_bytes() == before


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_a_damaged_database_is_one_clear_problem_or_still_read(tmp_path: Path, data: st.DataObject) -> None:
    for path in tmp_path.glob("lab.db*"):
        path.unlink()
    Inventory(tmp_path, "starter").enter(StockEntry("station", "mortar_bay", "glass_beads", "L7", 5000.0))
    content = bytearray((tmp_path / "lab.db").read_bytes())
    if data.draw(st.booleans()):
        del content[data.draw(st.integers(1, len(content) - 1)) :]
    else:
        content[data.draw(st.integers(0, len(content) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    (tmp_path / "lab.db").write_bytes(content)
    said = problems_of(lambda: Inventory(tmp_path, "starter").stock(simulated=False))
    assert all("the lab's database" in problem for problem in said)


def test_nothing_is_made_by_looking(tmp_path: Path) -> None:
    assert Inventory(tmp_path / "none", "starter").stock(simulated=False) == {}
    assert not (tmp_path / "none").exists()


def test_a_database_that_another_process_holds_is_said_to_be_locked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    Inventory(tmp_path, "starter").enter(StockEntry("cone", mass_mg=0.0))
    with writing_lab_db(tmp_path):
        connect = sqlite3.connect
        monkeypatch.setattr(sqlite3, "connect", lambda path, **more: connect(path, **{**more, "timeout": 0.05}))
        with pytest.raises(SourceError, match="cannot be used: database is locked"):
            Inventory(tmp_path, "starter").enter(StockEntry("cone", mass_mg=0.0))


# --- kept by runs


def test_a_run_keeps_what_it_believes_apart_from_real_cells(tmp_path: Path) -> None:
    ran = dry_run(tmp_path, RECIPE)
    cell, stock = ran.session.cell, Inventory(tmp_path, "starter").stock(simulated=True)
    station = stock["station", "mortar_bay"]
    assert (station.lot_key, station.mass_mg) == ("glass_beads/L7", cell.believed.sources_mg["beads"])
    assert station.mass_mg is not None
    assert 4500 < station.mass_mg < 5000
    assert station.run == ran.session.run_id
    assert stock["cone", ""].mass_mg == 0.0
    assert (stock["sheet", ""].lot_key, stock["sheet", ""].used) == ("glass_beads/L7", 1)
    assert stock["changer", ""].used == 2
    assert stock["container", "xrd_holder"].used == 2
    assert Inventory(tmp_path, "starter").stock(simulated=False) == {}
    assert Inventory(tmp_path, "another").stock(simulated=True) == {}


def test_only_what_changes_is_added_and_an_operators_entry_stands_until_the_run_changes_it(tmp_path: Path) -> None:
    cell = replace(dry_run(tmp_path, RECIPE).session.cell, simulated=False)
    inventory = Inventory(tmp_path, "starter")

    def count() -> int:
        with reading_lab_db(tmp_path) as database:
            assert database is not None
            return int(database.execute("SELECT count(*) FROM inventory WHERE simulated = 0").fetchone()[0])

    inventory.keep(cell, "r1")
    rows = count()
    inventory.keep(cell, "r1")
    assert count() == rows
    Inventory(tmp_path, "starter").enter(StockEntry("station", "mortar_bay", "glass_beads", "L7", 9000.0))
    inventory.keep(cell, "r1")
    refilled = inventory.stock(simulated=False)["station", "mortar_bay"]
    assert (refilled.mass_mg, refilled.run) == (9000.0, None)
    assert refilled.operator
    cell.believed.scooped(cell.sources["beads"], 100.0)
    inventory.keep(cell, "r1")
    assert inventory.stock(simulated=False)["station", "mortar_bay"].run == "r1"


def test_what_cannot_be_kept_is_told_and_ends_nothing(tmp_path: Path) -> None:
    cell = dry_run(tmp_path, RECIPE).session.cell
    (tmp_path / "lab.db").write_bytes(b"this is no database" * 100)
    error = Inventory(tmp_path, "starter").keep(cell, "r1")
    assert error is not None
    assert "the lab's database is damaged" in error
    error = LabState(tmp_path).keep(cell, "r1")
    assert error is not None
    assert "move it away" in error


# --- held against a recipe


def plan_of(desk: Desk, recipe: str = RECIPE) -> Plan:
    return make_plan(desk.load(recipe), desk.lab)


def stock_of(*entries: StockEntry) -> Stock:
    """What run r1 has left, of which only the changer's time counts."""
    at = {"changer": "2026-11-01T09:00:00+00:00"}
    return {(one.kind, one.name): replace(one, run="r1", at=at.get(one.kind, "today")) for one in entries}


def powder(mass_mg: float, lot: str = "L7", name: str = "glass_beads") -> StockEntry:
    return StockEntry("station", "mortar_bay", name, lot, mass_mg)


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
    gone = "its samples need 150.0 mg with losses, and as scoops bring more than a dose some 0.6 g are discarded before"
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
        "refill it, and say so: scuhand-bt inventory set mortar_bay '150 mg' --powder glass_beads --lot L7"
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


class Answering:
    """An operator who gives these answers."""

    def __init__(self, *answers: str) -> None:
        self.answers = list(answers)
        self.asked: list[tuple[str, tuple[str, ...]]] = []

    def ask(self, question: str, choices: tuple[str, ...]) -> Steps[str]:
        self.asked.append((question, choices))
        return self.answers.pop(0)
        yield


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
    assert operator.asked[0][0].endswith("Is a fresh one in the hand now, its rim 90 mm wide?")


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
    question = (
        "A fresh sheet was entered. How wide is its rim: 90 mm, as it is mounted, or 48 mm, to which it was rolled"
    )
    assert operator.asked == [(f"{question} since?", ("mounted", "rolled", "stop"))]


# --- in a real run, here with the simulated devices taken for real ones


@pytest.fixture
def real(tmp_path: Path, starter: Lab, monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[BatchResult, Session]]:
    balance = starter.cell.balance.model_copy(update={"limits": BalanceLimits()})  # no check weight is asked for
    lab = replace(starter, cell=starter.cell.model_copy(update={"balance": balance}))

    def taken_for_real(plan: Plan, lab: Lab, simulation: object, *args: object, **more: object) -> Setup:
        made = set_up(plan, lab, DryRun(), *args, **more)  # type: ignore[arg-type]
        made.cell.simulated = False
        return made

    def run(
        recipe: str = RECIPE,
        operator: Answering | None = None,
        rim_mm: float = 90.0,
        lab: Lab = lab,
        goes_on: Session | None = None,
        stop_at: int | None = None,
        **options: bool,
    ) -> tuple[BatchResult, Session]:
        path = tmp_path / "recipe.yaml"
        path.write_text(recipe)
        plan = make_plan(load_recipe(path, lab), lab)
        given = Options(None, "paper", tmp_path / "runs", **options)
        found = None
        if goes_on is not None:
            before = goes_on.journal.path
            found = resumable(before, checked_history(before), plan, lab, accept_changes=True)
        session = Session(plan, lab, given, shared_planner(plan, lab), resumes=found)
        if operator is not None:
            session.cell.operator = operator  # type: ignore[assignment]
        session.cell.hand.rim_is(rim_mm)
        try:
            return session.run(Watching(session, stop_at)), session
        finally:
            session.close()

    monkeypatch.setattr("scuhand_bt.run.session.set_up", taken_for_real)
    return run


def test_a_real_run_goes_on_from_what_the_one_before_left(real: Callable[..., tuple[BatchResult, Session]]) -> None:
    first = real()[1].cell.believed
    result, session = real(operator=Answering())
    second = session.cell.believed
    assert result.exit_code in (0, 1)
    assert second.sources_mg["beads"] < first.sources_mg["beads"] < 5000.0
    assert (first.slots_used, second.slots_used) == (2, 4)
    assert second.containers_used == {"xrd_holder": 4}


@pytest.mark.slow
def test_a_real_run_asks_for_the_rim_of_a_sheet_that_was_entered_once(
    real: Callable[..., tuple[BatchResult, Session]], tmp_path: Path, starter: Lab
) -> None:
    real()
    Inventory(tmp_path, starter.cell.cell).enter(StockEntry("sheet", "", used=2))
    for asked in (1, 0):
        operator = Answering(*["mounted"] * asked)
        assert real(operator=operator, rim_mm=48.0)[0].exit_code in (0, 1)
        assert len(operator.asked) == asked


@pytest.mark.slow
def test_a_real_run_asks_before_another_lot_comes_to_what_earlier_runs_have_put_into_a_vessel(
    real: Callable[..., tuple[BatchResult, Session]], tmp_path: Path, starter: Lab
) -> None:
    def in_jar() -> StockEntry | None:
        return Inventory(tmp_path, "starter").stock(simulated=False).get(("station", "jar"))

    balance = starter.cell.balance.model_copy(update={"limits": BalanceLimits()})
    jar = Station(name="jar", kind="waste", position_mm=(0.0, 320.0, 100.0))
    stations = {**starter.cell.stations, "jar": jar}
    lab = replace(starter, cell=starter.cell.model_copy(update={"balance": balance, "stations": stations}))
    into_jar = RECIPE + "leftover: {to: jar}\n"
    real(into_jar, lab=lab)
    first = in_jar()
    assert first is not None
    assert (first.lot_key, (first.mass_mg or 0.0) > 500.0) == ("glass_beads/L7", True)
    Inventory(tmp_path, "starter").enter(powder(5000.0))
    real(into_jar, Answering(), lab=lab)
    second = in_jar()
    assert second is not None
    assert (second.mass_mg or 0.0) > (first.mass_mg or 0.0) + 500.0, "of the same lot it is more and more"

    Inventory(tmp_path, "starter").enter(powder(5000.0))
    stopped = real(into_jar, Answering(), lab=lab, stop_at=150)[1]
    Inventory(tmp_path, "starter").enter(StockEntry("station", "jar", "monosodium_glutamate", "", 3.0))
    refused = "by the inventory the vessel 'jar' holds 3.0 mg of monosodium_glutamate (operator "
    for goes_on in (None, stopped):
        problems = problems_of(lambda one=goes_on: real(into_jar, lab=lab, unattended=True, goes_on=one))
        (problem,) = (one for one in problems if one.startswith(f"7:11: {refused}"))
        assert problem.endswith("what is left of glass_beads/L7 is to go there")
    operator = Answering("emptied")
    result, session = real(into_jar, operator, lab=lab, goes_on=stopped)
    assert result.exit_code in (0, 1)
    assert [choices for _, choices in operator.asked] == [("emptied", "stop")]
    held = session.cell.believed.vessels["jar"]
    assert held.lot == "glass_beads/L7"
    assert 500.0 < held.mass_mg < (first.mass_mg or 0.0) + 500.0, "what was there before it was emptied is not there"


@pytest.mark.slow
def test_a_run_goes_on_while_the_inventory_is_written(
    real: Callable[..., tuple[BatchResult, Session]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write, after_job = Inventory._write, LabRecords.after_job
    jobs, second, waited = list[int](), threading.Event(), list[bool]()

    def slow(inventory: Inventory, *arguments: Any) -> None:
        waited.append(second.wait(5.0))
        write(inventory, *arguments)

    def ended(records: LabRecords) -> None:
        after_job(records)
        jobs.append(1)
        if len(jobs) == 2:
            second.set()

    monkeypatch.setattr(Inventory, "_write", slow)
    monkeypatch.setattr(LabRecords, "after_job", ended)
    believed = real()[1].cell.believed
    assert waited[0], "the second job has ended before the first one was written"
    assert Inventory(tmp_path, "starter").stock(simulated=False)["station", "mortar_bay"].mass_mg == pytest.approx(
        believed.sources_mg["beads"]
    )


def test_a_real_run_settles_its_doubts_before_anything_moves(
    real: Callable[..., tuple[BatchResult, Session]], tmp_path: Path
) -> None:
    Inventory(tmp_path, "starter").enter(powder(3000.0))
    assert problems_of(lambda: real(unattended=True))[0].startswith(f"{AMOUNT}: 'beads' holds 3.0000 g")
    operator = Answering("inventory")
    result, session = real(operator=operator)
    assert len(operator.asked) == 1
    assert result.exit_code in (0, 1)
    assert session.cell.believed.sources_mg["beads"] < 3000.0
    refused, _ = real(RECIPE.replace("5 g", "9 g"), operator=Answering("stop"))
    assert refused.exit_code == 3
    assert "operator.refused" in refused.reason
    assert [sample.verdict for sample in refused.samples] == ["not run", "not run"]
    Inventory(tmp_path, "starter").enter(powder(3000.0, lot="L8"))
    assert problems_of(real)[0].startswith(f"{SOURCE}: by the inventory 'mortar_bay' holds 3.0000 g of glass_beads/L8")


# --- the command


@pytest.fixture
def inventory(command: Call, lab_folder: LabFolder) -> Call:
    """A command about this lab."""

    def call(*arguments: object) -> Ended:
        at = 2 if "set" in arguments else 1
        ended = command(*arguments[:at], "--lab", lab_folder.folder, *arguments[at:])
        return ended._replace(stderr=" ".join(ended.stderr.replace("│", " ").split()))

    return call


def test_an_operator_says_what_is_there(inventory: Call) -> None:
    assert inventory("inventory")[1].startswith("Nothing is known yet")
    given = ("inventory", "set", "mortar_bay", "12 g", "--powder", "glass_beads", "--lot", "GB-0311")
    assert inventory(*given) == (0, "mortar_bay: 12.0000 g of glass_beads/GB-0311\n", "")
    assert inventory("inventory", "set", "mortar_bay", "9 g")[1] == "mortar_bay: 9.0000 g of glass_beads/GB-0311\n"
    again = ("inventory", "set", "mortar_bay", "9 g", "--powder", "glass_beads")
    assert inventory(*again)[1] == "mortar_bay: 9.0000 g of glass_beads/GB-0311\n"
    assert inventory("inventory", "set", "cone", "0 mg")[1] == "cone: 0.0 mg\n"
    assert inventory("inventory", "set", "sheet", "fresh")[1] == "sheet: number 1, fresh\n"
    assert inventory("inventory", "set", "sheet", "touched", "--powder", "glass_beads")[0] == 0
    assert inventory("inventory", "set", "sheet", "fresh")[1] == "sheet: number 2, fresh\n"
    assert inventory("inventory", "set", "changer", "3")[1] == "changer: 3 used\n"
    assert inventory("inventory", "set", "xrd_holder", "40")[0] == 0
    shown = inventory("inventory")[1]
    assert all(word in shown for word in ("mortar_bay", "glass_beads/GB-0311", "9.0000 g", "operator ", "40 used"))
    entries = json.loads(inventory("inventory", "--json")[1])
    assert [entry["kind"] for entry in entries] == ["station", "cone", "sheet", "changer", "container"]
    assert inventory("inventory", "--simulated")[1].startswith("Nothing is known yet")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("mortar_bey", "1 g"), "did you mean 'mortar_bay'?"),
        (("mortar_bay", "1"), "'1' has no unit; write a mass with its unit"),
        (("mortar_bay", "1 mm"), "'mm' is a unit of length, not of mass"),
        (("mortar_bay", "1 g"), "nothing is known of the powder yet; name it"),
        (("mortar_bay", "1 g", "--powder", "glas_beads"), "did you mean 'glass_beads'?"),
        (("cone", "1 g"), "nothing is known of the powder yet"),
        (("sheet", "new"), "'new' is nothing a sheet can be; fresh or touched"),
        (("changer", "full"), "'full' is no number of what is used"),
        (("changer", "25"), "'25' is more than the changer's 24 slots; write 0 to 24"),
        (("changer", "2", "--powder", "glass_beads"), "it holds no powder"),
    ],
)
def test_what_cannot_be_meant_is_refused(inventory: Call, arguments: tuple[str, ...], said: str) -> None:
    code, _, error = inventory("inventory", "set", *arguments)
    assert code == 2
    assert said in error
    assert json.loads(inventory("inventory", "--json")[1]) == []


def test_a_vessel_for_leftovers_has_its_entry_and_an_empty_one_has_no_lot(
    inventory: Call, lab_folder: LabFolder
) -> None:
    assert "unknown thing 'jar'" in inventory("inventory", "set", "jar", "2 g", "--powder", "titanium_dioxide")[2]
    lab_folder.replace(
        "robot/cell.yaml", "  sheet_swap:", "  jar: {kind: waste, position: [0 mm, 320 mm, 100 mm]}\n  sheet_swap:"
    )
    assert (
        inventory("inventory", "set", "jar", "2 g", "--powder", "titanium_dioxide")[1]
        == "jar: 2.0000 g of titanium_dioxide\n"
    )
    assert inventory("inventory", "set", "jar", "0 g")[1] == "jar: 0.0 mg\n"
    assert inventory("inventory", "set", "waste", "2 g", "--powder", "titanium_dioxide")[0] == 2, (
        "the bin is of all lots"
    )


def test_what_no_sample_takes_from_does_not_come_into_a_vessel(inventory: Call, lab_folder: LabFolder) -> None:
    lab_folder.replace(
        "robot/cell.yaml", "  sheet_swap:", "  jar: {kind: waste, position: [0 mm, 320 mm, 100 mm]}\n  sheet_swap:"
    )
    spare = "  spare: {station: mortar_bay_2, container: agate_mortar, powder: glass_beads, amount: 5 g, lot: L8}\n"
    text = RECIPE.replace("sources:\n", f"sources:\n{spare}") + "leftover: {to: jar}\n"
    path = str(lab_folder.write("recipes/one.yaml", text))
    inventory("inventory", "set", "jar", "2 g", "--powder", "glass_beads", "--lot", "L7")
    code, said, noted = inventory("check", "--fast", path)
    assert (code, "[unused-source]" in said, "the vessel 'jar'" in noted) == (0, True, False)
    inventory("inventory", "set", "jar", "2 g", "--powder", "glass_beads", "--lot", "L8")
    assert "what is left of glass_beads/L7 is to go there" in inventory("check", "--fast", path)[2]


def test_less_than_nothing_is_refused(inventory: Call) -> None:
    code, _, error = inventory("inventory", "set", "--powder", "glass_beads", "mortar_bay", "--", "-1 g")
    assert code == 2
    assert "'-1 g' is less than nothing" in error


def test_check_notes_what_a_real_run_would_ask_and_dry_runs_do_not_mind(inventory: Call, lab_folder: LabFolder) -> None:
    path = str(lab_folder.write("recipes/one.yaml", RECIPE))
    inventory("inventory", "set", "mortar_bay", "3 g", "--powder", "glass_beads", "--lot", "L7")
    code, _, noted = inventory("check", path)
    assert code == 0
    assert f"Note: {path}:{AMOUNT}: 'beads' holds 3.0000 g of glass_beads/L7 by the inventory (operator " in noted
    notes = json.loads(inventory("plan", path, "--trials", 0, "--json")[1])["notes"]
    assert any("the recipe says 5.0000 g" in note for note in notes)
    inventory("inventory", "set", "mortar_bay", "3 g", "--lot", "L8")
    assert inventory("run", path, "--dry-run", "--controller", "paper")[0] in (0, 1)
    (lab_folder.folder / ".scuhand" / "lab.db").write_bytes(b"no database" * 1000)
    assert "the lab's database is damaged" in inventory("check", path)[2]


def test_the_lab_may_be_named_before_the_subcommand(command: Call, lab_folder: LabFolder) -> None:
    command("inventory", "--lab", lab_folder.folder, "set", "cone", "0 g")
    assert (lab_folder.folder / ".scuhand" / "lab.db").exists()
