"""The one interface of all dosing controllers: measurements in, the next valve command out.

A controller is pure: it owns no device and reads no clock. `scuhand_bt/cell/dose_loop.py` asks it for a command,
carries that out on the hand and the balance, and tells it what was measured:

    command = controller.decide(None)              # the first command
    while not isinstance(command, Finish):
        ... carry it out ...
        command = controller.decide(observation)   # and so on

A controller lives for one dose and ends it with `Finish`.
"""

import math
from dataclasses import dataclass, field
from typing import Literal, Protocol

from scuhand_bt.dosing.verdict import acceptance_mg
from scuhand_bt.specs import BalanceBelief, Departure, PowderBelief

LONGEST_UNWEIGHED_S = 30.0
"""The longest that a controller may go without a stable mean, as nobody sees what the zero does meanwhile."""


def silence_s(period_s: float) -> float:
    """How long the balance may be silent while the valve is open [s]."""
    return max(0.3, 3.0 * period_s)


@dataclass(frozen=True, slots=True)
class Pulse:
    """Open to `opening_mm`, hold for `dwell_s` (counted from when the opening is reached), close, then settle."""

    opening_mm: float
    dwell_s: float
    vibration: float = 0.0
    wait_s: float = 0.0
    """A fixed wait after the valve is shut, before the balance is asked to settle."""


@dataclass(frozen=True, slots=True)
class Stream:
    """Go to this opening and vibration now, and hold them until the next reading."""

    opening_mm: float
    vibration: float = 0.0
    hold_s: float = math.inf
    """The valve shuts after this time even if no reading has come yet."""


@dataclass(frozen=True, slots=True)
class Weigh:
    """Close the valve, stop vibrating and wait for a stable mean."""

    wait_s: float = 0.0
    """A fixed wait before the balance is asked, until it can have noticed what fell last."""


Reason = Literal["reached", "overshoot", "empty", "rest", "no_flow", "step_limit"]


@dataclass(frozen=True, slots=True)
class Doubt:
    """A stable mean far from what the readings predicted; the belief about the balance no longer holds."""

    difference_mg: float
    """The mean less what was predicted."""
    allowed_mg: float
    """How far they may differ."""


@dataclass(frozen=True, slots=True)
class Finish:
    """The dose is over. `empty` and `rest` ask for another scoop: the cone gives no more, or only shaken."""

    reason: Reason
    estimate_mg: float
    uncertainty_mg: float
    powder: PowderBelief | None = None
    """The belief about the powder, from a controller that learns."""
    balance: BalanceBelief | None = None
    """The belief about the balance, from a controller that learns."""
    doubt: Doubt | None = None
    """The first doubt of this dose."""
    shaken_mg: float | None = None
    """What came only shaken, after powder last came unshaken; None if it never did, or this is not watched."""


Command = Pulse | Stream | Weigh | Finish


@dataclass(frozen=True, slots=True)
class Observation:
    """What is known after a command; `net_mg` is what the container has got of this lot, earlier doses included."""

    time_s: float
    net_mg: float
    uncertainty_mg: float
    stable: bool
    """True for a stable mean (after Pulse and Weigh), False for a single reading (after Stream)."""
    opening_mm: float = 0.0
    """The opening that the hand reports at that time."""


@dataclass(frozen=True, slots=True)
class DoseRequest:
    """What a controller is built from: the goal, the hand's valve, and the beliefs about powder and balance."""

    target_mg: float
    tolerance_mg: float
    gain: float
    """Kp of the paper's Algorithm 1."""
    max_opening_mm: float
    valve_speed_mm_per_s: float
    readability_mg: float
    cone_mg: float
    """What the cone is believed to hold."""
    cone_doubt_mg: float = 750.0
    """How far that belief may be off, as scoops vary."""
    came_mg: float = 0.0
    """What has come of the cone's load before this dose."""
    may_scoop_again: bool = False
    """Whether what is missing may come out of a fresh load."""
    uncertainty_mg: float = 0.1
    """The expected standard uncertainty of the net mass that is judged in the end."""
    wait_s: float = 0.0
    """A fixed wait of stepwise controllers after each pulse, besides the balance's settling."""
    departures: tuple[Departure, ...] = tuple(Departure)
    """Departures from the paper's listing; without any it is Algorithm 1 as printed."""
    streaming: bool = True
    valve_dead_time_s: float = 0.06
    balance_period_s: float = 0.1
    step_limit: int = 100
    """The most pulses of a stepwise controller (paper: 100)."""
    free_flow: float = 0.0
    """Flow of powder of its density that nothing holds back, C' [mg s^-1 mm^-2.5]; 0 if unknown."""
    powder: PowderBelief = field(default_factory=PowderBelief)
    balance: BalanceBelief = field(default_factory=BalanceBelief)

    def given_up(self, dispensed_mg: float) -> Literal["empty", "no_flow"]:
        """Why no powder comes: the cone is all but empty, or holds powder that does not flow."""
        return "empty" if self.cone_mg - dispensed_mg < self.cone_doubt_mg else "no_flow"


def stopped(request: DoseRequest, seen: Observation, steps: int, dry: bool, dispensed_mg: float) -> Finish | None:
    """The paper's stopping rules, for stepwise controllers; None while there is more to dose.

    A dose ends when |error| < tolerance (strictly), less the guard band of `verdict`. Departures from the listing end
    it on an overshoot, and on a cone that gives nothing. The step limit always does.
    `dispensed_mg` is what this dose has taken from the cone.
    """
    error_mg, departures = request.target_mg - seen.net_mg, request.departures
    uncertainty_mg = seen.uncertainty_mg if Departure.GUARD in departures else 0.0
    reason: Reason
    if abs(error_mg) < acceptance_mg(request.tolerance_mg, uncertainty_mg):
        reason = "reached"
    elif error_mg < 0.0 and Departure.OVERSHOOT in departures:
        reason = "overshoot"
    elif dry and Departure.GIVING_UP in departures:
        reason = request.given_up(dispensed_mg)
    elif steps >= request.step_limit:
        reason = "step_limit"
    else:
        return None
    return Finish(reason, seen.net_mg, seen.uncertainty_mg)


class Controller(Protocol):
    """Decides the next valve command by what has been measured."""

    @property
    def name(self) -> str: ...

    @property
    def estimate_mg(self) -> float:
        """The estimated net mass that has left the nozzle."""
        ...

    def decide(self, seen: Observation | None) -> Command:
        """The next command. `seen` is None at the start, else the result of the last command."""
        ...
