"""What a lab describes in `robot/`: powders, containers, and the cell with its devices and stations.

These are the models of `robot/powders.yaml`, `robot/containers.yaml` and `robot/cell.yaml`, and the
values that travel on a workflow's wires (`Powder`, `Source`, `Container`).
"""

import math
from typing import Annotated, Any, Literal, Self
from urllib.parse import urlsplit

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    NonNegativeFloat,
    PositiveFloat,
    field_validator,
    model_validator,
)

from scuhand_bt.quantity import (
    CubicMillimetres,
    Degrees,
    Milligrams,
    MilligramsPerCubicMillimetre,
    Millimetres,
    MillimetresPerSecond,
    Ratio,
    Seconds,
    plain_name,
)


class Spec(BaseModel):
    """A frozen part of a lab's description; in YAML its fields are written without their unit suffix."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", alias_generator=plain_name, populate_by_name=True, allow_inf_nan=False
    )


Positive = Field(gt=0)
NotNegative = Field(ge=0)


class PowderFlowSpec(Spec):
    """How a powder behaves in simulation (`scuhand_bt.sim.powder`, docs/calibration.md); no controller reads it."""

    flow_coefficient: PositiveFloat = 75.0
    """C' of Q = C' (D - kd)^2.5, in mg s^-1 mm^-2.5."""
    dead_diameter_mm: Annotated[Millimetres, NotNegative] = 0.12
    """kd of the Beverloo law: below this opening nothing flows."""
    gravity: Annotated[Ratio, Field(ge=0, le=1)] = 1.0
    """Share of the flow that needs no vibration: 1 for a free-flowing powder, 0 for a cohesive one."""
    load_variation: Annotated[Ratio, Field(ge=0, le=3)] = 0.10
    """Spread of the flow from one cone load to the next."""
    packing_variation: Annotated[Ratio, Field(ge=0, le=3)] = 0.03
    """Spread of the flow from one opening of the valve to the next."""
    rate_variation: Annotated[Ratio, Field(ge=0, le=3)] = 0.05
    """Fluctuation of the flow within an opening."""
    arch_diameter_mm: Annotated[Millimetres, NotNegative] = 0.0
    """Da: the mass between arches grows as exp((D/Da)^3); 0 for a powder that never arches."""
    surge_share: Annotated[Ratio, Field(ge=0, lt=1)] = 0.0
    """Share of the flow that comes in lumps."""
    surge_mg: Annotated[Milligrams, NotNegative] = 0.0
    """Mean mass of a lump; at an opening of 1 mm if `surge_exponent` is not 0."""
    surge_exponent: Annotated[float, Field(ge=0, le=10)] = 0.0
    """How a lump grows with the opening: 0 fixed, 3 with the gap's volume."""
    heel: Annotated[Ratio, Field(ge=0, lt=1)] = 0.02
    """Share of a cone load that stays on the wall until it is shaken."""
    slot_mg_per_mm: NonNegativeFloat = 0.3
    """What the space between the sheets holds per mm of opening; squeezed out as the valve closes."""
    residue_mg: Annotated[Milligrams, NotNegative] = 3.0
    """What sticks to the sheet until it is swapped."""


class PowderBelief(Spec):
    """What controllers believe of a powder: a first guess in `robot/powders.yaml`, then learnt per lot.

    The flow is q = coefficient (D - threshold)^exponent, in mg/s with D in mm.
    """

    coefficient: PositiveFloat = 70.0
    threshold_mm: Annotated[Millimetres, NotNegative] = 0.1
    exponent: Annotated[float, Field(gt=0, le=10)] = 2.5
    spread: Annotated[Ratio, Field(gt=0, le=3)] = 0.5
    """Relative standard deviation of the flow about that law, from one opening to the next."""
    surge_mg: Annotated[Milligrams, NotNegative] = 0.3
    """Mass that may come at once, unasked."""
    vibration: Annotated[Ratio, Field(ge=0, le=1)] = 0.0
    """The level this powder needs to flow at all; 0 for one that flows by gravity."""
    pauses: bool = True
    """Whether a powder that is to be shaken stops when it is not."""
    doses: Annotated[int, Field(ge=0)] = 0
    """How many doses it was learnt from."""


