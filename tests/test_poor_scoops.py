"""Scoops that bring little or nothing, bridges, and a stuck valve: told apart, scooped again, and given up in time."""

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import pytest
from conftest import read
from daily import first_daily
from numpy.random import Generator
from running import Ran, dry_run, make_lab, shared_planner

from scuhand_bt.cell.believed_powder import MOST_BARREN_LOADS
from scuhand_bt.clock import Steps
from scuhand_bt.failures import CATALOGUE, Code
from scuhand_bt.lab import load_lab
from scuhand_bt.problems import SourceError
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.run.options import Options
from scuhand_bt.run.outcome import BatchResult
from scuhand_bt.run.resume import checked_history, resumable
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun
from scuhand_bt.sim.fault_rules import parse_faults
from scuhand_bt.sim.mass_ledger import in_source
from scuhand_bt.sim.powder import OurPowderFlow
from scuhand_bt.sim.scoop import OurScoopYield
from scuhand_bt.specs import Powder

RECIPE = """
recipe: r
workflow: scoop_and_dispense
defaults: {container: alumina_crucible, tolerance: 5 mg}
samples:
  - {id: a, source: beads, mass: 2 g}
  - {id: b, source: beads, mass: 500 mg}
  - {id: c, source: msg, mass: 300 mg}
  - {id: d, source: beads, mass: 500 mg}
on_failure: {scoop.nothing: POLICY, otherwise: stop}
"""
NOTHING_COMES = f"faults: [{{fault: scoop.nothing, times: {MOST_BARREN_LOADS}, probability: 1}}]"


class PoorScoops:
    """A plant whose scoops bring a third of what they should."""

    share = 0.35

    class Yield(OurScoopYield):
        def __init__(self, powder: Powder, share: float) -> None:
            super().__init__(powder)
            self._share = share

        def collect(self, lifted_mg: float, there_mg: float, rng: Generator) -> float:
            return self._share * super().collect(lifted_mg, there_mg, rng)

    def scoop(self, powder: Powder) -> OurScoopYield:
        return self.Yield(powder, self.share)


class NoScoops(PoorScoops):
    """A plant whose scoops bring nothing."""

    share = 0.0


class Bridges:
    """A plant whose first load bridges for good when 300 mg of it have come; more powder on top of it frees it."""

    loads = 0

    class Flow(OurPowderFlow):
        def __init__(self, powder: Powder, until_mg: float) -> None:
            super().__init__(powder)
            self._until_mg, self._left_mg = until_mg, 0.0

        def step(self, dt_s: float, opening_mm: float, vibration: float, in_cone_mg: float, rng: Generator) -> float:
            if self._left_mg >= self._until_mg:
                return 0.0
            leaving_mg = super().step(dt_s, opening_mm, vibration, in_cone_mg, rng)
            self._left_mg += leaving_mg
            return leaving_mg

    def flow(self, powder: Powder) -> OurPowderFlow:
        self.loads += 1
        return self.Flow(powder, 300.0 if self.loads <= 3 else 1e9)  # it is tried before a run


def told(ran: Ran, kind: str) -> list[dict[str, Any]]:
    return [event["payload"] for event in read(ran.journal, "event") if event["kind"] == kind]


def failures(ran: Ran) -> Counter[str]:
    return Counter(row["code"] for row in read(ran.journal, "action") if row["outcome"] == "failed")


def ended(ran: Ran) -> dict[str, tuple[str, str | None]]:
    return {sample.id: (sample.verdict, sample.code) for sample in ran.result.samples}


