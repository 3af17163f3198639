"""How late a balance shows, as each container on it tells: slower than was known, quicker, or with another filter."""

from collections import deque
from contextlib import nullcontext
from dataclasses import replace
from datetime import datetime
from math import cos, exp, inf, pi, sin
from pathlib import Path
from statistics import fmean
from types import SimpleNamespace
from typing import Any

import pytest
from balance_bench import RECIPE, told
from conftest import LabFolder
from dose_bench import DISH, Bench, Setting, shipped_powders
from running import dry_run

from scuhand_bt.cell.cell import Cell
from scuhand_bt.cell.shown_balance import require_known_delay, seems_to_adapt, shown_step
from scuhand_bt.cell.weighing import weigh_changed
from scuhand_bt.clock import pause
from scuhand_bt.device_specs.balance import BalanceResponseSpec, BalanceSpec
from scuhand_bt.devices.interfaces import Reading
from scuhand_bt.dosing.bracket import Gross
from scuhand_bt.dosing.characteristic import Step, step_of
from scuhand_bt.dosing.identification import balance_of
from scuhand_bt.failures import SkillFailed
from scuhand_bt.lab_state.beliefs import LabState
from scuhand_bt.record import Record
from scuhand_bt.sim.response import OurBalanceResponse
from scuhand_bt.specs import BalanceBelief

BEFORE_THE_SECOND = 4
"""Loads: the first container of a run is put on the pan twice, and once more when it was filled."""


class Slower:
    """A plant whose balance is set to another filter when the first container has gone: `lag_s` a pole."""

    lag_s = 1.0

    class Response(OurBalanceResponse):
        def __init__(self, spec: BalanceSpec, lag_s: float) -> None:
            super().__init__(spec)
            self._lag_s, self._loads, self._was_loaded = lag_s, 0, False

        def step(self, dt_s: float, on_pan_mg: float, landing_mg: float, vibration: float, rng: Any) -> float:
            is_loaded = on_pan_mg > 1000.0
            if is_loaded and not self._was_loaded:
                self._loads += 1
                if self._loads == BEFORE_THE_SECOND:
                    self._figures = self._figures.model_copy(update={"lag_s": self._lag_s})
                    self._dt_s = 0.0
            self._was_loaded = is_loaded
            return super().step(dt_s, on_pan_mg, landing_mg, vibration, rng)

    def balance(self, spec: BalanceSpec) -> "Slower.Response":
        return self.Response(spec, self.lag_s)


class MuchSlower(Slower):
    lag_s = 2.5


class FarSlower(Slower):
    lag_s = 3.5


class LittleSlower(Slower):
    lag_s = 0.36


class Adapting:
    """A plant whose balance is four times slower while it misses less than 8 mg."""

    class Response(OurBalanceResponse):
        def step(self, dt_s: float, on_pan_mg: float, landing_mg: float, vibration: float, rng: Any) -> float:
            lag_s = 0.2 if abs(on_pan_mg - self._second) > 8.0 else 0.8
            if lag_s != self._figures.lag_s:
                self._figures = self._figures.model_copy(update={"lag_s": lag_s})
                self._dt_s = 0.0
            return super().step(dt_s, on_pan_mg, landing_mg, vibration, rng)

    def balance(self, spec: BalanceSpec) -> "Adapting.Response":
        return self.Response(spec)


def late_by(delay_s: float) -> Step:
    """How a balance of two poles shows 25 g."""
    times_s = [0.02 * number for number in range(1, 2000)]
    return Step(25_000.0, tuple(times_s), tuple((1.0 + 2.0 * t / delay_s) * exp(-2.0 * t / delay_s) for t in times_s))


def late_at_last(delay_s: float) -> Step:
    """The same, of one whose last 10 mg take four times as long."""
    whole = late_by(delay_s)
    quick = sum(share * 25_000.0 > 10.0 for share in whole.missing)
    begins_s, left = whole.times_s[quick - 1], whole.missing[quick - 1]
    creeps = (left * exp(-(time_s - begins_s) / (2.0 * delay_s)) for time_s in whole.times_s[quick:])
    return whole._replace(missing=(*whole.missing[:quick], *creeps))


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Cell:
    """A cell that has dosed, and knows its balance."""
    return dry_run(tmp_path_factory.mktemp("sound"), RECIPE, controller="adaptive").session.cell


