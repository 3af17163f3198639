"""The bench of the dosing experiments: the simulated hand 80 mm above a dish on the balance.

The same world, devices and dose loop as a dry run's; only the arm stands still and the cone is loaded by
hand, as in the paper's experiments. One *run* is ten doses of one target: what a controller learns is
carried within a run and forgotten after it, and every dose starts from a fresh load of the cone.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import cast

import numpy as np
import yaml

from benchmarks.oracle import Oracle, run_oracle
from scuhand_bt.cell.cell import Cell
from scuhand_bt.cell.dose_loop import DoseRun, run_dose
from scuhand_bt.cell_spec import BalanceSpec, CellSpec, HandSpec, Station
from scuhand_bt.clock import Steps, T
from scuhand_bt.devices.interfaces import Operator
from scuhand_bt.dosing import DoseRequest, new_controller
from scuhand_bt.failures import SkillFailed
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.motion.kinematics import ApexPose
from scuhand_bt.record import Record
from scuhand_bt.run.clock import VirtualClock
from scuhand_bt.sim.cell import simulated_cell
from scuhand_bt.sim.world import World
from scuhand_bt.specs import BalanceBelief, Container, Mortar, Powder, PowderBelief, Source

DOSES_PER_RUN = 10
TOLERANCE_MG = 2.0
GUARD = 2.0
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


@dataclass(frozen=True)
class Trial:
    """One dose: errors against the target by the true and by the reported mass."""

    true_error_mg: float
    reported_error_mg: float
    accepted: bool
    """Reported in tolerance by the guard band."""
    steps: int
    duration_s: float
    reason: str


def shipped_powders() -> dict[str, Powder]:
    """The powders of `robot/powders.yaml`."""
    read = yaml.safe_load((ROBOT / "powders.yaml").read_text(encoding="utf-8"))
    return {name: Powder.model_validate({"name": name, **values}) for name, values in read.items()}


def run_of_doses(
    powder: Powder, target_mg: float, controller: str, run: int, setting: Setting, doses: int = DOSES_PER_RUN
) -> list[Trial]:
    """The doses of one run, one after another."""
    belief = powder.belief.model_copy(update={"coefficient": powder.belief.coefficient * setting.belief_factor})
    balance = BalanceBelief()
    trials = []
    for dose in range(doses):
        # A second attempt has a seed of its own, and its time counts as well.
        spent_s = 0.0
        for attempt in (dose, dose + REDONE) if setting.redo else (dose,):
            bench = Bench(powder, target_mg, run, attempt, setting)
            trial, learnt = bench.dose(controller, belief, balance)
            if learnt is not None:
                belief, balance = learnt.finish.powder or belief, learnt.finish.balance or balance
            spent_s += trial.duration_s
            if trial.accepted:
                break
        trials.append(replace(trial, duration_s=spent_s))
    return trials


class Bench:
    """One loaded cone above one dish."""

    def __init__(self, powder: Powder, target_mg: float, run: int, dose: int, setting: Setting) -> None:
        spec = CellSpec(cell="bench", hand=setting.hand, balance=setting.balance, stations={"balance": PAN, "bay": BAY})
        self.powder, self.target_mg = powder, target_mg
        self.believed_hand = setting.believed_hand or setting.hand
        self.load_mg = powder.load_limit_mg * setting.load_ratio
        source = Source(name="store", station="bay", mortar=MORTAR, powder=powder, amount_mg=10_000.0)
        self.clock = VirtualClock()
        self.cell: Cell
        self.world: World
        self.cell, self.world = simulated_cell(
            spec,
            {"store": source},
            clock=self.clock,
            record=Record(),
            motion=cast(MotionPlanner, None),
            operator=cast(Operator, None),
            seed=run,
            plant=setting.plant,
            apex_of=lambda joints: APEX,
        )
        self.clock.process = self.world
        self.world.begin_sample(f"{powder.name} {target_mg:g}", dose)
        self.world.place(DISH)
        self.world.load_cone("store", self.load_mg)

    def request(self, belief: PowderBelief, balance: BalanceBelief) -> DoseRequest:
        """What `skills/dispense.py` would ask."""
        hand, spec = self.believed_hand, self.cell.spec.balance
        return DoseRequest(
            target_mg=self.target_mg,
            tolerance_mg=TOLERANCE_MG,
            gain=self.powder.gain,
            max_opening_mm=min(self.powder.max_opening_mm, hand.max_opening_mm),
            valve_speed_mm_per_s=hand.valve_speed_mm_per_s,
            valve_dead_time_s=hand.valve_dead_time_s,
            readability_mg=spec.readability_mg,
            balance_period_s=spec.period_s,
            cone_mg=self.load_mg,
            streaming=hand.streaming,
            powder=belief,
            balance=balance,
        )

    def drive(self, steps: Steps[T]) -> T:
        """Run a generator to its end."""
        try:
            while True:
                self.clock.wait([next(steps)])
        except StopIteration as end:
            return cast(T, end.value)

    def dose(self, name: str, belief: PowderBelief, balance: BalanceBelief) -> tuple[Trial, DoseRun | None]:
        """One dose by a controller's name; `oracle` is given the true mass."""
        empty_mg = self.drive(self.cell.balance.stable_mean(60.0)).value_mg
        request = self.request(belief, balance)
        if name == "oracle":
            steps = run_oracle(Oracle(request), self.cell, self.world, DISH.id)
        else:
            controller = new_controller(name, request)
            steps = run_dose(controller, self.cell.hand, self.cell.balance, self.clock, Record(), empty_mg)
        begin_s = self.clock.now_s
        try:
            run = self.drive(steps)
        except SkillFailed as failure:
            error_mg = self.world.true_mass(DISH.id) - self.target_mg
            return Trial(error_mg, np.nan, False, 0, self.clock.now_s - begin_s, failure.code), None
        true_mg = self.world.true_mass(DISH.id)
        error_mg = run.finish.estimate_mg - self.target_mg
        guard_mg = 0.0 if name in ("paper", "direct_pid", "oracle") else GUARD * run.finish.uncertainty_mg
        trial = Trial(
            true_mg - self.target_mg,
            error_mg,
            abs(error_mg) <= TOLERANCE_MG - guard_mg,
            run.pulses,
            run.duration_s,
            run.finish.reason,
        )
        return trial, run
