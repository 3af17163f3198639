"""The planning service: the one object that skills ask for a motion, through the cell.

A request is (start, goal, geometry, constraint); its answer is planned once, and the last ones are kept. Geometry is
the cone's size, what stands on the pan, and which mortar may be touched; each has its own immutable scene,
built when first needed. Budgets are counted, randomness is seeded by the request's own bytes: the same
request gets the same motion on every run, on every machine of the same versions. Between two places,
where the arm goes again and again, an empty cone's motion is polished; whatever stands on the pan, the
motion over the bare pan is taken where it is proven free there too.

Joints in radians, shape (7,); poses of the apex in metres. Failures are `SkillFailed` with the codes
arm.unreachable, arm.no_path, arm.start_in_collision and arm.joint_limit; nothing has moved then.
"""

import hashlib
import itertools
import math
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import TypeAlias

import numpy as np

from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.motion import explain, transfer
from scuhand_bt.motion.collision import Arm, Scene
from scuhand_bt.motion.contact import contact_motion
from scuhand_bt.motion.inverse import solutions
from scuhand_bt.motion.kinematics import JOINTS, ApexPose, Floats, Mount, apex, checked_joints
from scuhand_bt.motion.places import Places
from scuhand_bt.motion.recent import Recent
from scuhand_bt.motion.reform import RollerAngle, reform_motion
from scuhand_bt.motion.scenes import CLOSE_MARGIN_M, CONE_DIAMETER_M, MARGIN_M, Geometry, Scenes
from scuhand_bt.motion.spill import spill_stretch
from scuhand_bt.motion.stopping import StoppableTrajectory
from scuhand_bt.motion.stroke import StrokePoses, arm_part, stroke_motion, with_roller
from scuhand_bt.motion.timelaw import RateLimits, TimeLaw
from scuhand_bt.motion.trajectory import JointTrajectory, beside, standing
from scuhand_bt.motion.transfer import LIVE, POLISHED, Effort
from scuhand_bt.specs import ContainerKind, Mortar

EMPTY_WILL_DO = 1.35
"""The empty cone's motion is taken for a load too where it need not be slowed by more than this."""
SETTLED_DIAMETER_M = 0.0005
"""How far the rim of a cone that was formed to the usual diameter may be measured from it."""
LIMIT_STEP_DEG = 5.0
"""Limits of loads are rounded down to whole steps for planning: loads that differ a little share their plans."""

PLANS_KEPT = 256
STROKES_KEPT = 64

Request: TypeAlias = tuple[bytes, bytes, Geometry, float | None]
"""Start and goals as their bytes, geometry, spill limit: what a plan is kept by."""


def _request(start: Floats, goals: Floats, geometry: Geometry, spill_limit_deg: float | None) -> Request:
    return start.tobytes(), goals.tobytes(), geometry, spill_limit_deg


def _seed(request: Request) -> int:
    """A seed that belongs to the request, so that its answer is the same on every run."""
    start, goals, geometry, spill_limit_deg = request
    kind = geometry.container.name if geometry.container is not None else ""
    words = " ".join([f"{geometry.cone_diameter_m} {kind} {spill_limit_deg}", *sorted(geometry.closed)])
    digest = hashlib.blake2b(start + goals + words.encode(), digest_size=16).digest()
    return int.from_bytes(digest, "big")


def _later(motion: JointTrajectory, begin_s: float, times_s: Floats) -> Floats:
    """Where a motion is at times counted from one of its moments."""
    return motion.at(begin_s + times_s)


