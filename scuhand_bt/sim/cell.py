"""A simulated cell: the devices of `cell.yaml`, built on a world."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from scuhand_bt.cell.cell import Cell
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.clock import Clock
from scuhand_bt.devices.interfaces import Changer, Joints, Operator
from scuhand_bt.record import Record
from scuhand_bt.sim.arm import Pose, SimulatedArm
from scuhand_bt.sim.balance import SimulatedBalance
from scuhand_bt.sim.changer import SimulatedChanger
from scuhand_bt.sim.faults import Faults
from scuhand_bt.sim.hand import SimulatedHand
from scuhand_bt.sim.instruments import simulated_instrument
from scuhand_bt.sim.plant import probed_plant
from scuhand_bt.sim.world import World
from scuhand_bt.specs import Source

if TYPE_CHECKING:
    from scuhand_bt.motion import MotionPlanner

ZERO: Joints = np.zeros(7)


def simulated_cell(
    spec: CellSpec,
    sources: Mapping[str, Source],
    *,
    clock: Clock,
    record: Record,
    motion: "MotionPlanner",
    operator: Operator,
    seed: int,
    plant: str | None = None,
    joints: Joints = ZERO,
    changer: Changer | None = None,
    faults: Faults | None = None,
    apex_of: Callable[[Joints], Pose] | None = None,
) -> tuple[Cell, World]:
    """A cell whose devices act on a `World`; the caller makes the world the clock's process.

    `plant` is "module:Class"; None stands for the cell's own plant (`spec.plant`) or else ours. `joints` is where the
    arm stands. `changer` replaces the simulated carousel (for example by the operator's hands), `apex_of` the arm's
    forward kinematics. `faults` are the faults to come. Raises PlantError for a plant that cannot be used, before
    anything moves.
    """
    physics = probed_plant(plant or spec.plant, sources.values(), spec.balance)
    hand = SimulatedHand(spec.hand, clock, None if motion is None else motion.mount)
    arm = SimulatedArm(clock, hand.mount, joints, apex_of)
    balance = SimulatedBalance(spec.balance, clock, physics)
    world = World(spec, sources, physics, seed, arm, hand, balance, faults)
    cell = Cell(
        spec=spec,
        clock=clock,
        record=record,
        arm=arm,
        hand=hand,
        balance=balance,
        changer=changer or SimulatedChanger(clock, world, spec.changer.options.swing_s(0.5)),
        operator=operator,
        motion=motion,
        sources=sources,
        simulated=True,
        begin_sample=world.begin_sample,
        devices={
            name: simulated_instrument(one.kind, clock, world, spec.own_options.get(name))
            for name, one in spec.devices.items()
        },
    )
    return cell, world
