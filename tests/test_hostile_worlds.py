"""Hostile worlds: nothing that is reported good may be out of tolerance (thousands of doses: `benchmarks.verdicts`)."""

from dataclasses import replace

import pytest

from harness.bench import MOMENTS, Bench, Ill
from harness.falsify import Falsifier, Tally
from harness.worlds import BY_NAME, WORLDS, HostileWorld
from scuhand_bt.sim.mass_ledger import in_container, in_source

RECIPE = "xrd_holders"
LUCKY = 1
"""A seed without the one dose of 130 in a sound world whose drift looks real by chance, and is flagged."""


@pytest.fixture(scope="module")
def falsifier(tmp_path_factory: pytest.TempPathFactory) -> Falsifier:
    return Falsifier(tmp_path_factory.mktemp("hostile"), (RECIPE, "redone"))


def traces(falsifier: Falsifier, name: str) -> tuple[object, ...]:
    """Whatever shows that something is other than in the sound world: readings, true masses, results."""
    shown = _Shown()
    world = replace(BY_NAME[name], ills=lambda: [*BY_NAME[name].ills(), shown])
    tally = falsifier.run(world, 8)
    return shown.sum_mg_s, tally.true_error_mg, tally.flagged, tally.failed


def test_a_sound_world_gives_good_doses_only(falsifier: Falsifier) -> None:
    tally = falsifier.run(BY_NAME["sound"], 8, LUCKY)
    assert (tally.doses, tally.good, tally.ends) == (8, 8, {0: 1})


def test_powder_that_no_weighing_can_tell_of_is_a_false_good_and_a_false_exit_code(falsifier: Falsifier) -> None:
    tally = falsifier.run(BY_NAME["leftover"], 8)
    assert tally.false_goods
    assert all(false.true_mg > false.target_mg + false.tolerance_mg for false in tally.false_goods)
    assert tally.false_zeros == [f"{RECIPE}, seed 0"]


@pytest.mark.slow
def test_what_falls_into_a_container_after_its_result_counts(falsifier: Falsifier) -> None:
    late = HostileWorld("late", "powder comes when all is over", lambda: [_Late()])
    tally = falsifier.run(late, 8, LUCKY)
    assert len(tally.false_goods) == 7  # none comes after the last


@pytest.mark.slow
def test_a_redone_sample_is_judged_by_its_second_container(falsifier: Falsifier) -> None:
    wrong_first = HostileWorld("wrong", "a wrong container first", faults="{fault: container.wrong, at: 0 s}")
    tally = Tally(wrong_first.name)
    falsifier.run_once(wrong_first, "redone", 0, tally)
    assert (tally.doses, tally.good, len(tally.false_goods)) == (5, 5, 0)


def test_a_run_that_ends_in_a_bug_is_told(falsifier: Falsifier) -> None:
    tally = Tally("bug")
    falsifier.run_once(HostileWorld("bug", "breaks", lambda: [_Breaking()]), RECIPE, 0, tally)
    assert len(tally.broken) == 1
    assert "ZeroDivisionError" in tally.broken[0]


def test_every_moment_comes_in_a_run(falsifier: Falsifier) -> None:
    seen = _Seen()
    falsifier.run(HostileWorld("seen", "looks on", lambda: [seen]), 1)
    assert set(seen.moments) == set(MOMENTS)
    assert seen.is_in_order


def test_a_step_of_the_zero_at_one_container_makes_all_of_the_run_doubtful(falsifier: Falsifier) -> None:
    tally = Tally("once")
    falsifier.run_once(HostileWorld("once", "3 mg less from the fifth dose on", lambda: [_Once(5)]), RECIPE, 0, tally)
    assert (tally.doses, tally.flagged) == (8, {"balance.bracket_open": 8})


@pytest.mark.slow
@pytest.mark.parametrize("name", [world.name for world in WORLDS if world.name != "sound"])
def test_every_hostile_world_is_another_one_than_the_sound_one(falsifier: Falsifier, name: str) -> None:
    assert traces(falsifier, name) != traces(falsifier, "sound")


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "step-before-opening",
        "push-in-the-dose",
        "warm-quick",
        "charged-hand",
        "drift-0.1",
        "sine-200",
        "hold-3",
        "tracked-leak",
        "drip-at-leaving",
        "beside-5",
        "knock",
    ],
)
def test_no_container_out_of_tolerance_is_reported_good(falsifier: Falsifier, name: str) -> None:
    tally = falsifier.run(BY_NAME[name], 30)
    assert (tally.false_goods, tally.false_zeros, tally.broken) == ([], [], [])


class _Once(Ill):
    """The zero steps down by 3 mg in the dose into one container, and stays there."""

    def __init__(self, number: int) -> None:
        self._number, self._on, self._seen = number, "", 0

    def force_mg(self, bench: Bench, dt_s: float) -> float:
        if "opened" in bench.at and bench.container is not None and bench.container != self._on:
            self._on, self._seen = bench.container, self._seen + 1
        return -3.0 if self._seen >= self._number else 0.0


class _Late(Ill):
    """Powder that comes into every container when the next one has come."""

    def __init__(self) -> None:
        self._on: str | None = None

    def act(self, bench: Bench, dt_s: float) -> None:
        before, self._on = self._on, bench.container or self._on
        if before is not None and before != self._on:
            bench.move(in_source("mortar-1"), in_container(before), 10.0)


class _Breaking(Ill):
    """A physics that breaks in mid-run."""

    def act(self, bench: Bench, dt_s: float) -> None:
        _ = 1 / ("opened" not in bench.at)


class _Seen(Ill):
    """Looks on, and notes the moments."""

    def __init__(self) -> None:
        self.moments: dict[str, float] = {}
        self.is_in_order = True

    def act(self, bench: Bench, dt_s: float) -> None:
        self.moments |= bench.at
        in_order = [bench.at[name] for name in MOMENTS if name in bench.at and name not in ("shut", "near")]
        self.is_in_order = self.is_in_order and in_order == sorted(in_order)


class _Shown(Ill):
    """Adds up what the balance shows."""

    def __init__(self) -> None:
        self.sum_mg_s = 0.0

    def shown_mg(self, bench: Bench, value_mg: float, dt_s: float) -> float:
        self.sum_mg_s += value_mg * dt_s
        return value_mg
