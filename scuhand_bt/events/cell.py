"""What skills write of powder, sheet, valve and arm."""

from typing import ClassVar

from scuhand_bt.events.entry import SkillEvent, Text


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
    lip_force_limit_n: float | None = None
    """The most that it may take: with a stiffer sheet the lip goes less far into the wall."""
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
