"""The inventory in runs: kept by what was measured, and what a real run begins from and asks."""

import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from conftest import problems_of
from inventory_bench import AMOUNT, RECIPE, SOURCE, Answering, powder
from running import Watching, dry_run, shared_planner

from scuhand_bt.bench_spec import Station
from scuhand_bt.device_specs.balance import BalanceLimits
from scuhand_bt.lab import Lab
from scuhand_bt.lab_state.beliefs import LabState
from scuhand_bt.lab_state.inventory import Inventory, StockEntry
from scuhand_bt.lab_state.lab_db import reading_lab_db
from scuhand_bt.recipe.plan import Plan, make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.lab_records import LabRecords
from scuhand_bt.run.make_cell import Setup, set_up
from scuhand_bt.run.options import Options
from scuhand_bt.run.outcome import BatchResult
from scuhand_bt.run.resume import checked_history, resumable
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun


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
        assert problem.endswith("the leftover of glass_beads/L7 is to go there")
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
