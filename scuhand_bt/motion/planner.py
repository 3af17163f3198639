"""The planning service: the one object that skills ask, through the cell, for a motion.

A request is (start, goal, geometry, constraint, effort). Its answer is planned once, and the last answers are kept
(`answers`). Geometry is the cone's size, what stands on the pan, and which mortar may be touched. Each has its own
immutable scene, built when first needed. Budgets are counts, and the random seed is a hash of the request. So the same
request gets the same motion on every machine with the same versions, unless `patience_s` limits its time.

Joints in radians, shape (7,); poses of the apex in metres. Failures are `SkillFailed` with the codes arm.unreachable,
arm.no_path, arm.start_in_collision and arm.joint_limit; nothing has moved then.
"""

import itertools
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.device_specs.hand import MOUNTED_DIAMETER_MM, HandSpec
from scuhand_bt.failures import SkillFailed
from scuhand_bt.motion import explain
from scuhand_bt.motion.answers import Answers, Way
from scuhand_bt.motion.arm_model import Arm
from scuhand_bt.motion.collision import Scene
from scuhand_bt.motion.contact import contact_motion, with_seams
from scuhand_bt.motion.decomposed import DecomposedArm
from scuhand_bt.motion.inverse import nearest_configuration, solutions
from scuhand_bt.motion.kinematics import ApexPose, Floats, Mount, apex, checked_joints
from scuhand_bt.motion.occupancy import SEEN, VOXEL_M, Occupancy
from scuhand_bt.motion.pace import Pace
from scuhand_bt.motion.patience import FOR_EVER_S, Patience
from scuhand_bt.motion.places import Places, visits_rad
from scuhand_bt.motion.plan_store import PlanStore
from scuhand_bt.motion.recent import Recent
from scuhand_bt.motion.reform import RollerAngle, forming_motion, reform_motion
from scuhand_bt.motion.scenes import CLOSE_MARGIN_M, CONE_DIAMETER_M, MARGIN_M, Geometry, Scenes, kept_diameter_m
from scuhand_bt.motion.stopping import StoppableTrajectory
from scuhand_bt.motion.stroke import StrokePoses, arm_part, stroke_motion, with_roller
from scuhand_bt.motion.timelaw import RateLimits
from scuhand_bt.motion.torque import Strain, Torques
from scuhand_bt.motion.trajectory import JointTrajectory, later, standing
from scuhand_bt.motion.transfer import LIVE, Effort
from scuhand_bt.motion.way_out import way_out
from scuhand_bt.specs import ContainerKind, Mortar

STROKES_KEPT, OTHERS_KEPT = 64, 192