class BalanceBelief(Spec):
    """What controllers believe of a balance: pessimistic until learnt from a run's first good dose."""

    lag_s: Annotated[Seconds, Field(gt=0, le=5)] = 0.6
    """Half the time that the reading of a steadily growing mass is behind it."""
    poles: Annotated[int, Field(ge=1, le=20)] = 2
    """How many equal poles, which share that time, the reading follows the mass with."""
    misfit: Annotated[Ratio, Field(ge=0, le=1)] = 0.1
    """The largest share of a sudden mass that this model of the balance was off by, noise apart."""
    noise_mg: Annotated[Milligrams, NotNegative] = 0.1
    """Standard deviation of a single reading on a quiet pan."""
    fits: Annotated[int, Field(ge=0)] = 0
    """How many openings the lag was learnt from; 0 while it is only assumed."""


class Powder(Spec):
    """A powder of `robot/powders.yaml`."""

    name: str
    summary: str = ""
    bulk_density_mg_per_mm3: Annotated[MilligramsPerCubicMillimetre, Positive]
    repose_deg: Annotated[Degrees, Field(gt=0, lt=90)]
    wall_friction_deg: Annotated[Degrees, Field(gt=0, lt=90)]
    load_limit_mg: Annotated[Milligrams, Positive]
    """The most the cone is ever loaded with (paper: 5 g; 4 g of titanium dioxide)."""
    gain: Annotated[float, Field(gt=0, le=1)] = 0.27
    """Kp of the paper's Algorithm 1 for this powder."""
    max_opening_mm: Annotated[Millimetres, Positive] = 2.4
    """The largest opening the paper's algorithm may use for this powder."""
    scoop_loss_mg: Annotated[Milligrams, NotNegative] = 20.0
    """What one scoop, carry and return leaves on the sheet or spills: planning figure."""
    belief: PowderBelief = PowderBelief()
    """What controllers start from before anything is learnt."""
    simulation: PowderFlowSpec = PowderFlowSpec()


class ContainerKind(Spec):
    """A kind of container of `robot/containers.yaml`: an XRD holder, a pellet die, a crucible."""

    name: str
    summary: str = ""
    mouth_mm: Annotated[Millimetres, Positive]
    """Inner diameter of the opening that the powder falls through."""
    height_mm: Annotated[Millimetres, Positive]
    """Mouth above the pan."""
    capacity_mm3: Annotated[CubicMillimetres, Positive]
    empty_mass_mg: Annotated[Milligrams, Positive]
    empty_mass_tolerance_mg: Annotated[Milligrams, Positive] = 500.0
    """How far a single one may be from `empty_mass` and still be taken for this kind."""


class Mortar(Spec):
    """A mortar of `robot/containers.yaml` (`mortars:`): a spherical bowl that powder is scooped from."""

    name: str
    summary: str = ""
    bore_mm: Annotated[Millimetres, Positive]
    """Inner diameter at the rim."""
    depth_mm: Annotated[Millimetres, Positive]
    """Rim to the bowl's lowest point; at most half the bore, as the bowl is a spherical cap."""
    height_mm: Annotated[Millimetres, Positive]
    """Rim above the table."""
    outer_diameter_mm: Annotated[Millimetres, Positive]

    @model_validator(mode="after")
    def _is_a_cap(self) -> Self:
        if self.depth_mm > self.bore_mm / 2:
            raise ValueError("the bowl is a cap of a sphere: its depth is at most half its bore")
        return self

    @property
    def bowl_radius_mm(self) -> float:
        """Radius of the sphere whose cap the bowl is: (a^2 + h^2) / 2h."""
        return ((self.bore_mm / 2) ** 2 + self.depth_mm**2) / (2 * self.depth_mm)

    @property
    def capacity_mm3(self) -> float:
        """Volume of the spherical cap: pi h (3 a^2 + h^2) / 6."""
        return math.pi * self.depth_mm * (3 * (self.bore_mm / 2) ** 2 + self.depth_mm**2) / 6


