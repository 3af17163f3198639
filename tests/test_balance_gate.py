"""What is known of a balance, and what is done where it is slower than that, unknown, or asked for too much."""

import json
from collections import deque
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from datetime import datetime, timedelta
from math import exp
from pathlib import Path
from statistics import stdev
from types import SimpleNamespace
from typing import Any

import pytest
from conftest import Call, LabFolder, problems_of
from running import Ran, dry_run, make_lab, shared_planner

from harness.falsify import Falsifier
from harness.worlds import BY_NAME
from scuhand_bt.cell.cell import Cell
from scuhand_bt.cell.weighing import require_known_delay, seems_to_adapt, shown_step
from scuhand_bt.device_specs.balance import BalanceLimits, BalanceSpec
from scuhand_bt.devices.interfaces import Reading
from scuhand_bt.dosing.bracket import Gross
from scuhand_bt.dosing.characteristic import Step, held_mg, is_frozen
from scuhand_bt.dosing.identification import balance_of
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.journal.reader import read
from scuhand_bt.lab import Lab
from scuhand_bt.lab_state.beliefs import LabState, Measured
from scuhand_bt.problems import Problem
from scuhand_bt.recipe.plan import Plan, make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.record import Record
from scuhand_bt.run.balance_limits import below_usp, beyond_limits
from scuhand_bt.run.cell_state import state_of, take_up
from scuhand_bt.run.make_cell import Setup, set_up
from scuhand_bt.run.options import Options
from scuhand_bt.run.resume import checked_history, resumable
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun
from scuhand_bt.sim.response import OurBalanceResponse
from scuhand_bt.specs import BalanceBelief

RECIPE = """\
recipe: four
workflow: scoop_and_dispense
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 20 g}
defaults: {source: beads, container: pellet_die_13mm, tolerance: 3 mg}
samples:
  - {id: a, mass: 500 mg}
  - {id: b, mass: 500 mg, tolerance: 1 mg}
  - {id: c, mass: 30 mg}
  - {id: d, mass: 500 mg}
on_failure: {otherwise: flag}
"""
DAY = "recipe: day\nworkflow: start_of_day\nsamples: [{id: check, weight: 20 g}]\n"
NOW = datetime.fromisoformat("2026-03-02T08:00:00+00:00")


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


def told(ran: Ran, kind: str) -> list[dict[str, Any]]:
    return [e["payload"] for e in read(ran.journal, "event") if e["kind"] == kind]


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
    ("by_hand", "adapted", "delay_s", "is_taken"),
    [(False, False, 0.6, True), (True, False, 0.6, False), (False, True, 0.6, False), (False, False, 0.08, False)],
)
def test_a_filter_that_has_begun_to_adapt_is_taken_for_what_a_container_has_shown_of_it(
    sound: Cell, by_hand: bool, adapted: bool, delay_s: float, is_taken: bool
) -> None:
    events: list[Any] = []
    changes: dict[str, Any] = {"changer": SimpleNamespace(needs_person=by_hand), "record": Record(events.append)}
    learnt = BalanceBelief(lag_s=0.3, misfit=0.01, fits=3, adapts=adapted)
    cell, step = replace(sound, balance_belief=learnt, known_delay_s=delay_s, **changes), late_at_last(delay_s)
    assert balance_of(step).adapts
    assert seems_to_adapt(cell, step) == is_taken
    require_known_delay(cell, step)
    assert cell.balance_belief == learnt, "one container of a thousand looks so by chance"
    require_known_delay(cell, step, has_seemed_to_adapt=True)
    assert cell.balance_belief == (balance_of(step) if is_taken else learnt)
    assert [event.adapts for event in events] == [True] * is_taken


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
    assert "it showed the container 7.0 s late; up to 6.2 s are dosed with" in (ran.sample("b").detail or "")


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


# --- the start of the day


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


# --- kept by the balance, and forgotten


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


@pytest.mark.slow
def test_a_resumed_run_knows_what_was_measured_before(tmp_path: Path) -> None:
    cell = dry_run(tmp_path, RECIPE, controller="adaptive").session.cell
    fresh = replace(cell, balance_figures={}, known_delay_s=None)
    take_up(fresh, json.loads(json.dumps(state_of(cell))))
    assert fresh.balance_figures == cell.balance_figures != {}
    assert fresh.known_delay_s == cell.known_delay_s


# --- limits, in `check` and in real runs


