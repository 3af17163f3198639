"""The doctor, on twins: a healthy cell, and every problem that it is to find."""

from collections.abc import Iterator

import pytest

from scuhand_bt.cell_spec import CellSpec, DeviceSpec
from scuhand_bt.devices import doctor
from scuhand_bt.devices.doctor import Finding, examine
from scuhand_bt.devices.line_device import LineOptions
from scuhand_bt.lab import load_lab, starter_lab
from scuhand_bt.run.bench import bench_of
from scuhand_bt.run.clock import WallClock
from scuhand_bt.sim.wire.bench import WireBench
from scuhand_bt.sim.wire.port import PtyPort
from scuhand_bt.sim.wire.scene import StillScene
from scuhand_bt.sim.wire.server import TwinServer
from scuhand_bt.sim.wire.vaisala import VaisalaTwin

pytestmark = pytest.mark.real_time


@pytest.fixture(scope="module")
def healthy() -> Iterator[WireBench]:
    with bench_of(load_lab(starter_lab())) as bench:
        yield bench


def failed(findings: Iterator[Finding]) -> list[tuple[str, str, str]]:
    return [(f.device, f.check, f.found) for f in findings if f.verdict == "FAIL"]


def test_a_healthy_cell_has_no_problem_and_nothing_of_it_has_moved(healthy: WireBench) -> None:
    before = [servo.position for servo in healthy.bus.twin.servos.values()]
    findings = list(examine(healthy.spec, WallClock(), self_test=False))
    assert failed(iter(findings)) == []
    assert {f.device for f in findings} >= {
        "arm",
        "hand",
        "balance",
        "changer",
        "servo 2 (joint 1)",
        "servo 9 (roller)",
    }
    assert [f.check for f in findings if f.verdict == "not done"] == ["self-test", "identity"]
    assert [servo.position for servo in healthy.bus.twin.servos.values()] == before
    assert not any(servo.has_torque for servo in healthy.bus.twin.servos.values())
    assert healthy.hand.twin.opening_mm == 0.0


def test_the_self_test_opens_the_valve_and_vibrates_and_ends_safe(healthy: WireBench) -> None:
    findings = {f.check: f for f in doctor.hand(healthy.spec.hand, WallClock(), self_test=True)}
    assert findings["valve opens"].verdict == "ok", findings["valve opens"]
    assert findings["vibration"].verdict == "ok", findings["vibration"]
    assert healthy.hand.twin.opening_mm < 0.05
    assert healthy.hand.twin.vibration == 0.0


def test_each_problem_of_a_servo_is_found_with_what_to_do(healthy: WireBench) -> None:
    twin = healthy.bus.twin
    tables = {servo.id: bytes(servo.table) for servo in twin.servos.values()}
    twin.missing.add(8)
    twin.servos[2].put(0, 2, 1120)
    twin.servos[3].put(6, 1, 37)
    twin.servos[4].put(144, 2, 84)
    twin.servos[5].temperature_c = 76.0
    twin.servos[6].put(48, 4, 3000)
    twin.servos[7].put(10, 1, 1)
    twin.servos[7].put(20, 4, -512)
    twin.servos[9].fail(5)
    try:
        findings = list(doctor.servos(healthy.spec))
    finally:
        twin.missing.clear()
        twin.servos[5].temperature_c = 25.0
        for servo in twin.servos.values():
            servo.table[:] = tables[servo.id]
    assert failed(iter(findings)) == [
        ("arm", "servo ids", "2, 3, 4, 5, 6, 7, 9"),
        ("servo 2 (joint 1)", "model", "XM540-W270"),
        ("servo 3 (joint 2)", "firmware", "37"),
        ("servo 4 (joint 3)", "voltage", "8.4 V"),
        ("servo 5 (joint 4)", "temperature", "76 °C"),
        ("servo 6 (joint 5)", "window", "-157.0 to 83.7°"),
        ("servo 7 (joint 6)", "offset, drive mode", "offset -512, mode 1"),
        ("servo 9 (roller)", "hardware error", "overload"),
    ]
    assert all(f.what_to_do for f in findings if f.verdict == "FAIL")
    assert "no answer from 8 (joint 7)" in findings[0].what_to_do


def test_a_pressed_emergency_stop_and_a_dead_valve_are_found(healthy: WireBench) -> None:
    board = healthy.hand.twin
    board.emergency_stop = True
    try:
        found = failed(doctor.hand(healthy.spec.hand, WallClock(), self_test=True))
    finally:
        board.emergency_stop = False
        board.reboot()
    assert found[0][:2] == ("hand", "faults")
    assert found[0][2].startswith("the emergency stop is (or was) pressed")
    assert [check for _, check, _ in found] == ["faults", "self-test"]


def test_a_further_device_is_asked_what_it_reads_and_one_that_is_silent_is_found() -> None:
    options = LineOptions(bits="8N1")
    with TwinServer(VaisalaTwin(options, StillScene()), PtyPort()) as server:
        room = DeviceSpec(kind="sensor", driver="vaisala", port=server.url)
        spec = CellSpec(cell="bench", stations={}, devices={"room": room}, own_options={"room": options})
        findings = list(doctor.driven(spec, "room", WallClock()))
        assert [(f.check, f.verdict) for f in findings] == [("fault", "ok"), ("last read", "ok")]
        assert findings[1].found == "temperature_c 22, humidity_percent 45"
        server.paused = True
        (fault, *_) = doctor.driven(spec, "room", WallClock())
        assert (fault.verdict, "does not answer" in fault.found) == ("FAIL", True)


def test_a_balance_of_another_maker_is_named(healthy: WireBench) -> None:
    spec = healthy.spec.model_copy(update={"balance": healthy.spec.balance.model_copy(update={"driver": "mt_sics"})})
    (finding,) = doctor.balance(spec, WallClock())
    assert (finding.check, finding.verdict) == ("connection", "FAIL")


def test_a_port_that_is_not_there_ends_the_checks_of_its_device_only(healthy: WireBench) -> None:
    gone = healthy.spec.arm.model_copy(update={"port": "/dev/no-such-port"})
    spec = healthy.spec.model_copy(update={"arm": gone})
    findings = examine(spec, WallClock(), self_test=False)
    assert failed(findings) == [("arm", "port", "/dev/no-such-port is not there")]


def test_a_changer_without_a_port_is_told_to_be_named_one_or_to_be_a_person(healthy: WireBench) -> None:
    spec = healthy.spec.model_copy(update={"changer": healthy.spec.changer.model_copy(update={"port": ""})})
    (finding,) = [f for f in examine(spec, WallClock(), self_test=False) if f.verdict == "FAIL"]
    assert (finding.device, finding.found) == ("changer", "none is named")
    assert finding.what_to_do.startswith("name its `port`")
    assert "driver: operator" in finding.what_to_do


@pytest.mark.parametrize(
    ("late_s", "every", "verdict"),
    [(0.001, 1, "ok"), (0.03, 200, "ok"), (0.03, 50, "FAIL"), (0.1, 200, "FAIL")],
)
def test_a_computer_that_does_not_keep_time_is_told_so(late_s: float, every: int, verdict: str) -> None:
    now_s, slept = 0.0, 0

    def sleep(duration_s: float) -> None:
        nonlocal now_s, slept
        slept += 1
        now_s += duration_s + (late_s if slept % every == 0 else 0.0)

    found = doctor.computer(sleep, lambda: now_s)
    assert found.verdict == verdict
    assert ("nice" in found.what_to_do) == (verdict == "FAIL")
