"""The cell of a run, for the page to draw: as its lab describes it today; the page says where that has changed."""

import hashlib
from pathlib import Path
from typing import Any

from scuhand_bt.journal.events import ArmMoves, RunBegun
from scuhand_bt.journal.follow import Follower
from scuhand_bt.journal.reader import open_journal
from scuhand_bt.lab import CELL_FILE, Lab, is_lab, load_lab, starter_lab
from scuhand_bt.problems import Mark, Problem, SourceError

_RIMS = f"SELECT DISTINCT ROUND(json_extract(payload, '$.cone_mm')) FROM entry WHERE kind = '{ArmMoves.KIND}' LIMIT 40"
MOST_RIMS = 12
"""Widths that the cone is drawn in."""


def run_scene(folder: Path, journal: Path) -> dict[str, Any]:
    """The scene of a run of the lab whose state is in `folder`. Raises SourceError for a lab that cannot be drawn."""
    from scuhand_bt.motion.scenes import CONE_DIAMETER_M
    from scuhand_bt.report.scene3d import scene_values

    now = Follower(journal, until_s=0.0)
    now.look()
    if now.begun is None:
        raise _undrawn(journal, "the run has not begun")
    lab = load_lab(folder.parent if is_lab(folder.parent) else starter_lab())
    usual_mm = 1000 * CONE_DIAMETER_M
    with open_journal(journal) as (database, _):
        rims = sorted({float(row[0]) for row in database.execute(_RIMS) if row[0]} | {usual_mm})
    try:
        values = scene_values(
            lab.motion_planner(_mortars(now.begun, lab)),
            lab.cell.hand.apex_offset_mm / 1000,
            [*rims[:: max(1, -(-len(rims) // MOST_RIMS))], usual_mm],
            {name: [mm / 1000 for mm in station.position_mm] for name, station in lab.cell.stations.items()},
            lab.library.containers.values(),
        )
    except (KeyError, ValueError) as error:
        raise _undrawn(journal, f"the cell cannot be drawn: {error}") from None
    return {**values, "usual_mm": usual_mm, "note": _note(now.begun, lab)}


def _mortars(run: RunBegun, lab: Lab) -> dict[str, Any]:
    """The mortar at each station of a source; of an older journal the largest there is."""
    largest = max(lab.library.mortars.values(), key=lambda one: one.outer_diameter_mm)
    used = {source.station: lab.library.mortars.get(source.mortar, largest) for source in run.sources.values()}
    return {name: mortar for name, mortar in used.items() if name in lab.cell.stations}


def _note(run: RunBegun, lab: Lab) -> str:
    """What is to be known of the picture."""
    drag = "Drag to turn, wheel or pinch to zoom, arrow keys to shift. Red: the way of the cone's tip."
    before = run.lab_files.get(CELL_FILE.as_posix())
    now = hashlib.sha256((lab.folder / CELL_FILE).read_bytes()).hexdigest()
    return (
        drag if before in (None, now) else f"{drag} The cell has been changed since this run: it is drawn as it is now."
    )


def _undrawn(journal: Path, why: str) -> SourceError:
    return SourceError([Problem(Mark(str(journal)), why)])
