"""What is believed of a balance's lines: its steps, its readability and its range, on a clock that the test moves."""

import random

import pytest
from balance_stream import ALL, PERIOD_S, Stream

from scuhand_bt.failures import SkillFailed


def test_a_flickering_balance_is_believed_to_be_stable_nearly_always() -> None:
    for digits in (0.3, 0.8, 8.0):  # standard deviation
        rng = random.Random(4)
        stream = Stream("mt_sics")
        given = stream.weigh(*[1000.0 + round(digits * rng.gauss(0.0, 1.0)) * 0.1 for _ in range(1000)])
        assert sum(reading.stable for reading in given) > 930, digits


def test_a_step_of_one_digit_is_believed_to_be_stable_when_it_is_said_twice() -> None:
    stream = Stream("shimadzu")
    stream.settle(500.0)
    assert [reading.stable for reading in stream.weigh(500.1, 500.1, 500.1)] == [False, True, True]


def test_what_was_said_before_the_balance_moved_bears_nothing_out() -> None:
    stream = Stream("and")
    stream.settle(500.0)
    stream.weigh(503.0, stable=False)
    assert [reading.stable for reading in stream.weigh(500.0, 500.0)] == [False, True]


# --- steps


def test_a_container_put_on_the_pan_is_shown_two_readings_later_and_written_down_at_once() -> None:
    stream = Stream("mt_sics")
    stream.settle(0.0)
    stream.written.clear()
    assert stream.weigh(20_000.0, 20_000.0) == []
    assert [reading.value_mg for reading in stream.written] == [20_000.0, 20_000.0]
    assert [reading.stable for reading in stream.written] == [False, False]
    assert [reading.value_mg for reading in stream.weigh(20_000.0, 20_000.0)] == [20_000.0, 20_000.0]
    assert stream.balance.discarded == 0


def test_a_load_that_rises_for_a_second_is_followed_with_no_more_delay_than_that() -> None:
    stream = Stream("and")
    stream.settle(0.0)
    rising_mg = [2000.0 * step for step in range(1, 11)]
    given = stream.weigh(*rising_mg, stable=False)
    assert len(given) == 3
    assert all(stream.clock.now_s - reading.time_s < 12 * PERIOD_S for reading in given)
    assert stream.weigh(20_000.0, 20_000.0, 20_000.0)[-1].value_mg == 20_000.0


def test_one_line_far_off_is_held_back_and_then_counted_as_discarded() -> None:
    stream = Stream("sbi")
    stream.settle(1000.0)
    given = stream.weigh(9000.0, 1000.0, 1000.0)
    assert [reading.value_mg for reading in given] == [1000.0, 1000.0]
    assert stream.balance.discarded == 1


def test_lines_that_contradict_each_other_confirm_nothing() -> None:
    stream = Stream("and")
    stream.settle(5000.0)
    assert stream.weigh(9000.0, 1000.0, 9000.0, 1000.0, 9000.0) == []
    assert stream.weigh(5000.0)[-1].value_mg == 5000.0


def test_of_three_lines_that_confirm_a_step_one_may_be_false() -> None:
    for place in range(3):
        stream = Stream("mt_sics")
        stream.settle(0.0)
        loads_mg = [20_000.0] * 3
        loads_mg[place] = 80_000.0
        assert [reading.value_mg for reading in stream.weigh(*loads_mg)] == [20_000.0]