def test_poor_scoops_lose_no_sample_and_what_the_next_ones_will_bring_is_learnt(tmp_path: Path) -> None:
    recipe = RECIPE.replace("POLICY", "stop")
    ran = dry_run(tmp_path, recipe, plant=f"{__name__}:PoorScoops", controller="adaptive")
    assert set(ended(ran).values()) == {("in tolerance", None)}
    scoops_mg = [scoop["expected_mg"] for scoop in told(ran, "scoop") if scoop["source"] == "beads"]
    assert 2000.0 < scoops_mg[0] < 2500.0, "half of what the cone may carry"
    assert all(mass_mg == pytest.approx(0.35 * 4750.0, rel=0.25) for mass_mg in scoops_mg[1:])
    assert failures(ran)["hand.no_flow"] == 1, "once; then it is known what a scoop brings"
    world, believed = ran.session.world, ran.session.cell.believed
    assert world is not None
    for source in ("beads", "msg"):
        assert believed.sources_mg[source] == pytest.approx(world.masses_mg[f"source:{source}"], abs=400.0)


@pytest.mark.slow
def test_a_source_that_gives_nothing_costs_six_scoops_at_most_and_its_other_samples_are_not_begun(
    tmp_path: Path,
) -> None:
    recipe = RECIPE.replace("POLICY", "skip_sample")
    ran = dry_run(tmp_path, recipe, plant=f"{__name__}:NoScoops", controller="adaptive", seed=2)
    assert ended(ran) == {
        "a": ("skipped", "scoop.nothing"),
        "b": ("not run", "scoop.nothing"),
        "c": ("skipped", "scoop.nothing"),
        "d": ("not run", "scoop.nothing"),
    }
    assert max(Counter(scoop["source"] for scoop in told(ran, "scoop")).values()) == MOST_BARREN_LOADS
    assert {placed["container"] for placed in told(ran, "container")} == {"a", "c"}
    assert "'beads' has brought nothing before" in (ran.sample("d").detail or "")
    assert ran.result.exit_code == 1
    with pytest.raises(SourceError, match="the run is complete"):
        checked_history(ran.journal)
    for told_to in ("the sheet opens", "the motor shakes", "begin a new run with the samples that were not run"):
        assert told_to in CATALOGUE[Code.SCOOP_NOTHING].remedy


@pytest.mark.slow
def test_small_doses_of_which_nothing_comes_cost_as_many_scoops_as_large_ones_do(tmp_path: Path) -> None:
    samples = "samples: [{id: a, source: beads, mass: 20 mg}, {id: b, source: beads, mass: 25 mg}]"
    recipe = f"recipe: r\nworkflow: fill_xrd_holder\ndefaults: {{container: xrd_holder}}\n{samples}\n"
    ran = dry_run(tmp_path, recipe, plant=f"{__name__}:NoScoops", controller="adaptive")
    told_so = ran.sample("a").code or "", ran.sample("a").detail or ""
    assert ": ".join(told_so).startswith("scoop.nothing: 6 loads in a row from 'beads' brought nothing")
    assert len(told(ran, "scoop")) == MOST_BARREN_LOADS


@pytest.mark.parametrize("controller", first_daily("direct_pid", "paper"))
def test_every_controller_gives_up_on_a_source_that_gives_nothing(tmp_path: Path, controller: str) -> None:
    recipe = RECIPE.replace("POLICY", "stop")
    ran = dry_run(tmp_path, recipe, plant=f"{__name__}:NoScoops", controller=controller)
    assert (ran.result.exit_code, len(told(ran, "scoop"))) == (3, MOST_BARREN_LOADS)
    assert ran.result.reason.startswith("a: scoop.nothing: 6 loads in a row from 'beads' brought nothing")
    left = r"\. \d+\.\d+ g should be left\. If there is less, refill it or correct the recipe's amount"
    hand = "Check that the sheet opens and the motor shakes"
    assert re.search(
        rf"{left}\. If the powder stands at the sides, level it; if it bridges, dry or sieve it\. {hand}",
        ran.result.reason,
    )


@pytest.mark.slow
def test_one_scoop_that_brought_nothing_is_made_again(tmp_path: Path) -> None:
    recipe = RECIPE.replace("POLICY", "stop")
    ran = dry_run(tmp_path, recipe, faults="faults: [{fault: scoop.nothing}]", controller="adaptive")
    assert set(ended(ran).values()) == {("in tolerance", None)}
    assert failures(ran)["hand.no_flow"] == 1
    assert ran.session.cell.believed.barren == {}
    assert ran.session.cell.believed.yields.get("beads", 1.0) > 0.7, "nothing is no share of anything"


