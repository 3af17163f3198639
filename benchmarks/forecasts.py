"""What `plan` says of a run, held against runs on plants that no trial has had.

`python -m benchmarks.forecasts [--json FILE]`: recipes of beads, of crystals and of lumps, each foretold by a few dry
runs on the shipped physics and then run once on a plant of `harness.random_plants`, of seeds that nothing else has.
Said for each: whether the time that it took lies in the interval; and for all samples how probabilities and outcomes go
together: the Brier score, beside that of who says the overall rate of every sample, and a table of reliability.
"""

import argparse
import json
import tempfile
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.rig import shipped_powders
from harness.random_plants import RandomPlant, draw
from scuhand_bt.lab import load_lab, starter_lab
from scuhand_bt.recipe.plan import Plan, make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.study.dry_run import dry_run
from scuhand_bt.study.odds import COVERED, odds_of
from scuhand_bt.study.trial import Setup

PLANT = "harness.random_plants:RandomPlant"
SETS = {"foretold": 18, "foretold_again": 19, "foretold_anew": 20}
"""Of plants, and the seed that the recipes for each are drawn with."""
TRIALS = 8
BINS = (0.0, 0.5, 0.8, 0.9, 0.95, 1.0)
FAMILIES = {"beads": ("glass_beads", 12), "msg": ("monosodium_glutamate", 12), "lumps": ("titanium_dioxide", 12)}
"""Powder, and so many recipes."""
RESULTS = Path(__file__).with_name("forecasts_results.json")
HEAD = """recipe: foretold
workflow: {workflow}
sources:
  store: {{station: mortar_bay, container: agate_mortar, powder: {powder}, amount: 20 g}}
defaults: {{source: store}}
on_failure: {{otherwise: flag}}
samples:
"""
KINDS = (
    ("fill_xrd_holder", "xrd_holder", (20.0, 80.0), 2.0),
    ("fill_pellet_die", "pellet_die_13mm", (200.0, 500.0), 5.0),
    ("fill_crucible", "alumina_crucible", (500.0, 2000.0), 5.0),
)


def recipe_text(powder: str, number: int, rng: np.random.Generator) -> str:
    """Three to eight samples of one kind, with masses drawn."""
    workflow, container, ends_mg, tolerance_mg = KINDS[number % len(KINDS)]
    lines = [
        f"  - {{id: s{index}, container: {container}, mass: {rng.uniform(*ends_mg):.0f} mg, "
        f"tolerance: {tolerance_mg:g} mg}}"
        for index in range(int(rng.integers(3, 9)))
    ]
    return HEAD.format(workflow=workflow, powder=powder) + "\n".join(lines) + "\n"


def foretold(folder: Path, trials: int, seeds: str) -> Iterator[dict[str, Any]]:
    """Each recipe of a set: what was said of it, and what came."""
    lab = load_lab(starter_lab())
    rng = np.random.default_rng(SETS[seeds])
    for family, (powder, recipes) in FAMILIES.items():
        for number, drawn in enumerate(draw(family, shipped_powders(), recipes, seeds=seeds)):
            path = folder / f"{family}-{number}.yaml"
            path.write_text(recipe_text(powder, number, rng), encoding="utf-8")
            setup = Setup(path, lab.folder)
            plan: Plan = make_plan(load_recipe(path, lab), lab)
            odds = odds_of(plan, [dry_run(setup, seed) for seed in range(trials)])
            RandomPlant.at_hand = drawn
            came = dry_run(Setup(path, lab.folder, plant=PLANT), drawn.seed)
            said = odds.duration_s
            yield {
                "seeds": seeds,
                "recipe": path.stem,
                "said_s": [said.low, said.middle, said.high],
                "took_s": came.duration_s,
                "inside": said.low <= came.duration_s <= said.high,
                "samples": [(odds.samples[one.id].probability, one.good) for one in came.samples],
            }


def reliability(said: Sequence[float], came: Sequence[bool]) -> list[dict[str, float]]:
    """By ranges of the probability that was said: how many, what was said on average, and what came."""
    table = []
    for low, high in pairwise(BINS):
        among = [(p, good) for p, good in zip(said, came, strict=True) if low < p <= high]
        if among:
            p, good = np.mean(among, axis=0)
            table.append({"above": low, "samples": len(among), "said": float(p), "came": float(good)})
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=TRIALS)
    parser.add_argument("--json", type=Path, default=RESULTS)
    asked = parser.parse_args()
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for one in (one for seeds in SETS for one in foretold(Path(folder), asked.trials, seeds)):
            low, middle, high = one["said_s"]
            mark = "inside" if one["inside"] else "OUTSIDE"
            print(
                f"{one['recipe']:9} said {middle:6.0f} s ({low:.0f} to {high:.0f}), took {one['took_s']:6.0f} s: {mark}"
            )
            found.append(one)
    said, came = zip(*(pair for one in found for pair in one["samples"]), strict=True)
    score = float(np.mean(np.square(np.subtract(said, came))))
    rate = float(np.mean(came))
    values = {
        "trials": asked.trials,
        "covered": COVERED,
        "inside": sum(one["inside"] for one in found),
        "recipes": len(found),
        "brier": score,
        "brier_of_the_overall_rate": rate * (1.0 - rate),
        "reliability": reliability(said, came),
    }
    print(json.dumps(values, indent=2))
    asked.json.write_text(json.dumps({**values, "runs": found}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
