"""Supplies of twins that fail: who is without power then, and what is forgotten when it is back."""

import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from running import make_lab

from scuhand_bt.devices.connect import connect_alone
from scuhand_bt.devices.hand_controller import HandController
from scuhand_bt.lab import load_lab
from scuhand_bt.run.clock import WallClock
from scuhand_bt.run.twins_process import TwinsProcess
from scuhand_bt.sim.outage import SAG_RAD
from scuhand_bt.specs import Source

pytestmark = pytest.mark.real_time


@pytest.fixture
def twins(tmp_path: Path) -> Iterator[TwinsProcess]:
    lab = load_lab(make_lab(tmp_path / "lab"))
    mortar, powder = lab.library.mortars["agate_mortar"], lab.library.powders["glass_beads"]
    beads = Source(name="beads", station="mortar_bay", mortar=mortar, powder=powder, amount_mg=6000.0)
    with TwinsProcess(tmp_path / "twins", lab, {"beads": beads}) as process:
        yield process


def until(condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.01)


def test_an_arm_without_power_holds_nothing_sinks_and_is_led_by_hand_only_then(twins: TwinsProcess) -> None:
    bench, servos = twins.bench, twins.bench.bus.twin.servos
    for servo in servos.values():
        servo.put(64, 1, 1)
    stood = bench.arm.joints
    led = [f"{math.degrees(angle) + 1.0:g}" for angle in stood]
    assert not twins.obey(["lead", *led]).is_done, "an arm that holds is not led"
    assert twins.obey(["power", "off", "arm"]).is_done
    assert twins.obey(["look"]).found["holding"] == []
    assert twins.obey(["look"]).found["without_power"] == ["arm"]
    until(lambda: stood[1] - bench.arm.joints[1] > 0.9 * SAG_RAD)
    time.sleep(0.3)
    assert stood[1] - bench.arm.joints[1] <= SAG_RAD + 1e-3, "then it rests on something"
    assert twins.obey(["power", "on", "arm"]).is_done
    time.sleep(0.3)
    assert twins.obey(["look"]).found["holding"] == [], "nobody has given it torque"
    assert twins.obey(["lead", *led]).is_done
    assert bench.arm.joints == pytest.approx(stood + math.radians(1.0), abs=1e-3)
    assert not twins.obey(["lead", "nan", *led[1:]]).is_done


def test_a_balance_takes_for_nothing_what_stands_on_it_as_it_is_switched_on(twins: TwinsProcess) -> None:
    balance = connect_alone(twins.bench.spec, "balance", WallClock())

    def shows(mass_mg: float) -> bool:
        return balance.latest is not None and abs(balance.latest.value_mg - mass_mg) < 2.0

    try:
        twins.obey(["weight", "1 g"])
        until(lambda: shows(1000.0))
        twins.obey(["power", "off", "balance"])
        last = balance.latest
        time.sleep(0.5)
        assert balance.latest is last or not balance.latest, "it says nothing"
        twins.obey(["power", "on", "balance"])
        until(lambda: shows(0.0))
        twins.obey(["remove"])
        until(lambda: shows(-1000.0))
    finally:
        balance.close()


def test_a_board_without_power_leaves_its_valve_as_it_is_and_shuts_it_when_it_begins_again(twins: TwinsProcess) -> None:
    board, controller = twins.bench.hand.twin, HandController(twins.bench.spec.hand)
    controller.open()
    try:
        controller.set_opening(2.0)
        until(lambda: board.opening_mm > 1.9)
        twins.obey(["power", "off", "hand"])
        until(lambda: controller.trouble is not None)
        assert controller.trouble is not None
        assert "at its last report the valve was not shut" in controller.trouble.detail
        time.sleep(0.5)
        assert board.opening_mm > 1.9, "nobody is there who would shut it"
        assert board.vibration == 0.0
        twins.obey(["power", "on", "hand"])
        until(lambda: board.opening_mm < 0.05)
        until(lambda: controller.trouble is None)
    finally:
        controller.close()


def test_one_word_takes_the_whole_cells_power_and_an_unknown_supply_is_named(twins: TwinsProcess) -> None:
    assert twins.obey(["power", "off", "cell"]).is_done
    assert twins.obey(["look"]).found["without_power"] == ["arm", "balance", "changer", "hand", "valve"]
    assert twins.obey(["power", "off", "arm"]).is_done, "it is off already"
    assert twins.obey(["power", "on", "cell"]).is_done
    assert twins.obey(["look"]).found["without_power"] == []
    assert not twins.obey(["power", "off", "kettle"]).is_done
