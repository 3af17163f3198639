"""Worlds whose scoops bring less, or more, than the bed's geometry lifts: how well is the cone's content believed?

    python -m benchmarks.yields [--seeds 2] [--first 0] [--heel 0.2] [--json FILE]

A dry run of eight doses for each share, powder, mortar and seed. Each time a scoop has ended, and each time a dose has,
believed and true content of the cone are compared: off, as a share of what the scoop truly brought. The figures are of
the scoops and doses after the third dose of the lot, beside those of the first scoop. With `--heel`, powder that comes
only shaken at the end of a load does so from this share of it on, and not from the shipped one.
"""

import argparse
import importlib
import itertools
import json
import tempfile
import time
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.random import Generator
from py_trees.behaviour import Behaviour

from scuhand_bt.journal.results import SampleResult
from scuhand_bt.lab import Lab, load_lab, starter_lab
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.run.options import Options
from scuhand_bt.run.prepared_motion import prepared_motion
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun
from scuhand_bt.sim.powder import OurPowderFlow
from scuhand_bt.sim.scoop import OurScoopYield
from scuhand_bt.specs import Powder

RESULTS = Path(__file__).with_name("yields_results.json")
POWDERS = {"glass_beads": "5 mg", "monosodium_glutamate": "10 mg", "titanium_dioxide": "40 mg"}
"""And the tolerance of their doses: they are to end, and are not what is judged here."""
MORTARS = {"agate_mortar": ("20 g", "2 g"), "small_agate_mortar": ("12 g", "1 g")}
"""What is in it, and each dose."""
DOSES = 8
LEARNT_AFTER = 3
"""Doses of a lot after which its scoops are to be known."""
RECIPE = """
recipe: yields
workflow: fill_crucible
sources:
  lot: {{station: mortar_bay_2, container: {mortar}, powder: {powder}, amount: {amount}}}
defaults: {{source: lot, container: alumina_crucible, mass: {mass}, tolerance: {tolerance}}}
samples: [{samples}]
on_failure: {{otherwise: skip_sample}}
"""


class Shares:
    """A plant whose scoops bring this share of what the bed's geometry lifts."""

    share: ClassVar[float] = 1.0
    heel: ClassVar[float | None] = None

    class Yield(OurScoopYield):
        def __init__(self, powder: Powder, share: float) -> None:
            super().__init__(powder)
            self._share = share

        def collect(self, lifted_mg: float, there_mg: float, rng: Generator) -> float:
            return min(there_mg, self._share * super().collect(lifted_mg, there_mg, rng))

    def scoop(self, powder: Powder) -> OurScoopYield:
        return self.Yield(powder, self.share)

    def flow(self, powder: Powder) -> OurPowderFlow:
        if self.heel is not None and powder.simulation.heel > 0.0:
            simulation = powder.simulation.model_copy(update={"heel": self.heel})
            powder = powder.model_copy(update={"simulation": simulation})
        return OurPowderFlow(powder)


class Third(Shares):
    share = 0.35


class Half(Shares):
    share = 0.5


class Double(Shares):
    share = 2.0


PLANTS = (Third, Half, Shares, Double)


class Watching(BatchObserver):
    """Compares what the cone is believed to hold with what it does."""

    def __init__(self) -> None:
        self.session: Session
        self.scoops: list[tuple[int, float, float]] = []
        """Doses before it, believed and true content [mg] after it."""
        self.doses: list[tuple[int, float, float]] = []
        """Doses with it, believed and true content after it, as shares of what the last scoop brought."""
        self.results: list[SampleResult] = []
        self._strokes = 0

    def ticked(self, root: Behaviour) -> None:
        # What a load's scoops should have brought grows without one, too, as what the last stroke had missed is found.
        strokes = sum(map(len, self.session.cell.strokes_made.values()))
        if strokes > self._strokes:
            self.scoops.append((len(self.doses), *self._contents_mg()))
        self._strokes = strokes

    def sample_ended(self, result: SampleResult) -> None:
        if result.id in {one.id for one in self.results}:
            return  # again, as its container has gone
        self.results.append(result)
        if result.verdict == "in tolerance" and self.scoops:
            believed_mg, true_mg = self._contents_mg()
            brought_mg = max(self.scoops[-1][2], 1.0)
            self.doses.append((len(self.doses) + 1, believed_mg / brought_mg, true_mg / brought_mg))

    def _contents_mg(self) -> tuple[float, float]:
        world = self.session.world
        assert world is not None
        return self.session.cell.believed.cone_mg, world.masses_mg["cone"]


