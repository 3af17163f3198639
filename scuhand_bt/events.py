"""What skills write into a run's journal: one model for each kind of entry, and notes for all that a lab invents.

The engine's own kinds (the run, its jobs and actions, verdicts, questions) are in `journal/events.py`. An entry's
payload is the model as JSON: what was not set is not written, and what a reader does not know is passed over.
"""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, TypeAlias

from pydantic import BaseModel, BeforeValidator, ConfigDict, JsonValue, TypeAdapter, ValidationError

from scuhand_bt.problems import shorten
from scuhand_bt.specs import Verdict


def readable(text: str) -> str:
    """A text from outside (a path, an answer) may hold what UTF-8 cannot: that is written as an escape."""
    return text if text.isascii() else text.encode("utf-8", "backslashreplace").decode()


Text = Annotated[str, BeforeValidator(lambda text: readable(text) if isinstance(text, str) else text)]


class Values(BaseModel):
    """A part of an entry."""

    model_config = ConfigDict(frozen=True, extra="ignore", ser_json_inf_nan="strings")


class Event(Values):
    """An entry of the journal."""

    KIND: ClassVar[str]
    SHAPE: ClassVar[int] = 1
    """The version of the kind's payload: one more when a reader of before would misread it. Written from 2 on."""

    def entry(self) -> tuple[str, str]:
        """Kind and payload (JSON), as the journal keeps them."""
        payload = self.model_dump_json(exclude_unset=True)
        return self.KIND, payload if self.SHAPE == 1 else json.dumps({**json.loads(payload), "shape": self.SHAPE})


class SkillEvent(Event):
    """An entry that a skill may write."""


# --- weighings


class Line(Values):
    """One line of the balance."""

    raw: str
    """As it came, one character for each byte (latin-1)."""
    value_mg: float
    unit: str
    """The unit that the balance showed."""
    stable: bool
    time_s: float = 0.0
    """The run's time."""


class Weighing(Values):
    """A mean of stable readings of the balance."""

    gross_mg: float
    uncertainty_mg: float | None = None
    """Standard uncertainty of the mean."""
    readings: tuple[Line, ...] = ()
    """What it is the mean of."""


class ContainerPlaced(SkillEvent):
    """A container was put on the pan, and weighed."""

    KIND: ClassVar = "container"

    container: Text
    """Its id."""
    kind: Text
    """Its name in `containers.yaml`."""
    mass_mg: float
    balance: Text = ""
    """What the balance answered when asked who it is."""
    bare: Weighing | None = None
    """The pan before."""
    loaded: Weighing | None = None
    delay_s: float | None = None
    """How late the balance has shown it; none where that cannot be told."""


class ContainerAgain(SkillEvent):
    """The first container of a run was taken off the pan and put back, and weighed again about the bare pan."""

    KIND: ClassVar = "container_again"

    container: Text
    bare: Weighing
    loaded: Weighing
    difference_mg: float
    """Against the time before."""
    allowance_mg: float
    """How far the two may be apart by chance; where they are farther, the zero has stepped in between."""


class ArmFreed(SkillEvent):
    """The arm stood where it touches something, in the model, and has gone out of that slowly."""

    KIND: ClassVar = "arm_freed"

    what: Text
    """What touched what, and by how much."""
    duration_s: float


class WayObstructed(SkillEvent):
    """Something was seen in the arm's way: it was stopped, or waited until it was gone or there was a way around it."""

    KIND: ClassVar = "way_obstructed"

    stopped: bool
    """Whether it was under way."""
    waited_s: float


class BalanceSlower(SkillEvent):
    """The balance has shown a container later than it was known to: what doses have taught of it is given up."""

    KIND: ClassVar = "balance_slower"

    delay_s: float
    known_s: float
    """How late it was known to be."""


class BalanceDoubted(SkillEvent):
    """A stable mean contradicts what a controller took to be on the pan: what is known of the balance is given up."""

    KIND: ClassVar = "balance_doubted"

    difference_mg: float
    """The mean less the estimate."""
    allowed_mg: float
    """By how much they may differ."""
    lag_s: float
    """What was believed."""


