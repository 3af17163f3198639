"""A bench for doses: a loaded cone that stands still above a dish on the simulated balance."""

from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import yaml

from scuhand_bt.bench_spec import Station
from scuhand_bt.cell.cell import Cell
from scuhand_bt.cell.dose_loop import DoseRun, run_dose
from scuhand_bt.cell.weighing import weighing_of
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.clock import Steps, T
from scuhand_bt.device_specs.balance import BalanceSpec
from scuhand_bt.device_specs.hand import HandSpec
from scuhand_bt.devices.interfaces import Operator
from scuhand_bt.dosing import DoseRequest, new_controller
from scuhand_bt.dosing.bracket import Drift, Net, Reference
from scuhand_bt.dosing.flow import free_flow
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.motion.kinematics import Mount
from scuhand_bt.record import Record
from scuhand_bt.run.clock import VirtualClock
from scuhand_bt.sim.cell import simulated_cell
from scuhand_bt.sim.world import World
from scuhand_bt.specs import BalanceBelief, Container, Mortar, Powder, PowderBelief, Source

ROBOT = Path(__file__).parent.parent / "robot"
PAN = Station(name="balance", kind="balance", position_mm=(330.0, 0.0, 60.0))
BAY = Station(name="bay", kind="mortar", position_mm=(0.0, 300.0, 0.0))
MORTAR = Mortar(name="store", bore_mm=90.0, depth_mm=30.0, height_mm=45.0, outer_diameter_mm=115.0)
DISH = Container(
    id="dish", name="petri_dish", mouth_mm=55.0, height_mm=15.0, capacity_mm3=20_000.0, empty_mass_mg=25_000.0
)
UNSEEN = BalanceBelief()
"""What is believed of a balance that nothing is known of."""
OVER_PAN = np.array([0.0, -0.032728698809, 0.0, -2.2031318676, 0.0, 0.21403742781, 0.0])
"""The arm's joints [rad] with which the apex is at its place over the dish."""


@dataclass(frozen=True)
class Setting:
    """What is other than usual."""

    plant: str | None = None
    hand: HandSpec = field(default_factory=HandSpec)
    balance: BalanceSpec = field(default_factory=BalanceSpec)
    load_ratio: float = 1.0
    """Filling of the cone, as a share of the powder's load limit."""


@dataclass(frozen=True)
class Dosed:
    """What a dose came to; the error is the true mass's."""

    true_error_mg: float
    run: DoseRun

    def learnt(self, powder: PowderBelief, balance: BalanceBelief) -> tuple[PowderBelief, BalanceBelief]:
        """What is believed after it, of what was believed before."""
        return self.run.finish.powder or powder, self.run.finish.balance or balance


def shipped_powders() -> dict[str, Powder]:
    """The powders of `robot/powders.yaml`."""
    read = yaml.load((ROBOT / "powders.yaml").read_text(encoding="utf-8"), yaml.CSafeLoader)  # at once
    return {name: Powder.model_validate({"name": name, **values}) for name, values in read.items()}


def dose_request(**changes: object) -> DoseRequest:
    """500 mg ± 2 mg of a full cone, but for what is given."""
    usual: dict[str, object] = {
        "target_mg": 500.0,
        "tolerance_mg": 2.0,
        "gain": 0.3,
        "max_opening_mm": 2.4,
        "valve_speed_mm_per_s": 4.0,
        "readability_mg": 0.1,
        "cone_mg": 5000.0,
    }
    return DoseRequest(**(usual | changes))  # type: ignore[arg-type]


class Bench:
    """One loaded cone above one dish; `dose` and `seed` choose the draws."""

    def __init__(
        self, powder: Powder, target_mg: float = 50.0, seed: int = 1, dose: int = 0, setting: Setting = Setting()
    ) -> None:
        spec = CellSpec(cell="bench", hand=setting.hand, balance=setting.balance, stations={"balance": PAN, "bay": BAY})
        self.powder, self.target_mg = powder, target_mg
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
            motion=cast(MotionPlanner, SimpleNamespace(mount=partial(Mount.of, setting.hand))),  # nothing is planned
            operator=cast(Operator, None),
            seed=seed,
            plant=setting.plant,
            joints=OVER_PAN,
        )
        self.clock.process = self.world
        self.world.begin_sample(f"{powder.name} {target_mg:g}", dose)
        self.world.place(DISH)
        self.world.load_cone("store", self.load_mg)

    def request(
        self, belief: PowderBelief | None = None, balance: BalanceBelief = UNSEEN, controller: str = ""
    ) -> DoseRequest:
        """What a controller is asked for, by one who believes this of the powder and of the balance."""
        hand, spec, powder = self.cell.spec.hand, self.cell.spec.balance, self.powder
        return DoseRequest(
            target_mg=self.target_mg,
            tolerance_mg=2.0,
            gain=powder.paper.gain,
            wait_s=powder.paper.wait_s,
            departures=powder.paper.departures,
            max_opening_mm=min(powder.widest_mm(controller), hand.max_opening_mm),
            valve_speed_mm_per_s=hand.valve_speed_mm_per_s,
            valve_dead_time_s=hand.valve_dead_time_s,
            readability_mg=spec.readability_mg,
            balance_period_s=spec.period_s,
            cone_mg=self.load_mg,
            streaming=hand.streaming,
            free_flow=free_flow(powder.bulk_density_mg_per_mm3),
            powder=belief or self.powder.belief,
            balance=balance,
        )

    def drive(self, steps: Steps[T]) -> T:
        """Run a generator to its end."""
        try:
            while True:
                self.clock.wait([next(steps)])
        except StopIteration as end:
            return cast(T, end.value)

    def dose(
        self, name: str, belief: PowderBelief | None = None, balance: BalanceBelief = UNSEEN, **asked_for: Any
    ) -> Dosed:
        """One dose by a controller's name, which is asked for it with these fields besides."""
        empty = weighing_of(self.drive(self.cell.balance.stable_mean(60.0)))
        against = Reference(empty, Drift(0.0, 0.0), Net(0.0, 0.0), self.cell.spec.balance.readability_mg)
        asked, cell = replace(self.request(belief, balance, name), **asked_for), self.cell
        controller = new_controller(name, asked)
        run = self.drive(run_dose(controller, asked, cell.hand, cell.balance, self.clock, Record(), against))
        return Dosed(self.world.true_mass(DISH.id) - self.target_mg, run)
