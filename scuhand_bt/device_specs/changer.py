"""What brings containers, and how many."""

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Annotated

from pydantic import BeforeValidator, Field

from scuhand_bt.device_specs.servo import Direction
from scuhand_bt.drivers import driver_name
from scuhand_bt.quantity import Seconds
from scuhand_bt.specs import Positive, Spec


class CarouselOptions(Spec):
    """The carousel's servo, whose shaft the plate is fixed to."""

    baud: Annotated[int, Positive] = 1_000_000
    latency_s: Annotated[Seconds, Field(gt=0, le=0.1)] = 0.008
    """How long the adapter may hold bytes back."""
    servo_id: Annotated[int, Field(ge=0, le=252)] = 10
    direction: Direction = 1
    """1 where the next slots come to the pan as the servo's position rises."""
    first_slot_count: Annotated[int, Field(ge=0, le=4095)] = 0
    """Its position with the first slot on the pan."""
    slot_s: Annotated[Seconds, Field(ge=0.2, le=60)] = 2.0
    """How long it turns from one slot to the next: containers slide along, and powder in them is not to be shaken."""

    def swing_s(self, slots: float) -> float:
        """How long a turn by so many slots, half a one say, takes [s].

        Nothing is accelerated harder than from one slot to the next, nor pushed along faster.
        """
        return max(slots, math.sqrt(slots)) * self.slot_s


def _slots_of(given: object) -> object:
    """A number of slots, or one for each kind of container; ValueError, worded as pydantic's own are, for all else."""
    if isinstance(given, Mapping):
        if not given:
            raise ValueError("write a kind of container, and its number of slots")
        return {str(kind): _slot_count(count, f" for '{kind}'") for kind, count in given.items()}
    return _slot_count(given)


def _slot_count(given: object, of: str = "") -> int:
    is_whole = isinstance(given, int) and not isinstance(given, bool)
    if not (is_whole or (isinstance(given, str) and given.isascii() and given.isdigit())):
        raise ValueError(f"a whole number{of}, such as 3, or one for each kind of container: {{xrd_holder: 8}}")
    count = int(str(given))
    if count <= 0:
        raise ValueError(f"more than 0{of}")
    return count


class ChangerSpec(Spec):
    """What brings containers: a carousel, or the operator."""

    driver: Annotated[str, driver_name("changer")] = "carousel"
    port: str = ""
    options: CarouselOptions = CarouselOptions()
    slots: Annotated[
        Annotated[int, Field(gt=0)] | dict[str, Annotated[int, Field(gt=0)]], BeforeValidator(_slots_of)
    ] = 24
    """Containers it holds before a person has to fill it again: in the plan's order, or so many of each kind.

    Kinds follow on each other: the first slots are for the kind that is named first.
    """

    @property
    def slot_count(self) -> int:
        """All of them."""
        return self.slots if isinstance(self.slots, int) else sum(self.slots.values())

    @property
    def kinds(self) -> tuple[str, ...]:
        """The kinds of container that have slots of their own; none where it is filled in the plan's order."""
        return () if isinstance(self.slots, int) else tuple(self.slots)

    def takes(self, kind: str) -> bool:
        """Whether a container of this kind has a place in it."""
        return not self.kinds or kind in self.kinds

    def slots_for(self, kind: str) -> int:
        """How many containers of a kind it holds, where it is filled with no others that want their slots."""
        return self.slots if isinstance(self.slots, int) else self.slots.get(kind, 0)

    def short_of(self, used: Mapping[str, int], kinds: Iterable[str]) -> str | None:
        """The first kind of which it has too few left for containers of these kinds that come without a visit between;
        None where it has enough. Where kinds have no slots of their own that is "", in `used` as here.

        Of more than it holds when it is full only the next one counts: it comes to a visit between them all the same.
        """
        wanted = Counter(kind if self.kinds else "" for kind in kinds)
        for kind, many in wanted.items():
            slots = self.slots_for(kind)
            if used.get(kind, 0) + (many if many <= slots else 1) > slots:
                return kind
        return None

    def first_slot(self, kind: str) -> int | None:
        """The first slot, from 0, of a kind with slots of its own; None where it is filled in the plan's order."""
        if isinstance(self.slots, int):
            return None
        before = list(self.slots).index(kind) if kind in self.slots else len(self.slots)
        return sum(list(self.slots.values())[:before])
