"""What is learnt of powders and balances is kept in the lab, versioned, and apart from what was simulated."""

import json
import math
import sqlite3
from contextlib import closing
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from conftest import Call, LabFolder
from running import dry_run

from scuhand_bt.cell.believed import Believed
from scuhand_bt.dosing.identification import SHAPES
from scuhand_bt.lab_state.beliefs import LabState
from scuhand_bt.lab_state.lab_db import writing_lab_db
from scuhand_bt.run.cell_state import state_of, take_up
from scuhand_bt.specs import BALANCE_SHAPES, BalanceBelief, PowderBelief, Source

NOW = datetime.now().astimezone()

CHARACTERISE = """
recipe: characterise
workflow: characterise
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 20 g, lot: L7}
samples: [{id: a, source: beads, container: alumina_crucible}]
"""


def test_a_characterisation_is_kept_by_lot_with_the_run_that_taught_it(tmp_path: Path) -> None:
    ran = dry_run(tmp_path, CHARACTERISE, controller="adaptive")
    learnt = LabState(tmp_path).powders(simulated=True)["glass_beads/L7"]
    assert learnt.run == ran.session.run_id
    assert learnt.belief.doses >= 3
    assert "SIMULATED" in learnt.origin
    balance = LabState(tmp_path).balances(simulated=True)["shimadzu simulated, 0.1 mg, 10 Hz"].belief
    assert balance.lag_s == pytest.approx(ran.session.cell.spec.balance.simulation.lag_s, rel=0.3)


def test_a_run_that_learns_more_adds_a_version_and_one_that_learns_nothing_does_not(tmp_path: Path) -> None:
    state = LabState(tmp_path)
    cell = dry_run(tmp_path, CHARACTERISE, controller="adaptive").session.cell
    before = state.powders(simulated=True)["glass_beads/L7"]
    state.keep(cell, "again")
    assert state.powders(simulated=True)["glass_beads/L7"] == before
    changed = before.belief.model_copy(update={"doses": before.belief.doses + 1})
    state.keep(replace(cell, powder_beliefs={"glass_beads/L7": changed}), "later")
    after = state.powders(simulated=True)["glass_beads/L7"]
    assert (after.belief, after.run) == (changed, "later")
    assert after.version > before.version


def test_a_real_cell_recalls_what_was_learnt_on_real_devices_only(tmp_path: Path) -> None:
    state = LabState(tmp_path)
    cell = dry_run(tmp_path, CHARACTERISE, controller="adaptive").session.cell
    fresh = replace(cell, powder_beliefs={})
    state.recall(fresh, NOW)
    assert fresh.powder_beliefs == {}
    state.keep(replace(cell, simulated=False), "real")
    state.recall(fresh, NOW)
    assert set(fresh.powder_beliefs) == {"glass_beads/L7"}
    assert fresh.balance_belief == cell.balance_belief


def test_a_belief_that_no_dose_has_taught_anything_is_not_written(tmp_path: Path) -> None:
    state = LabState(tmp_path)
    cell = dry_run(tmp_path, CHARACTERISE, controller="paper").session.cell
    state.keep(replace(cell, powder_beliefs={"glass_beads/L7": cell.sources["beads"].powder.belief}), "guessed")
    assert state.powders(simulated=True) == {}


def test_a_new_powder_with_a_poor_first_guess_is_measured_in_minutes(tmp_path: Path, lab_folder: LabFolder) -> None:
    guess = "belief: {coefficient: 35, threshold: 0.08 mm, spread: 15 %, surge: 0.1 mg}"
    lab_folder.replace("robot/powders.yaml", guess, guess.replace("35", "250"))
    recipe = CHARACTERISE.replace("glass_beads", "monosodium_glutamate")
    ran = dry_run(tmp_path, recipe, lab=lab_folder.folder, controller="adaptive")
    belief = LabState(tmp_path).powders(simulated=True)["monosodium_glutamate/L7"].belief
    assert 25.0 < belief.coefficient < 110.0, "gravity brings 32, and shaking 79"
    assert ran.session.cell.clock.now_s < 300.0


