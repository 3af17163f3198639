"""The bench of the dosing experiments: the simulated hand 80 mm above a dish on the balance.

The same world, devices and skills as a dry run's: it is the lab's own `tare` and `dispense` that dose, and their
verdict that is reported, as it stands when the dish has gone and the bare pan was weighed. Only the arm stands still
and the cone is loaded by hand, as in the paper's experiments. One
*run* is ten doses of one target: what a controller learns is carried within a run and forgotten after it, and every
dose starts from a fresh load of the cone.
"""

import math
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, cast

import numpy as np
import yaml

from benchmarks.oracle import run_oracle
from scuhand_bt.bench_spec import Station
from scuhand_bt.cell.cell import Cell
from scuhand_bt.cell.dose_loop import DoseRun, run_dose
from scuhand_bt.cell.pan_cleared import take_container_away
from scuhand_bt.cell.shown_balance import require_known_delay, shown_step
from scuhand_bt.cell.weighing import weigh_changed, weighing_of
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.clock import Steps, T
from scuhand_bt.device_specs.balance import BalanceSpec
from scuhand_bt.device_specs.hand import HandSpec
from scuhand_bt.devices.interfaces import Operator
from scuhand_bt.dosing import CONTROLLERS, new_controller
from scuhand_bt.dosing.bracket import Drift, Net, Reference
from scuhand_bt.dosing.verdict import judge
from scuhand_bt.events.doses import Dose
from scuhand_bt.events.entry import Note, SkillEvent
from scuhand_bt.failures import SkillFailed
from scuhand_bt.journal.results import DoseResult
from scuhand_bt.lab import load_lab
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.motion.kinematics import ApexPose
from scuhand_bt.record import Record
from scuhand_bt.run.clock import VirtualClock
from scuhand_bt.run.outcome import confirmed_dose
from scuhand_bt.sim.arm import SimulatedArm
from scuhand_bt.sim.cell import ZERO, simulated_cell
from scuhand_bt.sim.world import World
from scuhand_bt.skill import pause
from scuhand_bt.specs import BalanceBelief, Container, Departure, Mortar, Powder, PowderBelief, Source

DOSES_PER_RUN = 10
TOLERANCE_MG = 2.0
WAY_S = 4.0
"""From the tare to the dose: the arm's way over the balance; it is not counted."""
CHANGE_S = 1.0
"""From the bare pan's weighing to the dish."""
UNWAITING = "paper_unwaiting"
"""`paper` on a rig that asks its balance at once, without the fixed wait of the paper's."""
PAPERS = ("paper", UNWAITING, "direct_pid")
"""Run as in the paper's experiments: against one tare, without the lab's bracketed weighing and its guard band."""
TABLES_IMPLY = tuple(departure for departure in Departure if departure != Departure.GUARD)
"""The departures from the paper's listing that its own tables bear witness to (docs/calibration.md)."""
REDONE = 1000
"""Added to a dose's number for its second attempt."""
ROBOT = Path(__file__).parent.parent / "robot"
PAN = Station(name="balance", kind="balance", position_mm=(330.0, 0.0, 60.0))
BAY = Station(name="bay", kind="mortar", position_mm=(0.0, 300.0, 0.0))
MORTAR = Mortar(name="store", bore_mm=90.0, depth_mm=30.0, height_mm=45.0, outer_diameter_mm=115.0)
DISH = Container(
    id="dish", name="petri_dish", mouth_mm=55.0, height_mm=15.0, capacity_mm3=20_000.0, empty_mass_mg=25_000.0
)
APEX = ApexPose(np.array([0.330, 0.0, 0.140]))
OVER_PAN = (0.0, -0.032728698809, 0.0, -2.2031318676, 0.0, 0.21403742781, 0.0)
"""The arm's joints [rad] with which the apex is there."""


@dataclass(frozen=True)
class Setting:
    """What a row of the benchmark changes about the bench; the rest is the lab's."""

    name: str = "as calibrated"
    plant: str | None = None
    hand: HandSpec = field(default_factory=HandSpec)
    balance: BalanceSpec = field(default_factory=BalanceSpec)
    believed_hand: HandSpec | None = None
    """The hand that controllers are told of, where it is not the one there is."""
    belief_factor: float = 1.0
    """What the controllers' first guess of the flow is multiplied with."""
    load_ratio: float = 1.0
    """Filling of the cone, as a share of the powder's load limit."""
    redo: bool = False
    """A dose reported out of tolerance is dosed once more, into a new container."""
    departures: tuple[Departure, ...] = TABLES_IMPLY
    """Of the paper's controllers from its listing."""