@pytest.fixture
def plan_of(tmp_path: Path, starter: Lab) -> Callable[..., tuple[Plan, Lab]]:
    def make(recipe: str = RECIPE, **limits: Any) -> tuple[Plan, Lab]:
        balance = starter.cell.balance.model_copy(update={"limits": BalanceLimits(**limits)})
        lab = replace(starter, cell=starter.cell.model_copy(update={"balance": balance}))
        path = tmp_path / "recipe.yaml"
        path.write_text(recipe)
        return make_plan(load_recipe(path, lab), lab), lab

    return make


def at(problem: Problem) -> tuple[str, int, int]:
    return Path(problem.mark.file).name, problem.mark.line, problem.mark.column


def measured(value: float, ago: timedelta = timedelta()) -> Measured:
    return Measured(value, "run r", (NOW - ago).isoformat())


@pytest.mark.parametrize(
    ("ago", "said"),
    [
        (None, "was not weighed right yet"),
        (timedelta(hours=23, minutes=59), None),
        (timedelta(hours=24, minutes=1), "was last weighed right at 2026-03-01T07:59:00+00:00 (run r)"),
    ],
)
def test_a_check_weight_expires(
    plan_of: Callable[..., tuple[Plan, Lab]], ago: timedelta | None, said: str | None
) -> None:
    figures = {"check_weight_error_mg": measured(0.1, ago)} if ago is not None else {}
    found = beyond_limits(*plan_of(check_weight_every_s=86400.0), figures, NOW)
    assert [said in problem.message for problem in found if said] == ([True] if said else [])
    assert len(found) == (said is not None)
    assert beyond_limits(*plan_of(), figures, NOW) == []


def test_what_doses_nothing_needs_no_check_weight(plan_of: Callable[..., tuple[Plan, Lab]]) -> None:
    assert beyond_limits(*plan_of(DAY, check_weight_every_s=60.0), {}, NOW) == []


@pytest.mark.parametrize(
    ("limits", "repeatability_mg", "said"),
    [
        ({}, 0.1, None),
        ({"minimum_weight_mg": 30.0}, None, None),
        (
            {"minimum_weight_mg": 31.0},
            None,
            "30.0 mg is less than the balance's minimum weight, 31.0 mg (robot/cell.yaml)",
        ),
        (
            {"usp_41": True},
            None,
            "30.0 mg is less than the balance's minimum weight, 82.0 mg (2000 x 0.041 mg, USP 41)",
        ),
        (
            {"usp_41": True, "minimum_weight_mg": 90.0},
            None,
            "30.0 mg is less than the balance's minimum weight, 90.0 mg (robot/cell.yaml)",
        ),
        (
            {"usp_41": True, "minimum_weight_mg": 31.0},
            0.2,
            "30.0 mg is less than the balance's minimum weight, 400.0 mg (2000 x 0.2 mg, USP 41)",
        ),
    ],
)
def test_a_mass_below_the_minimum_weight_is_told_where_it_stands(
    plan_of: Callable[..., tuple[Plan, Lab]], limits: Any, repeatability_mg: float | None, said: str | None
) -> None:
    figures = {"repeatability_mg": measured(repeatability_mg)} if repeatability_mg is not None else {}
    found = beyond_limits(*plan_of(**limits), figures, NOW)
    assert [problem.message for problem in found] == ([said] if said else [])
    assert [at(problem) for problem in found] == ([("recipe.yaml", 9, 19)] if said else [])


@pytest.mark.parametrize(
    ("limits", "repeatability_mg", "minimum"),
    [
        ({}, None, None),
        ({}, 0.014, "82.0 mg (2000 x 0.041 mg, USP 41)"),
        ({}, 0.2, "400.0 mg (2000 x 0.2 mg, USP 41)"),
        ({"usp_41": False}, 0.2, None),
        ({"usp_41": True}, 0.2, None),
        ({"minimum_weight_mg": 10.0}, 0.2, None),
    ],
)
def test_a_measured_repeatability_warns_of_small_masses_where_the_lab_has_no_rule_of_its_own(
    plan_of: Callable[..., tuple[Plan, Lab]], limits: Any, repeatability_mg: float | None, minimum: str | None
) -> None:
    figures = {"repeatability_mg": measured(repeatability_mg)} if repeatability_mg is not None else {}
    found = below_usp(*plan_of(**limits), figures)
    assert [problem.message.partition("minimum weight, ")[2].partition(" (and")[0] for problem in found] == (
        [minimum] if minimum else []
    )
    assert [at(problem) for problem in found] == ([("recipe.yaml", 9, 19)] if minimum else [])


