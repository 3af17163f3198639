"""What a lab describes of its materials: the models of `robot/powders.yaml` and `robot/containers.yaml`, what is
believed of powders and balances, and the values that travel on a workflow's wires (`Powder`, `Source`, `Container`).
"""

import math
from enum import StrEnum
from typing import Annotated, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    NonNegativeFloat,
    PositiveFloat,
    model_validator,
)

from scuhand_bt.formula import FormulaText
from scuhand_bt.quantity import (
    CubicMillimetres,
    Degrees,
    Milligrams,
    MilligramsPerCubicMillimetre,
    Millimetres,
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
    avalanche_mg: Annotated[Milligrams, NotNegative] = 0.0
    """Mean mass of the avalanches that this powder comes in while it is shaken; 0 for one that comes evenly."""
    heel: Annotated[Ratio, Field(ge=0, lt=1)] = 0.02
    """Share of a cone load that stays on the wall until it is shaken."""
    slot_mg_per_mm: NonNegativeFloat = 0.3
    """What the space between the sheets holds per mm of opening; squeezed out as the valve closes."""
    residue_mg: Annotated[Milligrams, NotNegative] = 3.0
    """What sticks to the sheet until it is swapped."""
    grain_mm: Annotated[Millimetres, Positive] = 0.1
    """Diameter: nothing passes a narrower gap under the sheet's lip."""
    film_mm: Annotated[Millimetres, NotNegative] = 0.02
    """Thickness of what stays on a mortar's wall, whatever scrapes over it."""
    loose_grains: Annotated[float, Field(ge=0, le=5)] = 0.7
    """By so many grains a layer on a wall is thicker than it is heavy: beside walls grains lie less densely."""


GAPS_MM = (0.01, 100.0)
"""Openings above the threshold that a flow may be said to have been seen at."""


class PowderBelief(Spec):
    """What controllers believe of a powder: a first guess in `robot/powders.yaml`, then learnt per lot.

    The flow is q = coefficient (D - threshold)^exponent, in mg/s with D in mm. Beverloo's law has an exponent of 2.5.
    """

    coefficient: Annotated[float, Field(ge=1e-3, le=1e9)] = 70.0
    threshold_mm: Annotated[Millimetres, NotNegative] = 0.1
    exponent: Annotated[float, Field(ge=0.5, le=10)] = 2.5
    gap_mm: Annotated[Millimetres, Field(ge=GAPS_MM[0], le=GAPS_MM[1])] = 0.5
    """The opening above the threshold that the coefficient was seen at: at others the exponent counts, too."""
    narrowest_mm: Annotated[Millimetres, Field(gt=0)] = 0.05
    """Above the threshold: from less, little comes."""
    spread: Annotated[Ratio, Field(gt=0, le=3)] = 0.5
    """Relative standard deviation of the flow about that law, from one opening to the next."""
    surge_mg: Annotated[Milligrams, Field(ge=0, le=1e5)] = 0.3
    """Mass that may come at once, unasked."""
    erratic: Annotated[float, Field(ge=1)] = 3.0
    """By what factor the variance of the predictions of its mass turned out to be too small."""
    vibration: Annotated[Ratio, Field(ge=0, le=1)] = 0.0
    """The level this powder needs to flow at all; 0 for one that flows by gravity."""
    doses: Annotated[int, Field(ge=0)] = 0
    """How many doses it was learnt from."""

    @property
    def least_mm(self) -> float:
        """The opening up to which little comes."""
        return self.threshold_mm + self.narrowest_mm

    @property
    def little_comes(self) -> str:
        """That in words, where it is too much."""
        parts = f"'threshold', {self.threshold_mm:g} mm, and 'narrowest', {self.narrowest_mm:g} mm above it"
        return f"little flows up to the belief's {parts}"


BALANCE_SHAPES = ("ringing", "lively", "two poles", "one pole", "mean", "late", "delay")
"""Kinds of filters; `scuhand_bt.dosing.identification.SHAPES` has the figures."""


def _known_shape(shape: str) -> str:
    """What another version of this program has learnt may be of another kind."""
    if shape not in BALANCE_SHAPES:
        raise ValueError(f"unknown kind of balance '{shape}'; known: {', '.join(BALANCE_SHAPES)}")
    return shape


class BalanceBelief(Spec):
    """What controllers believe of a balance: pessimistic until a container's step or a good opening has shown it."""

    lag_s: Annotated[Seconds, Field(gt=0, le=5)] = 0.6
    """Half the time that the reading of a steadily growing mass is behind it."""
    doubt: Annotated[Ratio, Field(ge=0)] = 1.0
    """Standard deviation of that time's logarithm."""
    shape: Annotated[str, AfterValidator(_known_shape)] = "two poles"
    """The kind of filter that delays it so, of `BALANCE_SHAPES`."""
    adapts: bool = False
    """Its filter takes its time while little changes, and hurries while much does: an opening shows one of the two."""
    slow_mg: Annotated[Milligrams, NotNegative] = 0.0
    """With less than this missing it takes its time, if it adapts; 0 where no container has told."""
    misfit: Annotated[Ratio, Field(ge=0, le=1)] = 0.02
    """The share of what was not yet read that this model of the balance was off by, noise apart."""
    noise_mg: Annotated[Milligrams, NotNegative] = 0.1
    """Standard deviation of a single reading on a quiet pan."""
    shaken_noise_mg: Annotated[Milligrams, NotNegative] = 0.3
    """The same while the hand's motor shakes."""
    fits: Annotated[int, Field(ge=0)] = 0
    """How many steps and openings the lag was learnt from; 0 while it is only assumed."""
    shown_s: Annotated[Seconds, NotNegative] = 0.0
    """How late it has shown a container; 0 where none has told."""

    @property
    def may_be_late(self) -> bool:
        """Whether a person's container has shown that it adapts: a dead time is not in that."""
        return self.adapts and self.shown_s == 0.0


class Departure(StrEnum):
    """Where the stepwise controllers leave the paper's listing; `scuhand_bt.dosing.paper` says what each is for."""

    GUARD = "guard"
    OVERSHOOT = "overshoot"
    GIVING_UP = "giving-up"
    SHAKEN_START = "shaken-start"
    ORDER = "order"
    FIRST_GUESS = "first-guess"
    THAW = "thaw"


class PaperSpec(Spec):
    """What Algorithm 1 of the SCU-Hand-SV paper is set to for a powder."""

    gain: Annotated[float, Field(gt=0, le=1)] = 0.27
    """Kp."""
    max_opening_mm: Annotated[Millimetres, Positive] = 2.4
    """The largest opening it may use; no other controller is held to it."""
    wait_s: Annotated[Seconds, NotNegative] = 6.3
    """Fixed wait of the paper's rig after each pulse, on top of the balance's settling (Table II: a step takes 7.2 s
    plus the time the valve is open)."""
    departures: tuple[Departure, ...] = tuple(Departure)
    """From its listing; none of them is Algorithm 1 as printed."""


class Powder(Spec):
    """A powder of `robot/powders.yaml`."""

    name: str
    summary: str = ""
    formula: FormulaText | None = None
    """What it is, for samples that are composed (docs/compose.md)."""
    bulk_density_mg_per_mm3: Annotated[MilligramsPerCubicMillimetre, Field(gt=0, le=23)]
    """At most that of osmium: what is denser is a slip of units."""
    repose_deg: Annotated[Degrees, Field(gt=0, lt=90)]
    wall_friction_deg: Annotated[Degrees, Field(gt=0, lt=90)]
    grain_mm: Annotated[Millimetres, Positive] = 0.1
    """Diameter of its grains: a scoop leaves a layer that is several of them thick, or nothing."""
    load_limit_mg: Annotated[Milligrams, Positive]
    """The most the cone is ever loaded with (paper: 5 g; 4 g of titanium dioxide)."""
    max_opening_mm: Annotated[Millimetres, Positive] = 2.4
    """The largest opening for this powder, for controllers that have none of their own."""
    paper: PaperSpec = PaperSpec()
    """For controller `paper`."""
    scoop_loss_mg: Annotated[Milligrams, NotNegative] = 20.0
    """What one scoop, carry and return leaves on the sheet or spills: planning figure."""
    belief: PowderBelief = PowderBelief()
    """What controllers start from before anything is learnt."""
    simulation: PowderFlowSpec = PowderFlowSpec()

    @model_validator(mode="after")
    def _lets_powder_through(self) -> Self:
        if self.max_opening_mm <= self.belief.threshold_mm:
            widest, least = f"{self.max_opening_mm:g} mm", f"{self.belief.threshold_mm:g} mm"
            raise ValueError(f"'max_opening' is {widest}, and nothing flows up to the belief's 'threshold', {least}")
        if self.max_opening_mm <= self.belief.least_mm:
            raise ValueError(f"'max_opening' is {self.max_opening_mm:g} mm, and {self.belief.little_comes}")
        if self.paper.max_opening_mm <= self.belief.least_mm:
            raise ValueError(
                f"'max_opening' of 'paper' is {self.paper.max_opening_mm:g} mm, and {self.belief.little_comes}"
            )
        return self

    def widest_mm(self, controller: str) -> float:
        """The largest opening that a controller of this name may use."""
        return self.paper.max_opening_mm if controller == "paper" else self.max_opening_mm

    @property
    def lump_mg(self) -> float:
        """Mean mass of the lumps that no narrower opening makes smaller."""
        simulated, is_fixed = self.simulation, self.simulation.surge_exponent == 0.0
        return max(self.belief.surge_mg, simulated.surge_mg if simulated.surge_share > 0.0 and is_fixed else 0.0)


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
    """A vessel of `robot/containers.yaml` (`mortars:`) that powder is scooped from: a mortar, a beaker or a jar.

    A mortar's inside is a spherical bowl. One with a `corner` has a level floor and an upright wall instead.
    """

    name: str
    summary: str = ""
    bore_mm: Annotated[Millimetres, Positive]
    """Inner diameter at the rim."""
    depth_mm: Annotated[Millimetres, Positive]
    """Rim to the lowest point; at most half the bore in a bowl, which is a spherical cap."""
    height_mm: Annotated[Millimetres, Positive]
    """Rim above the table."""
    outer_diameter_mm: Annotated[Millimetres, Positive]
    corner_mm: Annotated[Millimetres, Positive] | None = None
    """Inner radius between the level floor and the upright wall of a beaker or a jar; a bowl has none."""

    @model_validator(mode="after")
    def _is_a_vessel(self) -> Self:
        if self.corner_mm is None and self.depth_mm > self.bore_mm / 2:
            beyond = "a beaker or a jar has a 'corner', the radius between its floor and its wall"
            raise ValueError(f"the bowl is a cap of a sphere: its depth is at most half its bore; {beyond}")
        if self.corner_mm is not None and self.corner_mm > min(self.depth_mm, self.bore_mm / 2):
            raise ValueError("the corner is the radius between floor and wall: at most the depth, and half the bore")
        return self

    @property
    def bowl_radius_mm(self) -> float:
        """Radius of the sphere whose cap the bowl is: (a^2 + h^2) / 2h; never less than a, which rounding makes it."""
        return max(self.bore_mm / 2, ((self.bore_mm / 2) ** 2 + self.depth_mm**2) / (2 * self.depth_mm))

    @property
    def capacity_mm3(self) -> float:
        """Volume of the spherical cap, pi h (3 a^2 + h^2) / 6, or of the cylinder without what its corner takes."""
        a_mm, h_mm = self.bore_mm / 2, self.depth_mm
        if self.corner_mm is None:
            return math.pi * h_mm * (3 * a_mm**2 + h_mm**2) / 6
        c_mm = self.corner_mm
        f_mm = a_mm - c_mm
        corner_mm3 = math.pi * c_mm * (f_mm**2 + math.pi / 2 * f_mm * c_mm + 2 / 3 * c_mm**2)
        return math.pi * a_mm**2 * (h_mm - c_mm) + corner_mm3


Leftover = Literal["keep", "return", "discard"]
"""What becomes of powder that is left in the cone (`recipe/leftover.py`)."""

Keeping = Literal["never", "if_told", "unless_told"]
"""Whether a workflow lets it stay there for the next sample: as the recipe's `leftover` says, or if that is silent."""


class Assay(Spec):
    """How much of a lot is what its powder's formula says, as its certificate has it; for composed samples.

    Where an uncertainty is not given, what is not the formula is known to within itself: u = x / √3, a rectangular
    distribution (JCGM 100:2008, 4.3.7).
    """

    purity_ratio: Annotated[Ratio, Field(gt=0, le=1)] | None = None
    """Share of the formula in the dry powder."""
    purity_uncertainty_ratio: Annotated[Ratio, Field(ge=0, lt=1)] | None = None
    """Standard uncertainty of the purity, as a share of the whole."""
    water_ratio: Annotated[Ratio, Field(ge=0, lt=1)] = 0.0
    """Share of water, and of all else that drying takes away, in the powder as it is weighed; beside the formula's."""
    water_uncertainty_ratio: Annotated[Ratio, Field(ge=0, lt=1)] | None = None
    """Standard uncertainty of the water, as a share of the whole."""


class Source(Assay):
    """A mortar with powder at a station, as a recipe names it."""

    name: str
    station: str
    mortar: Mortar
    powder: Powder
    amount_mg: Annotated[Milligrams, Positive]
    lot: str = ""
    leftover: Leftover | None = None
    """What the recipe wants done with what is left of it in the cone; None for what the workflow does."""
    leftover_to: str = ""
    """The station of the vessel that it is discarded into; "" for the waste bin."""
    refill_mg: Annotated[Milligrams, Positive] | None = None
    """What a person puts into the mortar before its powder runs short; None where nobody is to come for it."""

    @property
    def is_discarded(self) -> bool:
        """Whether what is left of it in the cone goes to waste, or into another vessel."""
        return self.leftover == "discard"

    @property
    def capacity_mg(self) -> float:
        """What its mortar holds of its powder."""
        return self.mortar.capacity_mm3 * self.powder.bulk_density_mg_per_mm3

    def is_kept(self, keeping: Keeping) -> bool:
        """Whether what is left of it in the cone stays there, by its policy and what a workflow lets."""
        return keeping != "never" and (self.leftover or ("keep" if keeping == "unless_told" else "return")) == "keep"

    def refill_into_mg(self, left_mg: float) -> float:
        """How much is put into the mortar while it still holds so much: what there is room for, at the most."""
        return max(0.0, min(self.refill_mg or 0.0, self.capacity_mg - left_mg))

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


class OnPan:
    """Marks a mass that a skill has put on the pan as it is, so that `check` refuses one beyond the balance's maximum.

    weight_mg: Annotated[Milligrams, OnPan()]
    """


Verdict = Literal["in tolerance", "under", "over"]
"""What is said of a dose (`dosing/verdict.py`)."""

BalanceFigure = Literal["delay_s", "check_weight_error_mg", "repeatability_mg", "noise_mg", "drift_mg_per_s"]
"""What is measured of a balance (`dosing/characteristic.py`), beside what controllers learn."""