@dataclass(frozen=True)
class Trial:
    """One dose: errors against the target by the true and by the reported mass."""

    true_error_mg: float
    reported_error_mg: float
    accepted: bool
    """Reported in tolerance."""
    steps: int
    duration_s: float
    reason: str


@cache
def _standing() -> MotionPlanner:
    """For where the arm stands: over the pan while a dose is made, whatever the world has of the cone."""
    return load_lab(ROBOT.parent).motion_planner({})


@cache
def skills() -> dict[str, Any]:
    """The lab's own skills, by name."""
    return dict(load_lab(ROBOT.parent).library.skills)


@cache
def shipped_powders() -> dict[str, Powder]:
    """The powders of `robot/powders.yaml`."""
    read = yaml.safe_load((ROBOT / "powders.yaml").read_text(encoding="utf-8"))
    return {name: Powder.model_validate({"name": name, **values}) for name, values in read.items()}


def run_of_doses(
    powder: Powder, target_mg: float, controller: str, run: int, setting: Setting, doses: int = DOSES_PER_RUN
) -> list[Trial]:
    """The doses of one run, one after another; a controller by its name, `oracle` or `paper_unwaiting`."""
    belief = powder.belief.model_copy(update={"coefficient": powder.belief.coefficient * setting.belief_factor})
    balance = BalanceBelief()
    trials = []
    for dose in range(doses):
        # A second attempt has a seed of its own, and its time counts as well.
        spent_s = 0.0
        for attempt in (dose, dose + REDONE) if setting.redo else (dose,):
            bench = Bench(powder, target_mg, run, attempt, setting)
            trial = bench.dose(controller, belief, balance)
            belief, balance = bench.cell.powder_beliefs[powder.name], bench.cell.balance_belief
            spent_s += trial.duration_s
            if trial.accepted:
                break
        trials.append(replace(trial, duration_s=spent_s))
    return trials


class DoseRecord(Record):
    """Keeps the last dose."""

    def __init__(self) -> None:
        super().__init__(self._hear)
        self.last: Dose | None = None

    def _hear(self, event: SkillEvent | Note) -> None:
        if isinstance(event, Dose):
            self.last = event


