"""What `driver:` in robot/cell.yaml stands for, for every kind of device, whoever made it: the one registry.

A driver is an object that `connect`s a device; `Options` is the model of what `options:` may say to it, and `twin`
names what plays the device in rehearsals. Its name is one of ours (`SHIPPED`), one that an installed package offers (an
entry point of the group `scuhand_bt.<kind>`), or `package.module:NAME`, the object itself.
"""

import importlib
import re
from collections.abc import Mapping
from functools import partial
from importlib.metadata import entry_points
from typing import Any, Protocol, runtime_checkable

from pydantic import AfterValidator, BaseModel
from pydantic_core import PydanticCustomError

_BALANCES = "scuhand_bt.devices.balances"
SHIPPED: Mapping[str, Mapping[str, str]] = {
    "arm": {"dynamixel": "scuhand_bt.devices.crane_x7:CraneX7"},
    "hand": {"hand_controller": "scuhand_bt.devices.crane_x7:Hand"},
    "balance": {
        "and": f"{_BALANCES}.and_standard:DIALECT",
        "mt_sics": f"{_BALANCES}.mt_sics:DIALECT",
        "sbi": f"{_BALANCES}.sbi:DIALECT",
        "shimadzu": f"{_BALANCES}.shimadzu:DIALECT",
    },
    "changer": {"carousel": "scuhand_bt.devices.carousel:Carousel", "operator": ""},
    "sensor": {"vaisala": "scuhand_bt.devices.vaisala:Vaisala"},
    "scanner": {"keyboard_wedge": "scuhand_bt.devices.keyboard_wedge:KeyboardWedge"},
    "ioniser": {},
    "capper": {},
    "watcher": {"boxes": "scuhand_bt.devices.boxes:Boxes"},
}
"""By kind, the engine's own drivers; `operator` is none, but a person."""
BESIDE: Mapping[str, Mapping[str, str]] = {"arm": {"ros2": "scuhand_bt.devices.ros2_arm:DRIVER"}}
"""And those that stand to the engine as another package's do: on no servo bus of ours, without a twin."""
UNWIRED = (("changer", "operator"), ("watcher", "boxes"))
"""At no cable, and so without a twin: a person, and a watcher that sees what it was told to, in rehearsals as well."""
NAMED_KINDS = ("sensor", "scanner", "ioniser", "capper", "watcher")
"""Kinds of which a cell has any number, each under a name of its own."""
PLUGGED = re.compile(r"[A-Za-z_]\w*(\.\w+)*:[A-Za-z_]\w*")
"""`package.module:NAME`."""


@runtime_checkable
class Driver(Protocol):
    """What a name in robot/cell.yaml stands for."""

    Options: type[BaseModel]
    """Validates what `options:` says to it."""
    twin: str
    """`package.module:Class` of its twin, for rehearsals and conformance; "" where it has none."""

    def connect(self, site: Any, /) -> Any:
        """The device, open, at a `devices.interfaces.Site`; SkillFailed device.lost."""
        ...


class NotPluggable(ValueError):  # noqa: N818 - it reads as the sentence it is raised in
    """A name that stands for nothing that can be used here; says why, and what would be right."""


def plugged(name: str, kind: type, called: str = "") -> Any:
    """The object of `package.module:NAME`, which must be of this kind (`called` so). NotPluggable."""
    module_name, _, object_name = name.partition(":")
    try:
        module = importlib.import_module(module_name)
    except Exception as error:
        why = f"{type(error).__name__}: {error}"
        raise NotPluggable(
            f"'{name}': module '{module_name}' cannot be imported ({why}); install its package"
        ) from None
    made = getattr(module, object_name, None)
    if not isinstance(made, kind):
        known = ", ".join(key for key, value in vars(module).items() if isinstance(value, kind)) or "none"
        raise NotPluggable(f"'{name}': '{object_name}' is not a {called or kind.__name__}; {module_name} has: {known}")
    return made


def driver_of(kind: str, driver: str) -> Driver:
    """The driver of a name. NotPluggable says what is wrong with that."""
    target = SHIPPED[kind].get(driver) or _installed(kind).get(driver) or driver
    made: Driver = plugged(target, Driver)
    return made


def is_ours(kind: str, driver: str) -> bool:
    """Whether the engine brings this driver itself."""
    return driver in SHIPPED[kind]


def _installed(kind: str) -> dict[str, str]:
    """What installed packages offer, and ours beside the engine."""
    return dict(BESIDE.get(kind, {})) | {point.name: point.value for point in entry_points(group=f"scuhand_bt.{kind}")}


def is_known(kind: str, driver: str) -> bool:
    """Whether this names a driver of this kind, by its form; what it stands for is seen when the lab is loaded."""
    return is_ours(kind, driver) or PLUGGED.fullmatch(driver) is not None or driver in _installed(kind)


def known_driver(kind: str, driver: str) -> str:
    """The name of a driver of this kind; PydanticCustomError for any other."""
    if is_known(kind, driver):
        return driver
    names = [*map(repr, (*SHIPPED[kind], *_installed(kind))), "package.module:NAME of a driver of your own"]
    raise PydanticCustomError("literal_error", "no driver", {"expected": ", ".join(names)})


def driver_name(kind: str) -> AfterValidator:
    """Makes a field's text the name of a driver of this kind."""
    return AfterValidator(partial(known_driver, kind))
