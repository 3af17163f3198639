"""The cell of `robot/cell.yaml`: its stations and obstacles, and the devices on it."""

from typing import Literal, Self
from urllib.parse import urlsplit

from pydantic import BaseModel, Field, SerializeAsAny, ValidationInfo, field_validator, model_validator

from scuhand_bt.bench_spec import Frame, Obstacle, Station
from scuhand_bt.device_specs.arm import ArmSpec
from scuhand_bt.device_specs.balance import BalanceSpec
from scuhand_bt.device_specs.changer import ChangerSpec
from scuhand_bt.device_specs.hand import HandSpec
from scuhand_bt.drivers import known_driver
from scuhand_bt.specs import Spec

DEVICES = ("arm", "hand", "balance", "changer")
"""What every cell has, and skills lease."""


class DeviceSpec(Spec):
    """A device of `devices:`, which skills lease by its name; its `options` are its driver's own."""

    kind: Literal["sensor", "scanner", "ioniser", "capper", "watcher"]
    driver: str
    port: str = ""

    @field_validator("driver")
    @classmethod
    def _is_a_driver_of_its_kind(cls, driver: str, info: ValidationInfo) -> str:
        return known_driver(info.data["kind"], driver) if "kind" in info.data else driver


class NotifySpec(Spec):
    """Who is told when a run pauses, needs a person or has ended: a program, or a web address."""

    command: tuple[str, ...] | None = None
    """The program and its arguments; it is given the JSON on its standard input."""
    webhook: str | None = None
    """It is sent the JSON by POST. Only this computer is called, and hosts under `allow`."""
    allow: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _names_one(self) -> Self:
        if (self.command is None) == (self.webhook is None):
            raise ValueError("write either a 'command' or a 'webhook'")
        if self.command is not None and not (self.command and self.command[0]):
            raise ValueError("'command' names no program")
        return self

    @field_validator("webhook")
    @classmethod
    def _is_an_address(cls, url: str) -> str:
        parts = urlsplit(url)
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise ValueError('a web address, such as "http://127.0.0.1:8080/hook"')
        if "@" in parts.netloc or not url.isascii() or not url.isprintable() or " " in url:
            raise ValueError("a plain web address, without a user, blanks or special letters")
        assert parts.port is None or parts.port > 0  # a port that is none raises ValueError itself
        return url


