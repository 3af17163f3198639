"""A bench on which several go on at once in one simulated cell, and dry runs of a lab of one's own."""

import math
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from running import shared_planner, simulated_bench

from scuhand_bt.cell.places import all_places, over_balance
from scuhand_bt.clock import Steps, Wake
from scuhand_bt.lab import Lab
from scuhand_bt.motion import ApexPose, MotionPlanner
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.clock import VirtualClock
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.run.options import Options
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun
from scuhand_bt.sim.fault_rules import parse_faults
from scuhand_bt.specs import Source

ARM, CHANGER = object(), object()
"""Who has the arm, and who the changer and the pan."""
AT_MOST_S = 300.0


def starter_motion(starter: Lab) -> MotionPlanner:
    """The starter lab's planner with its stations and the place over a holder."""
    mortar = starter.library.mortars["agate_mortar"]
    planner = starter.motion_planner({"mortar_bay": mortar, "mortar_bay_2": mortar})
    sources = {
        name: Source.model_construct(name=name, station=name, mortar=mortar) for name in ("mortar_bay", "mortar_bay_2")
    }
    holder = starter.library.containers["xrd_holder"]
    for name, position_mm in all_places(starter.cell, sources, [holder]).items():
        planner.add_place(name, ApexPose(np.array(position_mm) / 1000))
    return planner


class Bench:
    """A simulated cell on which several go on at once."""

    def __init__(self, lab: Lab, motion: MotionPlanner, sources: Mapping[str, Source] = {}) -> None:
        self.clock = VirtualClock()
        self.cell, self.world = simulated_bench(lab, motion, self.clock, sources)
        self.way = self.cell.right_of_way
        self.way.commands["arm"] = ARM
        self.over = over_balance(lab.cell, lab.library.containers["xrd_holder"])[0]
        self.seen: list[tuple[float, bool, bool]] = []
        """At every step: when, whether the arm moves, whether it is in the zone."""

    def have_the_pan(self) -> None:
        self.way.commands["changer"] = CHANGER
        self.way.enter(["pan"], CHANGER)

    def later(self, after_s: float, then: Callable[[], None]) -> Steps[None]:
        end_s = self.clock.now_s + after_s
        while self.clock.now_s < end_s:
            yield Wake(end_s)
        then()

    def do(self, *several: Steps[Any]) -> list[Any]:
        """Carry them out side by side; what each has given."""
        going = {number: (steps, Wake(0.0)) for number, steps in enumerate(several)}
        given: dict[int, Any] = {}
        while going:
            assert self.clock.now_s < AT_MOST_S
            for number, (steps, wake) in list(going.items()):
                if not (wake.has_fired or self.clock.now_s >= wake.until_s):
                    continue
                try:
                    going[number] = steps, next(steps)
                except StopIteration as end:
                    given[number] = end.value
                    del going[number]
            is_in = "pan" in self.cell.zones_entered()
            self.seen.append((self.clock.now_s, not self.cell.arm.is_stopped, is_in))
            if going:
                self.clock.wait([Wake(self.clock.now_s + 0.1), *(wake for _, wake in going.values())])
        return [given[number] for number in range(len(several))]


def scooping_bench(
    starter: Lab,
    motion: MotionPlanner,
    station: str = "mortar_bay",
    mortar: str = "agate_mortar",
    amount_mg: float = 20_000.0,
) -> tuple[Bench, Source]:
    """A cell with beads in a mortar."""
    library = starter.library
    source = Source.model_construct(
        name="beads",
        station=station,
        container=mortar,
        mortar=library.mortars[mortar],
        powder=library.powders["glass_beads"],
        amount_mg=amount_mg,
        lot="1",
    )
    bench = Bench(starter, motion, {"beads": source})
    bench.cell.believed.source_holds("beads", amount_mg)
    bench.cell.places_mm = all_places(starter.cell, bench.cell.sources, [])
    return bench, source


def first_headings_deg(lab: Lab, station: str, strokes: int) -> list[float]:
    """Those of the first strokes in a mortar there, where the arm can make all of them."""
    (x_mm, y_mm, _), skill = lab.cell.stations[station].position_mm, lab.library.skills["scoop"]
    turns_deg = vars(sys.modules[skill.__module__])["HEADINGS_DEG"][:strokes]
    return [(math.degrees(math.atan2(y_mm, x_mm)) + turn_deg) % 360.0 for turn_deg in turns_deg]


RECIPE = """
recipe: two
workflow: fill_crucible
sources: {beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 20 g}}
defaults: {source: beads, container: alumina_crucible, tolerance: 10 mg}
samples:
  - {id: a, mass: 500 mg}
on_failure: {otherwise: skip_sample}
"""


def run_dry(folder: Path, lab: Lab, faults: str = "", recipe: str = RECIPE) -> tuple[Any, Path]:
    path = lab.folder / "recipes" / "two.yaml"
    path.parent.mkdir(exist_ok=True)
    path.write_text(recipe, encoding="utf-8")
    plan = make_plan(load_recipe(path, lab), lab)
    wrong = parse_faults(faults, "faults") if faults else None
    session = Session(plan, lab, Options(DryRun(1, faults=wrong), folder=folder), shared_planner(plan, lab))
    try:
        ran = session.run(BatchObserver())
    finally:
        session.close()
    (journal,) = folder.glob("*.sqlite")
    return ran, journal
