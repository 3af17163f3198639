"""What is known of a balance: measured at the start of the day, kept from run to run, shown and forgotten."""

import json
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from statistics import stdev

import pytest
from balance_bench import DAY, RECIPE, told
from conftest import Call, LabFolder
from running import dry_run, make_lab

from scuhand_bt.lab_state.beliefs import LabState
from scuhand_bt.specs import BalanceBelief


def test_the_start_of_day_measures_noise_drift_repeatability_and_the_check_weight(tmp_path: Path) -> None:
    ran = dry_run(tmp_path, DAY)
    ((name, figures),) = LabState(tmp_path).figures(simulated=True).items()
    assert name == "shimadzu simulated, 0.1 mg, 10 Hz"
    assert set(figures) == {"noise_mg", "drift_mg_per_s", "check_weight_error_mg", "repeatability_mg"}
    assert figures["noise_mg"].value == pytest.approx(0.085, rel=0.3), "0.08 mg and its rounding"
    assert 0.0 < figures["repeatability_mg"].value < 0.3
    assert {one.says for one in figures.values()} == {ran.session.run_id}
    (measured,) = told(ran, "repeatability")
    checked = [weighed["error_mg"] for weighed in told(ran, "check_weight")]
    assert (measured["weighings"], len(checked)) == (5, 5)
    assert figures["check_weight_error_mg"].value == max(checked, key=abs)
    assert figures["repeatability_mg"].value == measured["repeatability_mg"] == pytest.approx(stdev(checked))


def test_a_container_on_the_pan_is_no_fault_of_the_balance(tmp_path: Path) -> None:
    """It was told to weigh the check weight 9 g wrong."""
    lab = make_lab(tmp_path / "lab")
    tree = "tree: {sequence: [{place_container: {container: $container}}, {check_weight: {weight: 20 g}}]}"
    behind = f"workflow: behind\ninputs: {{container: Container}}\n{tree}\n"
    (lab / "trees" / "behind.yaml").write_text(behind, encoding="utf-8")
    recipe = "recipe: behind\nworkflow: behind\nsamples: [{id: a, container: xrd_holder}]\n"
    ran = dry_run(tmp_path, recipe, lab=lab)
    assert ran.sample("a").code == "balance.not_bare"
    assert not told(ran, "asked")


def test_a_check_weight_that_is_wrong_once_fails_and_takes_back_the_day_before(tmp_path: Path) -> None:
    dry_run(tmp_path, DAY)
    assert "check_weight_error_mg" in LabState(tmp_path).figures(simulated=True).popitem()[1]
    ran = dry_run(tmp_path, DAY.replace("20 g", "20 g, tolerance: 0.2 mg"), seed=2)
    assert ran.sample("check").code == "balance.inaccurate"
    assert "check_weight_error_mg" not in LabState(tmp_path).figures(simulated=True).popitem()[1]


def test_what_is_known_belongs_to_one_balance_and_its_settings(tmp_path: Path) -> None:
    cell = dry_run(tmp_path, RECIPE, controller="adaptive").session.cell
    state = LabState(tmp_path)
    state.keep(replace(cell, simulated=False), "real")
    finer = cell.spec.model_copy(update={"balance": cell.spec.balance.model_copy(update={"readability_mg": 0.01})})
    for spec, knows in ((cell.spec, True), (finer, False)):
        fresh = replace(cell, spec=spec, balance_belief=BalanceBelief(), known_delay_s=None)
        state.recall(fresh, datetime.now().astimezone())
        assert (fresh.balance_belief.fits > 0, fresh.known_delay_s is not None) == (knows, knows)
    cell.balance.identity = "another"
    assert "another" in cell.balance_name
    cell.balance.identity = ""
    assert cell.spec.cell in cell.balance_name


def test_what_is_forgotten_is_believed_no_more_and_what_is_measured_later_is(tmp_path: Path) -> None:
    cell = dry_run(tmp_path, RECIPE, controller="adaptive").session.cell
    real, state = replace(cell, simulated=False), LabState(tmp_path)
    state.keep(real, "real")
    assert state.forget_balances() == [cell.balance_name]
    assert (state.figures(simulated=False), state.balances(simulated=False)) == ({}, {})
    assert state.figures(simulated=True), "what was simulated is nobody's belief"
    assert state.forget_balances() == []
    state.keep(real, "later")
    assert state.figures(simulated=False)[cell.balance_name]["delay_s"].says == "later"
    assert state.balances(simulated=False)[cell.balance_name].run == "later"


def test_the_balance_is_shown_and_forgotten(command: Call, lab_folder: LabFolder, tmp_path: Path) -> None:
    assert command("balance", "--lab", lab_folder.folder).stdout.startswith("Nothing is known yet")
    cell = dry_run(tmp_path, DAY).session.cell
    state = LabState(lab_folder.folder / ".scuhand")
    belief = BalanceBelief(lag_s=0.31, doubt=0.27, shape="late", adapts=True, misfit=0.34, noise_mg=0.23, fits=2)
    state.keep(replace(cell, simulated=False, balance_belief=belief), "day-1")
    shown = command("balance", "--lab", lab_folder.folder).stdout
    for said in ("shimadzu simulated, 0.1 mg, 10 Hz", "repeatability", "half its delay, by doses", "0.31 s", "day-1"):
        assert said in shown
    for said in ("late, adapts", "27%", "34%", "noise of a reading, by doses", "0.23 mg"):
        assert said in shown
    rows = json.loads(command("balance", "--lab", lab_folder.folder, "--json").stdout)
    figures = {row["figure"]: row["value"] for row in rows}
    assert figures["minimum_weight_mg"] == pytest.approx(2000 * max(figures["repeatability_mg"], 0.041))
    assert command("balance", "--simulated", "--lab", lab_folder.folder).stdout.startswith("Nothing is known yet")
    assert command("balance", "forget", "--lab", lab_folder.folder).stdout.startswith("Forgotten: shimadzu simulated")
    assert command("balance", "--lab", lab_folder.folder).stdout.startswith("Nothing is known yet")
    assert command("balance", "forget", "--lab", lab_folder.folder).stdout == "Nothing was known.\n"