class Tared(SkillEvent, Weighing):
    """The container was weighed before its first powder."""

    KIND: ClassVar = "tare"

    balance: Text = ""


class Reweighed(SkillEvent, Weighing):
    """After an interruption in a dose: what had arrived by then."""

    KIND: ClassVar = "reweighed"

    arrived_mg: float


class DoseBegun(SkillEvent, Weighing):
    """The pan was weighed with the hand in place, and the valve may open."""

    KIND: ClassVar = "dose_begun"

    lot: Text
    target_mg: float


class ContainerLifted(SkillEvent, Weighing):
    """The filled container was weighed, the hand away, and may be taken off the pan."""

    KIND: ClassVar = "container_lifted"

    container: Text


class DoseWeighed(SkillEvent, Weighing):
    """The pan was weighed and watched after a dose, the hand in place and the valve shut."""

    KIND: ClassVar = "dose_weighed"

    lot: Text
    before: Weighing
    """Just before the valve opened, the hand in place."""
    gained_mg: float
    """What has come between the two, the drift taken out."""
    gained_uncertainty_mg: float
    drift_mg_per_s: float
    """What was taken out: 0 where no drift was seen."""


class LotDosed(Values):
    """What of one powder lot is in a container."""

    net_mg: float
    uncertainty_mg: float


class Weighed(SkillEvent, Weighing):
    """A container was weighed, whatever is in it: the result of `weigh`."""

    KIND: ClassVar = "weighed"

    container: Text
    net_mg: float
    """What it has gained since it was weighed empty, a drift that was seen taken out."""
    net_uncertainty_mg: float
    """Standard uncertainty of `net_mg`."""


class ContainerDiscarded(SkillEvent):
    """A container is thrown away with what is in it: its doses of this job count no more."""

    KIND: ClassVar = "container_discarded"

    container: Text


class BracketClosed(SkillEvent):
    """A container has gone, and the bare pan was weighed: what it has gained, against what was dosed into it."""

    KIND: ClassVar = "bracket"

    container: Text
    net_mg: float
    """By the bare pan before and after."""
    uncertainty_mg: float
    difference_mg: float
    """That less what was dosed."""
    allowance_mg: float
    """How far they may be apart."""
    zero_mg: float
    """How far the bare pan's reading has moved."""
    closes: bool
    doses: dict[Text, LotDosed]
    """By powder lot, adjusted to both measurements."""
    bare: Weighing | None = None
    """The pan after the container."""


class WeightChecked(SkillEvent):
    """A check weight was put on the pan, and weighed."""

    KIND: ClassVar = "check_weight"

    weight_mg: float
    error_mg: float
    tolerance_mg: float | None = None
    balance: Text = ""
    bare: Weighing | None = None
    loaded: Weighing | None = None


class RepeatabilityMeasured(SkillEvent):
    """A check weight was put on the pan several times."""

    KIND: ClassVar = "repeatability"

    weight_mg: float
    weighings: int
    repeatability_mg: float
    """Standard deviation of what it weighed."""
    balance: Text = ""


class BalanceWatched(SkillEvent):
    """The balance was read for a while with nothing changing on its pan."""

    KIND: ClassVar = "balance_watched"

    readings: int
    """How many there were."""
    span_mg: float
    """How far they went apart."""
    noise_mg: float | None = None
    """Standard deviation of a reading about the drift."""
    drift_mg_per_s: float | None = None


# --- dosing


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


# --- powder, sheet and valve


class Scooped(SkillEvent):
    """Powder was scooped into the cone."""

    KIND: ClassVar = "scoop"

    source: Text
    expected_mg: float
    """What the stroke should have collected."""
    open_mm: float
    """The rim's diameter at the stroke's beginning."""
    closed_mm: float
    """And at its end."""
    heading_deg: float | None = None
    """The direction of the swing about the vertical; this and what follows are not in journals of upright scoops."""
    gap_mm: float | None = None
    """Between the lip and the wall; less than 0: so far it was pressed into it."""
    lip_force_n: float | None = None
    """What that takes, by the sheet's bending stiffness."""
    duration_s: float | None = None
    """Of the motion of arm and roller."""