def one(
    lab: Lab, plant: type[Shares], powder: str, mortar: str, seed: int, motion: MotionPlanner | None
) -> tuple[dict[str, Any], MotionPlanner]:
    """A run's figures, and the planner that it was made with."""
    amount, mass = MORTARS[mortar]
    with tempfile.TemporaryDirectory() as folder:
        recipe = Path(folder) / "recipe.yaml"
        samples = ", ".join(f"{{id: s{number}}}" for number in range(DOSES))
        tolerance = POWDERS[powder]
        recipe.write_text(
            RECIPE.format(mortar=mortar, powder=powder, amount=amount, mass=mass, tolerance=tolerance, samples=samples)
        )
        plan = make_plan(load_recipe(recipe, lab), lab)
        motion = motion or prepared_motion(plan, lab)
        watching = Watching()
        name = f"benchmarks.yields:{plant.__name__}"
        session = Session(plan, lab, Options(DryRun(seed, name), "adaptive", Path(folder) / "runs"), motion)
        watching.session = session
        session.run(watching)
        world = session.world
        assert world is not None
        left_mg, spilled_mg = world.masses_mg["source:lot"], world.masses_mg["spilled"]
        session.close()
    off = [abs(believed / max(true, 1.0) - 1) for _, believed, true in watching.scoops]
    later = [share for share, (doses, _, _) in zip(off, watching.scoops, strict=True) if doses >= LEARNT_AFTER]
    ends = [abs(believed - true) for doses, believed, true in watching.doses if doses > LEARNT_AFTER]
    codes = [sample.code for sample in watching.results if sample.verdict != "in tolerance"]
    return {
        "first_scoop_off": off[0],
        "later_scoops_off": later,
        "later_doses_off": ends,
        "heaviest_mg": max(true for _, _, true in watching.scoops),
        "scoops": len(watching.scoops),
        "lost": codes,
        "left_mg": left_mg,
        "spilled_mg": spilled_mg,
    }, motion


def row_of(runs: list[dict[str, Any]], took_s: float) -> dict[str, Any]:
    """The runs of one case, their scoops together."""
    scoops, doses = ([share for run in runs for share in run[key]] for key in ("later_scoops_off", "later_doses_off"))
    return {
        "seeds": len(runs),
        "took_s": round(took_s),
        "first_scoop_off": round(float(np.mean([run["first_scoop_off"] for run in runs])), 3),
        "later_scoops": len(scoops),
        "later_scoops_off": round(float(np.mean(scoops)), 3) if scoops else None,
        "later_doses_off": round(float(np.mean(doses)), 3) if doses else None,
        "heaviest_mg": round(max(run["heaviest_mg"] for run in runs)),
        "scoops": sum(run["scoops"] for run in runs),
        "lost": sorted(str(code) for run in runs for code in run["lost"]),
        "left_mg": [round(run["left_mg"]) for run in runs],
        "spilled_mg": round(max(run["spilled_mg"] for run in runs), 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--heel", type=float)
    parser.add_argument("--only", default="", help="cases whose names have this in them, beside those the file has")
    parser.add_argument("--json", type=Path, default=RESULTS)
    given = parser.parse_args()
    importlib.import_module("benchmarks.yields").Shares.heel = given.heel  # where runs find their plants
    lab, motions = load_lab(starter_lab()), dict[str, MotionPlanner]()
    table: dict[str, Any] = json.loads(given.json.read_text()) if given.only and given.json.exists() else {}
    for mortar, powder, plant in itertools.product(MORTARS, POWDERS, PLANTS):
        name = f"{mortar}, {powder}, {plant.share:g}"
        if given.only not in name:
            continue
        runs, began_s = [], time.monotonic()
        for seed in range(given.first, given.first + given.seeds):
            found, motions[mortar] = one(lab, plant, powder, mortar, seed, motions.get(mortar))
            runs.append(found)
        table[name] = row_of(runs, time.monotonic() - began_s)
        print(name, table[name], flush=True)
        lines = ",\n".join(f"{json.dumps(case)}: {json.dumps(row)}" for case, row in table.items())
        given.json.write_text(f"{{\n{lines}\n}}\n")


if __name__ == "__main__":
    main()
