"""The fault matrix: one recipe, and what comes of every fault at every moment of it.

Every fault at three moments of a dose (on the way to the container, in the middle of dispensing, while the rest
is returned) of a batch with two powders. A run must recover, or end safe with the right code; no run may end with
an open valve, a vibrating motor or a moving arm, in a traceback, or with a verdict that the world contradicts.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from harness.verdicts import is_untrue
from scuhand_bt.failures import Code
from scuhand_bt.journal.reader import open_contents
from scuhand_bt.journal.results import SampleResult
from scuhand_bt.lab import Lab, load_lab, starter_lab
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.recipe.plan import Plan, make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.run.options import Options
from scuhand_bt.run.prepared_motion import prepared_motion
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun
from scuhand_bt.sim.fault_rules import KINDS, OUTAGES, parse_faults

RECIPE = """\
recipe: matrix
workflow: scoop_and_dispense
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 12 g}
  msg: {station: mortar_bay_2, container: small_agate_mortar, powder: monosodium_glutamate, amount: 6 g}
defaults: {container: pellet_die_13mm, tolerance: 5 mg}
samples:
  - {id: first, source: beads, mass: 300 mg}
  - {id: second, source: msg, mass: 100 mg}
"""
MOMENTS = {"approach": "move_over", "dosing": "dispense", "return": "return_leftover"}
"""The moments, each in the middle of the first action of a skill."""
FAULTS = [name for name in KINDS if name not in OUTAGES]
"""Those that come while a run goes on."""
RECOVERS = "recovers"
CODES: Mapping[str, set[str]] = {
    "balance.silent": {"device.lost"},
    "balance.garbage": {RECOVERS, "device.lost"},
    "balance.bit_flips": {RECOVERS},
    "balance.restarted": {RECOVERS, "container.moved", "container.changed", "device.lost"},
    "balance.unstable": {"balance.unstable"},
    "balance.overload": {"balance.overload"},
    "balance.drifting": {"balance.unstable", "hand.leak"},
    "balance.draught": {RECOVERS, "balance.unstable", "dose.overshoot"},
    "valve.stuck_open": {"hand.valve_stuck", "dose.runaway"},
    "valve.stuck_closed": {"hand.valve_stuck"},
    "valve.slow": {RECOVERS, "dose.overshoot"},
    "vibration.dead": {RECOVERS, "hand.no_flow"},
    "powder.clog": {RECOVERS, "dose.overshoot"},
    "cone.leak": {"balance.unstable", "hand.leak"},
    "servo.overheat": {"servo.overload"},
    "servo.overload": {"servo.overload"},
    "servo.not_following": {"arm.not_following"},
    "arm.lost": {"device.lost"},
    "arm.no_power": {"arm.limp"},
    "valve.no_power": {"hand.valve_lost"},
    "hand.emergency_stop": {"device.emergency_stop"},
    "hand.lost": {"device.lost"},
    "scoop.nothing": {RECOVERS},
    "container.wrong": {"container.wrong_mass"},
    "operator.refuses": {"operator.refused"},
}
"""What a fault may come to: codes, or recovery."""
CANNOT_CLOSE = ("valve.stuck_open", "valve.no_power")


@dataclass(frozen=True)
class Outcome:
    """What came of one run: `wrong` is empty if it was as it should be."""

    fault: str
    moment: str
    seed: int
    exit_code: int
    code: str
    detail: str
    wrong: tuple[str, ...]


class Matrix:
    """Runs one recipe again and again, with one fault each."""

    def __init__(self, folder: Path, recipe: str = RECIPE, controller: str = "adaptive") -> None:
        path = folder / "matrix.yaml"
        path.write_text(recipe, encoding="utf-8")
        self._lab: Lab = load_lab(starter_lab())
        self._plan: Plan = make_plan(load_recipe(path, self._lab), self._lab)
        self._motion: MotionPlanner = prepared_motion(self._plan, self._lab)
        self._folder, self._controller = folder, controller

    def moments(self, seed: int) -> dict[str, float]:
        """When the moments are in a run in which nothing goes wrong [s]."""
        session = self._session(seed, None)
        try:
            assert session.run(BatchObserver()).exit_code == 0
        finally:
            session.close()
        with open_contents(session.journal.path) as contents:
            actions = contents.rows("action")
        times = {}
        for moment, skill in MOMENTS.items():
            first = next(row for row in actions if row["skill"] == skill)
            times[moment] = (first["started_s"] + first["ended_s"]) / 2.0
        return times

    def run(self, fault: str, moment: str, at_s: float, seed: int) -> Outcome:
        """One run with this fault at this time."""
        session = self._session(seed, f"faults: [{{fault: {fault}, at: {at_s:.3f} s}}]")
        try:
            result = session.run(BatchObserver())
        finally:
            session.close()
        # A run that ends early leaves its last container on the pan: that says nothing of the fault.
        codes = [sample.code for sample in result.samples if sample.code not in (None, Code.BALANCE_BRACKET_OPEN)]
        code = codes[0] or "" if codes else ""
        if not code and result.reason:
            code = next((word.strip(":;") for word in result.reason.split() if "." in word.strip(".:;")), "?")
        wrong = [*_unsafe(session, fault), *_untrue(result.samples), *self._lost(session)]
        if (code or RECOVERS) not in CODES[fault]:
            wrong.append(f"ended as {code or RECOVERS}, not as {' or '.join(sorted(CODES[fault]))}")
        if result.exit_code not in ((0, 1) if not code else (1, 3)):
            wrong.append(f"exit code {result.exit_code}")
        if session.unused_rules:
            wrong.append("the fault never came")
        with open_contents(session.journal.path) as contents:
            wrong += ["a traceback"] * sum(event["kind"] == "broken" for event in contents.rows("event"))
        return Outcome(fault, moment, seed, result.exit_code, code or RECOVERS, result.reason, tuple(wrong))

    def _lost(self, session: Session) -> Iterator[str]:
        """Powder that is nowhere."""
        assert session.world is not None
        was_mg = sum(source.amount_mg for source in self._plan.recipe.sources.values())
        if abs(session.world.ledger.total_mg - was_mg) > 1e-6:
            yield f"of {was_mg:.1f} mg of powder {session.world.ledger.total_mg:.1f} mg are left"

    def _session(self, seed: int, faults: str | None) -> Session:
        simulation = DryRun(seed, faults=parse_faults(faults, "matrix") if faults is not None else None)
        return Session(
            self._plan, self._lab, Options(simulation, self._controller, self._folder / "runs"), self._motion
        )


def _unsafe(session: Session, fault: str) -> Iterator[str]:
    """What moves, is open or vibrates after the end."""
    hand, arm, world = session.cell.hand, session.cell.arm, session.world
    assert world is not None
    if world.is_open and fault not in CANNOT_CLOSE:
        yield "the valve is open"
    if hand.vibration:  # type: ignore[attr-defined]
        yield "the motor vibrates"
    if not arm.is_stopped:
        yield "the arm moves"


def _untrue(samples: tuple[SampleResult, ...]) -> Iterator[str]:
    """Verdicts that the true mass contradicts, beyond the measurement's own uncertainty."""
    for sample in samples:
        if is_untrue(sample):
            yield f"'{sample.id}' is called {sample.verdict}, and holds {sample.true_mg:.1f} mg of {sample.target_mg:g}"
