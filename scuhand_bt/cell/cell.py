"""The cell: the devices at one bench, what they are believed to hold, and the motions between stations.

Skills act only through this object.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from operator import is_
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from scuhand_bt.cell.believed import Believed
from scuhand_bt.cell.carrying import spill_limit_of, upright_again
from scuhand_bt.cell.in_the_way import InTheWay, StoppedShort
from scuhand_bt.cell.places import CLEAR_MM, Position
from scuhand_bt.cell.right_of_way import LOOK_S, ZONE_TIMEOUT_S, RightOfWay, taken
from scuhand_bt.cell.scooping import planned_out, planned_stroke
from scuhand_bt.cell_spec import DEVICES, CellSpec
from scuhand_bt.clock import Clock, Steps, Wake
from scuhand_bt.devices.interfaces import (
    Arm,
    Balance,
    Changer,
    Device,
    Hand,
    Joints,
    Operator,
    Reading,
    StableMean,
    Trajectory,
)
from scuhand_bt.dosing import DEFAULT_CONTROLLER
from scuhand_bt.dosing.characteristic import Step
from scuhand_bt.dosing.cone import Cone
from scuhand_bt.dosing.swing import StrokePath
from scuhand_bt.events.cell import ArmFreed
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.motion import ApexPose, apex
from scuhand_bt.motion.axes import of_arm, of_roller
from scuhand_bt.record import Record
from scuhand_bt.specs import BalanceBelief, BalanceFigure, Container, PowderBelief, Source

PLANNING_S = 0.05
"""Run time charged for a plan, however fast it was made, so that dry runs do not depend on the machine."""
RIM_DECIMALS = 6
"""Decimals of a rim [mm] computed from the roller's angle, so that rounding does not make it another rim."""
RECENT = 4000
"""Readings kept: some minutes, in which a person puts a container on the pan."""

if TYPE_CHECKING:
    from scuhand_bt.motion import MotionPlanner
    from scuhand_bt.motion.stopping import StoppableTrajectory

T = TypeVar("T")


