"""The cell of `robot/cell.yaml`: its stations and obstacles, and the devices on it."""

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import Annotated, Literal, Self
from urllib.parse import urlsplit

from pydantic import (
    BaseModel,
    BeforeValidator,
    Field,
    SerializeAsAny,
    ValidationInfo,
    field_validator,
    model_validator,
)

from scuhand_bt.bench_spec import Frame, Obstacle, Point, Station
from scuhand_bt.drivers import driver_name, known_driver
from scuhand_bt.quantity import (
    Degrees,
    Milligrams,
    Millimetres,
    MillimetresPerSecond,
    Ratio,
    Seconds,
    plain_name,
)
from scuhand_bt.specs import NotNegative, Positive, Spec

Seven = Field(min_length=7, max_length=7)
Direction = Annotated[Literal[1, -1], BeforeValidator(lambda value: {"1": 1, "-1": -1}.get(value, value))]
"""Which way a servo turns; YAML's scalars are text."""


class ArmOptions(Spec):
    """What differs from one CRANE-X7 and its cabling to the next."""

    baud: Annotated[int, Positive] = 3_000_000
    latency_s: Annotated[Seconds, Field(gt=0, le=0.1)] = 0.008
    """How long adapter and system may hold bytes back; an answer is waited for twice as long."""
    servo_ids: Annotated[tuple[Annotated[int, Field(ge=0, le=252)], ...], Seven] = (2, 3, 4, 5, 6, 7, 8)
    """Of the joints, from the base."""
    home_counts: Annotated[tuple[int, ...], Seven] = (2048,) * 7
    """Position of each servo with the arm straight up."""
    directions: Annotated[tuple[Direction, ...], Seven] = (1,) * 7
    following_limit_deg: Annotated[Degrees, Positive] = 10.0
    """A joint further than this from its goal is held up by something."""


class ArmSpec(Spec):
    """The arm as this cell uses it: the CRANE-X7, or another of six or seven joints."""

    driver: Annotated[str, driver_name("arm")] = "dynamixel"
    port: str = ""
    options: ArmOptions = ArmOptions()
    urdf: str = "crane_x7_scuhand_sv.urdf"
    kinematics: Literal["crane_x7", "decomposed"] = "crane_x7"
    """How poses become joints: by the CRANE-X7's closed form, or another arm's as EAIK finds it from its axes."""
    tool_axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Of another arm: along which axis of its last joint's frame the handle goes on."""
    flange_mm: Point = (0.0, 0.0, 0.0)
    """Of another arm: where in that frame the hand is screwed on."""
    relaxed_deg: tuple[Degrees, ...] = ()
    """Of another arm: its joints as it stands before a place straight ahead; unset, the middles of its windows."""
    windows_deg: dict[str, tuple[Degrees, Degrees]] = Field(default_factory=dict)
    """By the URDF's names of joints: a narrower window than it tells, from and to."""
    may_touch: tuple[tuple[str, str], ...] = ()
    """Pairs that are not looked at, as bounding shapes that meet where what they bound does not: each a link of the
    URDF, one shape of it (`upper_0`), the cone or the clamp, and another of these or an obstacle."""
    speed_ratio: Annotated[Ratio, Field(ge=0.01, le=1)] = 1.0
    torque_ratio: Annotated[Ratio, Field(ge=0.1, le=1)] = 0.8
    """Of its servos' stall torque (the URDF's `effort`), what a motion may take; one that would take more is slower."""
    gentle_deg: Annotated[Degrees, Field(gt=0, le=90)] = 90.0
    """The largest spill angle a loaded cone is carried at; its powder's own limit where that is smaller."""

    @model_validator(mode="after")
    def _describes_another_arm_only(self) -> Self:
        if self.kinematics == "crane_x7":
            given = {"tool_axis", "flange_mm", "relaxed_deg"} & self.model_fields_set
            if given:
                what = plain_name(min(given))
                raise ValueError(f"'{what}' is told of another arm than the CRANE-X7: 'kinematics: decomposed'")
        elif math.hypot(*self.tool_axis) < 1e-6:
            raise ValueError("'tool_axis' has no direction")
        return self


class ValveErrorSpec(Spec):
    """How far the simulated valve is from what it is told; no controller reads it."""

    opening_mm: Annotated[Millimetres, NotNegative] = 0.03
    """Standard deviation of the real opening, drawn at each opening."""
    sample_mm: Annotated[Millimetres, NotNegative] = 0.02
    """Standard deviation that stays for a whole sample: how the sheet was last bent."""
    stick_probability: Annotated[Ratio, Field(ge=0, le=1)] = 0.012
    """How often the sheet sticks and slips as it opens."""
    stick_mm: Annotated[Millimetres, NotNegative] = 0.3
    """How much wider it then opens."""


MOUNTED_DIAMETER_MM = 90.0
"""Rim of the cone that a mounted sheet begins as, and that loads are carried in (paper, section V: 36° of overlap)."""


NARROWEST_SHARE, WIDEST_SHARE = 0.3, 0.95
"""Of the flat sheet's diameter: between these rims the roller turns."""


