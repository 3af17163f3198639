"""Carries out a step, has the person accept what it changes in `robot/cell.yaml`, and records it."""

import difflib
from contextlib import ExitStack

from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.clock import wall_time
from scuhand_bt.commissioning.record import Done, Record, replace_text, values_of
from scuhand_bt.commissioning.step import Found, NotFound, Site, Step
from scuhand_bt.devices.hand_controller import HandController
from scuhand_bt.devices.interfaces import is_twin
from scuhand_bt.failures import SkillFailed
from scuhand_bt.lab import CELL_FILE, Lab, load_lab
from scuhand_bt.problems import SourceError
from scuhand_bt.run.holds import take_cell
from scuhand_bt.yaml_edit import edited
from scuhand_bt.yaml_source import read_text


def carry_out(step: Step, site: Site) -> Done | None:
    """Do one step; None where the person does not accept what it found. Raises as `Step.run`, and SourceError."""
    with ExitStack() as held:
        if step.takes_cell:
            held.callback(take_cell(site.state).end)
        found = step.run(site)
    for what, value in found.words.items():
        site.person.tell(f"  {what}: {value}")
    lab = _accepted(site, found)
    if lab is None:
        return None
    done = Done(
        step.name,
        wall_time(),
        site.who.name,
        site.who.is_pin is not None,
        dict(found.words),
        values_of(lab.cell, step.rests_on),
        site.simulated,
    )
    Record(site.state).add(done)
    return done


def on_twins(cell: CellSpec) -> bool:
    """Whether the hand at the cell's port says that it is a twin; a hand that does not answer is none."""
    controller = HandController(cell.hand)
    try:
        hello = controller.open()
    except SkillFailed:
        return False
    controller.close()
    return is_twin(hello.firmware)


def _accepted(site: Site, found: Found) -> Lab | None:
    """The lab with what was found in its cell's file; None where the person does not want it there."""
    path = site.lab.folder / CELL_FILE
    old = read_text(path, "the lab's cell.yaml")
    try:
        new = edited(old, found.values)
    except ValueError as error:
        raise NotFound(f"{CELL_FILE} cannot be changed in this way: {error}") from None
    if new == old:
        site.person.tell(f"{CELL_FILE} stays as it is.")
        return site.lab
    for line in difflib.unified_diff(old.splitlines(), new.splitlines(), "before", "after", lineterm="", n=0):
        site.person.tell(line)
    if site.person.ask(f"Write this into {CELL_FILE}?", ("yes", "no", "stop")) != "yes":
        return None
    replace_text(path, new)
    try:
        return load_lab(site.lab.folder)
    except SourceError:
        replace_text(path, old)
        raise
