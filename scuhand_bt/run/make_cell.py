"""Makes the cell that a plan runs on: simulated, simulated behind the real drivers (a rehearsal), or real."""

import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from scuhand_bt.cell.believed import slot_of as believed_slot
from scuhand_bt.cell.cell import Cell
from scuhand_bt.clock import Clock
from scuhand_bt.device_specs.hand import MOUNTED_DIAMETER_MM
from scuhand_bt.devices.connect import Devices, connect_cell_devices
from scuhand_bt.devices.interfaces import Changer, Operator
from scuhand_bt.devices.liveness import Liveness
from scuhand_bt.devices.roller import FILE_NAME as ROLLER_FILE
from scuhand_bt.journal.run_events import NotResumable
from scuhand_bt.journal.writer import Journal
from scuhand_bt.lab import Lab, without_driver
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.problems import SourceError
from scuhand_bt.recipe.plan import Plan
from scuhand_bt.record import Record
from scuhand_bt.run.bench import NOT_ON_TWINS, find_plants, require_twins
from scuhand_bt.run.clock import VirtualClock, WallClock
from scuhand_bt.run.hands import check_weight
from scuhand_bt.run.operator import Nobody, OperatorChanger, Person, PersonOperator, SimulatedOperator, Terminal
from scuhand_bt.run.outage import rim_in_words
from scuhand_bt.run.prepared_motion import motion_of, places_of, prepared_motion
from scuhand_bt.run.questions import Questions
from scuhand_bt.run.simulation import DryRun, Rehearsal, Simulation
from scuhand_bt.run.twins import Made, Twins, folder_of_run, open_twins
from scuhand_bt.sim.cell import simulated_cell
from scuhand_bt.sim.faults import Faults
from scuhand_bt.sim.plant import probed_plant
from scuhand_bt.sim.wire.bench import at_twins
from scuhand_bt.sim.wire.hand import compiler
from scuhand_bt.sim.world import World
from scuhand_bt.specs import Container

FAULTS = "faults.yaml"
"""The fault file of a rehearsal's twins, in their folder."""
REHEARSED_ANSWER_S = 2.0
"""How long the simulated person of a rehearsal takes to do what is asked [s]."""


Ask = Callable[[Clock], PersonOperator]
"""Makes the operator who asks a person, on a run's clock."""


@dataclass(frozen=True)
class Setup:
    """A cell made ready, its world if it is in this process, the truth about it, what closes it, and its liveness."""

    cell: Cell
    world: World | None
    truth: "Truth | None"
    """None if nobody knows the true masses."""
    close: Callable[[], None]
    liveness: Liveness


class Truth(Protocol):
    """A simulated world, in this process or in its twins', for judging results and never for skills."""

    @property
    def masses_mg(self) -> Mapping[str, float]:
        """What is in every compartment [mg]; empty if nobody knows any more."""
        ...

    @property
    def fault_account(self) -> Sequence[Mapping[str, Any]]:
        """The fault of each rule, and when it came [s]."""
        ...

    def true_mass(self, container_id: str) -> float:
        """What is in this container [mg]."""
        ...


def set_up(
    plan: Plan,
    lab: Lab,
    simulation: Simulation | None,
    journal: Journal,
    motion: MotionPlanner | None = None,
    *,
    person: Person,
    questions: Questions,
    terminal: Terminal,
    unattended: bool = False,
    world_path: Path | None = None,
    resumed_at_s: float | None = None,
    may_torque: bool = True,
) -> Setup:
    """The cell for a plan, with all motions between its places planned (in `motion`, if given).

    It is the real one if `simulation` is None. `person` answers at the run's `terminal`, others through `questions`.
    `world_path` is the file in which a dry run's world outlives the program. `resumed_at_s` is the run time at which
    an interrupted run continues: a dry run's world is then restored from its file, and motions are planned when
    needed, as all were found possible before. Without `may_torque` a real arm that has no torque is refused.

    Raises SourceError for a real run on a cell whose changer has no driver, for a world's file that cannot be restored
    and for faults that cannot occur in this run; SkillFailed arm.* for a way that cannot be planned, device.lost for a
    device that cannot be opened; PlantError for a plant that cannot be used; NoCompiler for a rehearsal without a C++
    compiler.
    """
    if simulation is None and (problems := without_driver(lab)):
        raise SourceError(problems)
    if motion is None and resumed_at_s is None:
        motion = prepared_motion(plan, lab, for_real=simulation is None)
    motion = motion or motion_of(plan, lab)

    def ask(clock: Clock) -> PersonOperator:
        return PersonOperator(clock, journal.event, person, questions, terminal)

    match simulation:
        case DryRun():
            setup = _dry_run(plan, lab, simulation, journal, motion, world_path, resumed_at_s is not None, ask)
        case Rehearsal():
            setup = _rehearsal(plan, lab, simulation, journal, motion, ask, resumed_at_s)
        case None:
            setup = _real(plan, lab, journal, motion, resumed_at_s or 0.0, ask, may_torque=may_torque)
    cell = setup.cell
    cell.places_mm = places_of(plan, lab)
    for name, source in plan.recipe.sources.items():
        cell.believed.source_holds(name, source.amount_mg)
    if plan.recipe.controller is not None:
        cell.controller = plan.recipe.controller
    if unattended:
        cell.operator = Nobody()
        cell.changer = OperatorChanger(cell.operator) if cell.changer.needs_person else cell.changer
    return setup


