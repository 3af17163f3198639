"""Plans on disk: a later run in the same cell finds what was planned before.

A file holds the plans of one geometry. Its name is a hash of the URDF, what a cell says about motion, the mortars,
this package's source and its libraries. So a plan is looked up only where the same would be planned again. It is not
trusted: the planner proves every plan again before it is used (`MotionPlanner`).
"""

import hashlib
import importlib.metadata
import os
import zipfile
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from tempfile import NamedTemporaryFile

import numpy as np

from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.motion.kinematics import Floats
from scuhand_bt.motion.trajectory import JointTrajectory
from scuhand_bt.program import source_digest
from scuhand_bt.specs import Mortar

GEOMETRIES_KEPT = 32
"""How many files are kept, the latest; each has a megabyte or two."""
_LIBRARIES = ("coal", "numpy", "pin", "ruckig", "scipy")
_MOVING = ("arm", "hand", "stations", "geometry", "zones")
"""What a cell says about motion; its balance, for instance, does not matter."""
_WIRING = {"driver", "port", "options"}
"""How an arm or hand is connected, which does not matter either."""
_PRESSED = {"sheet_thickness_mm"}
"""By which a skill reckons how hard a lip may be pressed; no way is another by it."""
_UNREADABLE = (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile)
"""What reading a damaged or foreign file raises."""


class PlanStore:
    """The stored plans of one geometry. If the folder cannot be read or written, nothing is stored, without an
    error.
    """

    def __init__(self, folder: Path, urdf: str, cell: CellSpec, mortars: Mapping[str, Mortar]) -> None:
        of_no_way = {"arm": _WIRING, "hand": _WIRING | _PRESSED}
        moving = cell.model_dump(include=set(_MOVING), exclude=of_no_way, warnings=False)
        depends = (_source(), urdf, repr(moving), sorted((name, repr(mortar)) for name, mortar in mortars.items()))
        self._path = folder / f"{hashlib.sha256(repr(depends).encode()).hexdigest()[:32]}.npz"
        self._plans = self._written()
        self._is_new = self._has_written = False
        with suppress(OSError):
            os.utime(self._path)  # so that a file in use does not become the oldest

    def _written(self) -> dict[str, tuple[Floats, Floats]]:
        """What is in the file, by whomever."""
        with suppress(*_UNREADABLE), self._path.open("rb") as file, np.load(file, allow_pickle=False) as found:
            names = [name.removesuffix(".knots") for name in found.files if name.endswith(".knots")]
            return {name: (found[f"{name}.knots"], found[f"{name}.cubics"]) for name in names}
        return {}

    def found(self, request: str, spill_limit_deg: float | None) -> JointTrajectory | None:
        """The plan of a request, unproven; None if there is none."""
        kept = self._plans.get(_name(request))
        if kept is None:
            return None
        knots_s, coefficients = kept
        if coefficients.ndim != 3 or len(coefficients) != 4 or not np.isfinite(coefficients).all():
            return None
        with suppress(ValueError, IndexError):
            return JointTrajectory(knots_s, coefficients, spill_limit_deg)
        return None

    def keep(self, request: str, motion: JointTrajectory, *, is_common: bool) -> None:
        """Remember a plan until it is written. After the first writing, only plans that other runs may ask for too.

        What a run needs as it goes, such as a way from the end of a stroke, is asked for again once in a thousand
        scoops.
        """
        if self._has_written and not is_common:
            return
        self._plans[_name(request)] = motion.knots_s, motion.coefficients
        self._is_new = True

    def write(self) -> None:
        """Write all plans to the file, if there is a new one, and delete the files of the oldest geometries."""
        self._has_written = True
        if not self._is_new:
            return
        arrays = {}
        for name, (knots_s, coefficients) in {**self._written(), **self._plans}.items():
            arrays[f"{name}.knots"], arrays[f"{name}.cubics"] = knots_s, coefficients
        with suppress(OSError):
            folder = self._path.parent
            folder.mkdir(parents=True, exist_ok=True)
            with NamedTemporaryFile(dir=folder, suffix=".part", delete=False) as part:
                try:
                    np.savez(part, allow_pickle=False, **arrays)
                    part.close()
                    Path(part.name).replace(self._path)  # atomically
                except OSError:
                    Path(part.name).unlink(missing_ok=True)
                    raise
            self._is_new = False
            by_age = sorted(folder.glob("*.npz"), key=lambda path: path.stat().st_mtime, reverse=True)
            for old in by_age[GEOMETRIES_KEPT:]:
                old.unlink(missing_ok=True)


def _name(request: str) -> str:
    return hashlib.blake2b(request.encode(), digest_size=16).hexdigest()


@cache
def _source() -> str:
    """What determines plans besides the cell: this package's source, and the versions of its libraries."""
    versions = [importlib.metadata.version(name) for name in _LIBRARIES]
    return f"{source_digest('motion')} {versions}"
