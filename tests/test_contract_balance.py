"""What `devices.interfaces.Balance` says, of the simulated balance and of the driver over every twin alike."""

from collections.abc import Iterator
from typing import Any

import pytest
from device_benches import LOAD_MG, MAXIMUM_MG, SimulatedBalanceBench, WiredBalanceBench

from scuhand_bt.devices.balances import DIALECTS
from scuhand_bt.devices.interfaces import Reading
from scuhand_bt.failures import SkillFailed

NEARLY_MG = 2.0


@pytest.fixture(
    params=["simulated", *(pytest.param(driver, marks=pytest.mark.real_time) for driver in sorted(DIALECTS))],
    scope="module",
)
def opened(request: pytest.FixtureRequest) -> Iterator[Any]:
    if request.param == "simulated":
        yield SimulatedBalanceBench()
        return
    with WiredBalanceBench(request.param).open() as wired:
        yield wired


@pytest.fixture
def bench(opened: Any) -> Iterator[Any]:
    opened.load(LOAD_MG)
    opened.until(lambda: opened.device.latest is not None and opened.device.latest.stable)
    yield opened
    opened.load(LOAD_MG)


def test_a_reading_comes_each_period(bench: Any) -> None:
    balance = bench.device
    seen, news = [], balance.news.count
    begin_s = bench.clock.now_s
    for _ in range(8):
        seen.append(bench.run(balance.next_reading()))
    took_s = bench.clock.now_s - begin_s
    assert len({reading.time_s for reading in seen}) == 8
    assert all(reading.time_s > begin_s - 1e-9 for reading in seen)
    assert all(reading.value_mg == pytest.approx(LOAD_MG, abs=NEARLY_MG) for reading in seen)
    assert 0.65 * balance.spec.period_s * 8 <= took_s <= balance.spec.period_s * 9 + bench.late_s
    assert balance.news.count >= news + 8
    assert balance.latest.time_s >= seen[-1].time_s


def test_a_balance_never_moves_and_a_stop_changes_nothing(bench: Any) -> None:
    assert bench.device.is_stopped
    bench.device.stop()
    assert bench.device.is_stopped
    assert bench.run(bench.device.next_reading()).value_mg == pytest.approx(LOAD_MG, abs=NEARLY_MG)
    assert bench.device.fault is None
    assert isinstance(bench.device.identity, str)


def test_waiting_that_is_closed_in_the_middle_leaves_a_balance_that_goes_on(bench: Any) -> None:
    for steps in (bench.device.next_reading(), bench.device.stable_mean()):
        next(steps)
        steps.close()
    assert bench.run(bench.device.next_reading()).value_mg == pytest.approx(LOAD_MG, abs=NEARLY_MG)


def test_every_reading_is_told_with_its_line_to_whoever_listens(bench: Any) -> None:
    heard: list[Reading] = []
    bench.device.on_reading = heard.append
    bench.run(bench.device.next_reading())
    reading = bench.run(bench.device.next_reading())
    bench.device.on_reading = None
    assert reading in heard
    assert reading.raw.strip()


def test_a_stable_mean_is_of_stable_readings_and_knows_how_sure_it_is(bench: Any) -> None:
    mean = bench.run(bench.device.stable_mean())
    assert mean.value_mg == pytest.approx(LOAD_MG, abs=NEARLY_MG)
    assert len(mean.readings) == 5
    assert all(reading.stable for reading in mean.readings)
    assert mean.value_mg == pytest.approx(sum(reading.value_mg for reading in mean.readings) / 5)
    assert mean.time_s == mean.readings[-1].time_s
    digit_mg = bench.device.spec.readability_mg
    assert digit_mg / 12**0.5 * 0.99 <= mean.uncertainty_mg < 3 * digit_mg


def test_what_does_not_come_to_rest_is_unstable_in_the_time_that_was_given(bench: Any) -> None:
    with bench.unstable():
        bench.pass_time(0.3)
        begin_s = bench.clock.now_s
        with pytest.raises(SkillFailed, match=r"balance\.unstable"):
            bench.run(bench.device.stable_mean(0.6))
        assert 0.5 <= bench.clock.now_s - begin_s <= 0.9 + bench.late_s
        assert bench.device.fault is None, "that concerns the dose alone"


def test_a_load_beyond_its_range_is_told_and_is_no_fault(bench: Any) -> None:
    bench.load(2 * MAXIMUM_MG)
    bench.pass_time(2.0 if bench.late_s == 0.0 else 0.5)
    for steps in (bench.device.next_reading(), bench.device.stable_mean()):
        with pytest.raises(SkillFailed, match=r"balance\.overload"):
            bench.run(steps)
    assert bench.device.fault is None
    bench.load(LOAD_MG)


def test_a_balance_that_is_lost_is_a_fault_until_it_is_back(bench: Any) -> None:
    balance = bench.device
    with bench.lost():
        bench.until(lambda: balance.fault is not None)
        assert balance.fault.code == "device.lost"
        assert balance.latest is None, "what it weighed before is no news of now"
        for steps in (balance.next_reading(0.5), balance.stable_mean(0.5)):
            with pytest.raises(SkillFailed, match=r"device\.lost"):
                bench.run(steps)
        assert balance.is_stopped
    bench.until(lambda: balance.fault is None)
    assert bench.run(balance.next_reading()).value_mg == pytest.approx(LOAD_MG, abs=NEARLY_MG)