class ValvePoint(Spec):
    """Where the valve's servo stands for an opening."""

    count: Annotated[int, Field(ge=0, le=4095)]
    opening_mm: Annotated[Millimetres, Field(ge=0, le=20)]


class HandOptions(Spec):
    """The roller's servo on the arm's bus, the valve's servo, and the sheet as it is mounted."""

    roller_id: Annotated[int, Field(ge=0, le=252)] = 9
    roller_port: str = ""
    """Where the roller's servo is not on the arm's bus, as beside an arm with a driver of its own."""
    roller_direction: Direction = 1
    start_diameter_mm: Annotated[Millimetres, Positive] = MOUNTED_DIAMETER_MM
    """Of the cone of a sheet that has just been mounted (paper, section V)."""
    valve_map: Annotated[tuple[ValvePoint, ...], Field(min_length=2, max_length=8)] = (
        ValvePoint(count=2048, opening_mm=0.0),
        ValvePoint(count=2308, opening_mm=2.4),
    )
    """The outlet's opening by the position of the valve's servo, from shut to widest, straight in between; calibrated
    (default: the rack's own travel, 0.105 mm a degree, as if the outlet opened by what the rack moves)."""

    @model_validator(mode="after")
    def _valve_map_is_one(self) -> Self:
        openings = [point.opening_mm for point in self.valve_map]
        counts = [point.count for point in self.valve_map]
        if openings[0] != 0.0 or any(b <= a for a, b in pairwise(openings)):
            raise ValueError("its 'valve_map' goes from an opening of 0 mm upwards")
        if any((b - a) * (counts[1] - counts[0]) <= 0 for a, b in pairwise(counts)):
            raise ValueError("the counts of its 'valve_map' all rise or all fall")
        return self


class MountSpec(Spec):
    """How the handle holds the sheet: on the seam's side, as a ladle's.

    Read off the published pictures of the hand, not off drawings: measure yours.
    """

    azimuth_deg: Annotated[Degrees, Field(ge=-180, le=180)] = 180.0
    """Which way the cone lies from the j7 axis, about it, from the flange's x. So it lies above a handle that reaches
    forward with joint 7 at zero."""
    clamp_radius_mm: Annotated[Millimetres, Positive] = 18.0
    """Of what the handle carries where it holds the sheet: clamp, rollers, the valve's rack."""


class HandSpec(Spec):
    """The SCU-Hand-SV: its sheet, roller, valve and vibration motor."""

    driver: Annotated[str, driver_name("hand")] = "hand_controller"
    port: str = ""
    options: HandOptions = HandOptions()
    sheet_radius_mm: Annotated[Millimetres, Field(gt=45, le=500)] = 50.0
    """More than half of the cone that a mounted sheet begins as, 90 mm (paper, section V)."""
    sheet_thickness_mm: Annotated[Millimetres, Positive] = 0.2
    roller_deg_per_mm: Annotated[float, Field(gt=0)] = 11.46
    """Roller angle per millimetre of sheet along the rim; calibrated (default: a 10 mm roller)."""
    morph_speed_mm_per_s: Annotated[MillimetresPerSecond, Positive] = 20.0
    """Speed of the sheet's edge along the rim while the cone changes its size; what the roller's servo can turn."""
    apex_offset_mm: Annotated[Millimetres, Positive] = 120.0
    """Flange to cone apex along the j7 axis, which the sheet's slit continues: read off a picture, measure yours."""
    apex_aside_mm: tuple[Millimetres, Millimetres] = (0.0, 0.0)
    """The apex beside that axis, along x and y of the flange: how crookedly the hand is screwed on."""
    mass_mg: Annotated[Milligrams, Positive] | None = None
    """Of all beyond joint 7, with what was added to the hand; unset, the URDF's."""
    mount: MountSpec = MountSpec()
    max_opening_mm: Annotated[Millimetres, Field(gt=0, le=20)] = 2.4
    valve_speed_mm_per_s: Annotated[MillimetresPerSecond, Field(ge=0.1)] = 4.0
    valve_dead_time_s: Annotated[Seconds, NotNegative] = 0.06
    streaming: bool = True
    """False for a controller board that offers the step command only."""
    simulation: ValveErrorSpec = ValveErrorSpec()

    @property
    def rim_limits_mm(self) -> tuple[float, float]:
        """The narrowest and the widest rim that the roller makes, whoever asks."""
        mounted_mm, flat_mm = self.options.start_diameter_mm, 2 * self.sheet_radius_mm
        return min(mounted_mm, NARROWEST_SHARE * flat_mm), max(mounted_mm, WIDEST_SHARE * flat_mm)

    @model_validator(mode="after")
    def _sheet_makes_the_cone(self) -> Self:
        if self.options.start_diameter_mm >= 2 * self.sheet_radius_mm:
            raise ValueError(f"this sheet makes cones of less than {2 * self.sheet_radius_mm:g} mm")
        return self

    @model_validator(mode="after")
    def _valve_map_reaches(self) -> Self:
        widest_mm = self.options.valve_map[-1].opening_mm
        if widest_mm < self.max_opening_mm:
            raise ValueError(f"its 'valve_map' ends at {widest_mm:g} mm, below 'max_opening'")
        return self


