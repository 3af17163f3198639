"""A whole commissioning in one go on wire twins, from factory state to the first dose, with a scripted person.

    python -m benchmarks.commissioning [--seed 1] [--json FILE]

In real time, some ten minutes: every step in its order as `scuhand-bt commission` has it, and both runs in single step
at half speed. Then the real apex is looked at where the first dose began, and what was found is held against how the
cell was built (`harness/factory_cell.py`).
"""

import argparse
import json
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from harness.factory_cell import Factory, from_factory
from scuhand_bt.cell.places import over_balance
from scuhand_bt.commissioning.guide import carry_out
from scuhand_bt.commissioning.record import Record
from scuhand_bt.commissioning.step import NotFound
from scuhand_bt.commissioning.steps import next_step
from scuhand_bt.failures import SkillFailed
from scuhand_bt.lab import load_lab, state_folder
from scuhand_bt.motion.kinematics import Mount, apex
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.hands import check_weight
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.run.operator import Person
from scuhand_bt.run.options import Options
from scuhand_bt.run.questions import Who
from scuhand_bt.run.session import Session
from scuhand_bt.specs import Container

SLOW_RATIO = 0.5
RUNS = {"balance": "start_of_day", "first_dose": "first_dose"}
TRIES = 6
"""A step or a run that a busy computer has ended is begun again."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    began_s = time.monotonic()
    with tempfile.TemporaryDirectory() as folder, from_factory(Path(folder), 30_000.0) as factory:
        factory.hands.rng = np.random.default_rng(given.seed)
        said = commissioned(factory)
        said["took_s"] = round(time.monotonic() - began_s)
    print(json.dumps(said, indent=1))
    if given.json:
        given.json.write_text(json.dumps(said, indent=1) + "\n", encoding="utf-8")
    sys.exit(said["apex_off_mm"] > 1.0 or said["dose_error_mg"] > 5.0)


def commissioned(factory: Factory) -> dict[str, Any]:
    """Go through all steps; what was found, beside what is true."""
    said: dict[str, Any] = {"steps": {}, "again": []}
    tried: dict[str, int] = {}
    while (step := next_step(Record(state_folder(factory.lab)).last(simulated=True), factory.lab.cell)) is not None:
        tried[step.name] = tried.get(step.name, 0) + 1
        print(f"{step.name} …", file=sys.stderr, flush=True)
        if step.name in RUNS:
            said |= _run(factory, RUNS[step.name])
        try:
            done = carry_out(step, factory.site())
            assert done is not None
            said["steps"][step.name] = dict(done.found)
        except (NotFound, SkillFailed) as error:
            said["again"].append(f"{step.name}: {error}")
            print(f"  {error}", file=sys.stderr, flush=True)
            if tried[step.name] >= TRIES:
                raise
    found, true = factory.lab.cell, factory.truth.cell
    wanted = np.interp(
        [p.opening_mm for p in true.hand.options.valve_map],
        [p.opening_mm for p in found.hand.options.valve_map],
        [p.count for p in found.hand.options.valve_map],
    )
    counts_per_mm = np.ptp([p.count for p in true.hand.options.valve_map]) / true.hand.options.valve_map[-1].opening_mm
    off = (wanted - [p.count for p in true.hand.options.valve_map]) / counts_per_mm
    said["valve_shut_beyond_zero_mm"] = round(-float(off[0]), 3)
    said["yaw_off_deg"] = round(found.frames["balance"].yaw_deg - true.frames["balance"].yaw_deg, 3)
    said["roller_deg_per_mm"] = [found.hand.roller_deg_per_mm, true.hand.roller_deg_per_mm]
    return said


def _run(factory: Factory, recipe: str) -> dict[str, Any]:
    """One recipe in single step, slow; the real apex over the container when it first stood there to dose."""
    lab = load_lab(factory.lab_folder)
    plan = make_plan(load_recipe(lab.folder / "recipes" / f"{recipe}.yaml", lab), lab)
    for source in plan.recipe.sources.values():  # the steps before have used what there was
        factory.bench.world.refill("beads", source.amount_mg)
    options = Options(None, single_step=True, slow_ratio=SLOW_RATIO, person=Person("Ada"))
    session = Session(plan, lab, options)
    seen: dict[str, Any] = {}
    threading.Thread(target=_answer, args=(factory, session, seen), daemon=True).start()
    try:
        result = session.run(BatchObserver())
    finally:
        session.close()
    ends = [(sample.verdict, sample.code, sample.detail, sample.dispensed_mg) for sample in result.samples]
    print(f"  {recipe}: {result.exit_code} {ends}", file=sys.stderr, flush=True)
    for sample in result.samples:
        if sample.dispensed_mg is not None and sample.target_mg is not None:
            true_mg = factory.bench.world.masses_mg[f"container:{seen['container']}"]
            seen["dose_error_mg"] = round(abs(true_mg - sample.target_mg), 2)
            seen["dose_true_mg"] = round(true_mg, 2)
    return seen


def _answer(factory: Factory, session: Session, seen: dict[str, Any]) -> None:
    questions, world, library = session.control.questions, factory.bench.world, factory.lab.library
    samples = {s.id: s.container for s in session.plan.recipe.samples if s.container is not None}
    while True:
        time.sleep(0.05)
        if (asked := questions.waiting) is None:
            continue
        text = asked.text
        if text.startswith("Next: dispense") and "apex_off_mm" not in seen:
            container = next(iter(samples.values()))
            true_mm = np.array(over_balance(factory.truth.cell, library.containers[container.name])[1])
            there = apex(factory.bench.arm.joints, Mount.of(factory.truth.cell.hand)).position_m
            seen["apex_off_mm"] = round(float(np.linalg.norm(1e3 * there - true_mm)), 3)
        elif text.startswith("Put the ") and "'" in text and "weight" not in text:
            name = text.split("'")[1]
            kind = text.removeprefix("Put the ").split(" '")[0]
            world.remove()
            seen["container"] = f"{name}, {len(world.masses_mg)}"  # a clean one in each run
            world.place(Container.model_validate({**library.containers[kind].model_dump(), "id": seen["container"]}))
        elif "weight" in text and text.startswith("Put"):
            world.remove()
            world.place(check_weight(20_000.0))
        elif text.startswith("Take"):
            world.remove()
        elif "mount the sheet again" in text:
            world.swap_sheet()
        questions.give(asked.number, asked.choices[0], Who("Ada"))


if __name__ == "__main__":
    main()