class Bench:
    """One loaded cone above one dish."""

    def __init__(self, powder: Powder, target_mg: float, run: int, dose: int, setting: Setting) -> None:
        spec = CellSpec(cell="bench", hand=setting.hand, balance=setting.balance, stations={"balance": PAN, "bay": BAY})
        self.target_mg, self.departures = target_mg, setting.departures
        load_mg = powder.load_limit_mg * setting.load_ratio
        source = Source(name="store", station="bay", mortar=MORTAR, powder=powder, amount_mg=10_000.0)
        self.clock, self.record = VirtualClock(), DoseRecord()
        self.cell: Cell
        self.world: World
        self.cell, self.world = simulated_cell(
            spec,
            {"store": source},
            clock=self.clock,
            record=self.record,
            motion=_standing(),
            operator=cast(Operator, None),
            seed=run,
            plant=setting.plant,
            apex_of=lambda joints: APEX,
        )
        self.clock.process = self.world
        self.world.begin_sample(f"{powder.name} {target_mg:g}", dose)
        self.world.load_cone("store", load_mg)
        self.cell.spec = spec.model_copy(update={"hand": setting.believed_hand or setting.hand})
        believed = self.cell.believed
        believed.cone_holds(source, load_mg)
        self.cell.balance.on_reading = self.cell.readings.append
        bare = self.drive(self.cell.balance.stable_mean(60.0))
        self.drive(pause(self.cell, CHANGE_S))
        self.world.place(DISH)
        believed.brought(DISH, from_changer=True)
        brought_s = self.clock.now_s
        loaded = self.drive(weigh_changed(self.cell, bare.value_mg))
        self.step = self.cell.came = shown_step(self.cell, weighing_of(bare), weighing_of(loaded), brought_s)
        believed.placed(weighing_of(bare), weighing_of(loaded))

    def drive(self, steps: Steps[T]) -> T:
        """Run a generator to its end."""
        try:
            while True:
                self.clock.wait([next(steps)])
        except StopIteration as end:
            return cast(T, end.value)

    def dose(self, name: str, powder: PowderBelief, balance: BalanceBelief) -> Trial:
        """One dose by a controller's name; `oracle` is given the true mass. What was learnt is the cell's then."""
        cell = self.cell
        (source,) = cell.sources.values()
        cell.powder_beliefs[source.sheet_key], cell.balance_belief = powder, balance
        self.drive(skills()["tare"]().run(cell))
        self.drive(pause(cell, WAY_S))
        arm = cast(SimulatedArm, cell.arm)
        arm.hold(OVER_PAN)
        begin_s = self.clock.now_s
        dispense = skills()["dispense"](
            mass_mg=self.target_mg, tolerance_mg=TOLERANCE_MG, controller=name if name in CONTROLLERS else ""
        )
        reason: str = "reached"
        try:
            if self.step is not None:
                require_known_delay(cell, self.step)
            if name == "oracle":
                reason = self._keep(name, self.drive(self._oracle(dispense)))
            elif name in PAPERS:
                reason = self._keep(name, self.drive(self._as_in_the_paper(name)))
            else:
                self.drive(dispense.run(cell))
        except SkillFailed as failure:
            reason = failure.code
        arm.hold(ZERO.tolist())
        duration_s, true_mg, dose = self.clock.now_s - begin_s, self.world.true_mass(DISH.id), self.record.last
        return Trial(
            true_error_mg=true_mg - self.target_mg,
            reported_error_mg=dose.error_mg if dose is not None else np.nan,
            accepted=dose is not None and self._accepted(dose),
            steps=dose.pulses if dose is not None else 0,
            duration_s=duration_s,
            reason=reason,
        )

    def _accepted(self, dose: Dose) -> bool:
        """As a batch has it of its sample; what no recipe can name has nothing that a bare pan could confirm."""
        if dose.controller not in CONTROLLERS or dose.controller in PAPERS:
            return dose.verdict == "in tolerance"
        try:
            self.drive(take_container_away(self.cell))
        except SkillFailed:  # no bare pan has confirmed it
            return False
        (closed,) = self.cell.believed.closed
        told = {name: value for name, value in dict(dose).items() if name in DoseResult.model_fields}
        return confirmed_dose(DoseResult(**told), closed).is_good

    def _oracle(self, dispense: Any) -> Steps[DoseRun]:
        return run_oracle(dispense, self.cell, self.world, DISH.id)

    def _as_in_the_paper(self, name: str) -> Steps[DoseRun]:
        cell, known = self.cell, "paper" if name == UNWAITING else name
        dispense = skills()["dispense"](mass_mg=self.target_mg, tolerance_mg=TOLERANCE_MG, controller=known)
        request = replace(dispense.request(cell), departures=self.departures)
        if name == UNWAITING:
            request = replace(request, wait_s=0.0)
        assert cell.believed.bracket is not None
        digit_mg = cell.spec.balance.readability_mg
        reference = Reference(cell.believed.bracket.last, Drift(0.0, 0.0), Net(0.0, 0.0), digit_mg)
        controller = new_controller(known, request)
        devices = cell.hand, cell.balance, cell.clock, cell.record
        return run_dose(controller, request, *devices, reference, unwatched_s=math.inf)  # its experiments had no watch

    def _keep(self, name: str, run: DoseRun) -> str:
        """What a controller that no recipe can name came to, as a dose; why it ended."""
        net_mg = run.finish.estimate_mg
        uncertainty_mg = 0.0 if name in PAPERS else run.finish.uncertainty_mg
        self.record.last = Dose(
            target_mg=self.target_mg,
            tolerance_mg=TOLERANCE_MG,
            dispensed_mg=net_mg,
            uncertainty_mg=uncertainty_mg,
            pulses=run.pulses,
            vibration_s=run.vibration_s,
            duration_s=run.duration_s,
            controller=name,
            verdict=judge(self.target_mg, TOLERANCE_MG, net_mg, uncertainty_mg),
        )
        return run.finish.reason
