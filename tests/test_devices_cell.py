"""What `robot/cell.yaml` says of devices: what is wrong is found before any of them is opened."""

from pathlib import Path

import pytest
from conftest import LabFolder

from scuhand_bt.device_specs.balance import BalanceSpec
from scuhand_bt.devices.balances import DIALECTS
from scuhand_bt.drivers import SHIPPED
from scuhand_bt.lab import without_driver
from scuhand_bt.problems import SourceError
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.options import Options
from scuhand_bt.run.session import Session
from scuhand_bt.sim.wire.balances import balance_twin

CHANGER = "changer: {driver: carousel, slots: 24}"
BALANCE = "driver: shimadzu"
RECIPE = """\
recipe: r
workflow: w
samples: [{id: a}]
"""


def test_every_dialect_can_be_named_and_has_a_twin() -> None:
    for name in DIALECTS:
        assert BalanceSpec(driver=name).driver == name
        assert balance_twin(name).__name__
    assert DIALECTS.keys() == SHIPPED["balance"].keys()


@pytest.mark.parametrize(
    ("written", "wrong", "problem"),
    [
        ("driver: dynamixel", "driver: abacus", "cell.yaml:4:15: 'driver': 'abacus' is not accepted"),
        (BALANCE, "driver: scales", "cell.yaml:6:19: 'driver': 'scales' is not accepted; write 'and', "),
        (BALANCE, BALANCE + ", options: {buad: 9600}", "unknown key 'buad'; known: baud, bits, unit; did you mean"),
        (BALANCE, BALANCE + ", options: {bits: 9X9}", "'bits': '9X9' is not accepted"),
        (BALANCE, BALANCE + ", options: {baud: fast}", "'baud': 'fast' is not accepted"),
        ("driver: dynamixel", "driver: dynamixel, options: {directions: [1, 2, 1, 1, 1, 1, 1]}", "'2' is not accepted"),
        ("driver: dynamixel", "driver: dynamixel, options: {home_counts: [2048]}", "a list of at least 7"),
        ("driver: hand_controller", "driver: hand_controller, options: {start_diameter: 90}", "'90' has no unit"),
    ],
)
def test_a_wrong_driver_or_option_is_found_with_its_place(
    lab_folder: LabFolder, written: str, wrong: str, problem: str
) -> None:
    lab_folder.replace("robot/cell.yaml", written, wrong)
    found = lab_folder.problems()
    assert all(line.startswith("robot/cell.yaml:") for line in found)
    assert any(problem in line for line in found), found


def test_options_are_read_with_their_units(lab_folder: LabFolder) -> None:
    arm = "driver: dynamixel, options: {latency: 16 ms, directions: [1, -1, 1, 1, 1, 1, 1], following_limit: 5 deg}"
    lab_folder.replace("robot/cell.yaml", "driver: dynamixel", arm)
    lab_folder.replace("robot/cell.yaml", BALANCE, BALANCE + ", options: {baud: 9600, bits: 8N1, unit: g}")
    cell = lab_folder.load().cell
    assert (cell.arm.options.latency_s, cell.arm.options.following_limit_deg) == (0.016, 5.0)
    assert cell.arm.options.directions[:2] == (1, -1)
    assert (cell.balance.options.baud, cell.balance.options.bits, cell.balance.options.unit) == (9600, "8N1", "g")


@pytest.mark.parametrize(
    ("written", "place"), [(CHANGER, "7:19"), ("changer: {slots: 24}", "7:10"), ("", "3:1")], ids=["named", "", "none"]
)
def test_a_changer_without_a_driver_is_no_matter_to_a_dry_run_and_ends_a_real_one_before_any_port_is_opened(
    lab_folder: LabFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, written: str, place: str
) -> None:
    monkeypatch.setattr(
        "scuhand_bt.run.make_cell.connect_cell_devices", lambda *_, **__: pytest.fail("a port was opened")
    )
    lab_folder.replace("robot/cell.yaml", CHANGER, written)
    lab_folder.write("trees/w.yaml", "workflow: w\ntree:\n  park:\n")
    lab = lab_folder.load()
    path = lab_folder.write("recipes/r.yaml", RECIPE)
    plan = make_plan(load_recipe(path, lab), lab)
    with pytest.raises(SourceError, match="driver: operator") as refused:
        Session(plan, lab, Options(None, folder=tmp_path / "runs"))
    assert f"robot/cell.yaml:{place}: the changer 'carousel' has no port" in str(refused.value)
    assert list((tmp_path / "runs").iterdir()) == []


def test_an_operator_needs_no_driver(lab_folder: LabFolder) -> None:
    lab_folder.replace("robot/cell.yaml", CHANGER, "changer: {driver: operator}")
    assert without_driver(lab_folder.load()) == []
