"""What skills write of doses, and of what else is in a sample's row."""

from typing import ClassVar, Literal, TypeAlias

from scuhand_bt.events.entry import SkillEvent, Text
from scuhand_bt.events.weighings import Line
from scuhand_bt.specs import Verdict


class Pulsed(SkillEvent):
    """One opening of the valve while dosing, or a rest (`settle`), and the weighing after it."""

    KIND: ClassVar = "pulse"

    kind: Literal["pulse", "settle"]
    opening_mm: float | None = None
    """Commanded, as `dwell_s` and `vibration`; absent where the valve stayed shut."""
    dwell_s: float | None = None
    vibration: float | None = None
    """0 (off) to 1."""
    began_s: float | None = None
    ended_s: float | None = None
    net_mg: float
    """What is in the container."""
    uncertainty_mg: float
    """Standard uncertainty of `net_mg`."""
    gross_mg: float | None = None
    readings: tuple[Line, ...] = ()


class Dose(SkillEvent):
    """The result for one container, in tolerance or not; the last one written for a job is its dose."""

    KIND: ClassVar = "dose"

    container: Text = ""
    """Its id, and the powder lot: a dose is of one lot into one container."""
    lot: Text = ""
    target_mg: float
    tolerance_mg: float
    dispensed_mg: float
    """By a stable mean of the balance: gross now less gross before."""
    uncertainty_mg: float
    """Standard uncertainty of `dispensed_mg`."""
    lasted_s: float = 0.0
    """From the weighing before it to the one after it: what the balance's zero did meanwhile is in it."""
    pulses: int
    vibration_s: float
    duration_s: float
    controller: str
    verdict: Verdict

    @property
    def error_mg(self) -> float:
        return self.dispensed_mg - self.target_mg


CurveRow: TypeAlias = tuple[float, float, float, float, bool, float]


class DoseCurve(SkillEvent):
    """A part of a dose's course, for a plot: the parts of an action, one after another, are its course."""

    KIND: ClassVar = "dose_curve"

    points: tuple[CurveRow, ...]
    """Time [s], net [mg], opening [mm], vibration (0 to 1), stable, the controller's estimate [mg]."""


class ValueRecorded(SkillEvent):
    """A value for the sample's row; one of the same name before it in this job does not count any more."""

    KIND: ClassVar = "recorded"

    name: Text
    value: bool | int | float | Text
    unit: str = ""
    """Empty for a number, a text and a flag."""

    def __str__(self) -> str:
        shown = f"{self.value:.6g}" if isinstance(self.value, float) else str(self.value)
        return f"{shown} {self.unit}".strip()