@pytest.mark.parametrize("period_s", [0.05, 0.1])
def test_no_reading_of_a_dose_is_held_back(period_s: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Beads at full opening; titanium dioxide, in lumps of tens of milligrams that are felt as twice their weight."""
    monkeypatch.setattr("balance_stream.PERIOD_S", period_s)
    stream = Stream("shimadzu")
    stream.settle(10_000.0)
    rng, load_mg, felt_mg = random.Random(2), 10_000.0, []
    for _ in range(200):
        lump_mg = rng.choice((0.0, 0.0, rng.uniform(1.0, 50.0)))
        load_mg += 800.0 * period_s
        felt_mg.append(round(load_mg + 2.0 * lump_mg, 1))
        load_mg += lump_mg
    assert len(stream.weigh(*felt_mg, stable=False)) == 200


def test_a_conversation_that_begins_anew_believes_nothing_of_the_last_one() -> None:
    stream = Stream("mt_sics", 0.1, 1.0)
    stream.weigh(*[1000.0] * 10)
    stream.balance.opened()
    assert stream.balance.misfit is None
    stream.twin.readability_mg = 0.1
    stream.settle(1000.0)
    stream.balance.opened()
    assert stream.weigh(1000.0, 1000.0) == []
    assert stream.balance.discarded == 0


# --- readability


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize(("configured_mg", "shown_mg"), [(0.1, 1.0), (1.0, 0.1), (0.1, 0.01), (10.0, 1.0)])
def test_another_readability_than_configured_is_refused_with_what_to_write(
    name: str, configured_mg: float, shown_mg: float
) -> None:
    stream = Stream(name, configured_mg, shown_mg)
    assert stream.weigh(*[12_345.0] * 20) == []
    fault = stream.balance.fault
    assert fault is not None
    said = f"it shows steps of {shown_mg:g} mg instead of {configured_mg:g} mg; write `readability: {shown_mg:g} mg`"
    assert said in fault.detail


def test_a_line_or_two_of_another_form_are_noise_and_cost_nothing_else() -> None:
    stream = Stream("mt_sics")
    stream.settle(1000.0)
    assert stream.feed(b"S S       1.00 g\r\n", b"S S     1.0000 f\r\n") == []
    assert stream.balance.fault is None
    assert stream.weigh(1000.0)[-1].stable
    assert stream.balance.discarded == 2


def test_a_balance_set_right_again_is_read_again() -> None:
    stream = Stream("and", 0.1, 1.0)
    stream.weigh(*[1000.0] * 10)
    assert stream.balance.misfit is not None
    stream.twin.readability_mg = 0.1
    assert stream.weigh(*[1000.0] * 4)[-1].value_mg == 1000.0
    assert stream.balance.fault is None
    assert stream.balance.misfit is None


@pytest.mark.parametrize(("step_mg", "shown_mg"), [(1.0, 1.0), (0.2, 0.2), (0.5, 0.5)])
def test_a_last_digit_that_never_changes_is_noticed(step_mg: float, shown_mg: float) -> None:
    stream = Stream("shimadzu")
    stream.settle(0.0)
    given = stream.weigh(*[round(step_mg * step, 1) for step in range(1, 40)], stable=False)
    assert len(given) < 25
    fault = stream.balance.fault
    assert fault is not None
    assert f"it shows steps of {shown_mg:g} mg instead of 0.1 mg" in fault.detail


def test_a_load_that_stands_still_says_nothing_of_the_last_digit() -> None:
    stream = Stream("shimadzu")
    for load_mg in (0.0, 1000.0, 2000.0):
        stream.settle(load_mg)
    assert stream.balance.fault is None


def test_half_milligram_steps_are_read_where_they_are_configured() -> None:
    stream = Stream("mt_sics", 0.5, 0.5)
    assert stream.weigh(*[1000.5] * 4)[-1].value_mg == 1000.5
    given = stream.feed(b"S S     1.0006 g\r\n", b"S S     1.0005 g\r\n")
    assert [reading.value_mg for reading in given] == [1000.5]


def test_a_unit_other_than_the_configured_one_is_refused() -> None:
    stream = Stream("mt_sics", options={"unit": "mg"})
    stream.weigh(*[1000.0] * 6)
    assert stream.balance.misfit is not None
    assert "write `unit: g`" in stream.balance.misfit.what_to_do


# --- range


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize(("load_mg", "what"), [(120_500.0, "beyond its maximum"), (-121_000.0, "in underload")])
def test_more_than_the_maximum_is_overload_whatever_the_line_says(name: str, load_mg: float, what: str) -> None:
    stream = Stream(name)
    stream.twin.maximum_mg = 1e9
    stream.settle(5000.0)
    assert stream.weigh(*[load_mg] * 3) == []
    with pytest.raises(SkillFailed, match=rf"balance\.overload: .*{what}"):
        next(stream.balance.next_reading())
    stream.settle(5000.0)


def test_a_single_false_line_beyond_the_maximum_is_no_overload() -> None:
    stream = Stream("and")
    stream.twin.maximum_mg = 1e9
    stream.settle(5000.0)
    stream.weigh(185_000.0, 5000.0)
    reading = stream.balance.next_reading()
    next(reading)
    stream.weigh(5000.0)
    with pytest.raises(StopIteration):
        next(reading)


def test_a_balance_whose_line_is_held_back_is_not_silent() -> None:
    stream = Stream("and")
    stream.settle(0.0)
    reading = stream.balance.next_reading(timeout_s=0.25)
    next(reading)
    for _ in range(2):
        stream.weigh(3000.0)
        next(reading)
    stream.clock.now_s += 0.06  # 0.26 s after it was asked for
    next(reading)
    stream.weigh(3000.0)
    with pytest.raises(StopIteration):
        next(reading)