def test_a_balance_that_was_set_slower_is_noticed_before_the_next_dose_which_learns_it_anew(tmp_path: Path) -> None:
    ran = dry_run(tmp_path, RECIPE, plant=f"{__name__}:Slower", controller="adaptive")
    (slower,) = told(ran, "balance_slower")
    assert slower["known_s"] == pytest.approx(0.6, abs=0.1)
    assert slower["delay_s"] == pytest.approx(2.0, abs=0.2)
    assert max(sample.true_mg - sample.target_mg for sample in ran.result.samples) < 3.0  # type: ignore[operator]
    assert ran.session.cell.balance_belief.lag_s == pytest.approx(1.0, rel=0.3)
    assert ran.session.cell.balance_belief.fits > 0


@pytest.mark.parametrize(
    ("known_s", "by_hand", "delay_s", "is_slower"),
    [
        (0.6, False, 0.84, False),
        (0.6, False, 0.86, True),
        (0.6, True, 1.84, False),
        (0.6, True, 1.86, True),
        (None, False, 0.84, False),
        (None, False, 0.86, True),
        (1.6, False, 2.0, False),
    ],
)
def test_slower_is_a_quarter_more_than_was_measured_or_else_learnt_and_a_person_takes_a_second(
    sound: Cell, known_s: float | None, by_hand: bool, delay_s: float, is_slower: bool
) -> None:
    events: list[Any] = []
    learnt = BalanceBelief(lag_s=0.3, misfit=0.01, fits=3)
    changer = SimpleNamespace(needs_person=by_hand)
    changes: dict[str, Any] = {"changer": changer, "record": Record(events.append), "known_delay_s": known_s}
    cell = replace(sound, balance_belief=learnt, **changes)
    step = late_by(delay_s)
    require_known_delay(cell, step)
    assert len(events) == is_slower
    found = balance_of(step)
    taken_for = found.model_copy(update={"shown_s": 0.0}) if by_hand else found
    assert cell.balance_belief == (taken_for if is_slower else learnt)
    assert cell.known_delay_s == (step.delay_s if is_slower or known_s is None else known_s)


@pytest.mark.parametrize(
    ("shown_s", "shape", "by_hand", "delay_s", "is_taken"),
    [
        (1.5, "two poles", False, 1.1, True),
        (1.5, "two poles", False, 1.13, False),
        (1.5, "two poles", True, 1.1, False),
        (0.0, "two poles", False, 1.1, False),
        (1.5, "delay", False, 1.5, True),
        (1.5, "one pole", False, 1.5, False),
        (1.5, "delay", True, 1.5, False),
        (0.0, "delay", False, 1.5, False),
    ],
)
def test_a_balance_is_quicker_or_has_another_filter_where_a_container_tells_so_and_one_told_of_it_before(
    sound: Cell, shown_s: float, shape: str, by_hand: bool, delay_s: float, is_taken: bool
) -> None:
    """3 g of beads took 820 s where one that had a dead time of 3 s has two poles of 1.4 s: readings that come sooner
    than a dead time allows surprise in every opening."""
    events: list[Any] = []
    learnt = BalanceBelief(lag_s=0.75, misfit=0.01, fits=3, shape=shape, shown_s=shown_s)
    changes: dict[str, Any] = {"changer": SimpleNamespace(needs_person=by_hand), "record": Record(events.append)}
    cell, step = replace(sound, balance_belief=learnt, known_delay_s=1.5, **changes), late_by(delay_s)
    require_known_delay(cell, step)
    assert cell.balance_belief == (balance_of(step) if is_taken else learnt)
    changed = [(event.known_s, event.known_shape, event.shape) for event in events]
    assert changed == [(shown_s, shape, "two poles")] * is_taken


@pytest.mark.parametrize(
    ("adapted", "delay_s", "is_taken"), [(False, 0.6, True), (True, 0.6, False), (False, 0.08, False)]
)
def test_a_filter_that_has_begun_to_adapt_is_taken_for_what_a_container_has_shown_of_it(
    sound: Cell, adapted: bool, delay_s: float, is_taken: bool
) -> None:
    events: list[Any] = []
    changes: dict[str, Any] = {"changer": SimpleNamespace(needs_person=False), "record": Record(events.append)}
    learnt = BalanceBelief(lag_s=0.3, misfit=0.01, fits=3, adapts=adapted)
    cell, step = replace(sound, balance_belief=learnt, known_delay_s=delay_s, **changes), late_at_last(delay_s)
    assert balance_of(step).adapts
    assert seems_to_adapt(cell, step) == is_taken
    require_known_delay(cell, step)
    assert cell.balance_belief == learnt, "one container of a thousand looks so by chance"
    require_known_delay(cell, step, has_seemed_to_adapt=True)
    assert cell.balance_belief == (balance_of(step) if is_taken else learnt)
    assert [event.adapts for event in events] == [True] * is_taken


