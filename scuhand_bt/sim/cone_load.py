"""The powder in the cone: its intake, every way it leaves, and its fall until it has landed.

`scuhand_bt.sim.mortars` computes the intake. Powder leaves the apex while the valve is open or leaks. It pours over
the rim when the cone leans, or is accelerated, more than its load allows (`scuhand_bt.sim.spilling`). It lands, after
its fall time, on what stands below.
"""

from collections import deque
from collections.abc import Iterable, Mapping
from typing import ClassVar

from numpy.random import Generator

from scuhand_bt.sim.arm import SimulatedArm
from scuhand_bt.sim.cone_over import ConePose
from scuhand_bt.sim.faults import Faults
from scuhand_bt.sim.hand import SimulatedHand
from scuhand_bt.sim.mass_ledger import (
    BALANCE,
    CONE,
    FLIGHT,
    PAN,
    SHEET,
    WASTE,
    Compartment,
    MassLedger,
)
from scuhand_bt.sim.mortars import Mortars
from scuhand_bt.sim.pan import Pan
from scuhand_bt.sim.plain_state import Misplaced
from scuhand_bt.sim.plant import BREAKS, Plant, PowderFlow
from scuhand_bt.sim.spilling import Carried, poured_mg
from scuhand_bt.sim.under_the_cone import Surroundings
from scuhand_bt.specs import Source

CLOG_SHAKE_S = 3.0
"""The vibration at full level that breaks a clog at the apex."""
LEAK_MG_PER_S = 2.0
"""The leak of the shut valve in the fault `cone.leak`."""


