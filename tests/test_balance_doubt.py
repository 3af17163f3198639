"""What doses have taught of a balance is given up as soon as a weighing contradicts it."""

from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest
from conftest import read
from running import Ran, dry_run, make_lab

from scuhand_bt.cell.cell import Cell
from scuhand_bt.cell.dose_loop import CurvePoint
from scuhand_bt.cell.doubt import doubt_balance
from scuhand_bt.cell_spec import BalanceSpec
from scuhand_bt.lab_state.beliefs import LabState
from scuhand_bt.record import Record
from scuhand_bt.sim.response import OurBalanceResponse
from scuhand_bt.specs import BalanceBelief

LEARNT = BalanceBelief(lag_s=0.5, misfit=0.01, noise_mg=0.2, fits=1)
TWICE = """
workflow: twice
summary: A dose that may fail, and another into the same container.
inputs: {source: Source, container: Container, mass: Mass, tolerance: {type: Mass, default: 3 mg}}
result: $last
tree:
  sequence:
    - place_container: {container: $container}
    - tare:
    - optional: {child: {fill: {source: $source, container: $container, mass: 100 mg, tolerance: $tolerance}}}
    - optional: {child: {fill: {source: $source, container: $container, mass: 600 mg, tolerance: $tolerance}}}
    - fill: {source: $source, container: $container, mass: $mass, tolerance: $tolerance, as: last}
    - return_leftover: {source: $source}
    - park:
"""
RECIPE = """
recipe: r
workflow: twice
samples: [{id: a, source: beads, container: alumina_crucible, mass: 1500 mg}]
on_failure: {otherwise: flag}
"""


class SlowerInTheDose:
    """A plant whose balance is set from 0.3 to 1.0 s a pole while 300 mg are in its container."""

    class Response(OurBalanceResponse):
        def __init__(self, spec: BalanceSpec) -> None:
            super().__init__(spec)
            self._empty_mg = 0.0

        def step(self, dt_s: float, on_pan_mg: float, landing_mg: float, vibration: float, rng: Any) -> float:
            if on_pan_mg > 1000.0:
                self._empty_mg = self._empty_mg or on_pan_mg
                if on_pan_mg - self._empty_mg > 300.0 and self._figures.lag_s < 1.0:
                    self._figures = self._figures.model_copy(update={"lag_s": 1.0})
                    self._dt_s = 0.0
            return super().step(dt_s, on_pan_mg, landing_mg, vibration, rng)

    def balance(self, spec: BalanceSpec) -> OurBalanceResponse:
        return self.Response(spec)


def told(ran: Ran) -> list[dict[str, Any]]:
    return [event["payload"] for event in read(ran.journal, "event") if event["kind"] == "balance_doubted"]


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_filter_that_changes_within_a_dose_is_doubted_at_its_weighing_and_the_next_dose_learns_it(
    tmp_path: Path, seed: int
) -> None:
    lab = make_lab(tmp_path / "lab", trees__twice=TWICE)
    ran = dry_run(tmp_path, RECIPE, lab=lab, plant=f"{__name__}:SlowerInTheDose", controller="adaptive", seed=seed)
    (doubted,) = told(ran)
    assert doubted["lag_s"] == pytest.approx(0.3, abs=0.1)
    assert doubted["difference_mg"] > 2.0 * doubted["allowed_mg"]
    assert ran.sample("a").verdict == "in tolerance"
    belief = ran.session.cell.balance_belief
    assert (belief.fits > 0, belief.lag_s) == (True, pytest.approx(1.0, rel=0.2))


def test_a_sound_balance_is_not_doubted(tmp_path: Path) -> None:
    lab = make_lab(tmp_path / "lab", trees__twice=TWICE)
    ran = dry_run(tmp_path, RECIPE.replace("beads", "msg"), lab=lab, controller="adaptive")
    assert told(ran) == []
    assert ran.session.cell.balance_belief.fits > 0


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Cell:
    recipe = "recipe: r\nworkflow: scoop_and_dispense\n"
    recipe += "samples: [{id: a, source: beads, container: xrd_holder, mass: 50 mg}]\n"
    return dry_run(tmp_path_factory.mktemp("cell"), recipe).session.cell