def put_down(quick_s: float, slow_s: float, hand_s: float, pressed: float) -> Step:
    """How a filter of two poles, slow within 20 mg, shows 25 g that a hand puts down within a time, and presses."""
    dt_s, first_mg, second_mg, curve = 0.01, 0.0, 0.0, []
    for number in range(4000):
        share = min(number * dt_s / hand_s, 1.0)
        felt_mg = 25_000.0 * (share + pressed * sin(pi * share))
        step = 1.0 - exp(-dt_s / (quick_s if abs(felt_mg - second_mg) > 20.0 else slow_s))
        first_mg += (felt_mg - first_mg) * step
        second_mg += (first_mg - second_mg) * step
        if number % 10 == 0:
            curve.append((100.0 + number * dt_s, second_mg))
    shown = step_of([(90.0 + 0.1 * number, 0.0) for number in range(100)] + curve, 0.0, 25_000.0, inf)
    assert shown is not None
    return shown._replace(uncertainty_mg=0.05)


@pytest.mark.parametrize("fits", [0, 3])
@pytest.mark.parametrize(("hand_s", "pressed"), [(0.1, 0.0), (1.0, 0.0), (1.0, 0.6), (3.0, 0.0), (3.0, 0.2)])
def test_a_persons_container_shows_that_a_filter_adapts_however_long_the_hand_is_in_it(
    sound: Cell, hand_s: float, pressed: float, fits: int
) -> None:
    """Six of eight doses on such a balance were 4 to 14 mg too much."""
    events: list[Any] = []
    changes: dict[str, Any] = {"changer": SimpleNamespace(needs_person=True), "record": Record(events.append)}
    learnt = BalanceBelief(lag_s=0.5, misfit=0.01, fits=fits)
    for slow_s, adapts in ((0.25, False), (1.2, True)):
        cell = replace(sound, balance_belief=learnt, known_delay_s=4.0, **changes)
        require_known_delay(cell, put_down(0.25, slow_s, hand_s, pressed))
        found = cell.balance_belief
        assert found.adapts == adapts
        assert found == learnt or 0.25 < found.lag_s < 1.2
        assert found.fits > 0 or not adapts
    assert 15.0 < found.slow_mg < 30.0
    assert found.shown_s == 0.0, "the person's own time is in it"
    assert [event.adapts for event in events] == [True] * (fits > 0)


@pytest.mark.parametrize("kind", ["ringing", "let go too late"])
def test_a_persons_container_tells_nothing_where_its_last_is_not_the_filters(sound: Cell, kind: str) -> None:
    events: list[Any] = []
    changes: dict[str, Any] = {"changer": SimpleNamespace(needs_person=True), "record": Record(events.append)}
    step = put_down(0.25, 1.2, 0.1, 0.0)
    if kind == "ringing":
        swings = (exp(-0.83 * time_s) * (cos(1.44 * time_s) + 0.58 * sin(1.44 * time_s)) for time_s in step.times_s)
        step = step._replace(missing=tuple(swings))
    else:
        step = Step(step.step_mg, step.times_s[:5], step.missing[:5])
    cell = replace(sound, balance_belief=BalanceBelief(), known_delay_s=4.0, **changes)
    require_known_delay(cell, step)
    assert cell.balance_belief == BalanceBelief()


def test_that_an_unknown_balance_adapts_is_no_change_of_it(sound: Cell) -> None:
    events: list[Any] = []
    cell = replace(sound, balance_belief=BalanceBelief(), known_delay_s=None, record=Record(events.append))
    require_known_delay(cell, late_at_last(0.6))
    assert cell.balance_belief.adapts
    assert events == []


