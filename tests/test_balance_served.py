"""A twin on a pseudo-terminal: what the driver believes of it, and what the doctor says of its line."""

from collections.abc import Iterator

import pytest
from balance_stream import ALL
from wire_helpers import carry_out, wait_for

from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.device_specs.balance import BalanceSpec
from scuhand_bt.devices import doctor
from scuhand_bt.devices.balances import DIALECTS, SerialBalance
from scuhand_bt.devices.interfaces import Reading
from scuhand_bt.run.clock import WallClock
from scuhand_bt.sim.wire.balances import BalanceTwin, StillPan, balance_twin
from scuhand_bt.sim.wire.port import PtyPort
from scuhand_bt.sim.wire.server import TwinServer


@pytest.fixture
def served(request: pytest.FixtureRequest) -> Iterator[tuple[TwinServer[BalanceTwin], BalanceSpec]]:
    """A twin on a pseudo-terminal that shows steps of 1 mg, and the spec that says so."""
    name = request.param
    twin = balance_twin(name)(StillPan(12_345.0), 1.0, 120_000.0)
    twin.period_s = 0.005
    with TwinServer(twin, PtyPort()) as server:
        yield (
            server,
            BalanceSpec(driver=name, port=server.url, period_s=0.005, readability_mg=1.0, options={"bits": "8N1"}),
        )


@pytest.mark.real_time
@pytest.mark.parametrize("served", ALL, indirect=True)
def test_the_real_driver_never_believes_the_twins_flipped_bits(
    served: tuple[TwinServer[BalanceTwin], BalanceSpec], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("scuhand_bt.devices.balances.conversation.ANSWER_TIMEOUT_S", 0.1)
    server, spec = served
    server.misbehaviour.flip_every = 5
    written: list[Reading] = []
    balance, clock = SerialBalance(spec, DIALECTS[spec.driver], WallClock(), DIALECTS.values()), WallClock()
    balance.on_reading = written.append
    balance.open()
    try:
        wait_for(lambda: balance.discarded > 20)
        mean = carry_out(balance.stable_mean(), clock)
    finally:
        balance.close()
    assert mean.value_mg == 12_345.0
    assert {reading.value_mg for reading in written if reading.stable} == {12_345.0}
    assert any(reading.value_mg != 12_345.0 for reading in written), "what was not believed is written down too"


@pytest.mark.real_time
@pytest.mark.parametrize("served", ["shimadzu"], indirect=True)
def test_after_a_broken_answer_a_polled_balance_is_asked_again_at_once(
    served: tuple[TwinServer[BalanceTwin], BalanceSpec],
) -> None:
    server, spec = served
    clock = WallClock()
    balance = SerialBalance(spec, DIALECTS[spec.driver], clock, DIALECTS.values())
    balance.open()
    try:
        carry_out(balance.next_reading(), clock)
        server.misbehaviour.garble = 3
        wait_for(lambda: balance.discarded == 3)
        carry_out(balance.next_reading(timeout_s=1.0), clock)
    finally:
        balance.close()


def of_cell(balance: BalanceSpec) -> CellSpec:
    return CellSpec(cell="bench", stations={}, balance=balance)


@pytest.mark.real_time
@pytest.mark.parametrize("served", ALL, indirect=True)
def test_the_doctor_says_which_readability_it_has_seen_and_how_clean_the_line_is(
    served: tuple[TwinServer[BalanceTwin], BalanceSpec],
) -> None:
    found = [(f.check, f.verdict) for f in doctor.balance(of_cell(served[1]), WallClock())]
    assert found[:2] == [("reading", "ok"), ("readability", "ok")]
    assert found[-1] == ("line", "ok")


@pytest.mark.real_time
@pytest.mark.parametrize("served", ALL, indirect=True)
def test_the_doctor_says_that_the_readability_is_another_and_what_to_write(
    served: tuple[TwinServer[BalanceTwin], BalanceSpec],
) -> None:
    (wrong,) = doctor.balance(of_cell(served[1].model_copy(update={"readability_mg": 0.1})), WallClock())
    assert (wrong.check, wrong.verdict, wrong.found, wrong.expected) == (
        "readability",
        "FAIL",
        "steps of 1 mg",
        "0.1 mg",
    )
    assert wrong.what_to_do.startswith("write `readability: 1 mg` for the balance in robot/cell.yaml")


@pytest.mark.real_time
@pytest.mark.parametrize("served", ["shimadzu"], indirect=True)
def test_the_doctor_finds_a_bad_cable(served: tuple[TwinServer[BalanceTwin], BalanceSpec]) -> None:
    server, spec = served
    server.misbehaviour.flip_every = 3
    findings = {f.check: f for f in doctor.balance(of_cell(spec), WallClock())}
    assert findings["line"].verdict == "FAIL"
    assert "cable" in findings["line"].what_to_do
