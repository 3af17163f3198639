"""Making the cell that a plan runs on: simulated, or the real one."""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scuhand_bt.devices.cell import Cell
from scuhand_bt.devices.connect import connect_cell_devices
from scuhand_bt.devices.liveness import Liveness
from scuhand_bt.devices.places import Position, all_places
from scuhand_bt.lab import Lab
from scuhand_bt.motion import ApexPose, MotionPlanner
from scuhand_bt.plan import Plan
from scuhand_bt.record import Record
from scuhand_bt.run.clock import VirtualClock, WallClock
from scuhand_bt.run.operator import OperatorChanger, SimulatedOperator, TerminalOperator
from scuhand_bt.sim.cell import simulated_cell
from scuhand_bt.sim.world import World


@dataclass(frozen=True)
class DryRun:
    """What a dry run is told: its seed, its physics, and how fast virtual time may pass (None: at once)."""

    seed: int = 0
    plant: str | None = None
    speed: float | None = None


def simulated(
    plan: Plan, lab: Lab, options: DryRun, record: Record, motion: MotionPlanner | None = None
) -> tuple[Cell, World]:
    """The lab's cell with simulated devices, all motions between its places planned (in `motion`, if given).

    Raises SkillFailed (arm.*) if one cannot be planned, PlantError for a plant that cannot be used.
    """
    # A plant may be a module of the lab or of the working folder; last, so that it hides nothing.
    sys.path.extend(folder for folder in (str(lab.folder), str(Path.cwd())) if folder not in sys.path)
    clock = VirtualClock(speed=options.speed)
    motion = motion or prepared_motion(plan, lab)
    operator = SimulatedOperator(clock, record)
    cell, world = simulated_cell(
        lab.cell,
        plan.recipe.sources,
        clock=clock,
        record=record,
        motion=motion,
        operator=operator,
        seed=options.seed,
        plant=options.plant,
        joints=motion.home(),
    )
    clock.process = world
    if lab.cell.changer.driver == "operator":
        cell.changer = OperatorChanger(operator, world.place, world.remove)
    cell.sheet_mounted = world.swap_sheet
    _tell(cell, plan, lab)
    return cell, world


def real(plan: Plan, lab: Lab, record: Record) -> tuple[Cell, Callable[[], None]]:
    """The lab's cell with the devices that `cell.yaml` names, and what closes them.

    Raises SkillFailed arm.* for a way that cannot be planned, device.lost for a device that cannot be opened.
    """
    motion = prepared_motion(plan, lab)
    liveness = Liveness()
    clock = WallClock(liveness.beat)
    operator = TerminalOperator(clock, record, lambda question: print(question, flush=True))
    devices = connect_cell_devices(lab.cell, clock, liveness)
    cell = Cell(
        spec=lab.cell,
        clock=clock,
        record=record,
        arm=devices.arm,
        hand=devices.hand,
        balance=devices.balance,
        changer=OperatorChanger(operator),
        operator=operator,
        motion=motion,
        sources=plan.recipe.sources,
        simulated=False,
    )
    _tell(cell, plan, lab)

    def close() -> None:
        liveness.end()
        devices.close()

    return cell, close


def prepared_motion(plan: Plan, lab: Lab) -> MotionPlanner:
    """The motion planner with every place of the plan, and the ways between them planned."""
    mortars = {source.station: source.mortar for source in plan.recipe.sources.values()}
    # One thread: beside other work on the machine, a second one costs more in waiting than it gains.
    motion = MotionPlanner(lab.urdf, lab.cell, mortars, threads=1)
    for name, position_mm in places_of(plan, lab).items():
        motion.add_place(name, ApexPose(np.array(position_mm) / 1000))
    motion.prepare()
    return motion


def places_of(plan: Plan, lab: Lab) -> dict[str, Position]:
    """Every named place of the plan."""
    kinds = {sample.container.name: sample.container for sample in plan.recipe.samples if sample.container is not None}
    return all_places(lab.cell, plan.recipe.sources, kinds.values())


def _tell(cell: Cell, plan: Plan, lab: Lab) -> None:
    """What the recipe says of the cell: its places, its sources' amounts, its controller."""
    cell.places_mm = places_of(plan, lab)
    cell.believed.sources_mg = {name: source.amount_mg for name, source in plan.recipe.sources.items()}
    if plan.recipe.controller is not None:
        cell.controller = plan.recipe.controller
