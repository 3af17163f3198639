"""The skill SDK: what a file in a lab's `skills/` folder is written with.

A skill is one thing the cell can do. It is a class whose annotated fields are its parameters and whose
`run` is a generator: each `yield` waits (see `scuhand_bt.clock.Wake`), `return` is success with a
result, `raise SkillFailed(code, detail)` is failure. When the tree halts a skill, its generator is
closed; its `finally` then sends safe commands and must not yield.

    class Shake(Skill[None]):
        \"\"\"Vibrate the cone for a while, to bring powder down its wall.\"\"\"

        devices = ("hand",)
        duration_s: Seconds = 2.0

        def run(self, cell: Cell) -> Steps[None]:
            cell.hand.set_vibration(1.0)
            try:
                yield from pause(cell, self.duration_s)
            finally:
                cell.hand.set_vibration(0.0)

In a workflow this is `- shake: {duration: 5 s}`: the name is the file's, and parameters lose the unit
of their field. `cell.record` writes into the journal: the shipped kinds of entries (`cell.record.event(Tared(...))`)
and a lab's own (`cell.record.note("lab.shaken", {...})`).
"""

import inspect
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, Literal, TypeVar

from pydantic import BaseModel, ConfigDict

from scuhand_bt import clock
from scuhand_bt.cell.believed import Believed
from scuhand_bt.cell.cell import Cell
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.clock import Clock, Signal, Steps, Wake, until
from scuhand_bt.events.cell import Discarded, Kept, Refilled, Returned, Scooped, SheetSwapped, ValveChecked
from scuhand_bt.events.doses import Dose, DoseCurve, Pulsed, ValueRecorded
from scuhand_bt.events.weighings import (
    BalanceDoubted,
    BalanceWatched,
    ContainerDiscarded,
    ContainerPlaced,
    DoseBegun,
    DoseWeighed,
    RepeatabilityMeasured,
    Reweighed,
    Tared,
    Weighed,
    WeightChecked,
)
from scuhand_bt.failures import Code, Failure, SkillFailed
from scuhand_bt.quantity import (
    Degrees,
    Milligrams,
    Millimetres,
    MillimetresPerSecond,
    Ratio,
    Seconds,
    plain_name,
)
from scuhand_bt.specs import Container, Keeping, OnPan, Powder, Source

__all__ = [
    "BalanceDoubted",
    "BalanceWatched",
    "Believed",
    "Cell",
    "Clock",
    "Code",
    "Condition",
    "Container",
    "ContainerDiscarded",
    "ContainerPlaced",
    "Degrees",
    "Discarded",
    "Dose",
    "DoseBegun",
    "DoseCurve",
    "DoseWeighed",
    "Failure",
    "Forecast",
    "Keeping",
    "Kept",
    "Milligrams",
    "Millimetres",
    "MillimetresPerSecond",
    "OnPan",
    "Powder",
    "Pulsed",
    "Ratio",
    "Refilled",
    "RepeatabilityMeasured",
    "Returned",
    "Reweighed",
    "Scooped",
    "Seconds",
    "SheetSwapped",
    "Signal",
    "Skill",
    "SkillFailed",
    "Source",
    "Steps",
    "Tared",
    "ValueRecorded",
    "ValveChecked",
    "Wake",
    "Weighed",
    "WeightChecked",
    "pause",
    "until",
]

R = TypeVar("R")


BY_HAND_S = 60.0
"""Time that a person takes to put a container on the pan, or to take it off."""


@dataclass(frozen=True, slots=True)
class Forecast:
    """What `plan` says of an action before it runs."""

    duration_s: float
    person: str | None = None
    """What a person has to do, if one is needed."""
    descent: tuple[str, float] | None = None
    """A place that the cone comes straight down to, and from how many mm above it; `plan` checks that this is
    possible."""

    @classmethod
    def of_change(cls, cell: CellSpec, typical_s: float, task: str) -> "Forecast":
        """The forecast of a change of the container: a changer takes `typical_s`, a person is told the `task`."""
        return cls(BY_HAND_S, task) if cell.changer.driver == "operator" else cls(typical_s)


class Skill(BaseModel, Generic[R]):
    """One thing the cell can do: typed parameters, and a generator that does it."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        alias_generator=plain_name,
        populate_by_name=True,
        ignored_types=(property,),
        allow_inf_nan=False,
    )

    devices: ClassVar[tuple[str, ...]] = ()
    """Devices that it commands, and so leases: arm, hand, balance, changer, and the names of the cell's `devices:`."""
    zones: ClassVar[tuple[str, ...]] = ()
    """Zones of the cell (`zones` of `robot/cell.yaml`) in which it moves something, and which it so leases."""
    failures: ClassVar[Mapping[str, Failure]] = {}
    """Failure codes of its own, each with meaning and remedy."""
    raises: ClassVar[tuple[str, ...]] = ()
    """Codes of the catalogue that its own code fails with, besides those of the devices and the engine (`explain`)."""
    empties_cone: ClassVar[bool] = False
    """Whether the cone is empty when it has succeeded, unless an input `keep` (`Keeping`) lets something stay."""
    typical_s: ClassVar[float] = 5.0
    interrupted: ClassVar[Literal["repeat", "reweigh", "ask"]] = "ask"
    """What a resumed run does with an action that had begun when the run was interrupted (a crash, a stop).

    "repeat": begin it again, after `settle`. "reweigh": the same, and `settle` weighs what had arrived. "ask": the
    operator says whether it is done or begins again, as only a person can tell."""

    @abstractmethod
    def run(self, cell: Cell) -> Steps[R]:
        """Do it: yield `Wake`s, return the result, or raise SkillFailed."""

    def settle(self, cell: Cell) -> Steps[None]:
        """Bring the cell to where this action, interrupted on its way, can begin again; nothing by default."""
        yield from ()

    @classmethod
    def forecast(cls, inputs: Mapping[str, Any], cell: CellSpec) -> Forecast:
        """The forecast; `inputs` holds those fields whose values are known before the run.

        For a skill that doses, with hand and balance, `source` is the one named last before it.
        """
        return Forecast(cls.typical_s)

    @classmethod
    def sees(cls) -> tuple[str, ...]:
        """The devices that it is given: those it leases, or those that a condition watches."""
        return cls.devices

    @classmethod
    def result_type(cls) -> Any:
        """The type of the result: `Dose` for `Skill[Dose]`."""
        for base in cls.__mro__:
            metadata = getattr(base, "__pydantic_generic_metadata__", None)
            if metadata and metadata["origin"] is Skill:
                return metadata["args"][0]
        return type(None)

    @classmethod
    def summary(cls) -> str:
        """The first line of its docstring."""
        return (inspect.getdoc(cls) or "").split("\n", 1)[0]


class Condition(Skill[None]):
    """A skill that only looks: it answers at once, commands nothing, and may guard a `while`."""

    watches: ClassVar[tuple[str, ...]] = ()
    """Devices whose news may change the answer; a `while` looks again whenever they report."""
    typical_s = 0.0

    @classmethod
    def sees(cls) -> tuple[str, ...]:
        return cls.watches

    @abstractmethod
    def check(self, cell: Cell) -> None:
        """Return if it holds; raise SkillFailed with the reason if not."""

    def run(self, cell: Cell) -> Steps[None]:
        self.check(cell)
        return
        yield  # makes this a generator, as every skill's run is


def pause(cell: Cell, duration_s: float) -> Steps[None]:
    """Let time pass."""
    return clock.pause(cell.clock, duration_s)