class BalanceResponseSpec(Spec):
    """How the simulated balance answers (`scuhand_bt.sim.response`); no controller reads it."""

    lag_s: Annotated[Seconds, Field(gt=0)] = 0.3
    """Time constant of each of its filter's two poles."""
    noise_mg: Annotated[Milligrams, NotNegative] = 0.08
    """Standard deviation of a reading on a quiet pan."""
    vibration_noise_mg: Annotated[Milligrams, NotNegative] = 0.4
    """Standard deviation that the hand's motor adds at full level."""
    drift_mg: Annotated[Milligrams, NotNegative] = 0.1
    """Random walk of the zero: standard deviation after a minute."""


class BalanceOptions(Spec):
    """Where the balance's own menu is not as it left the factory."""

    baud: Annotated[int, Positive] | None = None
    bits: Annotated[str, Field(pattern=r"^[78][NEO][12]$")] | None = None
    """Data bits, parity, stop bits: "7E1"."""
    unit: Literal["g", "mg", "kg", "ct"] | None = None
    """Of a balance that leaves it out while it is not stable."""


class BalanceLimits(Spec):
    """What a run on the real cell asks of its balance (docs/weighing.md); `check` notes what is beyond."""

    check_weight_every_s: Annotated[Seconds, Field(gt=0)] | None = None
    """Within this time before a run it must have weighed a check weight right."""
    minimum_weight_mg: Annotated[Milligrams, NotNegative] = 0.0
    """The least mass to be dosed."""
    usp_41: bool | None = None
    """That, and at least 2000 times the repeatability (USP 41); unset, a mass below it is warned of, not refused."""
    when_beyond: Literal["refuse", "warn"] = "refuse"


class BalanceSpec(Spec):
    """The balance under the hand."""

    driver: Annotated[str, driver_name("balance")] = "shimadzu"
    port: str = ""
    options: BalanceOptions = BalanceOptions()
    readability_mg: Annotated[Milligrams, Positive] = 0.1
    maximum_mg: Annotated[Milligrams, Positive] = 120_000.0
    period_s: Annotated[Seconds, Field(gt=0, le=2)] = 0.1
    limits: BalanceLimits = BalanceLimits()
    weighed_twice: Literal["first", "every"] = "first"
    """Which containers come and go twice, about the bare pan, as the first of each run does (docs/weighing.md)."""
    simulation: BalanceResponseSpec = BalanceResponseSpec()

    @property
    def least_tolerance_mg(self) -> float:
        """Two digits: a stable mean is known to about half of one, and acceptance keeps twice that inside."""
        return 2.0 * self.readability_mg

    @property
    def confirmed_tolerance_mg(self) -> float:
        """Five digits: of doses within less, nine in ten are not always told so (docs/weighing.md has the figures)."""
        return 5.0 * self.readability_mg

    @property
    def lost_after_s(self) -> float:
        """Without a word for this long, the balance is taken for lost."""
        return max(3.0, 10.0 * self.period_s)


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


def _slots_of(given: object) -> object:
    """A number of slots, or one for each kind of container; ValueError, worded as pydantic's own are, for all else."""
    if isinstance(given, Mapping):
        if not given:
            raise ValueError("a kind of container, and how many slots are for it")
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
    """Containers it holds before a person has to fill it again: in the recipe's order, or so many of each kind.

    Kinds follow on each other: the first slots are for the kind that is named first.
    """

    @property
    def slot_count(self) -> int:
        """All of them."""
        return self.slots if isinstance(self.slots, int) else sum(self.slots.values())

    @property
    def kinds(self) -> tuple[str, ...]:
        """The kinds of container that have slots of their own; none where it is filled in the recipe's order."""
        return () if isinstance(self.slots, int) else tuple(self.slots)

    def takes(self, kind: str) -> bool:
        """Whether a container of this kind has a place in it."""
        return not self.kinds or kind in self.kinds

    def slots_for(self, kind: str) -> int:
        """How many containers of a kind it holds, where it is filled with no others that want their slots."""
        return self.slots if isinstance(self.slots, int) else self.slots.get(kind, 0)

    def first_slot(self, kind: str) -> int | None:
        """The first slot, from 0, of a kind with slots of its own; None where it is filled in the recipe's order."""
        if isinstance(self.slots, int):
            return None
        before = list(self.slots).index(kind) if kind in self.slots else len(self.slots)
        return sum(list(self.slots.values())[:before])


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
            raise ValueError("it names one: a 'command', or a 'webhook'")
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
                raise ValueError(f"'{thing.name}' belongs to '{thing.frame}', which is no frame; there are: {known}")
        for name, station in self.stations.items():
            if station.frame is not None:
                moved_mm = self.frames[station.frame].moved_mm(station.position_mm)
                self.stations[name] = station.model_copy(update={"position_mm": moved_mm, "frame": None})
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
                raise ValueError(f"'{name}' names none: letters, digits and _, and not {', '.join(DEVICES)}")
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