@pytest.mark.parametrize(("adapts", "is_taken"), [(False, False), (True, True)])
def test_a_container_that_was_weighed_a_little_too_high_is_no_filter_that_has_begun_to_adapt(
    sound: Cell, adapts: bool, is_taken: bool
) -> None:
    """It was looked at for some seconds after it had come to rest, as nothing is weighed while a scoop goes on."""
    whole, error_mg = late_at_last(0.6) if adapts else late_by(0.6), 0.1
    looked = sum(time_s < 8.0 for time_s in whole.times_s)
    missing = tuple(share + error_mg / whole.step_mg for share in whole.missing[:looked])
    step = Step(whole.step_mg, whole.times_s[:looked], missing, uncertainty_mg=0.05)
    assert balance_of(step).adapts, "taken by itself, it looks like one"
    learnt = BalanceBelief(lag_s=0.3, misfit=0.01, fits=3)
    cell = replace(sound, balance_belief=learnt, known_delay_s=0.6, record=Record(lambda event: None))
    assert seems_to_adapt(cell, step) == is_taken


@pytest.mark.parametrize(
    ("adapts", "uncertainty_mg", "by_hand", "is_taken_back"),
    [
        (False, 0.02, False, True),
        (False, 0.2, False, False),
        (True, 0.02, False, False),
        (False, 0.02, True, False),
    ],
)
def test_a_balance_that_was_taken_for_one_that_adapts_is_taken_for_what_it_is_by_a_container_that_tells_so_surely(
    sound: Cell, adapts: bool, uncertainty_mg: float, by_hand: bool, is_taken_back: bool
) -> None:
    """One container of a thousand looks so by chance: 110 doses in a row took 70 s for it, and six were too much."""
    step = (late_at_last(0.6) if adapts else late_by(0.6))._replace(uncertainty_mg=uncertainty_mg)
    looked = sum(time_s < 8.0 for time_s in step.times_s)
    step = step._replace(times_s=step.times_s[:looked], missing=step.missing[:looked])
    events: list[Any] = []
    taken_for = balance_of(late_at_last(0.6))
    changes: dict[str, Any] = {"changer": SimpleNamespace(needs_person=by_hand), "record": Record(events.append)}
    cell = replace(sound, balance_belief=taken_for, known_delay_s=0.6, **changes)
    require_known_delay(cell, step)
    assert cell.balance_belief == (balance_of(step) if is_taken_back else taken_for)
    assert [event.adapts for event in events] == [False] * is_taken_back


@pytest.mark.parametrize(
    ("by_hand", "delay_s", "refused"),
    [(False, 6.29, False), (False, 6.31, True), (True, 7.29, False), (True, 7.31, True)],
)
def test_a_delay_beyond_what_can_be_dosed_with_is_refused(
    sound: Cell, by_hand: bool, delay_s: float, refused: bool
) -> None:
    changes: dict[str, Any] = {"changer": SimpleNamespace(needs_person=by_hand), "record": Record(lambda event: None)}
    with pytest.raises(SkillFailed, match=r"balance\.slow") if refused else nullcontext():
        require_known_delay(replace(sound, **changes), late_by(delay_s))


def test_nothing_that_came_tells_no_delay(sound: Cell) -> None:
    bare, still = Gross(0.0, 0.1, 1.0), Gross(0.3, 0.1, 20.0)
    readings = deque(Reading(0.3 * (number > 100), True, 0.1 * number) for number in range(200))
    assert shown_step(replace(sound, readings=readings), bare, still, 10.0) is None
    loaded, heavy = (
        Gross(300.0, 0.1, 20.0),
        deque(replace(one, value_mg=1000.0 * one.value_mg) for one in readings),
    )
    assert shown_step(replace(sound, readings=heavy), bare, loaded, 10.0) is not None


@pytest.mark.slow
def test_a_persons_hand_hides_a_dead_time_and_nothing_else(tmp_path: Path, lab_folder: LabFolder) -> None:
    lab_folder.replace("robot/cell.yaml", "driver: carousel", "driver: operator")
    ran = dry_run(tmp_path, RECIPE, lab=lab_folder.folder, plant=f"{__name__}:Late")
    assert [placed["delay_s"] for placed in told(ran, "container")] == pytest.approx(4 * [0.6], abs=0.2)


def test_a_balance_too_slow_to_dose_with_is_refused_before_powder_falls(tmp_path: Path) -> None:
    ran = dry_run(tmp_path, RECIPE, plant=f"{__name__}:FarSlower", controller="adaptive")
    assert ran.sample("a").true_mg == pytest.approx(500.0, abs=3.0)
    assert [sample.code for sample in ran.result.samples][1:] == 3 * ["balance.slow"]
    assert [ran.sample(name).true_mg for name in "bcd"] == [0.0, 0.0, 0.0]
    assert "the balance showed the container 7.0 s late; for a dose 6.2 s are allowed" in (ran.sample("b").detail or "")


