"""The engine's kinds of entries about the whole run: what it is, how it went on and how it ended.

Fields with a default are absent in journals of before they were written.
"""

from typing import ClassVar

from pydantic import ConfigDict, Field, JsonValue

from scuhand_bt.events.entry import Event, Text, Values


class SourceUsed(Values):
    """A source of the recipe."""

    station: Text
    powder: Text
    lot: Text
    mortar: Text = ""
    """Its name in `containers.yaml`; empty in older journals."""


class SamplePlanned(Values):
    """A sample of the recipe, with its inputs as `action_started` has them."""

    id: Text
    workflow: str
    inputs: dict[str, JsonValue]
    done_s: float | None = None
    """When it is to be done, by the plan's forecast, from the beginning of the run."""


class OptionsGiven(Values):
    """What the command line said, as a resumed run needs it."""

    controller: str | None = None
    plant: str | None = None
    speed: float | None = None
    faults: Text | None = None
    """The fault file's name."""
    asks: bool = False
    """A person was asked in a simulation, too."""
    step: bool = False
    """A person was asked before each action."""
    slow_ratio: float = 1.0
    """Of the cell's own speeds."""


class RunBegun(Event):
    """The first entry: what the whole run is, before anything moves."""

    KIND: ClassVar = "run"

    run: Text
    """Its id."""
    recipe: Text
    recipe_hash: str
    """SHA-256 of the recipe and its tables."""
    recipe_text: Text = ""
    recipe_path: Text
    lab: Text = ""
    """Its folder."""
    lab_files: dict[Text, str] = Field(default_factory=dict)
    """SHA-256 of each of the lab's files."""
    modules: dict[Text, str] | None = None
    """SHA-256 of each module beside the lab that its skills and drivers are made of; older journals name none."""
    cell: Text
    simulated: bool
    unattended: bool = False
    mode: str
    """In words: real devices, TWINS, SIMULATED, REHEARSAL."""
    seed: int | None = None
    plant: str | None = None
    """The simulated physics."""
    controller: str
    faults_hash: str | None = None
    """SHA-256 of the fault file."""
    faults_text: Text | None = None
    options: OptionsGiven = OptionsGiven()
    sources: dict[Text, SourceUsed] = Field(default_factory=dict)
    samples: list[SamplePlanned] | None = None
    planned_s: float | None = None
    """When all is to be done, also what comes after the last sample, by the plan's forecast, from the beginning."""
    operator: Text | None = None
    signed: bool = False
    """The operator has proven it by a PIN."""
    devices: dict[str, dict[str, JsonValue]] = Field(default_factory=dict)
    """Each device as `cell.yaml` has it."""
    version: str
    """Of scuhand_bt."""
    libraries: dict[str, str] = Field(default_factory=dict)
    started: str
    """ISO 8601 with its offset from UTC."""
    ledger: str | None = None
    """The head of the lab's ledger before this run."""

    @property
    def code_files(self) -> dict[str, str]:
        """SHA-256 of all that the run was made of beside its recipe and the program: the lab's files, own modules."""
        return {**self.lab_files, **(self.modules or {})}


class Resumed(Event):
    """An interrupted run goes on."""

    KIND: ClassVar = "resumed"

    last_at: str
    """Wall time of the last entry before."""
    changes: list[Text]
    """What had changed since, and was accepted."""
    version: str
    operator: Text | None = None
    signed: bool = False
    """The operator has proven it by a PIN."""


class Paused(Event):
    """The run stands still because a person wished it."""

    KIND: ClassVar = "paused"

    by: Text | None = None
    """Who; None where the journal is older, or the wish came by a signal."""
    signed: bool = False
    """With this person's PIN."""


class Continued(Event):
    """A person let the paused run go on."""

    KIND: ClassVar = "continued"

    by: Text | None = None
    """As of `paused`."""
    signed: bool = False


class Ended(Event):
    """The run has ended, and said so; a run without this entry after its last `resumed` was interrupted."""

    KIND: ClassVar = "ended"

    exit_code: int
    reason: Text
    """Empty where all went well."""
    complete: bool | None = None
    """Nothing is left that could be resumed."""
    by: Text | None = None
    """Who stopped it, if a person did; as of `paused`."""
    signed: bool = False

    @property
    def is_complete(self) -> bool:
        return self.exit_code <= 1 if self.complete is None else self.complete


class NotResumable(Event):
    """The simulated world could not be kept: the run cannot be resumed."""

    KIND: ClassVar = "not_resumable"

    why: Text


class Matter(Event):
    """A simulated run has ended: what its world holds, one key for each compartment [mg]."""

    KIND: ClassVar = "matter"
    model_config = ConfigDict(extra="allow")

    __pydantic_extra__: dict[str, float]


class RuleAccount(Values):
    """A rule of the fault file, and when its fault came."""

    fault: str
    came_s: list[float]


class FaultRules(Event):
    """A run with a fault file has ended: when each rule's fault came."""

    KIND: ClassVar = "fault_rules"

    rules: list[RuleAccount]


class Trouble(Event):
    """Something beside the batch is wrong: a notification failed, what was learnt is not kept, a limit is passed."""

    KIND: ClassVar = "trouble"

    what: Text


class Broken(Event):
    """The program has a fault: where it broke."""

    KIND: ClassVar = "broken"

    traceback: Text