@pytest.mark.slow
def test_a_load_that_bridges_is_let_out_into_its_mortar_and_scooped_again(tmp_path: Path) -> None:
    recipe = RECIPE.replace("POLICY", "stop")
    ran = dry_run(tmp_path, recipe, plant=f"{__name__}:Bridges", controller="adaptive")
    assert set(ended(ran).values()) == {("in tolerance", None)}
    assert failures(ran)["hand.no_flow"] == 1
    kinds = [event["kind"] for event in read(ran.journal, "event") if event["kind"] in ("scoop", "returned")]
    assert kinds[:3] == ["scoop", "returned", "scoop"]


def test_a_stuck_valve_is_no_empty_cone_and_nothing_is_scooped_again(tmp_path: Path) -> None:
    faults = "faults: [{fault: valve.stuck_closed, at_pulse: 1}]"
    ran = dry_run(tmp_path, RECIPE.replace("POLICY", "stop"), faults=faults, controller="adaptive")
    assert (ran.sample("a").code, len(told(ran, "scoop"))) == ("hand.valve_stuck", 1)


@pytest.mark.slow
def test_of_a_mortar_that_holds_half_of_what_is_written_all_samples_are_dosed(tmp_path: Path) -> None:
    """It was given up after two strokes above its powder."""
    case = Case(tmp_path, "stop", part=0.5)
    assert {sample.verdict for sample in case.go().samples} == {"in tolerance"}


class Case:
    """A recipe on a lab of its own, whose mortars hold a `part` of what is written; answered by `answer`.

    Where they hold all, scoops bring nothing until their source is given up.
    """

    def __init__(self, folder: Path, policy: str, answer: str = "", part: float = 1.0) -> None:
        self._part = part
        self.lab = load_lab(make_lab(folder / "lab"))
        path = folder / "recipe.yaml"
        head = "sources:\n  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 20 g}\n"
        head += "  msg: {station: mortar_bay_2, container: agate_mortar, powder: monosodium_glutamate, amount: 8 g}\n"
        path.write_text(RECIPE.replace("POLICY", policy) + head)
        self.plan = make_plan(load_recipe(path, self.lab), self.lab)
        self._folder, self._answer = folder / "runs", answer
        self.session: Any = None

    def go(self, journal: Path | None = None) -> BatchResult:
        found = None
        if journal is not None:
            found = resumable(journal, checked_history(journal), self.plan, self.lab, accept_changes=False)
        simulation = DryRun(2, faults=parse_faults(NOTHING_COMES, "f.yaml") if self._part == 1.0 else None)
        options = Options(simulation, "adaptive", self._folder)
        self.session = Session(self.plan, self.lab, options, shared_planner(self.plan, self.lab), resumes=found)
        for source in ("beads", "msg") if self._part < 1.0 else ():
            self.session.world.ledger.masses_mg[in_source(source)] *= self._part
        if self._answer:
            self.session.cell.operator = Answers(self._answer)
        try:
            return self.session.run(BatchObserver())
        finally:
            self.session.close()


class Answers:
    """A person who says one thing wherever it is among the answers, and does what else is asked."""

    def __init__(self, answer: str) -> None:
        self._answer = answer

    def expect(self) -> None:
        pass

    def dismiss(self) -> None:
        pass

    def ask(self, question: str, choices: Sequence[str] = ("done",)) -> Steps[str]:
        yield from ()
        return self._answer if self._answer in choices else choices[0]


@pytest.mark.slow
def test_a_batch_that_stopped_for_an_empty_source_is_resumed_when_that_was_filled(tmp_path: Path) -> None:
    case = Case(tmp_path, "stop")
    stopped = case.go()
    assert (stopped.exit_code, stopped.is_complete) == (3, False)
    resumed = case.go(case.session.journal.path)
    assert {sample.verdict for sample in resumed.samples} == {"in tolerance"}