class Source(Spec):
    """A mortar with powder at a station, as a recipe names it."""

    name: str
    station: str
    mortar: Mortar
    powder: Powder
    amount_mg: Annotated[Milligrams, Positive]
    lot: str = ""

    @property
    def sheet_key(self) -> str:
        """What a sheet may touch without contaminating: one powder of one lot."""
        return f"{self.powder.name}/{self.lot}" if self.lot else self.powder.name


class Container(ContainerKind):
    """One container of a batch: its kind, and the sample it is for."""

    id: str

    @property
    def kind(self) -> ContainerKind:
        """What it has in common with all of its kind."""
        return ContainerKind.model_construct(**{name: getattr(self, name) for name in ContainerKind.model_fields})


Point = Annotated[tuple[Millimetres, Millimetres, Millimetres], Field(description="x, y, z in the base frame")]


class Station(Spec):
    """A named place of the cell. `position` is the table point of a mortar, the pan's centre, …"""

    name: str
    kind: Literal["mortar", "balance", "waste", "service", "park"]
    position_mm: Point


Size = Annotated[Millimetres, Field(gt=0)]


class Obstacle(Spec):
    """A box or a cylinder (axis along z) the arm must not touch, by the centre of its shape."""

    name: str
    at_mm: Point
    box_mm: tuple[Size, Size, Size] | None = None
    cylinder_mm: tuple[Size, Size] | None = None
    """Diameter and length."""

    @model_validator(mode="after")
    def _has_one_shape(self) -> Self:
        if (self.box_mm is None) == (self.cylinder_mm is None):
            raise ValueError("it has one shape: a box, or a cylinder")
        return self


Seven = Field(min_length=7, max_length=7)
Direction = Annotated[Literal[1, -1], BeforeValidator(lambda value: {"1": 1, "-1": -1}.get(value, value))]
"""Which way a servo turns; YAML's scalars are text."""


class ArmOptions(Spec):
    """What differs from one CRANE-X7 and its cabling to the next."""

    baud: Annotated[int, Positive] = 3_000_000
    latency_s: Annotated[Seconds, Field(gt=0, le=0.1)] = 0.008
    """How long adapter and system may hold bytes back; an answer is waited for twice as long."""
    home_counts: Annotated[tuple[int, ...], Seven] = (2048,) * 7
    """Position of each servo with the arm straight up."""
    directions: Annotated[tuple[Direction, ...], Seven] = (1,) * 7
    following_limit_deg: Annotated[Degrees, Positive] = 10.0
    """A joint further than this from its goal is held up by something."""


class ArmSpec(Spec):
    """The CRANE-X7 as this cell uses it."""

    driver: Literal["dynamixel"] = "dynamixel"
    port: str = ""
    options: ArmOptions = ArmOptions()
    urdf: str = "crane_x7_scuhand_sv.urdf"
    speed_ratio: Annotated[Ratio, Field(ge=0.01, le=1)] = 1.0
    gentle_deg: Annotated[Degrees, Field(gt=0, le=90)] = 90.0
    """The largest spill angle a loaded cone is carried at; its powder's own limit where that is smaller."""


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


class HandOptions(Spec):
    """The roller's servo on the arm's bus, and the sheet as it is mounted."""

    roller_id: Annotated[int, Field(ge=0, le=252)] = 9
    roller_direction: Direction = 1
    start_diameter_mm: Annotated[Millimetres, Positive] = 90.0
    """Of the cone when the driver connects: of a sheet that has just been mounted (paper, section V)."""


