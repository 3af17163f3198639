"""A display that was held or frozen: what falls meanwhile is not taken for a dose."""

from pathlib import Path

import pytest

from harness.falsify import Falsifier
from harness.worlds import BY_NAME
from scuhand_bt.dosing.characteristic import held_mg, is_frozen
from scuhand_bt.failures import Code

STILL = [5.0] * 8


@pytest.mark.parametrize(
    ("readings_mg", "mg"),
    [
        ([*STILL, 5.6], 0.6),
        ([*STILL, 4.4], 0.6),
        ([*STILL, 5.5], 0.0),
        ([*STILL[1:], 5.6], 0.0),
        ([*STILL, 5.1, 5.8], 0.0),
        ([*STILL, 5.6, *[5.6] * 7, 8.6], 3.0),
        ([*STILL, 8.0, *[8.0] * 7, 8.6], 3.0),
        ([*STILL, 5.6, 6.2, 6.8], 0.0),
        ([*STILL, 4.4, 3.8, 3.2], 0.0),
        ([*STILL, 8.0, 8.4], 2.6),
        ([*STILL, 5.6, 5.0], 0.0),
        ([], 0.0),
    ],
)
def test_a_display_that_stands_still_and_jumps_was_held(readings_mg: list[float], mg: float) -> None:
    assert held_mg(readings_mg, 0.1) == pytest.approx(mg)


NOISY = [5.0, 5.1] * 100
AVERAGING = [0.1 * step for step, run in enumerate((8, 8, 9, 9, 12, 16, 22, 26, 29, 32, 40)) for _ in range(run)]
AS_IT_BEGINS = [*NOISY, *[5.2] * 30, *NOISY, *[5.2] * 30, *NOISY, *[5.2] * 46, *NOISY, *[5.2] * 49, *NOISY]


@pytest.mark.parametrize(
    ("readings_mg", "frozen"),
    [
        ([*NOISY, *[5.2] * 18], True),
        ([*NOISY, *[5.2] * 17], False),
        ([*NOISY[1:], *[5.2] * 18], False),
        ([*NOISY, *[5.2] * 18, 5.3], False),
        ([*AVERAGING, *[5.2] * 149], False),
        ([*AVERAGING, *[5.2] * 250], True),
        ([*AS_IT_BEGINS, *[5.2] * 39], False),
        ([5.0] * 1000, False),
        ([], False),
    ],
)
def test_a_display_that_stands_still_for_longer_than_its_noise_allows_is_frozen(
    readings_mg: list[float], frozen: bool
) -> None:
    assert is_frozen(readings_mg, 0.1) is frozen


@pytest.mark.slow
def test_what_falls_on_a_frozen_display_is_not_taken_for_a_dose(tmp_path: Path) -> None:
    tally = Falsifier(tmp_path, recipes=("short",)).run(BY_NAME["frozen-until-lifted"], 1, 46004)
    assert tally.failed[Code.BALANCE_COARSE] == 1
    assert not tally.false_goods


@pytest.mark.slow
def test_a_balance_that_holds_its_display_gives_no_dose(tmp_path: Path) -> None:
    falsifier = Falsifier(tmp_path, recipes=("msg-once",))
    tally = falsifier.run(BY_NAME["hold-3"], 1)
    assert tally.failed == {Code.BALANCE_COARSE: 1}


def test_what_stood_still_before_is_no_noise_of_the_balance() -> None:
    noisy = [0.1 * (k % 3) for k in range(600)]
    assert is_frozen([*noisy, *[5.0] * 300, *noisy, *[7.0] * 110], 0.1)
    quiet = [0.1 * step for step, run in enumerate((1, 4, 15, 60, 100, 400)) for _ in range(run)]
    assert not is_frozen([*quiet, *[7.0] * 900], 0.1), "as quiet at other times"
    filling = [12.0 + rise for rise in range(150) for _ in range(1 + rise % 3)]
    coarse = [*[0.0] * 310, 3.0, 9.0, 11.0, *[12.0] * 65, *filling, *[162.0] * 74, 165.0, 240.0, 280.0]
    assert not is_frozen([*coarse, *[300.0] * 120], 1.0), "as quiet whenever nothing fell, however seldom that was"
    poured = [reading for rest in range(5) for reading in (*noisy, *[float(rest)] * 110)]
    assert not is_frozen([*poured, *noisy, *[7.0] * 120], 0.1), "as quiet whenever nothing falls"
