"""Runs of hostile worlds, and what came of their doses: by the world's true masses alone.

A container that is reported good and is not within its tolerance is a false good. What is true is asked when the run
has ended, of the container that the sample ended in: what fell into it or out of it after its result counts.
"""

import math
import tempfile
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from harness.bench import Bench, HostilePlant
from harness.worlds import HostileWorld
from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.journal.reader import open_contents
from scuhand_bt.journal.results import SampleResult
from scuhand_bt.lab import Lab, load_lab, starter_lab
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.recipe.plan import Plan, make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.recipe.sample import Sample
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.run.options import Options
from scuhand_bt.run.prepared_motion import prepared_motion
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun
from scuhand_bt.sim.fault_rules import parse_faults
from scuhand_bt.sim.mass_ledger import in_container
from scuhand_bt.sim.world import World

MARGIN_MG = 0.1
"""A true error is beyond its tolerance when it is more than this beyond: the last digit of the balance."""
SHIPPED = ("xrd_holders", "pellet_dies", "crucibles")
SHORT = """\
recipe: short
workflow: scoop_and_dispense
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 25 g}
  msg: {station: mortar_bay_2, container: agate_mortar, powder: monosodium_glutamate, amount: 20 g}
defaults: {tolerance: 2 mg}
samples:
"""
FLAGS = (
    "on_failure: {dose.overshoot: flag, dose.not_reached: flag, hand.no_flow: skip_sample, otherwise: skip_sample}\n"
    "overshoot_limit: 0\n"
)
OWN = {
    "short": SHORT
    + """\
  - {id: b-xrd, source: beads, container: xrd_holder, mass: 35 mg, workflow: fill_xrd_holder, repeat: 2}
  - {id: b-pellet, source: beads, container: pellet_die_13mm, mass: 500 mg, tolerance: 5 mg, workflow: fill_pellet_die}
  - {id: b-crucible, source: beads, container: alumina_crucible, mass: 2 g, tolerance: 5 mg, workflow: fill_crucible}
  - {id: m-xrd, source: msg, container: xrd_holder, mass: 50 mg, workflow: fill_xrd_holder, repeat: 2}
  - {id: m-pellet, source: msg, container: pellet_die_13mm, mass: 500 mg, tolerance: 5 mg, workflow: fill_pellet_die}
"""
    + FLAGS,
    "msg-once": SHORT + "  - {id: msg-1, source: msg, container: pellet_die_13mm, mass: 500 mg}\n" + FLAGS,
    "msg-3g": SHORT + "  - {id: msg-1, source: msg, container: alumina_crucible, mass: 3 g}\n" + FLAGS,
    "redone": SHORT
    + "  - {id: again, source: msg, container: xrd_holder, mass: 30 mg, repeat: 5}\non_failure: {otherwise: redo}\n",
}
RECIPES = (*SHIPPED, *OWN)


@dataclass(frozen=True)
class FalseGood:
    """A container that was reported good."""

    recipe: str
    seed: int
    sample: str
    target_mg: float
    tolerance_mg: float
    dispensed_mg: float | None
    uncertainty_mg: float | None
    true_mg: float


@dataclass
class Tally:
    """What came of one world's doses."""

    world: str
    doses: int = 0
    """Samples that were begun."""
    good: int = 0
    """Reported good, and truly so."""
    false_goods: list[FalseGood] = field(default_factory=list)
    false_zeros: list[str] = field(default_factory=list)
    """Runs with exit code 0 that left a container out of tolerance."""
    flagged: Counter[str] = field(default_factory=Counter)
    """Doses that were reported as not good, by their code, or verdict."""
    failed: Counter[str] = field(default_factory=Counter)
    """Samples without a dose, likewise."""
    good_flagged: int = 0
    """Doses flagged though they were truly in tolerance."""
    ends: Counter[int] = field(default_factory=Counter)
    """Runs by their exit code."""
    broken: list[str] = field(default_factory=list)
    """Runs that ended in a bug."""
    duration_s: float = 0.0
    """The sum over all that was dispensed, in the world's time."""
    true_error_mg: float = 0.0
    """The sum of the true errors of all that was dispensed, without signs."""

    @property
    def seconds_per_dose(self) -> float:
        """What a dose takes; NaN without any."""
        dispensed = self.doses - self.failed.total()
        return self.duration_s / dispensed if dispensed else math.nan

    @property
    def worst_mg(self) -> float:
        """The largest error beyond its tolerance that was reported good."""
        beyond = [abs(false.true_mg - false.target_mg) - false.tolerance_mg for false in self.false_goods]
        return max(beyond, default=0.0)

    def values(self) -> dict[str, Any]:
        """For JSON."""
        return vars(self) | {"false_goods": [asdict(false) for false in self.false_goods], "worst_mg": self.worst_mg}

    def note(self, recipe: str, seed: int, sample: Sample, result: SampleResult, true_mg: float) -> bool:
        """Count a sample; whether it is truly within its tolerance."""
        target_mg, tolerance_mg = sample.mass_mg, sample.tolerance_mg
        assert target_mg is not None
        assert tolerance_mg is not None
        is_true = abs(true_mg - target_mg) <= tolerance_mg + MARGIN_MG
        if result.verdict == "not run":
            return is_true
        self.doses += 1
        if result.dispensed_mg is not None:
            self.duration_s += result.duration_s
            self.true_error_mg += abs(true_mg - target_mg)
        if result.is_good and is_true:
            self.good += 1
        elif result.is_good:
            told = result.dispensed_mg, result.uncertainty_mg
            self.false_goods.append(FalseGood(recipe, seed, sample.id, target_mg, tolerance_mg, *told, true_mg))
        else:
            (self.failed if result.dispensed_mg is None else self.flagged)[result.code or result.verdict] += 1
            self.good_flagged += is_true and result.dispensed_mg is not None
        return is_true