@pytest.mark.parametrize(("days", "is_known"), [(6.9, True), (7.1, False)])
def test_what_doses_taught_of_a_balance_a_week_ago_is_learnt_anew_and_of_a_powder_it_is_believed(
    tmp_path: Path, days: float, is_known: bool
) -> None:
    cell, state = dry_run(tmp_path, CHARACTERISE, controller="adaptive").session.cell, LabState(tmp_path)
    state.keep(replace(cell, simulated=False), "real")
    later = replace(cell, powder_beliefs={})
    state.recall(later, NOW + timedelta(days=days))
    assert later.balance_belief == (cell.balance_belief if is_known else BalanceBelief())
    assert later.powder_beliefs == cell.powder_beliefs


@pytest.mark.parametrize(
    ("at", "is_old"),
    [
        ("", True),
        ("yesterday", True),
        ("0001-01-01T00:00:00", True),
        (f"{NOW.replace(tzinfo=None).isoformat()}", False),
        ((NOW + timedelta(hours=1)).isoformat(), False),
        ((NOW + timedelta(days=3650)).isoformat(), True),
    ],
    ids=["none", "a word", "long ago", "without a zone", "in an hour", "in ten years"],
)
def test_what_was_learnt_at_a_time_that_nobody_can_tell_is_learnt_anew(
    command: Call, lab_folder: LabFolder, at: str, is_old: bool
) -> None:
    folder, belief = lab_folder.folder, BalanceBelief(fits=2).model_dump_json()
    with writing_lab_db(folder / ".scuhand") as database:
        learnt = "INSERT INTO learnt (kind, name, simulated, run, at, belief) VALUES ('balance', 'b', 0, 'r', ?, ?)"
        database.execute(learnt, (at, belief))
        brought = "INSERT INTO yielded (lot, mortar, simulated, share, run, at) VALUES ('a', 'm', 0, 0.5, 'r', ?)"
        database.execute(brought, (at,))
    state = LabState(folder / ".scuhand")
    assert state.balances(simulated=False)["b"].is_older_than(timedelta(days=7), NOW) == is_old
    for name in ("balance", "powders"):
        told = command(name, "--lab", folder)
        assert (told.returncode, "anew" in told.stdout) == (0, is_old)


def test_what_was_learnt_of_a_powder_is_shown_with_its_date_and_forgotten_by_lot(
    command: Call, lab_folder: LabFolder, tmp_path: Path
) -> None:
    folder = lab_folder.folder
    lots = ("glass_beads", "glass_beads/L7", "glass_beads/L8", "glass_beads_fine/L7")
    cell = dry_run(tmp_path, CHARACTERISE, controller="paper").session.cell
    beliefs = {lot: PowderBelief(doses=3) for lot in lots}
    state = LabState(folder / ".scuhand")
    for simulated in (False, True):
        state.keep(replace(cell, powder_beliefs=beliefs, simulated=simulated), "run-1")

    def known() -> list[str]:
        assert list(state.powders(simulated=True)) == list(lots), "what was simulated is nobody's belief"
        return list(state.powders(simulated=False))

    lines = command("powders", "--lab", folder).stdout.splitlines()
    rows = [line for line in lines if line.startswith(" glass_beads/L7")]
    assert ["SIMULATED" in row for row in rows] == [False, True] * 2
    for row in rows[2:]:
        assert f"{NOW:%Y-%m-%dT}" in row
        assert "run-1" in row
    assert command("powders", "forget", "glass_beads/L7", "--lab", folder).stdout == "Forgotten: glass_beads/L7.\n"
    assert known() == ["glass_beads", "glass_beads/L8", "glass_beads_fine/L7"]
    assert command("powders", "forget", "glass_beads", "--lab", folder).stdout == (
        "Forgotten: glass_beads, glass_beads/L8.\n"
    )
    assert known() == ["glass_beads_fine/L7"]
    for shown in ("glass_beads", "glass_beads/L8"):  # which the table has, too: as what a dry run has learnt
        told = command("powders", "forget", shown, "--lab", folder).stdout
        assert told == f"Nothing was learnt of '{shown}' on real devices.\n"
    ended = command("powders", "forget", "glass_bead", "--lab", folder)
    told = " ".join(ended.stderr.replace("│", " ").split())  # which is set in a box
    assert (ended.returncode, "did you mean 'glass_beads'?" in told) == (2, True)
    state.keep(replace(cell, powder_beliefs=beliefs, simulated=False), "run-2")
    assert known() == sorted(lots), "what is learnt later is believed"