class Returned(SkillEvent):
    """What was in the cone went back into its mortar."""

    KIND: ClassVar = "returned"

    source: Text
    expected_mg: float


class Kept(SkillEvent):
    """What was left in the cone stays there for the next sample of its lot."""

    KIND: ClassVar = "kept"

    source: Text
    expected_mg: float


class Discarded(SkillEvent):
    """What was in the cone went to waste, or into another vessel."""

    KIND: ClassVar = "discarded"

    expected_mg: float
    source: Text | None = None
    """Of which it was; this and what follows are not in journals of earlier versions."""
    to: Text | None = None
    """The station of what it went into."""


class SheetSwapped(SkillEvent):
    """A fresh sheet is in the hand."""

    KIND: ClassVar = "sheet"

    sheets_used: int
    touched: Text | None = None
    """The powder lot that the old one, the rollers and the passive clamp had touched; these were wiped."""


class Refilled(SkillEvent):
    """A person has put more powder into the mortar of a source."""

    KIND: ClassVar = "refilled"

    source: Text
    mass_mg: float
    holds_mg: float
    """What the source is believed to hold now."""


class ValveChecked(SkillEvent):
    """The valve was opened and shut over the waste bin."""

    KIND: ClassVar = "valve_zero"

    opening_mm: float
    """Where the shut valve stands."""


# --- a sample's row


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


SKILL_EVENTS: tuple[type[SkillEvent], ...] = (
    ContainerPlaced,
    Tared,
    Pulsed,
    Dose,
    DoseCurve,
    DoseBegun,
    DoseWeighed,
    Weighed,
    ContainerDiscarded,
    ContainerLifted,
    ContainerAgain,
    BracketClosed,
    Reweighed,
    WeightChecked,
    RepeatabilityMeasured,
    BalanceWatched,
    BalanceSlower,
    BalanceDoubted,
    ArmFreed,
    WayObstructed,
    Scooped,
    Returned,
    Kept,
    Discarded,
    SheetSwapped,
    Refilled,
    ValveChecked,
    ValueRecorded,
)
"""All that skills write, beside a lab's own notes."""

# --- a lab's own

NOTE_PREFIX = "lab."
NOTE_KIND = r"lab(\.[a-z][a-z0-9_]*)+"
_JSON: TypeAdapter[dict[str, JsonValue]] = TypeAdapter(dict[str, JsonValue], config=ConfigDict(allow_inf_nan=False))


@dataclass(frozen=True)
class Note:
    """An entry of a kind that a lab's skill invents: `lab.` and a name, with any JSON as `values`.

    Raises ValueError for a kind without the prefix, and for values that are no JSON.
    """

    kind: str
    values: Mapping[str, JsonValue]

    def __post_init__(self) -> None:
        if not isinstance(self.kind, str) or not re.fullmatch(NOTE_KIND, self.kind):
            name = (
                re.sub(r"[^a-z0-9_.]+", "_", str(self.kind).lower().removeprefix(NOTE_PREFIX)).strip("_.") or "sieved"
            )
            example = f'`cell.record.note("{NOTE_PREFIX}{name}", {{…}})`'
            raise ValueError(f"{self.kind!r} is no kind that a lab may write: write {example}")
        try:
            _JSON.validate_python(self.values, strict=True)
        except ValidationError as error:
            wrong = error.errors(include_url=False)[0]
            raise ValueError(
                f"{shorten(repr(wrong['input']))} among the values of {self.kind!r} is no JSON: write finite numbers, "
                "texts, True, False, None, and lists and dicts (with texts as keys) of these"
            ) from None

    def entry(self) -> tuple[str, str]:
        """Kind and payload (JSON), as the journal keeps them."""
        return self.kind, _JSON.dump_json(dict(self.values)).decode()