class ConeLoad:
    """The powder in the cone, of one source, and the powder in the air."""

    STATE: ClassVar[tuple[str, ...]] = (
        "source",
        "flow",
        "flying",
        "_was_open",
        "_rim_mm",
        "_flow_rng",
        "_scoop_rng",
        "_shaken_s",
    )
    """The attributes that the world's file keeps, beside the masses."""

    def __init__(
        self,
        ledger: MassLedger,
        pan: Pan,
        around: Surroundings,
        sources: Mapping[str, Source],
        plant: Plant,
        mortars: Mortars,
        arm: SimulatedArm,
        hand: SimulatedHand,
        faults: Faults,
    ) -> None:
        self.source: str | None = None
        """The source of the powder; None while the present sheet has held none."""
        self._ledger, self._masses_mg, self._pan, self._around = ledger, ledger.masses_mg, pan, around
        self._sources, self._plant, self._mortars = sources, plant, mortars
        self._arm, self._hand, self._faults = arm, hand, faults
        self._flow: PowderFlow | None = None
        self._flying: deque[tuple[float, float, Compartment]] = deque()  # (time of landing, mg, where)
        self._below: tuple[str | None, Compartment, float] | None = None  # container on the pan, where, fall time [s]
        self._was_open = False
        self._carried = Carried()
        self._rim_mm = hand.cone_diameter_mm  # at the last step
        self._is_pouring = True  # until the first look, also in a resumed world
        self._shaken_s = 0.0
        self._flow_rng: Generator
        self._scoop_rng: Generator

    def use_randomness(self, flow: Generator, scoop: Generator) -> None:
        """Draw from these generators from now on."""
        self._flow_rng, self._scoop_rng = flow, scoop

    @property
    def is_falling(self) -> bool:
        """Whether powder is in the air, or may fall in the next step."""
        return bool(self._flying) or self._was_open or "cone.leak" in self._faults.active

    @property
    def flying(self) -> list[tuple[float, float, str]]:
        """The time of landing [s], the mass [mg] and the compartment (as text) of all powder in the air."""
        return [(time_s, mass_mg, str(place)) for time_s, mass_mg, place in self._flying]

    @flying.setter
    def flying(self, written: Iterable[tuple[float, float, str]]) -> None:
        self._flying = deque((time_s, mass_mg, Compartment.of_text(text)) for time_s, mass_mg, text in written)

    @property
    def flow(self) -> PowderFlow | None:
        """The flow of the powder in the cone; in a resumed world a new one, which then takes the kept state."""
        if self._flow is None and self.source is not None:
            if self.source not in self._sources:
                raise Misplaced(f"powder of '{self.source}', which the recipe no longer has, is in the cone")
            self._flow = self._plant.flow(self._sources[self.source].powder)
        return self._flow

    @flow.setter
    def flow(self, taken_up: PowderFlow | None) -> None:
        self._flow = taken_up

    @property
    def is_in_the_air(self) -> bool:
        return bool(self._flying)

    def begin(self, source: str) -> None:
        """The cone holds this source's powder from now on."""
        self.source, self._below = source, None
        self._flow = self._plant.flow(self._sources[source].powder)

    def throw_away(self) -> None:
        """Throw away the sheet, with the powder on it and in the cone."""
        for place in (CONE, SHEET):
            self._ledger.transfer(place, WASTE, self._masses_mg[place])
        self._flow = self.source = None

    def advance(self, end_s: float, dt_s: float, opening_mm: float) -> float:
        """Advance by a step at this mean opening; returns the mass [mg] that landed on the balance."""
        if opening_mm > 0.0 or self._was_open:
            self._leave(end_s, dt_s, opening_mm)
        elif "cone.leak" in self._faults.active:
            self.drop(end_s, min(LEAK_MG_PER_S * dt_s, self._masses_mg[CONE]))
        rim_mm = self._hand.cone_diameter_mm
        if self._arm.is_active or rim_mm != self._rim_mm:
            self._rim_mm, self._below = rim_mm, None
            self._move(end_s, dt_s)
        else:
            self._carried.rest()
            if self._is_pouring:
                self._move(end_s, dt_s)
        return self._land(end_s) if self._flying else 0.0

    def drop(self, now_s: float, mass_mg: float) -> None:
        """Let this mass fall from the cone's apex."""
        if mass_mg <= 0.0:
            return
        if self._below is None or self._arm.is_active or self._below[0] != self._pan.container_id:
            apex_mm = 1000.0 * self._arm.pose(now_s).position_m
            self._below = (self._pan.container_id, *self._around.below(apex_mm, self._pan.mouth_mm, self.source))
        self._fall(now_s, mass_mg, *self._below[1:])

    def _pour(self, now_s: float, mass_mg: float, pose: ConePose) -> None:
        """Let this mass fall over the rim."""
        if mass_mg > 0.0:
            self._fall(now_s, mass_mg, *self._around.below(pose.lip_mm, self._pan.mouth_mm, self.source))

    def _fall(self, now_s: float, mass_mg: float, place: Compartment, fall_s: float) -> None:
        self._ledger.transfer(CONE, FLIGHT, mass_mg)
        self._flying.append((now_s + fall_s, mass_mg, place))

    def _leave(self, end_s: float, dt_s: float, opening_mm: float) -> None:
        """Let powder flow out of the apex."""
        in_cone_mg = self._masses_mg[CONE]
        self._was_open = opening_mm > 0.0
        if in_cone_mg <= 0.0 or self._flow is None or self._is_clogged(end_s, dt_s):
            return
        try:
            leaving_mg = self._flow.step(dt_s, opening_mm, self._hand.felt_vibration, in_cone_mg, self._flow_rng)
            leaving_mg = self._plant.leaving(leaving_mg, in_cone_mg)
        except BREAKS as error:  # of a user's plant
            self._plant.blame(error, "flow")
            raise
        self.drop(end_s, leaving_mg)

    def _is_clogged(self, now_s: float, dt_s: float) -> bool:
        if "powder.clog" not in self._faults.active:
            return False
        self._shaken_s += self._hand.felt_vibration * dt_s
        if self._shaken_s >= CLOG_SHAKE_S:
            self._shaken_s = 0.0
            self._faults.end("powder.clog", now_s)
        return True

    def _move(self, end_s: float, dt_s: float) -> None:
        """The cone has moved: through a mortar's powder, or with a load that may go over its rim."""
        at = self._arm.pose(end_s)
        pose = ConePose(1000.0 * at.position_m, at.axis, self._rim_mm, self._hand.spec.sheet_radius_mm)
        was_inside = self._mortars.inside
        if self._mortars.go(pose, self.source) and was_inside is not None:
            self._lift(was_inside, end_s)
        in_cone_mg = self._masses_mg[CONE]
        self._is_pouring = False
        if in_cone_mg <= 0.0 or self.source is None:
            self._carried.rest()
            return
        lean = self._carried.lean(end_s, pose)
        if self._mortars.inside is None:
            powder = self._sources[self.source].powder
            mass_mg = poured_mg(in_cone_mg, lean, pose, powder, dt_s)
            self._is_pouring = mass_mg > 0.0
            self._pour(end_s, mass_mg, pose)

    def _lift(self, source: str, now_s: float) -> None:
        """The cone has come out of a mortar."""
        lifted_mg = self._mortars.lifted_mg()
        if lifted_mg <= 0.0:
            return
        if self._faults.comes("scoop.nothing", now_s):
            self._mortars.give_back(source, lifted_mg)
            return
        self._mortars.keep_of(source, lifted_mg, self._scoop_rng)
        self.begin(source)

    def _land(self, now_s: float) -> float:
        """Land the powder whose fall is over; returns the mass [mg] that landed on the balance."""
        landed_mg = 0.0
        flying = self._flying
        while flying and flying[0][0] <= now_s:
            _, mass_mg, place = flying.popleft()
            mass_mg = min(mass_mg, self._masses_mg[FLIGHT])
            if place in (BALANCE, PAN):
                landed_mg += mass_mg
            if place == BALANCE:
                density = self._sources[self.source].powder.bulk_density_mg_per_mm3 if self.source is not None else 0.0
                self._pan.land(mass_mg, density)
            else:
                self._ledger.transfer(FLIGHT, place, mass_mg)
        if not flying:  # rounding leaves a residue
            self._ledger.transfer(FLIGHT, WASTE, self._masses_mg[FLIGHT])
        return landed_mg