def test_a_rule_that_several_samples_break_is_told_once(plan_of: Callable[..., tuple[Plan, Lab]]) -> None:
    (found,) = beyond_limits(*plan_of(minimum_weight_mg=501.0), {}, NOW)
    assert found.message.endswith("(and 3 more like it)")


@pytest.mark.parametrize(("repeatability_mg", "place"), [(0.24, None), (0.26, (8, 38)), (0.8, (5, 66))])
def test_a_tolerance_that_the_repeatability_cannot_tell_is_told_where_it_stands(
    plan_of: Callable[..., tuple[Plan, Lab]], repeatability_mg: float, place: tuple[int, int] | None
) -> None:
    found = beyond_limits(*plan_of(), {"repeatability_mg": measured(repeatability_mg)}, NOW)
    assert [at(problem)[1:] for problem in found] == ([place] if place else [])
    assert all(f"with a repeatability of {repeatability_mg} mg" in problem.message for problem in found)


def test_check_notes_what_a_real_run_is_refused_for(command: Call, lab_folder: LabFolder) -> None:
    recipe = lab_folder.write("recipes/r.yaml", RECIPE)
    ended = command("check", recipe, "--fast")
    assert ended.returncode == 0
    assert "robot/cell.yaml:6:" in ended.stderr
    assert "a check weight is asked for every 24 h 00 min, and was not weighed right yet" in ended.stderr
    assert len(json.loads(command("check", recipe, "--fast", "--json").stdout)["notes"]) == 2, (
        "the changer, and the weight"
    )


