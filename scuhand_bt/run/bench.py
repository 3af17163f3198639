"""A bench with twins of all devices of a lab's cell, and what these cannot show."""

import sys
from collections.abc import Mapping
from pathlib import Path

from scuhand_bt.clock import Clock
from scuhand_bt.drivers import NAMED_KINDS, UNWIRED, NotPluggable, is_ours
from scuhand_bt.lab import Lab, cell_mark
from scuhand_bt.problems import Problems
from scuhand_bt.run.clock import WallClock
from scuhand_bt.sim.fault_rules import OUTAGES, FaultFile
from scuhand_bt.sim.faults import Faults
from scuhand_bt.sim.wire.bench import WireBench
from scuhand_bt.sim.wire.scene import twin_of
from scuhand_bt.specs import Source

NOT_ON_TWINS = dict.fromkeys(OUTAGES, "twins that have ended are there again as they were")
NOT_WITHOUT_A_RUN = {**NOT_ON_TWINS, "operator.refuses": "nobody is asked by twins alone"}
NOT_WITHOUT_A_RECIPE = {
    "powder.clog": "no powder is behind twins alone",
    "cone.leak": "no powder is behind twins alone",
    "scoop.nothing": "no powder is behind twins alone",
    "vibration.dead": "no powder is behind twins alone that would feel it",
    "container.wrong": "nothing is put on the pan of twins alone",
    **NOT_WITHOUT_A_RUN,
}
"""Faults that twins cannot show, and why."""


def find_plants(lab: Lab) -> None:
    """Make modules of the lab and the working folder importable, for plants. They come last, so they hide nothing."""
    sys.path.extend(folder for folder in (str(lab.folder), str(Path.cwd())) if folder not in sys.path)


def require_twins(lab: Lab) -> None:
    """Raises SourceError if a device of the cell has no twin, so that it cannot be rehearsed."""
    problems, cell = Problems(), lab.cell
    for name in cell.device_names:
        kind, driver = cell.kind_of(name), cell.section(name).driver
        try:
            if (kind, driver) not in UNWIRED and (not is_ours(kind, driver) or kind in NAMED_KINDS):
                twin_of(kind, driver)
                if kind in ("arm", "hand"):
                    raise NotPluggable(
                        f"'{driver}': the world of a rehearsal has no place for the twin of another {kind}"
                    )
        except NotPluggable as error:
            keys = (name, "driver") if kind == name else ("devices", name, "driver")
            problems.add(cell_mark(lab, *keys), f"driver {error}", "a dry run simulates it", code="no-twin")
    problems.raise_any()


def bench_of(
    lab: Lab,
    seed: int = 0,
    faults: FaultFile | None = None,
    sources: Mapping[str, Source] | None = None,
    *,
    plant: str | None = None,
    ports: Path | None = None,
    clock: Clock | None = None,
    of_run: bool = False,
) -> WireBench:
    """The twins of a lab's cell: arm parked, nothing on the pan, the powder of `sources` in their mortars.

    `ports` is the folder for their ports; None for a temporary one. `of_run`: a run will tell them of its samples.
    Raises NoCompiler, PlantError, and SourceError for faults that could have no effect.
    """
    require_twins(lab)
    find_plants(lab)
    if faults is not None and of_run:
        faults.refuse(NOT_ON_TWINS)
    elif faults is not None:
        faults.refuse(NOT_WITHOUT_A_RUN if sources else NOT_WITHOUT_A_RECIPE, "twins alone know of no sample")
    return WireBench(
        lab.cell,
        sources or {},
        lab.folder / "robot" / "firmware",
        lab.motion_planner({}).home(),
        clock or WallClock(),
        seed,
        plant,
        ports,
        Faults(faults.rules if faults is not None else (), seed),
    )
