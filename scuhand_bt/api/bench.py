"""The cell's devices beside any run: a doctor for them, twins of them, and the notification hook tried."""

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from scuhand_bt.lab import CELL_FILE, Lab, find_state, state_folder
from scuhand_bt.run.bench import bench_of
from scuhand_bt.run.clock import WallClock
from scuhand_bt.run.notify import Notice, notify
from scuhand_bt.run.twins import FOLDER, say
from scuhand_bt.run.twins_process import TwinsProcess

if TYPE_CHECKING:
    from scuhand_bt.devices.doctor import Finding
    from scuhand_bt.run.hands import Answer
    from scuhand_bt.sim.fault_rules import FaultFile
    from scuhand_bt.specs import Source

__all__ = ["TwinsProcess", "examine", "folder_of_cell", "make_twins", "tell_twins", "try_notification"]


def examine(lab: Lab, *, twins: bool = False, self_test: bool = False) -> "list[Finding]":
    """Look at every device of a lab's cell, or at `twins` of them. Nothing moves, but for the `self_test`.

    With that the valve opens by 1 mm and the motor vibrates: the cone has to be empty. For twins also PlantError and
    NoCompiler.
    """
    from scuhand_bt.devices import doctor

    bench = bench_of(lab) if twins else None
    with bench or nullcontext():
        spec = bench.spec if bench is not None else lab.cell
        return list(doctor.examine(spec, WallClock(), self_test=self_test))


def make_twins(
    lab: Lab,
    sources: "Mapping[str, Source]",
    *,
    at: Path | None = None,
    seed: int = 0,
    plant: str | None = None,
    faults: "FaultFile | None" = None,
    is_new: bool = False,
    of_run: bool = False,
) -> TwinsProcess:
    """Twins of a lab's devices on ports that any program can open, in a `with`; `go_on` until `end`.

    Their world is in the folder `at`, else in the lab's own, and goes on where it was unless it `is_new`. Raises
    PlantError, NoCompiler, and SourceError where another process has them.
    """
    folder = at or state_folder(lab) / FOLDER
    return TwinsProcess(folder, lab, sources, seed=seed, plant=plant, faults=faults, is_new=is_new, of_run=of_run)


def tell_twins(words: Sequence[str], *, at: Path | None = None, lab: Path | None = None) -> "Answer":
    """Say to twins that go on what a person does at the cell, and hear what became of it."""
    return say(at or find_state(lab) / FOLDER, list(words))


def folder_of_cell(cell: Path) -> Path:
    """The lab whose `robot/cell.yaml` this is. Raises ValueError for any other file."""
    folder = cell.absolute().parent.parent
    if folder / CELL_FILE != cell.absolute():
        raise ValueError(f"'{cell}' is not the {CELL_FILE} of a lab")
    return folder


def try_notification(lab: Lab) -> str | None:
    """Send a trial by the notification hook of `robot/cell.yaml`; why that failed, or None. ValueError without one."""
    if (spec := lab.cell.notify) is None:
        raise ValueError(f"{CELL_FILE} has no `notify:`; docs/unattended.md shows it.")
    return notify(spec, Notice("none", "none", simulated=True, state="ended", reason="scuhand-bt notify: a trial"))