@pytest.mark.slow
def test_a_person_who_says_redo_has_looked_after_the_source(tmp_path: Path) -> None:
    case = Case(tmp_path, "ask", "redo")
    assert {sample.verdict for sample in case.go().samples} == {"in tolerance"}
    assert case.session.cell.believed.containers_used == {"alumina_crucible": 5}


@pytest.mark.slow
def test_the_last_of_a_large_dose_comes_out_of_a_fresh_load(tmp_path: Path) -> None:
    """Crystals of which the last third comes only shaken, in avalanches."""
    recipe = """
recipe: r
workflow: fill_crucible
sources:
  msg: {station: mortar_bay, container: agate_mortar, powder: monosodium_glutamate, amount: 20 g}
defaults: {source: msg, container: alumina_crucible, tolerance: 2 mg}
samples: [{id: a, mass: 2 g}]
on_failure: {otherwise: stop}
"""
    ran = dry_run(tmp_path, recipe, controller="adaptive", seed=6)
    assert set(ended(ran).values()) == {("in tolerance", None)}
    kinds = [event["kind"] for event in read(ran.journal, "event") if event["kind"] in ("scoop", "returned")]
    assert kinds == ["scoop", "returned", "scoop", "returned"]
    world, believed = ran.session.world, ran.session.cell.believed
    assert world is not None
    assert believed.sources_mg["msg"] == pytest.approx(world.masses_mg["source:msg"], abs=400.0)


def test_after_a_scoop_that_brought_nothing_the_next_one_goes_deeper_however_little_is_wanted(tmp_path: Path) -> None:
    """What the first has missed may be on the way of the next: with that little went beyond what was wanted."""
    recipe = """
recipe: r
workflow: fill_crucible
sources:
  msg: {station: mortar_bay, container: agate_mortar, powder: monosodium_glutamate, amount: 16 g}
defaults: {source: msg, container: alumina_crucible, tolerance: 2 mg}
leftover: discard
samples: [{id: a, mass: 100 mg}, {id: b, mass: 100 mg}]
"""
    faults = "faults: [{fault: scoop.nothing, sample: b}]"
    ran = dry_run(tmp_path, recipe, controller="adaptive", faults=faults)
    _, barren, next_one = (scoop["gap_mm"] for scoop in told(ran, "scoop"))
    assert next_one < barren - 0.5
    assert set(ended(ran).values()) == {("in tolerance", None)}


class Heaviest:
    """A plant that notes how much scoops have brought."""

    brought_mg: ClassVar[list[float]] = []

    class Yield(OurScoopYield):
        def collect(self, lifted_mg: float, there_mg: float, rng: Generator) -> float:
            Heaviest.brought_mg.append(super().collect(lifted_mg, there_mg, rng))
            return Heaviest.brought_mg[-1]

    def scoop(self, powder: Powder) -> OurScoopYield:
        return self.Yield(powder)


@pytest.mark.slow
def test_the_load_after_one_that_brought_nothing_keeps_the_limit_and_tells_no_larger_yield(tmp_path: Path) -> None:
    """Of titanium dioxide 5.4 g came of 4."""
    source = "  lot: {station: mortar_bay_2, container: agate_mortar, powder: titanium_dioxide, amount: 20 g}\n"
    samples = "samples: [{id: a, source: lot, mass: 2 g}]\n"
    text = f"recipe: r\nworkflow: fill_crucible\ndefaults: {{container: alumina_crucible, tolerance: 40 mg}}\n{samples}"
    faults = "faults: [{fault: scoop.nothing}]"
    plant = f"{__name__}:Heaviest"
    ran = dry_run(tmp_path, f"{text}sources:\n{source}", seed=3, controller="adaptive", faults=faults, plant=plant)
    assert ran.sample("a").verdict == "in tolerance"
    assert len(told(ran, "scoop")) >= 2
    assert 2000.0 < max(Heaviest.brought_mg) < 4000.0
    assert ran.session.cell.believed.yields.get("lot", 1.0) < 1.5
