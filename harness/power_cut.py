"""Cut the power of a dry run again and again, and resume it: no dose may be called good that is not.

A child process is ended at a random tick, also while it resumes; then its simulated world loses what a power cut may
take (`outage.…`, docs/faults.md): the balance's zero, the roller's turns, powder from the cone, the container itself.
A run must end, or end safe and say why. What it calls in tolerance is held against the world's true masses.
"""

import math
import random
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path

from harness.kill import LOST_MG, Batch, at_ticks, journals, make_batch, run_child
from harness.kill import Kill as Cut
from scuhand_bt.journal.history import read_history
from scuhand_bt.journal.reader import read
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.sim.fault_rules import OUTAGES, parse_faults

RECIPE = """
recipe: power-cuts
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 20 g}
  salt: {station: mortar_bay_2, container: small_agate_mortar, powder: monosodium_glutamate, amount: 8 g}
workflow: fill_xrd_holder
defaults: {source: beads, container: xrd_holder, tolerance: 2 mg}
samples:
  - {id: small, mass: 20 mg}
  - {id: middle, mass: 80 mg}
  - {id: split, mass: 6 g, tolerance: 5 mg, container: alumina_crucible, workflow: fill_crucible}
  - {id: other, mass: 300 mg, tolerance: 5 mg, source: salt, container: pellet_die_13mm, workflow: fill_pellet_die}
on_failure: {container.changed: redo, container.missing: redo, otherwise: flag}
"""
LIKELY = 0.15
"""How likely each of the things that a power cut may do comes with one."""
TICKS = 400
TRIES = 8
"""So often a run that ended safe is resumed."""


@dataclass
class Tally:
    """What was seen."""

    cuts: int = 0
    while_dosing: int = 0
    batches: int = 0
    doses: int = 0
    good: int = 0
    flagged: Counter[str] = field(default_factory=Counter)
    """By failure code, or verdict."""
    came: Counter[str] = field(default_factory=Counter)
    """What the cuts have done."""
    given_up: int = 0
    """Containers that were found to be others, or changed."""
    stuck: Counter[str] = field(default_factory=Counter)
    """Batches that ended safe and stayed so, by their reason."""
    worst_error_mg: float = 0.0
    """Largest difference of a good dose's recorded mass from the true one."""
    worst_imbalance_mg: float = 0.0
    problems: list[str] = field(default_factory=list)


def make_power_batch(
    folder: Path, seed: int, motion: MotionPlanner | None = None, only: str = "", text: str = RECIPE
) -> Batch:
    """The batch, each of whose cuts may do anything; or always and alone `only` this."""
    folder.mkdir(parents=True, exist_ok=True)
    recipe = folder / "recipe.yaml"
    recipe.write_text(text, encoding="utf-8")
    rules = (
        [f"{{fault: {only}, probability: 1}}"] if only else [f"{{fault: {k}, probability: {LIKELY}}}" for k in OUTAGES]
    )
    faults = parse_faults("faults:\n" + "".join(f"  - {rule}\n" for rule in rules), "cuts")
    return replace(make_batch(recipe, folder / "runs", seed, motion), faults=faults)


def cut_until_done(batch: Batch, rng: random.Random, cuts: int, tally: Tally) -> None:
    """Run a batch, cutting its power on its way, then let it end, and judge what came of it."""
    begun: Path | None = None
    code: int | None = None
    for cut in at_ticks(rng, TICKS, cuts):
        code = run_child(batch, begun, cut)
        begun = begun or next(journals(batch.folder), None)
        if code is not None:
            break
        tally.cuts += 1
        if begun is not None:
            actions = read(begun, "action")
            tally.while_dosing += bool(actions) and (actions[-1]["skill"], actions[-1]["outcome"]) == (
                "dispense",
                "started",
            )
    for _ in range(TRIES):
        if begun is not None and read_history(begun).is_complete:
            break
        code = run_child(batch, begun, Cut())
        begun = begun or next(journals(batch.folder))
    assert begun is not None
    tally.batches += 1
    if code not in (0, 1, 3):
        tally.problems.append(f"seed {batch.seed}: ended with {code}")
    _judge(batch, begun, tally)


def _judge(batch: Batch, journal: Path, tally: Tally) -> None:
    history, events = read_history(journal), read(journal, "event")
    if not history.is_complete and history.ended is not None:
        tally.stuck[history.ended.reason.split(": ")[1] if ": " in history.ended.reason else "?"] += 1
    matter = [event["payload"] for event in events if event["kind"] == "matter"][-1]
    there_mg = sum(source.amount_mg for source in batch.plan.recipe.sources.values())
    imbalance_mg = abs(math.fsum(matter.values()) - there_mg)
    tally.worst_imbalance_mg = max(tally.worst_imbalance_mg, imbalance_mg)
    if imbalance_mg > LOST_MG:
        tally.problems.append(f"seed {batch.seed}: {imbalance_mg} mg lost or made")
    accounts = [event["payload"]["rules"] for event in events if event["kind"] == "fault_rules"]
    for rule in accounts[-1]:
        tally.came[rule["fault"]] += len(rule["came_s"])
    tally.given_up += sum(e["kind"] == "container_reweighed" and not e["payload"]["counts"] for e in events)
    results = {event["payload"]["id"]: event["payload"] for event in events if event["kind"] == "sample"}
    for result in results.values():
        tally.doses += 1
        code, verdict = result.get("code"), result["verdict"]
        if code is not None or verdict != "in tolerance":
            tally.flagged[code or verdict] += 1
            continue
        tally.good += 1
        error_mg = result["true_mg"] - result["target_mg"]
        tally.worst_error_mg = max(tally.worst_error_mg, abs(result["true_mg"] - result["dispensed_mg"]))
        if abs(error_mg) > result["tolerance_mg"]:
            tally.problems.append(
                f"seed {batch.seed}: {result['id']}: 'in tolerance' at {result['dispensed_mg']:.2f} mg, "
                f"{result['true_mg']:.2f} mg true of {result['target_mg']:g} ± {result['tolerance_mg']:g} mg"
            )
