"""What skills write of what was weighed, and of the balance."""

from typing import ClassVar

from scuhand_bt.events.entry import SkillEvent, Text, Values


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
    slot: int | None = None
    """Of the changer that it came from, from 1; none where a person puts containers on the pan."""


class ContainerAgain(SkillEvent):
    """The first container of a run or with a powder lot, or one by which its balance seems to adapt, was put on the pan
    twice."""

    KIND: ClassVar = "container_again"

    container: Text
    bare: Weighing
    loaded: Weighing
    difference_mg: float
    """Against the time before."""
    allowance_mg: float
    """How far the two may be apart by chance; where they are farther, the zero has stepped in between."""


class BalanceSlower(SkillEvent):
    """The balance has shown a container later than it was known to: what doses have taught of it is given up."""

    KIND: ClassVar = "balance_slower"

    delay_s: float
    known_s: float
    """How late it was known to be."""


class BalanceChanged(SkillEvent):
    """A container tells that a known balance is quicker than it was, or its filter another: it is taken for that."""

    KIND: ClassVar = "balance_changed"

    delay_s: float
    """How late the balance has shown the container."""
    known_s: float
    """How late it has shown one before."""
    shape: str
    """The kind of its filter, as the container tells."""
    known_shape: str


class BalanceAdapts(SkillEvent):
    """The last of a container tells that a known balance adapts as it did not, or no more: it is taken for that."""

    KIND: ClassVar = "balance_adapts"

    adapts: bool
    delay_s: float
    """How late the balance has shown the container."""
    last_s: float
    """How late the last 3 mg of it."""
    last_uncertainty_s: float
    """Standard uncertainty of `last_s`."""


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