def test_all_that_was_learnt_of_a_powder_is_shown_and_told_as_json(command: Call, lab_folder: LabFolder) -> None:
    """`narrowest` and `erratic` were not: a dose that went by them could not be understood."""
    belief = PowderBelief(
        coefficient=61.3,
        threshold_mm=0.11,
        exponent=2.75,
        gap_mm=0.62,
        narrowest_mm=0.28,
        spread=0.37,
        surge_mg=0.9,
        erratic=4.2,
        vibration=0.41,
        doses=17,
    )
    row = {"lot": "glass_beads/L7", **belief.model_dump(), "says": "run-1", "simulated": False, "at": NOW.isoformat()}
    with writing_lab_db(lab_folder.folder / ".scuhand") as database:
        learnt = "INSERT INTO learnt (kind, name, simulated, run, at, belief) VALUES ('powder', ?, 0, 'run-1', ?, ?)"
        database.execute(learnt, (row["lot"], row["at"], belief.model_dump_json()))
        brought = "INSERT INTO yielded (lot, mortar, simulated, share, run, at) VALUES (?, 'm', 1, 0.5, 'dry', ?)"
        database.execute(brought, (row["lot"], row["at"]))
    shown = next(line for line in command("powders", "--lab", lab_folder.folder).stdout.splitlines() if "L7" in line)
    assert shown.replace("│", " ").split() == (
        ["glass_beads/L7", "61.3", "0.62", "0.11", "0.28", "2.75", "37%", "4.2", "0.9", "41%", "17", "doses"]
    )
    told = json.loads(command("powders", "--json", "--lab", lab_folder.folder).stdout)
    assert told["beliefs"][-1] == row | {"too_old": False}
    guesses = {one["lot"]: (one["says"], one["doses"]) for one in told["beliefs"][:-1]}
    assert guesses == dict.fromkeys(lab_folder.load().library.powders, ("robot/powders.yaml", 0))
    scoops = {
        "lot": row["lot"],
        "mortar": "m",
        "share": 0.5,
        "says": "dry",
        "simulated": True,
        "at": row["at"],
        "too_old": False,
    }
    assert told["scoops"] == [scoops]


def test_a_lot_is_forgotten_without_those_whose_names_begin_with_its_own(tmp_path: Path) -> None:
    state, lots = LabState(tmp_path), ["beads/2026", "beads/2026/b 1", "beads/2026/b 2"]
    with writing_lab_db(tmp_path) as database:
        learnt = "INSERT INTO learnt (kind, name, simulated, run, at, belief) VALUES ('powder', ?, 0, 'r', ?, ?)"
        database.executemany(learnt, [(lot, NOW.isoformat(), PowderBelief().model_dump_json()) for lot in lots])
    assert state.forget_powders("beads/2026") == ["beads/2026"]
    assert state.forget_powders("beads/2026/b 1") == ["beads/2026/b 1"]
    assert state.forget_powders("beads") == ["beads/2026/b 2"]


@pytest.mark.parametrize("share", [-0.5, 0.0, math.inf])
def test_a_share_that_no_scoop_brings_is_learnt_anew(tmp_path: Path, share: float) -> None:
    with writing_lab_db(tmp_path) as database:
        brought = "INSERT INTO yielded (lot, mortar, simulated, share, run, at) VALUES ('beads', ?, 0, ?, 'r', ?)"
        database.executemany(brought, [("agate", share, NOW.isoformat()), ("steel", 0.4, NOW.isoformat())])
    assert list(LabState(tmp_path).yields(simulated=False)) == [("beads", "steel")]


def test_a_figure_that_another_version_has_measured_is_shown_by_its_own_name(
    command: Call, lab_folder: LabFolder
) -> None:
    with writing_lab_db(lab_folder.folder / ".scuhand") as database:
        measured = "INSERT INTO measured (balance, figure, simulated, value, says, at) VALUES ('b', ?, 0, 1.5, 'r', ?)"
        database.execute(measured, ("span_ppm", NOW.isoformat()))
    shown = command("balance", "--lab", lab_folder.folder)
    assert (shown.returncode, "span_ppm" in shown.stdout) == (0, True)