class Falsifier:
    """Runs recipes in hostile worlds; the plans are made, and their motions planned, once."""

    def __init__(self, folder: Path, recipes: Sequence[str] = RECIPES, controller: str | None = None) -> None:
        self._folder, self._controller = folder, controller
        self._lab: Lab = load_lab(starter_lab())
        self._made: Mapping[str, tuple[Plan, MotionPlanner]] = {name: self._make(name) for name in recipes}

    def run(self, world: HostileWorld, doses: int, first_seed: int = 0) -> Tally:
        """Every recipe with seed after seed, until so many doses were begun, or so many runs have begun hardly any."""
        tally, seed, runs = Tally(world.name), first_seed, 0
        while tally.doses < doses and runs < max(len(self._made), doses):
            for recipe in self._made:
                self.run_once(world, recipe, seed, tally)
                runs += 1
                if tally.doses >= doses:
                    break
            seed += 1
        return tally

    def run_once(self, world: HostileWorld, recipe: str, seed: int, tally: Tally) -> None:
        """One run of one recipe, into the tally."""
        plan, motion = self._made[recipe]
        bench = Bench(list(world.ills()), np.random.default_rng([seed, zlib.crc32(f"{world.name} {recipe}".encode())]))
        faults = parse_faults(f"faults: [{world.faults}]", world.name) if world.faults is not None else None
        plant = f"{HostilePlant.__module__}:{HostilePlant.__name__}"
        HostilePlant.at_hand = bench
        with tempfile.TemporaryDirectory(dir=self._folder) as runs:
            simulation = DryRun(seed, plant, faults=faults)
            session = Session(plan, self._lab, Options(simulation, self._controller, Path(runs) / "runs"), motion)
            try:
                bench.attach(session)
                result = session.run(BatchObserver())
            finally:
                session.close()
            if result.exit_code == ExitCode.CELL_FAULT and _is_broken(session.journal.path):
                tally.broken.append(f"{recipe}, seed {seed}: {result.reason}")
        assert session.world is not None
        tally.ends[result.exit_code] += 1
        results = {sample.id: sample for sample in result.samples}
        are_true = [
            tally.note(recipe, seed, sample, results[sample.id], true_mass_mg(session.world, sample))
            for sample in plan.recipe.samples
        ]
        if result.exit_code == 0 and not all(are_true):
            tally.false_zeros.append(f"{recipe}, seed {seed}")

    def _make(self, name: str) -> tuple[Plan, MotionPlanner]:
        path = starter_lab() / "recipes" / f"{name}.yaml"
        if name in OWN:
            path = self._folder / f"{name}.yaml"
            path.write_text(OWN[name], encoding="utf-8")
        plan = make_plan(load_recipe(path, self._lab), self._lab)
        return plan, prepared_motion(plan, self._lab)


def _is_broken(journal: Path) -> bool:
    """Whether a bug ended the run, and no failure that has a code."""
    with open_contents(journal) as contents:
        jobs, events = contents.rows("job"), contents.rows("event")
    return any(job["outcome"] == "broken" for job in jobs) or any(event["kind"] == "broken" for event in events)


def true_mass_mg(world: World, sample: Sample) -> float:
    """What is in the container that a sample ended in: its second one, if it was redone."""
    assert sample.container is not None
    again = f"{sample.container.id}#2"
    return world.true_mass(again if in_container(again) in world.ledger.masses_mg else sample.container.id)
