"""Where the twins of a cell's further devices stand: what they sense, and what they do.

A twin is made of the `options` of its device and of the scene; `hear` makes it speak (`sim/wire/server.py`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

from pydantic import BaseModel

from scuhand_bt.devices.boxes import Seen
from scuhand_bt.drivers import NotPluggable, driver_of, plugged
from scuhand_bt.sim.instruments import ROOM

M = TypeVar("M", bound=BaseModel)
LATENCY_S = 0.1
"""A twin on a busy computer answers later than a servo does, and is not to be taken for one without power."""
AT_A_TWIN = {"latency_s": LATENCY_S, "bits": "8N1"}
"""Options that are so at twins: a pseudo-terminal cannot be set to seven bits or parity twice."""


def at_a_twin(options: M) -> M:
    """The options of a device whose cable ends at its twin."""
    return options.model_copy(update={key: one for key, one in AT_A_TWIN.items() if key in type(options).model_fields})


class Scene(Protocol):
    """What of the cell a twin meets."""

    @property
    def air(self) -> Mapping[str, float]:
        """What sensors measure, by names with units."""
        ...

    @property
    def slots(self) -> int:
        """How many containers the changer holds."""
        ...

    @property
    def on_pan(self) -> str | None:
        """The code of the container on the pan."""
        ...

    @property
    def seen(self) -> Sequence[Seen]:
        """What is in the cell that is none of it, for watchers."""
        ...

    def bring(self, slot: int | None) -> None:
        """The changer has put the container of this slot, from 0, on the pan; None: it has cleared the pan."""
        ...


@dataclass
class StillScene:
    """A scene of its own, on which things change only when told to."""

    air: dict[str, float] = field(default_factory=lambda: dict(ROOM))
    slots: int = 24
    on_pan: str | None = None
    slot: int | None = None
    seen: tuple[Seen, ...] = ()

    def bring(self, slot: int | None) -> None:
        self.slot = slot


def twin_of(kind: str, driver: str) -> type[Any]:
    """The class of a driver's twin. NotPluggable where it has none."""
    name = driver_of(kind, driver).twin
    if not name:
        raise NotPluggable(f"'{driver}' names no twin: it cannot be rehearsed")
    twin: type[Any] = plugged(name, type, "class")
    return twin