class CellSpec(Spec):
    """`robot/cell.yaml`: the devices of one bench, its stations and its geometry."""

    cell: str
    arm: ArmSpec = ArmSpec()
    hand: HandSpec = HandSpec()
    balance: BalanceSpec = BalanceSpec()
    changer: ChangerSpec = ChangerSpec()
    devices: dict[str, DeviceSpec] = Field(default_factory=dict)
    """Further devices by the names that skills lease them under."""
    own_options: dict[str, SerializeAsAny[BaseModel]] = Field(default_factory=dict)
    """By device, the `options` of drivers that bring a model of their own for them."""
    plant: str | None = None
    """`module:Class` of the simulated physics; none for the shipped one."""
    notify: NotifySpec | None = None
    frames: dict[str, Frame] = Field(default_factory=dict)
    """What stands as one thing where it was measured to stand, by the names that stations and obstacles give."""
    stations: dict[str, Station]
    geometry: list[Obstacle] = Field(default_factory=list)
    zones: list[Obstacle] = Field(default_factory=list)
    """Spaces that only one may move in at a time, as what the container changer sweeps; skills lease them by name."""

    @model_validator(mode="after")
    def _stands_where_its_frames_do(self) -> Self:
        """Stations and obstacles in the base frame, once: everybody else knows of no other."""
        things: list[Station | Obstacle] = [*self.stations.values(), *self.geometry, *self.zones]
        for thing in things:
            if thing.frame is not None and thing.frame not in self.frames:
                known = ", ".join(self.frames) or "none"
                raise ValueError(f"'{thing.name}' belongs to '{thing.frame}', which is not a frame; known: {known}")
        for name, station in self.stations.items():
            if station.frame is not None:
                frame = self.frames[station.frame]
                there = {"position_mm": frame.moved_mm(station.position_mm), "frame": None, "of_frame": frame}
                self.stations[name] = station.model_copy(update=there)
        for solids in (self.geometry, self.zones):
            solids[:] = [self._in_base_frame(solid) for solid in solids]
        return self

    def _in_base_frame(self, solid: Obstacle) -> Obstacle:
        if solid.frame is None:
            return solid
        frame = self.frames[solid.frame]
        yaw_deg = (solid.yaw_deg + frame.yaw_deg + 180.0) % 360.0 - 180.0
        return solid.model_copy(update={"at_mm": frame.moved_mm(solid.at_mm), "yaw_deg": yaw_deg, "frame": None})

    @field_validator("devices")
    @classmethod
    def _have_names_to_lease_by(cls, devices: dict[str, DeviceSpec]) -> dict[str, DeviceSpec]:
        for name in devices:
            if name in DEVICES or not name.isidentifier():
                raise ValueError(
                    f"'{name}' is not a valid name: use letters, digits and _, and not {', '.join(DEVICES)}"
                )
        return devices

    @property
    def watchers(self) -> tuple[str, ...]:
        """The names of the devices that see what comes into the cell."""
        return tuple(name for name, one in self.devices.items() if one.kind == "watcher")

    @property
    def zone_names(self) -> tuple[str, ...]:
        """The zones that skills can lease."""
        return tuple(zone.name for zone in self.zones)

    @property
    def device_names(self) -> tuple[str, ...]:
        """All that skills can lease."""
        return (*DEVICES, *self.devices)

    def section(self, device: str) -> "ArmSpec | HandSpec | BalanceSpec | ChangerSpec | DeviceSpec":
        """What is said of a device, by the name that skills lease it under."""
        found: ArmSpec | HandSpec | BalanceSpec | ChangerSpec | DeviceSpec
        found = self.devices[device] if device in self.devices else getattr(self, device)
        return found

    def options_of(self, device: str) -> BaseModel:
        """The options of a device, as its driver's own model has read them, or the engine's."""
        options: BaseModel = self.own_options.get(device) or self.section(device).options  # type: ignore[union-attr]
        return options

    def slowed(self, ratio: float) -> "CellSpec":
        """This cell with all that moves by itself at a share of its speed: arm, roller and changer.

        But for the valve: its speed is part of every dose, and is not a person's to be afraid of.
        """
        arm = self.arm.model_copy(update={"speed_ratio": self.arm.speed_ratio * ratio})
        hand = self.hand.model_copy(update={"morph_speed_mm_per_s": self.hand.morph_speed_mm_per_s * ratio})
        turning = self.changer.options.model_copy(update={"slot_s": self.changer.options.slot_s / ratio})
        changer = self.changer.model_copy(update={"options": turning})
        return self.model_copy(update={"arm": arm, "hand": hand, "changer": changer})

    def kind_of(self, device: str) -> str:
        """The kind of a device, as `scuhand_bt.drivers` has it."""
        return self.devices[device].kind if device in self.devices else device

    @classmethod
    def options_model(cls, kind: str) -> type[BaseModel]:
        """The model of the options of the engine's own drivers of one of `DEVICES`."""
        section = cls.model_fields[kind].annotation
        assert section is not None
        model: type[BaseModel] = section.model_fields["options"].annotation
        return model

    def station_of_kind(self, kind: str) -> Station:
        """The first station of a kind; KeyError if the cell has none."""
        for station in self.stations.values():
            if station.kind == kind:
                return station
        raise KeyError(kind)

    @property
    def vessels(self) -> list[Station]:
        """What a recipe may send leftovers to beside the waste bin, which is the first station of the kind `waste`."""
        return [station for station in self.stations.values() if station.kind == "waste"][1:]