def test_a_balance_whose_teaching_is_old_is_told_to_be_learnt_anew(
    command: Call, lab_folder: LabFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell = dry_run(tmp_path, CHARACTERISE, controller="paper").session.cell
    LabState(lab_folder.folder / ".scuhand").keep(
        replace(cell, simulated=False, balance_belief=BalanceBelief(fits=2)), "run-1"
    )
    assert "anew" not in command("balance", "--lab", lab_folder.folder).stdout
    monkeypatch.setattr("scuhand_bt.lab_state.beliefs.BALANCE_BELIEVED_FOR", timedelta(0))
    assert (
        "shimadzu simulated, 0.1 mg, 10 Hz: its delay was learnt from doses"
        in command("balance", "--lab", lab_folder.folder).stdout
    )


def test_what_another_version_has_learnt_is_told_of_and_learnt_anew(tmp_path: Path) -> None:
    state = LabState(tmp_path)
    cell = dry_run(tmp_path, CHARACTERISE, controller="adaptive").session.cell
    state.keep(replace(cell, simulated=False), "real")
    assert state.unreadable() == []
    with closing(sqlite3.connect(tmp_path / "lab.db")) as database, database:
        database.execute("UPDATE learnt SET belief = json_insert(belief, '$.poles', 2, '$.pauses', 1)")
    assert state.unreadable() == ["glass_beads/L7", cell.balance_name]
    state.recall(cell, NOW)
    assert cell.powder_beliefs == {}
    assert cell.balance_belief == BalanceBelief()
    fresh = replace(cell, simulated=False, balance_belief=BalanceBelief(fits=2))
    state.keep(fresh, "again")
    assert state.unreadable() == ["glass_beads/L7"]


def test_a_balance_of_a_kind_that_this_version_does_not_know_is_learnt_anew(tmp_path: Path) -> None:
    """It was believed, and ended a dose with a bug."""
    assert tuple(SHAPES) == BALANCE_SHAPES
    state = LabState(tmp_path)
    cell = dry_run(tmp_path, CHARACTERISE, controller="adaptive").session.cell
    state.keep(replace(cell, simulated=False), "real")
    with closing(sqlite3.connect(tmp_path / "lab.db")) as database, database:
        database.execute("UPDATE learnt SET belief = json_set(belief, '$.shape', 'four poles') WHERE kind = 'balance'")
    assert state.unreadable() == [cell.balance_name]
    state.recall(cell, NOW)
    assert cell.balance_belief == BalanceBelief()


def test_a_run_of_another_version_is_resumed_with_what_can_be_read_of_its_beliefs(tmp_path: Path) -> None:
    cell = dry_run(tmp_path, CHARACTERISE, controller="adaptive").session.cell
    state = state_of(cell)
    state["balance"]["poles"] = 2
    state["powders"]["glass_beads/L7"]["pauses"] = True
    fresh = replace(cell, powder_beliefs={}, balance_belief=BalanceBelief())
    take_up(fresh, state)
    assert fresh.believed == cell.believed
    assert (fresh.powder_beliefs, fresh.balance_belief) == ({}, BalanceBelief())


@pytest.mark.parametrize(("days", "is_known"), [(179.9, True), (180.1, False)])
def test_how_a_lot_flowed_half_a_year_ago_is_a_first_guess_again(
    command: Call, lab_folder: LabFolder, days: float, is_known: bool
) -> None:
    belief, at = PowderBelief(coefficient=61.3, doses=17), datetime.now().astimezone() - timedelta(days=days)
    with writing_lab_db(lab_folder.folder / ".scuhand") as database:
        learnt = "INSERT INTO learnt (kind, name, simulated, run, at, belief) VALUES ('powder', ?, ?, 'r', ?, ?)"
        brought = "INSERT INTO yielded (lot, mortar, simulated, share, run, at) VALUES (?, 'm', ?, 0.5, 'r', ?)"
        for simulated, learnt_at in ((0, at), (1, datetime.now().astimezone())):
            lot = "glass_beads/L7", simulated
            database.execute(learnt, (*lot, learnt_at.isoformat(), belief.model_dump_json()))
            database.execute(brought, (*lot, learnt_at.isoformat()))
    cell: Any = SimpleNamespace(sources={}, balance_name="", powder_beliefs={})
    LabState(lab_folder.folder / ".scuhand").recall(cell, datetime.now().astimezone())
    assert cell.powder_beliefs == {"glass_beads/L7": belief.model_copy(update={} if is_known else {"doses": 0})}
    told = command("powders", "--lab", lab_folder.folder).stdout
    assert told.count("more than 180 days ago: only a first guess again") == int(not is_known)
    told = json.loads(command("powders", "--json", "--lab", lab_folder.folder).stdout)
    old = [one["too_old"] for one in told["beliefs"][-2:]]
    assert old == [not is_known, False], "it is shown, and believed no more; what was simulated today is not old for it"
    assert [one["too_old"] for one in told["scoops"]] == [True, False], "of scoops it is a month"


@pytest.mark.parametrize(("days", "is_known"), [(29.9, True), (30.1, False)])
def test_what_a_lots_scoops_bring_is_believed_for_a_month_in_that_kind_of_mortar(
    tmp_path: Path, days: float, is_known: bool
) -> None:
    cell, state = dry_run(tmp_path, CHARACTERISE, controller="paper").session.cell, LabState(tmp_path)
    taught = replace(Believed(), yields={"beads": 0.6})
    for simulated in (True, False):
        state.keep(replace(cell, believed=taught, simulated=simulated), "first")
    (beads,) = cell.sources.values()
    small = replace_mortar(beads, "small_agate_mortar")
    for source, expected in ((beads, is_known), (small, False), (beads.model_copy(update={"lot": "L8"}), False)):
        later = replace(cell, sources={"again": source.model_copy(update={"name": "again"})}, believed=Believed())
        state.recall(later, NOW + timedelta(days=days))
        assert later.believed.yields == ({"again": 0.6} if expected else {})


def test_what_was_simulated_of_scoops_is_recalled_by_no_run_and_what_is_no_news_stays_as_old_as_it_is(
    tmp_path: Path,
) -> None:
    cell, state = dry_run(tmp_path, CHARACTERISE, controller="paper").session.cell, LabState(tmp_path)
    taught = replace(cell, believed=replace(Believed(), yields={"beads": 0.6}))
    state.keep(taught, "dry")
    fresh = replace(cell, believed=Believed())
    state.recall(fresh, NOW)
    assert fresh.believed.yields == {}
    for run in ("first", "second"):
        state.keep(replace(taught, simulated=False), run)
    ((of, learnt),) = state.yields(simulated=False).items()
    assert (of, learnt.share, learnt.run) == (("glass_beads/L7", "agate_mortar"), 0.6, "first")
    state.keep(replace(taught, simulated=False, believed=replace(Believed(), yields={"beads": 0.7})), "third")
    assert [(one.share, one.run) for one in state.yields(simulated=False).values()] == [(0.7, "third")]


@pytest.mark.slow
def test_what_scoops_bring_is_shown_with_its_date_and_forgotten_with_its_lot(
    command: Call, lab_folder: LabFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell, state = (
        dry_run(tmp_path, CHARACTERISE, controller="paper").session.cell,
        LabState(lab_folder.folder / ".scuhand"),
    )
    believed = replace(Believed(), yields={"beads": 0.6})
    state.keep(replace(cell, simulated=False, believed=believed, powder_beliefs={}), "run-1")

    def shown() -> str:
        out = command("powders", "--lab", lab_folder.folder).stdout
        return next((line for line in out.splitlines() if "glass_beads/L7" in line), "")

    for told in ("agate_mortar", "60%", "run-1", f"{NOW:%Y-%m-%dT}"):
        assert told in shown()
    assert "anew" not in shown()
    monkeypatch.setattr("scuhand_bt.lab_state.beliefs.YIELD_BELIEVED_FOR", timedelta(0))
    assert "anew" in shown()
    forgotten = command("powders", "forget", "glass_beads", "--lab", lab_folder.folder).stdout
    assert forgotten == "Forgotten: glass_beads/L7.\n"
    assert shown() == ""
    state.keep(replace(cell, believed=believed, powder_beliefs={}), "dry-1")
    assert "SIMULATED" in shown()
    told = command("powders", "forget", "glass_beads/L7", "--lab", lab_folder.folder).stdout
    assert told == "Nothing was learnt of 'glass_beads/L7' on real devices.\n"
    assert state.yields(simulated=False) == {}


def replace_mortar(source: Source, name: str) -> Source:
    return source.model_copy(update={"mortar": source.mortar.model_copy(update={"name": name})})
