"""The surroundings of the twins of a cell's further devices: what they sense, and what they change.

A twin is built from its device's `options` and the scene; `hear` makes it speak (`sim/wire/server.py`).
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
"""A twin on a busy computer answers later than a servo; this keeps it from looking like one without power."""
AT_A_TWIN = {"latency_s": LATENCY_S, "bits": "8N1"}
"""Options that differ at twins: a pseudo-terminal cannot be set to seven bits or parity twice."""


def at_a_twin(options: M) -> M:
    """The options of a device whose cable ends at its twin."""
    return options.model_copy(update={key: one for key, one in AT_A_TWIN.items() if key in type(options).model_fields})


class Scene(Protocol):
    """What a twin senses and changes of the cell."""

    @property
    def air(self) -> Mapping[str, float]:
        """What sensors measure, by names with units."""
        ...

    @property
    def slots(self) -> int:
        """The number of containers that the changer holds."""
        ...

    @property
    def on_pan(self) -> str | None:
        """The code of the container on the pan."""
        ...

    @property
    def seen(self) -> Sequence[Seen]:
        """Foreign objects in the cell, for watchers."""
        ...

    def bring(self, slot: int | None) -> None:
        """The changer has put the container of this slot (from 0) on the pan; None: it has cleared the pan."""
        ...


@dataclass
class StillScene:
    """A stand-alone scene that changes only by assignment, and `bring`."""

    air: dict[str, float] = field(default_factory=lambda: dict(ROOM))
    slots: int = 24
    on_pan: str | None = None
    slot: int | None = None
    seen: tuple[Seen, ...] = ()

    def bring(self, slot: int | None) -> None:
        self.slot = slot


def twin_of(kind: str, driver: str) -> type[Any]:
    """The class of a driver's twin. Raises NotPluggable if it has none."""
    name = driver_of(kind, driver).twin
    if not name:
        raise NotPluggable(f"'{driver}' names no twin: it cannot be rehearsed")
    twin: type[Any] = plugged(name, type, "class")
    return twin
