"""Dosing: the cone's geometry, the flow model, and the controllers behind one interface.

Pure: no device, no clock, no file.
"""

from collections.abc import Callable, Mapping

from scuhand_bt.dosing.adaptive import Adaptive
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
]

CONTROLLERS: Mapping[str, Callable[[DoseRequest], Controller]] = {
    Adaptive.name: Adaptive,
    Paper.name: Paper,
    DirectPid.name: DirectPid,
}
DEFAULT_CONTROLLER = Adaptive.name


def new_controller(name: str, request: DoseRequest) -> Controller:
    """A controller for one dose; ValueError for an unknown name."""
    if name not in CONTROLLERS:
        raise ValueError(f"no controller is called '{name}'; there are {', '.join(CONTROLLERS)}")
    return CONTROLLERS[name](request)