def _dry_run(
    plan: Plan,
    lab: Lab,
    dry_run: DryRun,
    journal: Journal,
    motion: MotionPlanner,
    world_path: Path | None,
    restore: bool,
    ask: Ask,
) -> Setup:
    find_plants(lab)
    liveness = Liveness()
    clock = VirtualClock(speed=dry_run.speed, beat=liveness.beat)
    faults = _faults(plan, dry_run)
    operator: Operator = (simulated := SimulatedOperator(clock, journal.event, faults=faults))
    if dry_run.asks:
        _refuse_refusals(dry_run)
        operator = person = ask(clock)
        clock.is_waited_in = lambda: person.is_asking
    cell, world = simulated_cell(
        lab.cell,
        plan.recipe.sources,
        clock=clock,
        record=_record(journal),
        motion=motion,
        operator=operator,
        seed=dry_run.seed,
        plant=dry_run.plant,
        joints=motion.home(),
        faults=faults,
    )
    clock.process = world
    if lab.cell.changer.driver == "operator":
        cell.changer = OperatorChanger(operator, world.place, world.remove, may_be_loaded=restore)
    _follow_hands(world, cell)
    simulated.sees = lambda: (
        "another" if world.pan.is_exchanged else "same",
        rim_in_words(cell.hand.cone_diameter_mm),
    )

    def tell(why: str) -> None:
        journal.event(NotResumable(why=why))

    if world_path is not None and restore:
        clock.go_on_from(world.restore(world_path, tell))
    elif world_path is not None:
        world.keep_in(world_path, tell)
    journal.before_commit = clock.save
    return Setup(cell, world, world, world.close, liveness)


def _rehearsal(
    plan: Plan,
    lab: Lab,
    rehearsal: Rehearsal,
    journal: Journal,
    motion: MotionPlanner,
    ask: Ask,
    resumed_at_s: float | None,
) -> Setup:
    require_twins(lab)
    find_plants(lab)
    _faults(plan, rehearsal)
    has_person = rehearsal.asks or sys.stdin.isatty()
    if rehearsal.faults is not None:
        rehearsal.faults.refuse(NOT_ON_TWINS)
    if has_person:
        _refuse_refusals(rehearsal)
    compiler()
    probed_plant(rehearsal.plant or lab.cell.plant, plan.recipe.sources.values(), lab.cell.balance)
    liveness = Liveness()

    def beat() -> None:
        twins.check()
        liveness.beat()

    def slot_of(container: Container) -> int:
        slot = believed_slot(cell.believed, container, lab.cell.changer.first_slot(container.name))
        # As a person would, fill each slot with the container that is expected in it.
        twins.say("fill", str(slot + 1), container.name, container.id)
        return slot

    with ExitStack() as opened:
        twins = _twins_of(plan, lab, rehearsal, journal)
        opened.callback(twins.end)
        clock = WallClock(beat, max(twins.say("look")["now_s"], resumed_at_s or 0.0))
        devices = connect_cell_devices(
            at_twins(lab.cell, twins.port_of),
            clock,
            liveness,
            slot_of=slot_of,
            roller_file=folder_of_run(journal.path) / ROLLER_FILE,
        )
        opened.callback(devices.close)
        if resumed_at_s is None:
            devices.hand.rim_is(MOUNTED_DIAMETER_MM)
        opened.callback(liveness.end)
        operator: Operator = ask(clock)
        if not has_person:
            operator = simulated = SimulatedOperator(clock, journal.event, REHEARSED_ANSWER_S, twins)
            simulated.sees = lambda: ("same", rim_in_words(twins.say("look")["rim_mm"]))
        changer = devices.changer or OperatorChanger(
            operator, twins.place, twins.remove, may_be_loaded=resumed_at_s is not None
        )
        cell = _wired_cell(plan, lab, devices, clock, journal, motion, operator, changer, simulated=True)
        cell.begin_sample = twins.begin_sample
        cell.sheet_mounted, cell.weight_on_pan, cell.mortar_refilled = twins.swap_sheet, twins.weigh, twins.refill
        return Setup(cell, None, twins, opened.pop_all().close, liveness)