@pytest.mark.parametrize(
    "believed", [BalanceBelief(), BalanceBelief(lag_s=0.4, doubt=0.7, adapts=True, fits=3)], ids=["unknown", "known"]
)
def test_a_balance_that_adapts_is_weighed_when_it_no_longer_creeps(believed: BalanceBelief) -> None:
    """It calls readings stable that are still on their way; the next weighing then looked like a step of its zero."""
    spec = BalanceSpec(simulation=BalanceResponseSpec(drift_mg=0.0))
    lacking_mg = []
    for seed in range(4):
        bench = Bench(shipped_powders()["glass_beads"], 50.0, seed, 0, Setting(f"{__name__}:Adapting", balance=spec))
        bench.cell.balance.on_reading = bench.cell.readings.append
        bench.cell.balance_belief = believed
        bench.world.remove()
        bench.drive(pause(bench.clock, 60.0))
        bare = bench.drive(bench.cell.balance.stable_mean())
        bench.world.place(DISH)
        loaded = bench.drive(weigh_changed(bench.cell, bare.value_mg))
        bench.drive(pause(bench.clock, 30.0))
        lacking_mg.append(bench.drive(bench.cell.balance.stable_mean()).value_mg - loaded.value_mg)
    assert abs(fmean(lacking_mg)) < 0.08, "it was 0.17"


@pytest.mark.slow
def test_a_balance_that_is_set_to_five_seconds_is_dosed_with(tmp_path: Path) -> None:
    ran = dry_run(tmp_path, RECIPE, plant=f"{__name__}:MuchSlower", controller="adaptive")
    assert told(ran, "container")[1]["delay_s"] == pytest.approx(5.0, abs=0.3)
    for sample in ran.result.samples:
        assert sample.true_mg == pytest.approx(sample.target_mg, abs=sample.tolerance_mg)
    assert [ran.sample(name).is_good for name in "cd"] == [True, True]


@pytest.mark.slow
def test_a_sound_balance_and_one_that_is_a_little_slower_change_nothing(tmp_path: Path) -> None:
    for number, plant in enumerate((None, f"{__name__}:LittleSlower")):
        folder = tmp_path / str(number)
        folder.mkdir()
        ran = dry_run(folder, RECIPE, plant=plant, controller="adaptive")
        assert told(ran, "balance_slower") == []
        delays_s = [placed["delay_s"] for placed in told(ran, "container")]
        assert delays_s[0] == pytest.approx(0.6, abs=0.1)
        assert ran.session.cell.known_delay_s == pytest.approx(min(delays_s), rel=0.02)


@pytest.mark.slow
def test_a_delay_known_from_an_earlier_run_is_held_against_the_first_container(tmp_path: Path) -> None:
    cell = dry_run(tmp_path, RECIPE).session.cell
    quicker = replace(cell, simulated=False, balance_figures={"delay_s": 0.3}, known_delay_s=None)
    LabState(tmp_path).keep(quicker, "before")
    LabState(tmp_path).recall(quicker, datetime.now().astimezone())
    assert quicker.known_delay_s == 0.3


@pytest.mark.slow
def test_the_container_of_a_balance_with_a_dead_time_is_waited_for(tmp_path: Path) -> None:
    ran = dry_run(tmp_path, RECIPE, plant=f"{__name__}:Late", controller="paper")
    assert [placed["delay_s"] for placed in told(ran, "container")] == pytest.approx(4 * [1.6], abs=0.2)


class Late:
    """A plant whose balance shows everything a second late."""

    class Response(OurBalanceResponse):
        def __init__(self, spec: BalanceSpec) -> None:
            super().__init__(spec)
            self._now_s, self._kept = 0.0, [(0.0, 0.0)]

        def step(self, dt_s: float, on_pan_mg: float, landing_mg: float, vibration: float, rng: Any) -> float:
            self._now_s += dt_s
            self._kept.append((self._now_s, super().step(dt_s, on_pan_mg, landing_mg, vibration, rng)))
            while self._kept[1][0] <= self._now_s - 1.0:
                del self._kept[0]
            return self._kept[0][1]

    def balance(self, spec: BalanceSpec) -> "Late.Response":
        return self.Response(spec)