@dataclass
class Cell:
    """One bench, real or simulated."""

    spec: CellSpec
    clock: Clock
    record: Record
    arm: Arm
    hand: Hand
    balance: Balance
    changer: Changer
    operator: Operator
    motion: "MotionPlanner"
    """Told by this object, at each motion, the cone's size and what stands on the pan."""
    sources: Mapping[str, Source]
    simulated: bool
    devices: Mapping[str, Device] = field(default_factory=dict)
    """Further devices, by the names that robot/cell.yaml gives them."""
    places_mm: Mapping[str, Position] = field(default_factory=dict)
    """The named places of this run (`cell/places.py`)."""
    believed: Believed = field(default_factory=Believed)
    begin_sample: Callable[[str, int], None] = lambda sample, attempt: None
    """Called at the start of each job with (sample id, attempt); the simulation draws its randomness by it."""
    sheet_mounted: Callable[[], None] = lambda: None
    """Called when a fresh sheet has been clamped; the simulation discards the old one."""
    mortar_refilled: Callable[[str, float], None] = lambda source, mass_mg: None
    """Called when a person has put a mass [mg] into a source's mortar; the simulation follows."""
    weight_on_pan: Callable[[float], None] = lambda mass_mg: None
    """Called when the operator has put a weight [mg] on the pan, or taken it off (0); the simulation follows."""
    of_job: Sequence[Container] = ()
    """The containers of the present job: the changer is filled before the first one, and not between them."""
    controller: str = DEFAULT_CONTROLLER
    """The dosing controller of this run."""
    strokes_made: dict[str, list[float]] = field(default_factory=dict)
    """By source, the headings [deg] of strokes made by this process; each stroke is turned from those before it."""
    powder_beliefs: dict[str, PowderBelief] = field(default_factory=dict)
    """What is learnt about powders, by `Source.sheet_key`; the powder's own `belief` until then."""
    balance_belief: BalanceBelief = field(default_factory=BalanceBelief)
    """What is learnt about the balance."""
    balance_figures: dict[BalanceFigure, float | None] = field(default_factory=dict)
    """What this run has measured of it; None for an earlier figure that no longer holds."""
    known_delay_s: float | None = None
    """How late it last showed a load, in this run or an earlier one."""
    came: Step | None = None
    """How the balance has shown the container that came last, in this process."""
    weighed: StableMean | None = None
    """The last weighing with arm and hand at rest, in this process."""
    readings: deque[Reading] = field(default_factory=lambda: deque(maxlen=RECENT))
    """The balance's last readings, filled where they arrive."""
    right_of_way: RightOfWay = field(init=False)
    """Who has which zone, and who needs stillness."""
    in_the_way: InTheWay = field(init=False)
    """What comes into the cell unplanned."""

    def __post_init__(self) -> None:
        self.right_of_way = RightOfWay(self)
        self.in_the_way = InTheWay(self)

    @property
    def balance_name(self) -> str:
        """The balance and its settings, to which what is known of it belongs."""
        spec = self.spec.balance
        who = self.balance.identity or f"of {self.spec.cell}"
        return f"{spec.driver} {who}, {spec.readability_mg:g} mg, {1.0 / spec.period_s:.3g} Hz"

    def device(self, name: str) -> Any:
        """A device by the name that skills lease it under: arm, hand, balance, changer, or that of `devices:`.

        It meets the Protocol of its kind (`devices/instruments.py`), which a skill may state: `a: Sensor =
        cell.device("a")`.
        """
        return getattr(self, name) if name in DEVICES else self.devices[name]

    @property
    def every_device(self) -> dict[str, Device]:
        """All devices, by those names."""
        return {name: self.device(name) for name in (*DEVICES, *self.devices)}

    def apex_mm(self) -> tuple[float, float, float]:
        """The position of the cone's apex now, in the base frame."""
        x_m, y_m, z_m = self.apex().position_m
        return (1000 * x_m, 1000 * y_m, 1000 * z_m)

    def apex(self) -> ApexPose:
        """The pose of the cone's apex now."""
        return apex(self.arm.positions, self.motion.mount(self.hand.cone_diameter_mm))

    def aside_of_pan_mm(self) -> float:
        """Horizontal distance of the cone's apex from the middle of the pan."""
        return math.dist(self.apex_mm()[:2], self.spec.station_of_kind("balance").position_mm[:2])

    def place(self, name: str) -> ApexPose:
        """The apex pose of a named place, cone upright; raises KeyError for an unknown one."""
        return ApexPose(np.array(self.places_mm[name]) / 1000)

    def move_to(self, place: str | ApexPose) -> Steps[None]:
        """Move to a named place or a pose, with a loaded cone within its spill angle (`motion/spill.py`).

        A cone that leans more, as after a halted pouring, is turned upright first. If there is no way around zones that
        others have, wait for these. Raises SkillFailed arm.no_path, arm.unreachable, arm.start_in_collision,
        arm.joint_limit, arm.zone_taken.
        """
        if (turning := upright_again(self)) is not None:
            yield from self._follow(turning)
        while True:
            trajectory = yield from self._planned(
                lambda planner: planner.move(self.arm.positions, place, spill_limit_deg=spill_limit_of(self))
            )
            try:
                yield from self._follow(trajectory)
            except StoppedShort:
                continue
            return

    def lower_to(self, place: str, from_above_mm: float, speed_mm_per_s: float) -> Steps[None]:
        """Move above a named place, and from there straight down; a load stays in the cone all the way.

        Raises SkillFailed as `move_to`.
        """
        limit_deg = spill_limit_of(self)
        down = yield from self._planned(
            lambda planner: planner.descent(place, from_above_mm / 1000, speed_mm_per_s / 1000, limit_deg)
        )
        with self.right_of_way.ahead():
            there = yield from self._planned(
                lambda planner: planner.move(self.arm.positions, down.start, spill_limit_deg=limit_deg)
            )
            yield from self._follow(there)
            yield from self._follow(down)

    def touch(self, waypoints: Sequence[ApexPose], speed_mm_per_s: float, station: str | None) -> Steps[None]:
        """Move the apex along straight lines; the sheet may touch the mortar at `station`, nothing else.

        Waits for zones on the way that others have. Raises SkillFailed arm.no_path, arm.unreachable, arm.zone_taken.
        """
        motion = yield from self._planned(
            lambda _: self.contact(waypoints, speed_mm_per_s, station), only_zones=True, touching=station
        )
        yield from self._follow(motion)

    def contact(self, waypoints: Sequence[ApexPose], speed_mm_per_s: float, station: str | None) -> Trajectory:
        """The trajectory of `touch`, to be started beside another motion."""
        return self._planner().contact(self.arm.positions, waypoints, speed_mm_per_s / 1000, touching=station)

    def planned(self, plan: "Callable[[], T]") -> "Steps[T]":
        """The result of a skill's `plan`; if it fails while others have zones, try again once these are free.

        Raises SkillFailed as `plan` does, and arm.zone_taken.
        """
        return self._planned(lambda _: plan())

    def plan_stroke(self, path: StrokePath, source: Source) -> "StoppableTrajectory":
        """The motion of arm and roller along a stroke, as near to the mortar's place as possible.

        Raises SkillFailed arm.no_path, arm.unreachable.
        """
        near = self._planner().standing_at(source.station)
        return planned_stroke(self.motion, near, path, self.spec, source.station, source.mortar)

    def soon_gets_out(self, motion: "StoppableTrajectory", source: Source) -> bool:
        """Whether a way out of the mortar with the heaviest load is quickly found from a planned stroke's end."""
        rim_mm = Cone.from_roller(math.degrees(float(motion.end[-1])), self.spec.hand).diameter_mm
        try:
            planned_out(self._planner(rim_mm), motion, self.spec, source, rim_mm, is_brief=True)
        except SkillFailed:
            return False
        return True

    def make_stroke(self, motion: "StoppableTrajectory", station: str) -> Steps[float]:
        """Move to a stroke's beginning with the cone formed, and along the stroke; returns the rim there [mm].

        The cone is formed on the way, from where the arm stands. If something is in its way, or a cone may hold powder,
        which would fall out as it tilts, it is formed from the mortar's place on. If that is not possible either, it is
        formed at the mortar's place.
        """
        # Not the rim asked for: if the lip comes to the wall later, the rim has closed somewhat by then.
        begins_deg = math.degrees(float(motion.start[-1]))
        open_mm = round(Cone.from_roller(begins_deg, self.spec.hand).diameter_mm, RIM_DECIMALS)
        with self.right_of_way.ahead():
            yield from self._led_to(motion.start[:-1], open_mm, station)
            yield from self._together(motion)
        return open_mm

    def _led_to(self, begin: Joints, open_mm: float, station: str) -> Steps[None]:
        """Move to a stroke's beginning, with the cone formed."""
        is_empty = self.believed.cone_source is None and not self.believed.has_rest
        forming = self._forming(begin, open_mm) if is_empty else None
        if forming is None:
            yield from self.move_to(station)
            forming = self._forming(begin, open_mm)
        if forming is None:
            yield from self.right_of_way.go()
            yield from self.hand.morph(open_mm)
            there = yield from self._planned(lambda planner: planner.move(self.arm.positions, begin), only_zones=True)
            yield from self._follow(there)
        else:
            yield from self._together(forming)

    def _forming(self, goal: Joints, rim_mm: float) -> "StoppableTrajectory | None":
        """The motion to a configuration that also forms the empty cone; None where something is in the way."""
        rims_mm = (self.hand.cone_diameter_mm, rim_mm)
        try:
            return self._planner().forming(self.arm.positions, goal, rims_mm, self._roller_rad)
        except SkillFailed:
            return None

    def _together(self, motion: "StoppableTrajectory") -> Steps[None]:
        """Follow a motion of arm and roller."""
        yield from self.right_of_way.go()
        yield from self.in_the_way.followed(motion, self._both(motion))
        self.right_of_way.crossed()

    def _both(self, motion: "StoppableTrajectory") -> Steps[None]:
        arm = self.arm.follow(of_arm(motion))
        self.hand.start_rolling(of_roller(motion))
        is_over = False
        try:
            for wake in arm:
                if (fault := self.hand.fault) is not None:
                    raise fault
                yield wake
            is_over = True
        finally:
            arm.close()
            if not is_over:
                self.hand.stop()

    def form_upright(self, place: str, diameter_mm: float) -> Steps[None]:
        """Move to a named place and change the cone's size there; the handle turns along, so that it stays upright.

        Raises SkillFailed as `move_to`.
        """
        yield from self.move_to(place)
        yield from self._together(self._planner().reform(self.arm.positions, place, diameter_mm, self._roller_rad))

    def _roller_rad(self, rim_mm: float) -> float:
        """The roller's angle at a rim, from the flat sheet."""
        return math.radians(Cone(rim_mm, self.spec.hand.sheet_radius_mm).roller_deg(self.spec.hand))

    def _planner(self, rim_mm: float | None = None) -> "MotionPlanner":
        """The planner, told the cone's size (or what it will be), what stands on the pan, and the zones of others.

        Nobody else needs to tell it.
        """
        pan, closed = self.believed.pan, self.right_of_way.crossing()
        formed_mm = self.hand.cone_diameter_mm if rim_mm is None else rim_mm
        self.motion.set_geometry(formed_mm / 1000, pan.kind if pan is not None else None, closed)
        if self.spec.watchers:
            self.motion.set_occupied(self.in_the_way.points_m)
        return self.motion

    def _planned(
        self, plan: "Callable[[MotionPlanner], T]", *, only_zones: bool = False, touching: str | None = None
    ) -> "Steps[T]":
        """A motion around the zones of others and what is seen; if there is none, try again once they are free.

        If the arm stands in something, move out first, except of the mortar at `touching`. With `only_zones` that is a
        failure, unless the arm was limp; and what is seen is not waited for.
        """
        began_s, is_freed, is_obstructed = self.clock.now_s, False, False
        deadline_s = began_s + ZONE_TIMEOUT_S
        while True:
            around, seen = self._around, self.in_the_way.seen
            try:
                found = plan(self._planner())
            except SkillFailed as failure:
                if not (closed := self.right_of_way.closed):
                    may_free = failure.code == Code.ARM_START_IN_COLLISION and not is_freed
                    if only_zones and not (may_free and self.arm.was_limp):
                        raise
                    if may_free:  # before waiting for what is seen, which may be elsewhere, and stay
                        try:
                            out, what = self._way_out(touching)
                        except SkillFailed as stuck:
                            failure = stuck
                        else:
                            is_freed = True
                            self.record.event(ArmFreed(what=what, duration_s=round(out.duration_s, 3)))
                            yield from self._follow(out)
                            continue
                    if only_zones or not self.spec.watchers or self.in_the_way.points_m is None:
                        raise failure
                    is_obstructed = True
                    yield from self.in_the_way.gone(began_s, failure)
                    continue
            else:
                if is_obstructed:
                    self.in_the_way.waited(began_s)
                return found
            if self.clock.now_s >= deadline_s:
                raise self._fails_all_the_same(plan) or taken(closed, ZONE_TIMEOUT_S)
            # Nothing else can help until something changes; planning may take as long as the time between readings.
            while (
                self._around == around and all(map(is_, self.in_the_way.seen, seen)) and self.clock.now_s < deadline_s
            ):
                yield Wake.on(self.right_of_way.news, min(deadline_s, self.clock.now_s + LOOK_S))

    @property
    def _around(self) -> tuple[frozenset[str], Container | None, float]:
        """What a motion is planned by, besides the arm's position and what is seen."""
        return self.right_of_way.closed, self.believed.pan, self.hand.cone_diameter_mm

    def _fails_all_the_same(self, plan: "Callable[[MotionPlanner], T]") -> SkillFailed | None:
        """Why there is no such motion even with all zones free; None if there is one. Then the zone is not to blame."""
        with self.right_of_way.as_if_open():
            try:
                plan(self._planner())
            except SkillFailed as failure:
                return failure
        return None

    def _way_out(self, touching: str | None) -> "tuple[StoppableTrajectory, str]":
        """A slow way out of what the arm touches, and what that is; raises SkillFailed arm.start_in_collision.

        The sheet may touch the mortar at `touching`. Only an arm that was limp can be in another one.
        """
        return self._planner().way_out(
            self.arm.positions, spill_limit_of(self), touching, from_mortars=self.arm.was_limp
        )

    def zones_entered(self) -> frozenset[str]:
        """The zones that the arm is in."""
        if not self.spec.zones:
            return frozenset()
        return self.motion.entered(self.arm.positions, self.hand.cone_diameter_mm / 1000)

    @property
    def may_meet_a_container(self) -> bool:
        """Whether the arm is where containers are changed: over the pan, or in any zone."""
        return self.aside_of_pan_mm() < CLEAR_MM or bool(self.zones_entered())

    def _follow(self, trajectory: Trajectory) -> Steps[None]:
        planned_s = self.clock.now_s + PLANNING_S
        while self.clock.now_s < planned_s:
            yield Wake(planned_s)
        yield from self.right_of_way.go()
        yield from self.in_the_way.followed(trajectory, self.arm.follow(trajectory))
        self.right_of_way.crossed()
