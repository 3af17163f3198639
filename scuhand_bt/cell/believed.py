"""What a cell is believed to hold, from what was measured and commanded; never the true mass."""

from dataclasses import dataclass, field

from scuhand_bt.specs import Container


@dataclass
class DoseSoFar:
    """What the container on the pan has cost until now, over all scoops and attempts."""

    began_s: float = 0.0
    pulses: int = 0
    scoops: int = 0
    vibration_s: float = 0.0
    target_mg: float | None = None
    """What is being dispensed towards now; None while nothing may flow into the container."""
    is_unweighed: bool = False
    """A dose broke off: what had left the cone then was not weighed by a stable mean yet."""


@dataclass
class Believed:
    """What the cell is believed to hold, from what was measured and commanded; never the true mass."""

    cone_mg: float = 0.0
    cone_source: str | None = None
    """The source that the powder in the cone came from."""
    sheet: str | None = None
    """The powder lot (`Source.sheet_key`) that this sheet has touched; None for a fresh one."""
    sheets_used: int = 1
    slots_used: int = 0
    """Containers taken from the changer since it was filled."""
    containers_used: dict[str, int] = field(default_factory=dict)
    """Containers that were put on the pan, by kind."""
    pan: Container | None = None
    """The container on the pan."""
    pan_empty_mg: float | None = None
    """Stable gross with that container, before its first powder: the software tare."""
    pan_gross_mg: float | None = None
    """The last stable gross with that container; None while containers are changed."""
    sources_mg: dict[str, float] = field(default_factory=dict)
    dosing: DoseSoFar = field(default_factory=DoseSoFar)