class HandSpec(Spec):
    """The SCU-Hand-SV: its sheet, roller, valve and vibration motor."""

    driver: Literal["hand_controller"] = "hand_controller"
    port: str = ""
    options: HandOptions = HandOptions()
    sheet_radius_mm: Annotated[Millimetres, Field(gt=45, le=500)] = 50.0
    """More than half of the cone that a mounted sheet begins as, 90 mm (paper, section V)."""
    roller_deg_per_mm: Annotated[float, Field(gt=0)] = 11.46
    """Roller angle per millimetre of sheet along the rim; calibrated (default: a 10 mm roller)."""
    morph_speed_mm_per_s: Annotated[MillimetresPerSecond, Positive] = 20.0
    """Speed of the sheet's edge along the rim while the cone changes its size; what the roller's servo can turn."""
    apex_offset_mm: Annotated[Millimetres, Positive] = 120.0
    """Flange to cone apex along the j7 axis."""
    max_opening_mm: Annotated[Millimetres, Field(gt=0, le=20)] = 2.4
    valve_speed_mm_per_s: Annotated[MillimetresPerSecond, Field(ge=0.1)] = 4.0
    valve_dead_time_s: Annotated[Seconds, NotNegative] = 0.06
    streaming: bool = True
    """False for a controller board that offers the step command only."""
    simulation: ValveErrorSpec = ValveErrorSpec()

    @model_validator(mode="after")
    def _sheet_makes_the_cone(self) -> Self:
        if self.options.start_diameter_mm >= 2 * self.sheet_radius_mm:
            raise ValueError(f"this sheet makes cones of less than {2 * self.sheet_radius_mm:g} mm")
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


class BalanceSpec(Spec):
    """The balance under the hand."""

    driver: Literal["and", "mt_sics", "sbi", "shimadzu"] = "shimadzu"
    port: str = ""
    options: BalanceOptions = BalanceOptions()
    readability_mg: Annotated[Milligrams, Positive] = 0.1
    maximum_mg: Annotated[Milligrams, Positive] = 120_000.0
    period_s: Annotated[Seconds, Field(gt=0, le=2)] = 0.1
    simulation: BalanceResponseSpec = BalanceResponseSpec()

    @property
    def least_tolerance_mg(self) -> float:
        """Two digits: a stable mean is known to about half of one, and acceptance keeps twice that inside."""
        return 2.0 * self.readability_mg

    @property
    def lost_after_s(self) -> float:
        """Without a word for this long, the balance is taken for lost."""
        return max(3.0, 10.0 * self.period_s)


class ChangerSpec(Spec):
    """What brings containers: a carousel, or the operator."""

    driver: Literal["carousel", "operator"] = "carousel"
    port: str = ""
    options: dict[str, Any] = {}
    slots: Annotated[int, Field(gt=0)] = 24
    """Containers it holds before a person has to fill it again."""


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
    plant: str | None = None
    """`module:Class` of the simulated physics; none for the shipped one."""
    notify: NotifySpec | None = None
    stations: dict[str, Station]
    geometry: list[Obstacle] = []

    def station_of_kind(self, kind: str) -> Station:
        """The first station of a kind; KeyError if the cell has none."""
        for station in self.stations.values():
            if station.kind == kind:
                return station
        raise KeyError(kind)


class Dose(Spec):
    """The result for one container: what was asked, what the balance says is there, and the verdict."""

    target_mg: float
    tolerance_mg: float
    dispensed_mg: float
    """By a stable mean of the balance: gross now less gross before."""
    uncertainty_mg: float
    """Standard uncertainty of `dispensed_mg`."""
    pulses: int
    vibration_s: float
    duration_s: float
    controller: str
    verdict: Literal["in tolerance", "under", "over"]

    @property
    def error_mg(self) -> float:
        return self.dispensed_mg - self.target_mg
