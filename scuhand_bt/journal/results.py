"""How samples came out: the journal's entries of kind `sample`, and what a person chose for one that failed."""

from dataclasses import dataclass, field
from typing import ClassVar, Literal

from scuhand_bt.events.doses import Dose, ValueRecorded
from scuhand_bt.events.entry import Event, Note, Text, Values
from scuhand_bt.events.weighings import ContainerDiscarded
from scuhand_bt.recipe.composition import Composition
from scuhand_bt.specs import Verdict

SampleVerdict = Literal[Verdict, "not as asked", "no dose", "recorded", "skipped", "interrupted", "not run"]


@dataclass
class SoFar:
    """What the entries of a job, in their order, tell of its sample."""

    doses: list[Dose] = field(default_factory=list)
    """Those that count."""
    recorded: dict[str, ValueRecorded] = field(default_factory=dict)
    """By name."""

    def note(self, event: Event | Note) -> None:
        """Take an entry into account."""
        match event:
            case Dose():
                self.doses.append(event)
            case ContainerDiscarded():
                self.doses = [dose for dose in self.doses if dose.container != event.container]
            case ValueRecorded():
                self.recorded[event.name] = event

    def copy(self) -> "SoFar":
        return SoFar(list(self.doses), dict(self.recorded))


class DoseResult(Values):
    """What one powder lot came to in one container of a sample."""

    container: Text
    lot: Text
    target_mg: float
    tolerance_mg: float
    dispensed_mg: float
    uncertainty_mg: float
    verdict: Verdict
    bracket: Literal["open", "closed", "does not close"] = "open"
    """Whether the bare pan after the container confirms what was dosed into it."""
    zero_uncertainty_mg: float = 0.0
    """What of the uncertainty is for steps and drifts of the balance's zero, as the run has seen them elsewhere."""
    lasted_s: float = 0.0
    """How long it took to come, between two weighings."""
    true_mg: float | None = None
    """The simulation's, of all that the container holds, whichever lot; None on a real cell."""

    @property
    def error_mg(self) -> float:
        return self.dispensed_mg - self.target_mg

    @property
    def is_open(self) -> bool:
        """In tolerance as far as it is known, and its container is still to go."""
        return self.verdict == "in tolerance" and self.bracket == "open"

    @property
    def is_good(self) -> bool:
        """In tolerance, and confirmed."""
        return self.verdict == "in tolerance" and self.bracket == "closed"


class SampleResult(Event):
    """A sample has its result: one line of the table at the end.

    It comes again when the sample's container has gone, and the bare pan was weighed.
    """

    KIND: ClassVar = "sample"

    id: Text
    container: Text | None
    target_mg: float | None
    dispensed_mg: float | None
    error_mg: float | None
    uncertainty_mg: float | None
    tolerance_mg: float | None
    pulses: int
    scoops: int
    vibration_s: float
    duration_s: float
    controller: str | None
    verdict: SampleVerdict
    code: str | None
    """Of the failure, if there was one."""
    detail: Text | None
    true_mg: float | None
    """The simulation's, of what is in the container, for judging; None on a real cell."""
    attempt: int = 1
    doses: tuple[DoseResult, ...] = ()
    """Every powder lot in every container. Masses and controller above are of the one that the recipe asks for, or the
    last; pulses, scoops, vibration and duration of all."""
    recorded: tuple[ValueRecorded, ...] = ()
    """What its workflow has recorded of it (`record`)."""
    composition: Composition | None = None
    """What it was to be composed of, and what its doses come to; None where its recipe gives masses."""

    @property
    def is_open(self) -> bool:
        """All is well as far as it is known, and a container is still to go."""
        is_well = self.code is None and self.verdict == "in tolerance"
        return is_well and any(dose.bracket == "open" for dose in self.doses)

    @property
    def was_tried(self) -> bool:
        """It has come to an end; a resumed run has all others before it."""
        return self.verdict not in ("interrupted", "not run")

    @property
    def overshot_mg(self) -> float | None:
        """By how much the worst of its doses is beyond its target, if that is beyond its tolerance too."""
        return max((dose.error_mg for dose in self.doses if dose.error_mg > dose.tolerance_mg), default=None)

    @property
    def is_good(self) -> bool:
        """All doses in tolerance and confirmed, or a workflow that was to dose nothing; and no failure."""
        wanted = ("no dose", "recorded") if self.target_mg is None else ("in tolerance",)
        is_composed = self.composition is None or self.composition.verdict == "in tolerance"
        return self.code is None and self.verdict in wanted and all(dose.is_good for dose in self.doses) and is_composed


class Chosen(Event):
    """A person chose what a sample's failure means (`on_failure: ask`)."""

    KIND: ClassVar = "chosen"

    sample: Text
    attempt: int
    action: str
