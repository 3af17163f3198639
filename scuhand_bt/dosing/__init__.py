"""Dosing: the cone's geometry, the flow, the balance, and the controllers behind one interface (docs/dosing.md).

Pure: no device, no clock, no file.
"""

from collections.abc import Callable, Mapping

from scuhand_bt.dosing.controller import (
    Command,
    Controller,
    DoseRequest,
    Finish,
    Observation,
    Pulse,
    Stream,
    Weigh,
)
from scuhand_bt.dosing.direct_pid import DirectPid
from scuhand_bt.dosing.paper import Paper

__all__ = [
    "CONTROLLERS",
    "DEFAULT_CONTROLLER",
    "Command",
    "Controller",
    "DoseRequest",
    "Finish",
    "Observation",
    "Pulse",
    "Stream",
    "Weigh",
    "new_controller",
    "prepare",
]

DEFAULT_CONTROLLER = "adaptive"


def _adaptive(request: DoseRequest) -> Controller:
    from scuhand_bt.dosing.adaptive import Adaptive  # deferred: its compiled code takes half a second to load

    return Adaptive(request)


CONTROLLERS: Mapping[str, Callable[[DoseRequest], Controller]] = {
    DEFAULT_CONTROLLER: _adaptive,
    Paper.name: Paper,
    DirectPid.name: DirectPid,
}


def new_controller(name: str, request: DoseRequest) -> Controller:
    """A controller for one dose; raises ValueError for an unknown name."""
    if name not in CONTROLLERS:
        raise ValueError(f"no controller is called '{name}'; there are {', '.join(CONTROLLERS)}")
    return CONTROLLERS[name](request)


def prepare() -> None:
    """Load compiled code, so that no dose waits for it: some seconds the first time, half a second later."""
    import scuhand_bt.dosing.filters  # noqa: F401
