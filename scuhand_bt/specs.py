"""What a lab describes in `robot/`: powders, containers, and the cell with its devices and stations.

These are the models of `robot/powders.yaml`, `robot/containers.yaml` and `robot/cell.yaml`, and the
values that travel on a workflow's wires (`Powder`, `Source`, `Container`).
"""

import math
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, NonNegativeFloat, PositiveFloat

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

    model_config = ConfigDict(frozen=True, extra="forbid", alias_generator=plain_name, populate_by_name=True)


Positive = Field(gt=0)
NotNegative = Field(ge=0)


class PowderFlowSpec(Spec):
    """How a powder behaves in simulation (`scuhand_bt.sim.powder`); no controller reads it."""

    flow_coefficient: PositiveFloat = 70.0
    """C' of Q = C' (D - kd)^2.5, in mg s^-1 mm^-2.5."""
    dead_diameter_mm: Annotated[Millimetres, NotNegative] = 0.14
    """kd of the Beverloo law: below this opening nothing flows."""


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


Point = Annotated[tuple[Millimetres, Millimetres, Millimetres], Field(description="x, y, z in the base frame")]


class Station(Spec):
    """A named place of the cell. `position` is the table point of a mortar, the pan's centre, …"""

    name: str
    kind: Literal["mortar", "balance", "waste", "service", "park"]
    position_mm: Point


class Obstacle(Spec):
    """A box or a cylinder (axis along z) the arm must not touch, by the centre of its shape."""

    name: str
    at_mm: Point
    box_mm: tuple[Millimetres, Millimetres, Millimetres] | None = None
    cylinder_mm: tuple[Millimetres, Millimetres] | None = None
    """Diameter and length."""


class ArmSpec(Spec):
    """The CRANE-X7 as this cell uses it."""

    driver: str = "dynamixel"
    port: str = ""
    options: dict[str, Any] = {}
    urdf: str = "crane_x7_scuhand_sv.urdf"
    speed_ratio: Annotated[Ratio, Field(gt=0, le=1)] = 1.0


class HandSpec(Spec):
    """The SCU-Hand-SV: its sheet, roller, valve and vibration motor."""

    driver: str = "hand_controller"
    port: str = ""
    options: dict[str, Any] = {}
    sheet_radius_mm: Annotated[Millimetres, Positive] = 50.0
    roller_deg_per_mm: Annotated[float, Field(gt=0)] = 11.46
    """Roller angle per millimetre of sheet along the rim; calibrated (default: a 10 mm roller)."""
    morph_speed_mm_per_s: Annotated[MillimetresPerSecond, Positive] = 40.0
    """Speed of the sheet's edge along the rim while the cone changes its size."""
    apex_offset_mm: Annotated[Millimetres, Positive] = 120.0
    """Flange to cone apex along the j7 axis."""
    max_opening_mm: Annotated[Millimetres, Positive] = 2.4
    valve_speed_mm_per_s: Annotated[MillimetresPerSecond, Positive] = 4.0
    valve_dead_time_s: Annotated[Seconds, NotNegative] = 0.06
    streaming: bool = True
    """False for a controller board that offers the step command only."""


class BalanceSpec(Spec):
    """The balance under the hand."""

    driver: str = "shimadzu"
    port: str = ""
    options: dict[str, Any] = {}
    readability_mg: Annotated[Milligrams, Positive] = 0.1
    maximum_mg: Annotated[Milligrams, Positive] = 120_000.0
    period_s: Annotated[Seconds, Field(gt=0, le=2)] = 0.1


class ChangerSpec(Spec):
    """What brings containers: a carousel, or the operator."""

    driver: Literal["carousel", "operator"] = "carousel"
    port: str = ""
    options: dict[str, Any] = {}
    slots: NonNegativeFloat = 24


class CellSpec(Spec):
    """`robot/cell.yaml`: the devices of one bench, its stations and its geometry."""

    cell: str
    arm: ArmSpec = ArmSpec()
    hand: HandSpec = HandSpec()
    balance: BalanceSpec = BalanceSpec()
    changer: ChangerSpec = ChangerSpec()
    plant: str | None = None
    """`module:Class` of the simulated physics; none for the shipped one."""
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
