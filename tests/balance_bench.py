"""Recipes that teach a run its balance, its journal, plans with limits, and simulated devices taken for real ones."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from running import Ran

from scuhand_bt.device_specs.balance import BalanceLimits
from scuhand_bt.journal.reader import read
from scuhand_bt.lab import Lab
from scuhand_bt.recipe.plan import Plan, make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.make_cell import Setup, set_up
from scuhand_bt.run.simulation import DryRun

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


def told(ran: Ran, kind: str) -> list[dict[str, Any]]:
    return [e["payload"] for e in read(ran.journal, "event") if e["kind"] == kind]


def plans_with(folder: Path, starter: Lab) -> Callable[..., tuple[Plan, Lab]]:
    """Makes plans of a recipe, with limits of its balance."""

    def make(recipe: str = RECIPE, **limits: Any) -> tuple[Plan, Lab]:
        balance = starter.cell.balance.model_copy(update={"limits": BalanceLimits(**limits)})
        lab = replace(starter, cell=starter.cell.model_copy(update={"balance": balance}))
        path = folder / "recipe.yaml"
        path.write_text(recipe)
        return make_plan(load_recipe(path, lab), lab), lab

    return make


def taken_for_real(plan: Plan, lab: Lab, simulation: object, *args: object, **more: object) -> Setup:
    made = set_up(plan, lab, DryRun(), *args, **more)  # type: ignore[arg-type]
    made.cell.simulated = simulation is not None
    return made