class MotionPlanner:
    """Plans the arm's motions in one cell, and keeps what it has planned.

    `urdf` is the text of the robot's URDF, `mortars` what stands at the mortar stations, by name.
    ValueError for a URDF or a cell that does not describe this arm, KeyError for an unknown station.
    """

    def __init__(self, urdf: str, cell: CellSpec, mortars: Mapping[str, Mortar] | None = None) -> None:
        self.urdf = urdf
        arm = Arm(urdf)
        self._cell = cell
        self.rates = RateLimits(arm.rates.speed * cell.arm.speed_ratio, arm.rates.acceleration, arm.rates.jerk)
        self._geometry = Geometry()
        self._scenes = Scenes(arm, cell, mortars or {})
        self._places = Places(self._scenes, self.rates, cell.hand)
        self._plans: Recent[Request, StoppableTrajectory] = Recent(PLANS_KEPT)
        self._carries: Recent[Request, StoppableTrajectory] = Recent(PLANS_KEPT)
        self._strokes: Recent[Hashable, StoppableTrajectory | SkillFailed] = Recent(STROKES_KEPT)
        self._reforms: Recent[Hashable, StoppableTrajectory] = Recent(STROKES_KEPT)

    # What the cell looks like now -------------------------------------------------------------------

    def set_geometry(
        self,
        cone_diameter_m: float = CONE_DIAMETER_M,
        container: ContainerKind | None = None,
        closed: frozenset[str] = frozenset(),
    ) -> None:
        """How wide the rim is, which kind of container stands on the pan, and which zones of the cell are closed.

        In all that is asked from now on.
        """
        is_usual = abs(cone_diameter_m - CONE_DIAMETER_M) <= SETTLED_DIAMETER_M
        self._geometry = Geometry(CONE_DIAMETER_M if is_usual else round(cone_diameter_m, 4), container, closed)

    def entered(self, q: Floats) -> frozenset[str]:
        """The zones of the cell that the arm is in, at a configuration."""
        one = (frozenset({zone}) for zone in self._cell.zone_names)
        return frozenset[str]().union(*(z for z in one if self._scenes.of_zones(self._geometry, z).hits(q[None, :])[0]))

    def add_place(self, name: str, pose: ApexPose) -> None:
        """Name a pose the cell moves between; SkillFailed arm.unreachable if the arm cannot reach it."""
        self._places.add(name, pose)

    def scene(self, margin_m: float = MARGIN_M, touching: str | None = None) -> Scene:
        """The arm in the present geometry."""
        return self._scenes.of(self._geometry, margin_m, touching)

    # Motions ----------------------------------------------------------------------------------------

    def home(self) -> Floats:
        """The park place's canonical configuration, where a simulated arm starts: shape (7,)."""
        name = self._cell.station_of_kind("park").name
        if name not in self._places.names:
            x, y, z = self._cell.stations[name].position_mm
            self.add_place(name, ApexPose(np.array([x, y, z]) / 1e3))
        return self._posture(name).copy()

    def prepare(self, containers: Iterable[ContainerKind] = (), carries: Iterable[tuple[str, str, float]] = ()) -> None:
        """Plan all pairs of places, with a bare pan and with each container on it, and polish them; so, too, around the
        zones of the cell, between those that are in none.

        So 'no path' is found before anything moves. `carries`: places from and to, and spill limits [deg] of
        loaded motions that are to be polished too; others are planned when they are asked for.
        """
        names, present, carried = self._places.names, self._geometry, list(carries)
        for kind in (None, *containers):
            self._geometry = Geometry(present.cone_diameter_m, kind)
            for first, second in itertools.combinations(names, 2):
                self.move(self._posture(first), second)
            for first, second, limit_deg in carried:
                self.move(self._posture(first), second, spill_limit_deg=limit_deg, effort=POLISHED)
        if zones := frozenset(self._cell.zone_names):
            self._geometry = Geometry(present.cone_diameter_m)
            outside = [name for name in names if not self.entered(self._posture(name))]
            self._geometry = Geometry(present.cone_diameter_m, None, zones)
            for first, second in itertools.combinations(outside, 2):
                self.move(self._posture(first), second)
        self._geometry = present

    def move(
        self,
        start: Floats,
        goal: str | ApexPose | Floats,
        *,
        spill_limit_deg: float | None = None,
        effort: Effort = LIVE,
    ) -> StoppableTrajectory:
        """A motion from rest at `start` to rest at a place, pose or configuration; `spill_limit_deg` for a load."""
        begin, goals, name = self._resolved(start, goal)
        if spill_limit_deg is None:
            return self._kept(begin, goals, name, None, effort)
        if not spill_limit_deg > 0:
            raise ValueError(f"a spill limit is an angle above zero, not {spill_limit_deg!r} deg")
        key = _request(begin, goals, self._geometry, spill_limit_deg)
        return self._carries.of(
            key, lambda: self._stoppable(self._carried(begin, goals, name, spill_limit_deg, effort))
        )

    def _carried(
        self, begin: Floats, goals: Floats, name: str, spill_limit_deg: float, effort: Effort
    ) -> JointTrajectory:
        """The empty cone's motion, slowed until it keeps the load; or one of the load's own, if that is quicker."""
        empty = self._kept(begin, goals, name, None, effort)
        factor = spill_stretch(empty, self._mount, spill_limit_deg) or math.inf
        if factor > EMPTY_WILL_DO:
            steps_deg = LIMIT_STEP_DEG * math.floor(spill_limit_deg / LIMIT_STEP_DEG)
            try:
                loaded = self._kept(begin, goals, name, steps_deg or spill_limit_deg, effort)
            except SkillFailed:
                if factor == math.inf:
                    raise
            else:
                if loaded.duration_s <= factor * empty.duration_s:
                    return loaded
        return empty.stretched(factor).keeping(spill_limit_deg)

    def _kept(
        self, begin: Floats, goals: Floats, name: str, spill_limit_deg: float | None, effort: Effort
    ) -> StoppableTrajectory:
        """The plan of a request, made once. Between two configurations it is made in one direction only."""
        key = _request(begin, goals, self._geometry, spill_limit_deg)

        def made() -> StoppableTrajectory:
            if len(goals) == 1 and key[1] < key[0]:
                self._require_free(begin)
                # Backwards, a motion keeps its path, its limits and its accelerations: it needs no new proof.
                there = self._kept(goals[0], begin[None, :], "its start", spill_limit_deg, effort)
                return self._stoppable(there.reversed())
            return self._stoppable(self._planned(begin, goals, name, spill_limit_deg, effort))

        return self._plans.of(key, made)

    def _planned(
        self, begin: Floats, goals: Floats, name: str, spill_limit_deg: float | None, effort: Effort
    ) -> JointTrajectory:
        """Planned anew, but for what was planned over the bare pan and is free of a container, or a zone, there too."""
        if self._places.is_posture(begin) and len(goals) == 1 and self._places.is_posture(goals[0]):
            if spill_limit_deg is None:
                effort = POLISHED
            if self._geometry != (bare := Geometry(self._geometry.cone_diameter_m)):
                with self._as_if(bare):
                    over_bare_pan = self._kept(begin, goals, name, spill_limit_deg, effort)
                if self.scene().proves(over_bare_pan):
                    return over_bare_pan
        return self._searched(begin, goals, name, spill_limit_deg, effort)

    @contextmanager
    def _as_if(self, geometry: Geometry) -> Iterator[None]:
        present, self._geometry = self._geometry, geometry
        try:
            yield
        finally:
            self._geometry = present

    def contact(
        self,
        start: Floats,
        waypoints: Sequence[ApexPose],
        speed_m_per_s: float,
        touching: str | None = None,
        spill_limit_deg: float | None = None,
    ) -> StoppableTrajectory:
        """A slow motion of the apex in straight lines from `start` through the waypoints, rest to rest.

        The sheet may touch the mortar at the station `touching`; nothing else may.
        A load is kept within `spill_limit_deg`.
        """
        begin = checked_joints(start)
        scene = self.scene(CLOSE_MARGIN_M, touching)
        if not waypoints:
            return self._stoppable(standing(begin))
        motion = contact_motion(begin, waypoints, speed_m_per_s, scene, self.rates, self._mount, spill_limit_deg)
        return self._stoppable(motion)

    def descent(
        self, place: str, from_above_m: float, speed_m_per_s: float, spill_limit_deg: float | None = None
    ) -> StoppableTrajectory:
        """Straight down to a place, rest to rest: planned upwards from its posture, as not every other lets the arm.

        A load is kept within `spill_limit_deg`. SkillFailed arm.no_path.
        """
        posture = self._posture(place)
        below = apex(posture, self._mount)
        above = ApexPose(below.position_m + from_above_m * below.axis, below.axis)
        scene = self.scene(CLOSE_MARGIN_M)
        up = contact_motion(posture, [above], speed_m_per_s, scene, self.rates, self._mount, spill_limit_deg)
        return self._stoppable(up.reversed())

    def forming(
        self, start: Floats, goal: Floats, rims_mm: tuple[float, float], roller_rad: RollerAngle
    ) -> StoppableTrajectory:
        """The empty cone's motion between two configurations, on which its rim becomes another: 8 columns.

        Either half of it is proven with the rims of that half. SkillFailed as `move`, and arm.no_path where the cone
        would touch something on the way.
        """
        rates, last = (
            with_roller(self.rates, self._cell.hand),
            replace(self._geometry, cone_diameter_m=rims_mm[1] / 1e3),
        )
        with self._as_if(last):
            way = self.move(start, goal)
        law = TimeLaw(RateLimits(rates.speed[JOINTS:], rates.acceleration[JOINTS:], rates.jerk[JOINTS:]))
        both = beside(way, law.straight(np.array([[roller_rad(rim_mm)] for rim_mm in rims_mm])))
        half_s, quarters_mm = both.duration_s / 2, np.linspace(*rims_mm, 5).round(1).tolist()
        for begin_s, three_mm in ((0.0, quarters_mm[:3]), (half_s, quarters_mm[2:])):
            scene = self._scenes.of_stroke(last, three_mm, None, CLOSE_MARGIN_M)
            course = partial(_later, arm_part(both), begin_s)
            if not scene.curve_free(course, half_s, both.extremes()[1][:JOINTS]):
                raise SkillFailed(Code.ARM_NO_PATH, f"a cone that becomes {rims_mm[1]:g} mm wide would touch something")
        return StoppableTrajectory(both, rates, self._mount)

    def stroke(self, near: Floats, poses: StrokePoses, rims_mm: Sequence[float], station: str) -> StoppableTrajectory:
        """A stroke of arm and roller in the mortar at a station, from the configuration nearest to `near` that has one.

        Eight columns: the joints, and the roller. `rims_mm` are the first, some in between, and the last. SkillFailed
        arm.unreachable, arm.no_path.
        """
        begin, hand = checked_joints(near), self._cell.hand

        def made() -> StoppableTrajectory | SkillFailed:
            scene = self._scenes.of_stroke(self._geometry, rims_mm, station, CLOSE_MARGIN_M)
            mount, rates = Mount.of(hand, rims_mm[0]), with_roller(self.rates, hand)
            try:
                return StoppableTrajectory(stroke_motion(begin, poses, scene, rates, mount), rates, mount)
            except SkillFailed as failure:  # as expensive as a stroke that there is, and asked for as often
                return failure

        found = self._strokes.of((begin.tobytes(), poses.digest, tuple(rims_mm), station, self._geometry), made)
        if isinstance(found, SkillFailed):
            raise SkillFailed(found.code, found.detail)
        return found

    def reform(self, start: Floats, place: str, diameter_mm: float, roller_rad: RollerAngle) -> StoppableTrajectory:
        """Arm and roller (8 columns) from `start`, the cone upright, to a place with a cone of another size.

        The cone stays upright: apex, handle, elbow and rim go evenly to where they are in the place's posture.
        SkillFailed arm.no_path.
        """
        hand, begin = self._cell.hand, checked_joints(start)
        end = self._places.posture(place, replace(self._geometry, cone_diameter_m=diameter_mm / 1e3))
        rims_mm = (1e3 * self._geometry.cone_diameter_m, diameter_mm)
        rates = with_roller(self.rates, hand)

        def made() -> StoppableTrajectory:
            three_mm = [rims_mm[0], sum(rims_mm) / 2, rims_mm[1]]
            scene = self._scenes.of_stroke(self._geometry, three_mm, None, CLOSE_MARGIN_M)
            motion = reform_motion(begin, end, rims_mm, scene, rates, hand, roller_rad)
            return StoppableTrajectory(motion, rates, self._mount)

        return self._reforms.of((begin.tobytes(), end.tobytes(), rims_mm, self._geometry), made)

    @property
    def _mount(self) -> Mount:
        """How the hand holds the cone of the present geometry."""
        return Mount.of(self._cell.hand, 1e3 * self._geometry.cone_diameter_m)

    # Within -----------------------------------------------------------------------------------------

    def _stoppable(self, motion: JointTrajectory) -> StoppableTrajectory:
        return StoppableTrajectory(motion, self.rates, self._mount)

    def _resolved(self, start: Floats, goal: str | ApexPose | Floats) -> tuple[Floats, Floats, str]:
        """The start, the goal's configurations (n, 7), and what to call the goal."""
        begin = self._places.settled(checked_joints(start), self._geometry)
        if isinstance(goal, np.ndarray):
            return begin, checked_joints(goal)[None, :], "where the way begins"
        if isinstance(goal, str):
            return begin, self._posture(goal)[None, :], goal
        goals = solutions(goal, self._mount)
        if not len(goals):
            explain.require_reachable(goal, "the pose", self._mount)
        return begin, goals, f"({', '.join(f'{1e3 * x:.0f}' for x in goal.position_m)}) mm"

    def _posture(self, place: str) -> Floats:
        return self._places.posture(place, self._geometry)

    def _searched(
        self, begin: Floats, goals: Floats, name: str, spill_limit_deg: float | None, effort: Effort
    ) -> JointTrajectory:
        for margin_m in (MARGIN_M, CLOSE_MARGIN_M):
            scene = self.scene(margin_m)
            start_free = not scene.hits(begin[None, :])[0]
            ranked = transfer.Goals.ranked(goals, begin, self.rates, scene)
            if start_free and len(ranked.free):
                break
        if not start_free:
            raise explain.start_in_collision(scene, begin)
        if not len(ranked.free):
            raise explain.goal_blocked(scene, name, goals)
        if np.abs(ranked.free[0] - begin).max() < 1e-9:
            return standing(begin)
        task = transfer.Task(begin, ranked, scene, self.rates, self._mount, spill_limit_deg)
        motion = transfer.plan(task, effort, _seed(_request(begin, goals, self._geometry, spill_limit_deg)))
        if motion is None:
            raise SkillFailed(Code.ARM_NO_PATH, f"no way to {name} was found that is free and keeps its limits")
        return motion

    def _require_free(self, begin: Floats) -> None:
        if self.scene().hits(begin[None, :])[0]:
            close = self.scene(CLOSE_MARGIN_M)
            if close.hits(begin[None, :])[0]:
                raise explain.start_in_collision(close, begin)