def _twins_of(plan: Plan, lab: Lab, rehearsal: Rehearsal, journal: Journal) -> Twins:
    """A process with a rehearsal's twins: one that is still running, one that restores their world, or a new one."""
    folder = folder_of_run(journal.path)
    command = [str(plan.recipe.path.absolute()), "--lab", str(lab.folder.absolute()), "--seed", str(rehearsal.seed)]
    if rehearsal.plant is not None:
        command += ["--plant", rehearsal.plant]
    if rehearsal.faults is not None:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / FAULTS).write_text(rehearsal.faults.text, encoding="utf-8")
        command += ["--faults", str(folder / FAULTS)]

    def tell(why: str) -> None:
        journal.event(NotResumable(why=why))

    return open_twins(folder, Made.of(lab, plan.recipe.sources, rehearsal.seed, rehearsal.plant), command, tell)


def _refuse_refusals(simulation: Simulation) -> None:
    if simulation.faults is not None:
        simulation.faults.refuse({"operator.refuses": "a person answers for the operator"})


def _faults(plan: Plan, simulation: Simulation) -> Faults:
    if simulation.faults is None:
        return Faults()
    simulation.faults.check_samples([sample.id for sample in plan.recipe.samples])
    return Faults(simulation.faults.rules, simulation.seed)


def _real(
    plan: Plan, lab: Lab, journal: Journal, motion: MotionPlanner, began_s: float, ask: Ask, *, may_torque: bool
) -> Setup:
    liveness = Liveness()
    clock = WallClock(liveness.beat, began_s)
    with ExitStack() as opened:
        devices = connect_cell_devices(
            lab.cell,
            clock,
            liveness,
            may_torque=may_torque,
            slot_of=lambda container: believed_slot(
                cell.believed, container, lab.cell.changer.first_slot(container.name)
            ),
            roller_file=journal.path.parent.parent / ROLLER_FILE,
        )
        opened.callback(devices.close)
        opened.callback(liveness.end)
        operator = ask(clock)
        changer = devices.changer or OperatorChanger(operator, may_be_loaded=began_s > 0.0)
        cell = _wired_cell(plan, lab, devices, clock, journal, motion, operator, changer, simulated=False)
        return Setup(cell, None, None, opened.pop_all().close, liveness)


def _wired_cell(
    plan: Plan,
    lab: Lab,
    devices: Devices,
    clock: Clock,
    journal: Journal,
    motion: MotionPlanner,
    operator: Operator,
    changer: Changer,
    *,
    simulated: bool,
) -> Cell:
    """The cell with drivers that are already open."""
    return Cell(
        spec=lab.cell,
        clock=clock,
        record=_record(journal),
        arm=devices.arm,
        hand=devices.hand,
        balance=devices.balance,
        changer=changer,
        operator=operator,
        motion=motion,
        sources=plan.recipe.sources,
        simulated=simulated,
        devices=devices.others,
    )


def _record(journal: Journal) -> Record:
    return Record(journal.event, journal.waits, journal.course if journal.is_kept else None)


def _follow_hands(world: World, cell: Cell) -> None:
    """Let the simulated world follow what a person does at the cell."""

    def weight_on_pan(mass_mg: float) -> None:
        world.remove()
        if mass_mg > 0.0:
            world.place(check_weight(mass_mg))

    cell.sheet_mounted, cell.mortar_refilled = world.swap_sheet, world.refill
    cell.weight_on_pan = weight_on_pan