def dose(estimates_mg: Sequence[float], mean_mg: float, begins_s: float = 0.0) -> list[CurvePoint]:
    """One estimate a second, at each reading, and a stable mean."""
    points = [CurvePoint(begins_s + t, mg, 0.0, 0.0, False, mg) for t, mg in enumerate(estimates_mg)]
    return [*points, CurvePoint(begins_s + len(points), mean_mg, 0.0, 0.0, True, mean_mg)]


STILL, COMING = (90.0, 100.0, 100.0, 100.0), (90.0, 90.0, 95.0, 100.0)
"""Within two seconds, four lags, nothing came, or 10 mg did: five noises are allowed, and 3 mg more."""


@pytest.mark.parametrize(
    ("estimates_mg", "off_mg", "is_doubted"),
    [
        (STILL, 0.99, False),
        (STILL, 1.01, True),
        (STILL, -0.99, False),
        (STILL, -1.01, True),
        (COMING, 3.99, False),
        (COMING, 4.01, True),
        (COMING, -4.01, True),
    ],
)
def test_a_weighing_may_differ_by_noise_and_a_share_of_what_came_last(
    cell: Cell, estimates_mg: Sequence[float], off_mg: float, is_doubted: bool
) -> None:
    events: list[Any] = []
    trusting = replace(cell, balance_belief=LEARNT, record=Record(events.append))
    doubt_balance(trusting, LEARNT, [*dose((0.0, 50.0), 50.0), *dose(estimates_mg, 100.0 + off_mg, 10.0)])
    assert trusting.balance_belief == (BalanceBelief() if is_doubted else LEARNT)
    assert [event.lag_s for event in events] == [0.5] * is_doubted


def test_a_weighing_after_a_weighing_tells_nothing_of_a_lag(cell: Cell) -> None:
    """As those of step commands: between them powder has come that nobody has estimated."""
    trusting = replace(cell, balance_belief=LEARNT, record=Record(lambda event: None))
    doubt_balance(trusting, LEARNT, [*dose(STILL, 100.0), *dose((), 150.0, 10.0)])
    assert trusting.balance_belief == LEARNT


def test_a_fine_noise_counts_as_a_digit(cell: Cell) -> None:
    quiet = LEARNT.model_copy(update={"noise_mg": 0.001})
    for off_mg, expected in ((0.49, quiet), (0.51, BalanceBelief())):
        trusting = replace(cell, balance_belief=quiet, record=Record(lambda event: None))
        doubt_balance(trusting, quiet, dose(STILL, 100.0 + off_mg))
        assert trusting.balance_belief == expected


@pytest.mark.parametrize("learnt_now", [LEARNT.model_copy(update={"fits": 2}), BalanceBelief(lag_s=1.0)])
def test_what_a_dose_has_learnt_anew_or_was_never_known_is_not_given_up(cell: Cell, learnt_now: BalanceBelief) -> None:
    trusting = replace(cell, balance_belief=learnt_now, record=Record(lambda event: None))
    doubt_balance(trusting, BalanceBelief() if learnt_now.fits == 0 else LEARNT, dose(STILL, 200.0))
    assert trusting.balance_belief == learnt_now


def test_what_was_given_up_is_forgotten_by_the_lab(cell: Cell, tmp_path: Path) -> None:
    state = LabState(tmp_path)
    for simulated in (True, False):
        state.keep(replace(cell, simulated=simulated, balance_belief=LEARNT), "learnt")
        state.keep(replace(cell, simulated=simulated, balance_belief=BalanceBelief()), "given up")
    assert state.balances(simulated=False) == {}
    assert len(state.balances(simulated=True)) == 1, "a dry run that learns nothing takes nothing back"
    fresh = replace(cell, balance_belief=LEARNT)
    state.recall(fresh, datetime.now().astimezone())
    assert fresh.balance_belief == BalanceBelief()
