"""The cell of a run in 3D, and how its arm moved in it: as its lab describes it today, which is said where that has
changed. None of the lab's own code is run for it.
"""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from scuhand_bt.events.weighings import BracketClosed, ContainerPlaced
from scuhand_bt.journal.events import ArmMoves
from scuhand_bt.journal.follow import Follower
from scuhand_bt.journal.kinds import parsed
from scuhand_bt.journal.reader import Contents
from scuhand_bt.journal.run_events import RunBegun
from scuhand_bt.lab import CELL_FILE, Lab, is_lab, load_bench, starter_lab
from scuhand_bt.problems import Mark, Problem, SourceError
from scuhand_bt.specs import Mortar

RIMS = tuple(0.3 + 0.085 * k for k in range(9))
"""Widths in which the cone is described, as shares of the sheet's diameter; the viewer draws those between two."""


def run_scene(journal: Path) -> dict[str, Any]:
    """The scene of a run. Raises SourceError for a lab that cannot be drawn."""
    now = Follower(journal, until_s=0.0)
    now.look()
    if now.begun is None:
        raise _undrawn(journal, "the run has not begun")
    folder = journal.absolute().parent.parent
    lab = load_bench(folder.parent if is_lab(folder.parent) else starter_lab())
    try:
        return {**scene_of(lab, _mortars(now.begun, lab)), "note": _note(now.begun, lab)}
    except (KeyError, ValueError) as error:
        raise _undrawn(journal, f"the cell cannot be drawn: {error}") from None


def scene_of(lab: Lab, mortars: Mapping[str, Mortar]) -> dict[str, Any]:
    """A lab's cell with a mortar at each of these stations, and the cone in every width that a motion may form.

    KeyError for a station that it does not have, ValueError for a cone that cannot be made.
    """
    from scuhand_bt.motion.scenes import CONE_DIAMETER_M
    from scuhand_bt.report.scene3d import scene_values

    rims_mm = [2.0 * lab.cell.hand.sheet_radius_mm * share for share in RIMS]
    stations = {name: [mm / 1000 for mm in station.position_mm] for name, station in lab.cell.stations.items()}
    offset_m = lab.cell.hand.apex_offset_mm / 1000
    values = scene_values(lab.motion_planner(mortars), offset_m, rims_mm, stations, lab.library.containers.values())
    return {**values, "usual_mm": 1000 * CONE_DIAMETER_M}


def run_motions(contents: Contents) -> list[dict[str, Any]]:
    """Every motion of a run's arm, in order, as `viewer/player.js` takes them."""
    jobs = {row["id"]: row["name"] for row in contents.rows("job")}
    kinds = (ArmMoves, ContainerPlaced, BracketClosed)
    marks = ", ".join(f"'{kind.KIND}'" for kind in kinds)
    query = f"SELECT job, time_s, kind, payload FROM entry WHERE kind IN ({marks}) ORDER BY seq"
    motions, pan = [], None
    for job, time_s, kind, payload in contents.database.execute(query):
        match parsed(kind, json.loads(payload)):
            case ContainerPlaced(kind=name):
                pan = name
            case BracketClosed():
                pan = None
            case ArmMoves() as move:
                values = move.model_dump(mode="json")
                motions.append({"job": jobs.get(job, "between the jobs"), "at_s": time_s, "pan": pan, **values})
    return motions


def _mortars(run: RunBegun, lab: Lab) -> dict[str, Mortar]:
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