class MotionPlanner:
    """Plans the arm's motions in one cell, and keeps what it has planned.

    `urdf` is the text of the robot's URDF, `mortars` what stands at the mortar stations, by name. `plans` is the
    folder in which plans are kept for later planners of the same geometry; each is proven again.

    Raises ValueError for a URDF or a cell that does not describe this arm, KeyError for an unknown station.
    """

    def __init__(
        self, urdf: str, cell: CellSpec, mortars: Mapping[str, Mortar] | None = None, plans: Path | None = None
    ) -> None:
        self.urdf = urdf
        self._store = None if plans is None else PlanStore(plans, urdf, cell, mortars or {})
        arm = Arm(urdf, cell.arm)
        arm.require_names([solid.name for solid in (*cell.geometry, *cell.zones)] + list(mortars or {}))
        self._cell, self._limits_rad, self._arm = cell, arm.limits_rad, arm.decomposed
        self.rates = RateLimits(arm.rates.speed * cell.arm.speed_ratio, arm.rates.acceleration, arm.rates.jerk)
        hand_kg = None if cell.hand.mass_mg is None else cell.hand.mass_mg / 1e6
        self._pace = Pace(self.rates, Torques(arm.model, cell.arm.torque_ratio, hand_kg))
        self.tool = arm.tool
        self._geometry = Geometry()
        self._scenes = Scenes(arm, cell, mortars or {})
        self._places = Places(self._scenes, cell.hand, arm.decomposed, self.rates, visits_rad(cell))
        self._mount_in = partial(_mounted, cell.hand, arm.decomposed)
        self._answers = Answers(self._scenes, self._places, self._pace, self._mount_in, self._store)
        self._strokes: Recent[Hashable, StoppableTrajectory | SkillFailed] = Recent(STROKES_KEPT)
        self._others: Recent[Hashable, StoppableTrajectory] = Recent(OTHERS_KEPT)
        self.patience_s = FOR_EVER_S
        """How long `move` searches for something quicker than an answer that it has [s, wall time]; see `patience`."""

    # What the cell looks like now -------------------------------------------------------------------

    def set_geometry(
        self,
        cone_diameter_m: float = CONE_DIAMETER_M,
        container: ContainerKind | None = None,
        closed: frozenset[str] = frozenset(),
    ) -> None:
        """Set the rim's diameter, the kind of container on the pan, and the closed zones, for all later requests.

        Raises ValueError for a rim that the sheet cannot make.
        """
        rim_mm, widest_mm = 1e3 * cone_diameter_m, 2 * self._cell.hand.sheet_radius_mm
        if not 0 < rim_mm < widest_mm:
            raise ValueError(f"this sheet makes cones of less than {widest_mm:g} mm, not of {rim_mm:g} mm")
        self._geometry = Geometry(kept_diameter_m(cone_diameter_m), container, closed, self._geometry.occupied)

    def set_occupied(self, points_m: Floats | None, voxel_m: float = VOXEL_M) -> None:
        """Set where something else is seen, as points (n, 3) whose cubes nothing may touch; None for nothing.

        The points must not include the arm's own. Later requests are planned for them. Motions under way are not
        changed; see `keeps_clear`. Raises ValueError for malformed points.
        """
        occupied = None if points_m is None else Occupancy.of(points_m, voxel_m)
        self._geometry = replace(self._geometry, occupied=occupied)

    def keeps_clear(self, motion: JointTrajectory, from_s: float = 0.0) -> bool:
        """Whether the rest of a motion is proven clear of what is seen now; other contacts are not considered."""
        scene = self._scenes.of_seen(self._geometry)
        if scene is None:
            return True
        left_s = max(motion.duration_s - from_s, 0.0)
        arm = arm_part(motion) if motion.start.size > self.joints else motion
        return scene.curve_free(later(arm, from_s), left_s, arm.extremes()[1])

    def entered(self, q: Floats, cone_diameter_m: float | None = None) -> frozenset[str]:
        """The zones that the arm is in at a configuration, with the present rim or another."""
        geometry = self._geometry if cone_diameter_m is None else Geometry(kept_diameter_m(cone_diameter_m))
        one = (frozenset({zone}) for zone in self._cell.zone_names)
        return frozenset[str]().union(*(z for z in one if self._scenes.of_zones(geometry, z).hits(q[None, :])[0]))

    def add_place(self, name: str, pose: ApexPose) -> None:
        """Name a pose between which the cell moves. Raises SkillFailed arm.unreachable if the arm cannot reach it."""
        self._places.add(name, pose)

    def scene(self, margin_m: float = MARGIN_M, touching: str | None = None) -> Scene:
        """The arm in the present geometry."""
        return self._scenes.of(self._geometry, margin_m, touching)

    # Motions ----------------------------------------------------------------------------------------

    def home(self) -> Floats:
        """The posture of the park place, where a simulated arm starts: shape (7,)."""
        name = self._cell.station_of_kind("park").name
        if name not in self._places.names:
            x, y, z = self._cell.stations[name].position_mm
            self.add_place(name, ApexPose(np.array([x, y, z]) / 1e3))
        return self._posture(name).copy()

    @property
    def places(self) -> list[str]:
        """The names of all places."""
        return self._places.names

    def standing_at(self, place: str) -> Floats:
        """The configuration (7,) in which the arm stands at a place. Raises SkillFailed arm.no_path if it cannot."""
        return self._posture(place).copy()

    def held_at(self, place: str) -> Strain:
        """What the arm's most strained joint holds at a place. SkillFailed arm.no_path if the arm cannot stand
        there.
        """
        torques = self._pace.torques
        return torques.strain(torques.holding(self._posture(place)[None, :]))

    def prepare(
        self, pans: Iterable[tuple[ContainerKind, str]] = (), carries: Iterable[tuple[str, str, float]] = ()
    ) -> None:
        """Plan and polish the motions between all places, so that a missing way is found before anything moves.

        They are planned with a bare pan and with each container on it; and around the cell's zones, between places
        outside them. `pans` are those containers with the places over them; a place is left out while another kind
        stands there. `carries` are start, destination and spill limit [deg] of loads to plan for; others are planned
        when asked for.
        """
        over, carried = dict(pans), list(carries)
        for kind, place in ((None, None), *over.items()):
            names = [one for one in self._places.names if place in (None, one) or one not in over.values()]
            with self._as_if(replace(self._geometry, container=kind)):
                for first, second in itertools.combinations(names, 2):
                    self.move(self._posture(first), second)
                for first, second, limit_deg in carried:
                    if first in names and second in names:
                        self.move(self._posture(first), second, spill_limit_deg=limit_deg)
        if zones := frozenset(self._cell.zone_names):
            with self._as_if(Geometry(self._geometry.cone_diameter_m)):
                outside = [name for name in self._places.names if not self.entered(self._posture(name))]
            with self._as_if(Geometry(self._geometry.cone_diameter_m, None, zones)):
                for first, second in itertools.combinations(outside, 2):
                    self.move(self._posture(first), second)

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
        pose = goal if isinstance(goal, ApexPose) and len(goals) > 1 else None
        way = Way(begin, goals, name, self._geometry, effort, Patience(self.patience_s), pose)
        if spill_limit_deg is None:
            return self._answers.empty(way)
        if not spill_limit_deg > 0:
            raise ValueError(f"a spill limit is an angle above zero, not {spill_limit_deg!r} deg")
        return self._answers.loaded(way, spill_limit_deg)

    def keep_plans(self) -> None:
        """Write what was planned to the folder of plans, if there is one."""
        if self._store is not None:
            self._store.write()

    def let_go(self) -> None:
        """Free most of its memory, the scenes; the next request has to wait until they are rebuilt."""
        self._scenes.let_go()

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

        The sheet may touch the mortar at the station `touching`; nothing else may. A load is kept within
        `spill_limit_deg`.
        """
        begin = checked_joints(start, self._limits_rad)
        if not waypoints:
            return self._stoppable(standing(begin))

        def made() -> StoppableTrajectory:
            scene = self.scene(CLOSE_MARGIN_M, touching)
            motion = contact_motion(begin, waypoints, speed_m_per_s, scene, self.rates, self._mount, spill_limit_deg)
            return self._borne(motion)

        way = tuple(pose.digest for pose in waypoints)
        asked = ("contact", begin.tobytes(), way, speed_m_per_s, touching, spill_limit_deg, self._geometry)
        return self._others.of(asked, made)

    def descent(
        self, place: str, from_above_m: float, speed_m_per_s: float, spill_limit_deg: float | None = None
    ) -> StoppableTrajectory:
        """Straight down to a place, rest to rest: planned upwards from its posture, as others may have no such way.

        A load is kept within `spill_limit_deg`. Raises SkillFailed arm.no_path, arm.unreachable.
        """
        posture = self._posture(place)

        def made() -> StoppableTrajectory:
            below = apex(posture, self._mount)
            above = ApexPose(below.position_m + from_above_m * below.axis, below.axis)
            scene = self.scene(CLOSE_MARGIN_M)
            try:
                up = contact_motion(posture, [above], speed_m_per_s, scene, self.rates, self._mount, spill_limit_deg)
            except SkillFailed as failure:
                way = f"the last {1e3 * from_above_m:g} mm straight down to '{place}'"
                raise SkillFailed(failure.code, f"{way}: {failure.detail}") from None
            return self._borne(up.reversed())

        asked = ("descent", posture.tobytes(), from_above_m, speed_m_per_s, spill_limit_deg, self._geometry)
        return self._others.of(asked, made)

    def way_out(
        self,
        start: Floats,
        spill_limit_deg: float | None = None,
        touching: str | None = None,
        *,
        from_mortars: bool = False,
    ) -> tuple[StoppableTrajectory, str]:
        """A slow motion out of what the arm touches, and what that is; `move` can go on from its end.

        The sheet may touch the mortar at the station `touching`; `contact` goes on from there. Raises SkillFailed
        arm.start_in_collision if the arm touches nothing, stands too deep in something, or the load would spill. Also
        if it touches a closed zone or what was seen (which are waited for), or a mortar (which `withdraw` leaves)
        unless `from_mortars`.
        """
        begin, scene = checked_joints(start, self._limits_rad), self.scene(CLOSE_MARGIN_M, touching)
        kept_in = {SEEN, *self._geometry.closed, *(() if from_mortars else self._scenes.mortars)}
        motion = way_out(scene, begin, self.rates, self._mount, kept_in, spill_limit_deg)
        return self._stoppable(motion), explain.closest_pair(scene, begin)

    def forming(
        self, start: Floats, goal: Floats, rims_mm: tuple[float, float], roller_rad: RollerAngle
    ) -> StoppableTrajectory:
        """The empty cone's motion between two configurations while its rim changes: 8 columns.

        If the roller takes longer, the arm waits at the start, and then arrives with the wanted rim. The wait and each
        half of the way are proven with the rims that the cone has then. Raises SkillFailed as `move`, and arm.no_path
        if the cone would touch something.
        """
        begin, end = (checked_joints(q, self._limits_rad) for q in (start, goal))
        rates = with_roller(self.rates, self._cell.hand)
        last = replace(self._geometry, cone_diameter_m=rims_mm[1] / 1e3)

        def made() -> StoppableTrajectory:
            with self._as_if(last):
                way = self.move(begin, end)
            scene_of = partial(self._scenes.of_stroke, last, station=None, margin_m=CLOSE_MARGIN_M)
            return self._borne(forming_motion(way, rims_mm, rates, roller_rad, scene_of), rates)

        return self._others.of(("forming", begin.tobytes(), end.tobytes(), rims_mm, self._geometry), made)

    def stroke(self, near: Floats, poses: StrokePoses, rims_mm: Sequence[float], station: str) -> StoppableTrajectory:
        """A stroke of arm and roller in the mortar at a station, begun as near to `near` as is possible.

        Eight columns: the joints and the roller. `rims_mm` are the first rim, some in between, and the last. Raises
        SkillFailed arm.unreachable, arm.no_path.
        """
        begin, hand = checked_joints(near, self._limits_rad), self._cell.hand

        def made() -> StoppableTrajectory | SkillFailed:
            scene = self._scenes.of_stroke(self._geometry, rims_mm, station, CLOSE_MARGIN_M)
            mount, rates = self.mount(rims_mm[0]), with_roller(self.rates, hand)
            try:
                motion = self._pace.borne(stroke_motion(begin, poses, scene, rates, mount), mount)
                return self._pace.stoppable(motion, mount, rates)
            except SkillFailed as failure:  # kept too, as it is as expensive as a stroke, and asked for as often
                return SkillFailed(failure.code, failure.detail)  # the original's frames would keep this scene alive

        found = self._strokes.of((begin.tobytes(), poses.digest, tuple(rims_mm), station, self._geometry), made)
        if isinstance(found, SkillFailed):
            raise SkillFailed(found.code, found.detail)
        return found

    def reform(self, start: Floats, place: str, diameter_mm: float, roller_rad: RollerAngle) -> StoppableTrajectory:
        """Arm and roller (8 columns) from `start`, the cone upright, to a place with a cone of another size.

        The cone stays upright: apex, handle, elbow and rim change evenly to what they are in the place's posture.
        Raises SkillFailed arm.no_path.
        """
        hand, begin = self._cell.hand, checked_joints(start, self._limits_rad)
        end = self._places.posture(place, replace(self._geometry, cone_diameter_m=diameter_mm / 1e3))
        rims_mm = (1e3 * self._geometry.cone_diameter_m, diameter_mm)
        rates = with_roller(self.rates, hand)

        def made() -> StoppableTrajectory:
            three_mm = [rims_mm[0], sum(rims_mm) / 2, rims_mm[1]]
            scene = self._scenes.of_stroke(self._geometry, three_mm, None, CLOSE_MARGIN_M)
            motion = reform_motion(begin, end, rims_mm, scene, rates, hand, roller_rad, self._arm)
            return self._borne(motion, rates)

        return self._others.of(("reform", begin.tobytes(), end.tobytes(), rims_mm, self._geometry), made)

    @property
    def _mount(self) -> Mount:
        """The mount of the present geometry's cone."""
        return self._mount_in(self._geometry)

    @property
    def joints(self) -> int:
        """Number of joints of the arm."""
        return len(self._limits_rad[0])

    def mount(self, diameter_mm: float = MOUNTED_DIAMETER_MM) -> Mount:
        """The mount of this cell's hand and arm with a rim of this diameter."""
        return Mount.of(self._cell.hand, diameter_mm, self._arm)

    # Within -----------------------------------------------------------------------------------------

    def _stoppable(self, motion: JointTrajectory, rates: RateLimits | None = None) -> StoppableTrajectory:
        return self._pace.stoppable(motion, self._mount, rates)

    def _borne(self, motion: JointTrajectory, rates: RateLimits | None = None) -> StoppableTrajectory:
        return self._stoppable(self._pace.borne(motion, self._mount), rates)

    def _resolved(self, start: Floats, goal: str | ApexPose | Floats) -> tuple[Floats, Floats, str]:
        """The start, the goal's configurations (n, 7), and what messages call the goal."""
        begin = self._places.settled(checked_joints(start, self._limits_rad), self._geometry)
        if isinstance(goal, np.ndarray):
            return begin, checked_joints(goal, self._limits_rad)[None, :], "the configuration asked for"
        if isinstance(goal, str):
            return begin, self._posture(goal)[None, :], goal
        goals = solutions(goal, self._mount, self._limits_rad)
        if not len(goals):
            explain.require_reachable(goal, "the pose", self._mount, self.scene())
        _, with_seam = with_seams(apex(begin, self._mount), [goal])
        goals = np.vstack([nearest_configuration(begin, with_seam, self._mount), goals])
        if self._arm is not None:
            goals = self._arm.nearest_turns(goals, begin)
        return begin, goals, f"({', '.join(f'{1e3 * x:.0f}' for x in goal.position_m)}) mm"

    def _posture(self, place: str) -> Floats:
        return self._places.posture(place, self._geometry)


def _mounted(hand: HandSpec, arm: DecomposedArm | None, geometry: Geometry) -> Mount:
    return Mount.of(hand, 1e3 * geometry.cone_diameter_m, arm)
