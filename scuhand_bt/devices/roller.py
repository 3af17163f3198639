"""How far the sheet is rolled, kept on disk: what turned the roller may be killed, and what it rolled stays rolled.

The roller drives the sheet by friction and has no mark. Its servo counts turns for as long as it has power, also those
that it was turned by hand; when it loses its power it still knows its angle, and not any more which turn that is in:

    rim = 2 R (1 - psi / (360 R k)),    psi = zero + count + 360 n

R the sheet's radius [mm], k roller degrees per mm of sheet, psi the roller's angle from the flat sheet, `zero` what psi
is at the servo's zero, all [deg]. n is 0 where no turns were lost; else every n is possible that makes a rim within
its limits, and a person says which (they are 360 / (pi k) = 10 mm apart).
"""

import math
import os
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from scuhand_bt.device_specs.hand import HandSpec
from scuhand_bt.dosing.cone import Cone
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.record import RecordLost

FILE_NAME = "roller.json"
BEYOND_DEG = 15.0
"""A roller that is farther than this from where its last move could lead was turned by something else."""


class RollerCount(BaseModel):
    """What is known of a roller's turns."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    set_up: tuple[float, ...]
    """Which servo, its direction, and what its angle means: a count with other ones tells nothing."""
    at_zero_deg: float
    """The roller's angle from the flat sheet at the servo's zero."""
    between_deg: tuple[float, float]
    """From where to where the last move could turn the servo."""
    is_intact: bool
    """False once the servo was found to have been without power since."""


class RollerRecord:
    """The last known count, in a file, or in memory only where `path` is None."""

    def __init__(self, hand: HandSpec, path: Path | None = None) -> None:
        options = hand.options
        self.set_up = (options.roller_id, options.roller_direction, hand.roller_deg_per_mm, hand.sheet_radius_mm)
        self._hand, self._path = hand, path
        self.count = self._read()
        """None where nothing is known."""

    def keep(self, at_zero_deg: float, between_deg: tuple[float, float]) -> None:
        """The roller is about to turn between these; on disk when this returns. Raises RecordLost."""
        self._write(RollerCount(set_up=self.set_up, at_zero_deg=at_zero_deg, between_deg=between_deg, is_intact=True))

    def turns_were_lost(self) -> None:
        """The servo was without power: before it is given torque again, so that no later program believes its count."""
        if self.count is not None:
            self._write(self.count.model_copy(update={"is_intact": False}))

    def _read(self) -> RollerCount | None:
        if self._path is None:
            return None
        try:
            count = RollerCount.model_validate_json(self._path.read_bytes())
        except (OSError, ValidationError):  # whatever it was: a person says
            return None
        return count if count.set_up == self.set_up and self._may_be(count) else None

    def _may_be(self, count: RollerCount) -> bool:
        """Whether its last move made rims within their limits, as every move does: a damaged figure seldom has."""
        least_deg, most_deg = turned_limits_deg(self._hand)
        ends_deg = [count.at_zero_deg + end_deg for end_deg in count.between_deg]
        return least_deg - BEYOND_DEG <= min(ends_deg) and max(ends_deg) <= most_deg + BEYOND_DEG

    def _write(self, count: RollerCount) -> None:
        if count == self.count:
            return
        if self._path is not None:
            try:
                _replace(self._path, count.model_dump_json())
            except OSError as error:
                raise RecordLost(f"how far the sheet is rolled cannot be written to {self._path}: {error}") from error
        self.count = count


def roller_lost() -> SkillFailed:
    """The failure of a roller that was to be turned and has lost its turns."""
    return SkillFailed(Code.HAND_ROLLER_LOST, "the roller has lost count of its turns, so it is not turned")


def rims_mm(turned_deg: float, hand: HandSpec) -> list[float]:
    """The rims within their limits that a roller may have made which stands at this angle of some turn, widest first.

    `turned_deg` is its angle from the flat sheet, but for whole turns.
    """
    least_deg, most_deg = turned_limits_deg(hand)
    first = math.ceil((least_deg - turned_deg) / 360.0)
    last = math.floor((most_deg - turned_deg) / 360.0)
    return [Cone.from_roller(turned_deg + 360.0 * n, hand).diameter_mm for n in range(first, last + 1)]


def turned_limits_deg(hand: HandSpec) -> tuple[float, float]:
    """The roller's angles from the flat sheet at the widest and at the narrowest rim."""
    narrowest_mm, widest_mm = hand.rim_limits_mm
    least_deg, most_deg = (Cone(rim_mm, hand.sheet_radius_mm).roller_deg(hand) for rim_mm in (widest_mm, narrowest_mm))
    return least_deg, most_deg


def _replace(path: Path, text: str) -> None:
    """The file as it was, or as it is to be, whatever happens meanwhile."""
    path.parent.mkdir(parents=True, exist_ok=True)
    written = path.with_suffix(".new")
    with written.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    written.replace(path)
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