def test_a_real_run_without_a_check_weight_is_refused_or_warned_and_a_dry_run_is_not(
    tmp_path: Path, plan_of: Callable[..., tuple[Plan, Lab]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("scuhand_bt.run.session.set_up", taken_for_real)

    def begin(simulation: DryRun | None, **limits: Any) -> Session:
        plan, lab = plan_of(check_weight_every_s=86400.0, **limits)
        return Session(plan, lab, Options(simulation, "paper", tmp_path / "runs"), shared_planner(plan, lab))

    (refused,) = problems_of(lambda: begin(None))
    assert "a check weight is asked for" in refused
    assert list((tmp_path / "runs").glob("*.sqlite")) == []
    for simulation, limits, warned in ((None, {"when_beyond": "warn"}, 1), (DryRun(), {}, 0)):
        session = begin(simulation, **limits)
        session.close()
        assert len(session.warnings) == warned
        assert [entry["kind"] for entry in read(session.journal.path, "event")].count("trouble") == warned
    keep_checked(session.cell, tmp_path)
    begin(None).close()


def test_a_run_that_was_begun_goes_on_whatever_its_balance(
    tmp_path: Path, plan_of: Callable[..., tuple[Plan, Lab]], monkeypatch: pytest.MonkeyPatch
) -> None:
    ran = dry_run(tmp_path, RECIPE, stop_at=40)
    monkeypatch.setattr("scuhand_bt.run.session.set_up", taken_for_real)
    plan, lab = plan_of(check_weight_every_s=86400.0)
    found = resumable(ran.journal, checked_history(ran.journal), plan, lab, accept_changes=True)
    session = Session(plan, lab, Options(None, "paper", tmp_path / "runs"), shared_planner(plan, lab), resumes=found)
    session.close()
    assert "a check weight is asked for" in session.warnings[0]


@pytest.mark.parametrize("wrote", ["nothing", "before", "since", "forgotten"])
def test_a_resumed_real_run_believes_what_its_doses_taught_of_powders_but_for_what_the_lab_wrote_since(
    tmp_path: Path, plan_of: Callable[..., tuple[Plan, Lab]], monkeypatch: pytest.MonkeyPatch, wrote: str
) -> None:
    """What a run had learnt before it was killed was learnt anew, as it is kept at a run's end."""
    ran, state = dry_run(tmp_path, RECIPE, stop_at=500, controller="adaptive"), LabState(tmp_path)
    learnt = ran.session.cell.powder_beliefs["glass_beads"]
    assert (ran.result.is_complete, ran.session.cell.balance_belief.fits > 0, learnt.doses) == (False, True, 1)
    other = learnt.model_copy(update={"coefficient": 50.0})
    if wrote != "nothing":
        taught: dict[str, Any] = {"powder_beliefs": {"glass_beads": other}, "balance_belief": BalanceBelief()}
        with monkeypatch.context() as then:
            if wrote == "before":
                then.setattr("scuhand_bt.lab_state.beliefs.wall_time", lambda: "2026-01-01T00:00:00+00:00")
            state.keep(replace(ran.session.cell, simulated=False, **taught), "another")
    if wrote == "forgotten":
        state.forget_powders("glass_beads")
    monkeypatch.setattr("scuhand_bt.run.session.set_up", taken_for_real)
    plan, lab = plan_of()
    found = resumable(ran.journal, checked_history(ran.journal), plan, lab, accept_changes=True)
    session = Session(plan, lab, Options(None, "paper", tmp_path / "runs"), shared_planner(plan, lab), resumes=found)
    session.close()
    assert session.cell.balance_belief == BalanceBelief(), "nothing was learnt of it on real devices, or forgotten"
    assert session.cell.powder_beliefs.get("glass_beads") == {"since": other, "forgotten": None}.get(wrote, learnt)


@pytest.mark.parametrize(("is_forgotten", "believes"), [(True, {}), (False, {"beads": 0.6})])
def test_what_was_forgotten_of_scoops_since_a_run_broke_off_stays_forgotten_when_it_is_resumed(
    tmp_path: Path,
    plan_of: Callable[..., tuple[Plan, Lab]],
    monkeypatch: pytest.MonkeyPatch,
    is_forgotten: bool,
    believes: dict[str, float],
) -> None:
    """It was believed again, and written anew at the run's end."""
    ran, state = dry_run(tmp_path, RECIPE, stop_at=500), LabState(tmp_path)
    taught = replace(ran.session.cell.believed, yields={"beads": 0.6})
    state.keep(replace(ran.session.cell, simulated=False, believed=taught), "day-1")
    monkeypatch.setattr("scuhand_bt.run.session.set_up", taken_for_real)
    plan, lab = plan_of()
    found = resumable(ran.journal, checked_history(ran.journal), plan, lab, accept_changes=True)
    found.history.state["believed"]["yields"] = {"beads": 0.6}
    if is_forgotten:
        state.forget_powders("glass_beads")
    session = Session(plan, lab, Options(None, "paper", tmp_path / "runs"), shared_planner(plan, lab), resumes=found)
    session.close()
    assert session.cell.believed.yields == believes
    state.keep(session.cell, "resumed")
    assert [one.share for one in state.yields(simulated=False).values()] == list(believes.values())


def taken_for_real(plan: Plan, lab: Lab, simulation: object, *args: object, **more: object) -> Setup:
    made = set_up(plan, lab, DryRun(), *args, **more)  # type: ignore[arg-type]
    made.cell.simulated = simulation is not None
    return made


def keep_checked(cell: Cell, folder: Path) -> None:
    """A check weight was weighed right just now, on the real balance."""
    passed = replace(cell, simulated=False, balance_figures={"check_weight_error_mg": 0.1}, powder_beliefs={})
    LabState(folder).keep(passed, "day")


# --- the command


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


@pytest.mark.parametrize(
    ("limits", "said"),
    [
        ("minimum_weight: 0.1", "6:"),
        ("minimum_weight: -1 mg", "6:"),
        ("usp_41: perhaps", "6:"),
        ("check_weight_every: 0 h", "6:"),
        ("when_beyond: ask", "6:"),
    ],
)
def test_a_wrong_limit_is_told_where_it_stands(lab_folder: LabFolder, limits: str, said: str) -> None:
    lab_folder.replace("robot/cell.yaml", "limits: {check_weight_every: 24 h}", f"limits: {{{limits}}}")
    problems = problems_of(lab_folder.load)
    assert len(problems) == 1
    assert problems[0].startswith(said)


def test_limits_are_written_as_the_docs_say(lab_folder: LabFolder) -> None:
    limits = "limits: {check_weight_every: 12 h, minimum_weight: 50 mg, usp_41: true, when_beyond: warn}"
    lab_folder.replace("robot/cell.yaml", "limits: {check_weight_every: 24 h}", limits)
    expected = BalanceLimits(check_weight_every_s=43200.0, minimum_weight_mg=50.0, usp_41=True, when_beyond="warn")
    assert lab_folder.load().cell.balance.limits == expected


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
