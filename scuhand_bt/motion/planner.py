"""The planning service: the one object that skills ask for a motion, through the cell.

A request is (start, goal, geometry, constraint); its answer is planned once and kept. Geometry is the
cone's size, what stands on the pan, and which mortar may be touched; each has its own immutable scene,
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
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from scuhand_bt.cell_spec import CellSpec, Station
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.motion import cell_solids, transfer
from scuhand_bt.motion import contact as contact_path
from scuhand_bt.motion.collision import Arm, Scene, Solid
from scuhand_bt.motion.inverse import along, finest, solutions, swivel_of, unreachable_reason
from scuhand_bt.motion.kinematics import COUNT_RAD, ApexPose, Floats, apex, checked_joints
from scuhand_bt.motion.nearest import nearest_reachable
from scuhand_bt.motion.spill import spill_stretch
from scuhand_bt.motion.stopping import StoppableTrajectory
from scuhand_bt.motion.timelaw import RateLimits, rest_to_rest_s
from scuhand_bt.motion.trajectory import JointTrajectory, standing, through
from scuhand_bt.motion.transfer import LIVE, POLISHED, Effort
from scuhand_bt.motion.via_points import Chain
from scuhand_bt.specs import ContainerKind, Mortar

CONE_DIAMETER_M = 0.090
MARGIN_M = 0.005
RELAXED_RAD = (-0.2, 0.0, -1.6, 0.0, -1.2, 0.0)
"""j2 to j7 of an arm that reaches forward over its elbow: what postures are chosen near to."""
SETTLED_RAD = 2 * COUNT_RAD
"""How far an arm at rest may report to be from where it was sent."""
SETTLED_DIAMETER_M = 0.0005
"""The same for the rim of a cone that was formed to the usual diameter."""
EMPTY_WILL_DO = 1.35
"""The empty cone's motion is taken for a load too where it need not be slowed by more than this."""
LIMIT_STEP_DEG = 5.0
CLOSE_MARGIN_M = 0.001
"""Where the start or the goal itself is nearer to something than the usual margin; and in contact."""


@dataclass(frozen=True, slots=True)
class Geometry:
    """What the arm could touch: everything a scene is built from, besides the fixed bench."""

    cone_diameter_m: float = CONE_DIAMETER_M
    container: ContainerKind | None = None
    touching: str | None = None


Request: TypeAlias = tuple[bytes, bytes, Geometry, float | None]
"""Start and goals as their bytes, geometry, spill limit: what a plan is kept by."""


def _seed(request: Request) -> int:
    """A seed that belongs to the request, so that its answer is the same on every run."""
    start, goals, geometry, spill_limit_deg = request
    kind = geometry.container.name if geometry.container is not None else ""
    words = f"{geometry.cone_diameter_m} {kind} {spill_limit_deg}"
    digest = hashlib.blake2b(start + goals + words.encode(), digest_size=16).digest()
    return int.from_bytes(digest, "big")


class MotionPlanner:
    """Plans the arm's motions in one cell, and keeps what it has planned.

    `urdf` is the text of the robot's URDF, `mortars` what stands at the mortar stations, by name. More than one of
    `threads` gains something only where cores are idle.
    ValueError for a URDF or a cell that does not describe this arm, KeyError for an unknown station.
    """

    def __init__(
        self, urdf: str, cell: CellSpec, mortars: Mapping[str, Mortar] | None = None, *, threads: int = 1
    ) -> None:
        self.urdf = urdf
        self._arm = Arm(urdf)
        self._cell = cell
        self._mortars = dict(mortars or {})
        for name in self._mortars:
            self._station(name)
        self._bench = cell_solids.bench(cell)
        self._threads = threads
        self._offset_m = cell.hand.apex_offset_mm / 1e3
        rates, speed = self._arm.rates, cell.arm.speed_ratio
        self.rates = RateLimits(rates.speed * speed, rates.acceleration, rates.jerk)
        self._geometry = Geometry()
        self._scenes: dict[tuple[Geometry, float], Scene] = {}
        self._places: dict[str, ApexPose] = {}
        self._postures: dict[tuple[str, Geometry], Floats] = {}
        self._plans: dict[Request, StoppableTrajectory] = {}
        self._carries: dict[Request, StoppableTrajectory] = {}

    # What the cell looks like now -------------------------------------------------------------------

    def set_geometry(self, cone_diameter_m: float = CONE_DIAMETER_M, container: ContainerKind | None = None) -> None:
        """How wide the rim is, and which kind of container stands on the pan, in all that is asked from now on."""
        is_usual = abs(cone_diameter_m - CONE_DIAMETER_M) <= SETTLED_DIAMETER_M
        self._geometry = Geometry(CONE_DIAMETER_M if is_usual else round(cone_diameter_m, 4), container)

    def add_place(self, name: str, pose: ApexPose) -> None:
        """Name a pose the cell moves between; SkillFailed arm.unreachable if the arm cannot reach it."""
        self._require_reachable(pose, name)
        self._places[name] = pose
        # Where it was before, if it had been named already, is forgotten.
        self._postures = {key: q for key, q in self._postures.items() if key[0] != name}

    # Motions ----------------------------------------------------------------------------------------

    def home(self) -> Floats:
        """The park place's canonical configuration, where a simulated arm starts: shape (7,)."""
        name = self._cell.station_of_kind("park").name
        if name not in self._places:
            x, y, z = self._cell.stations[name].position_mm
            self.add_place(name, ApexPose(np.array([x, y, z]) / 1e3))
        return self._posture(name).copy()

    def prepare(self, containers: Iterable[ContainerKind] = (), carries: Iterable[tuple[str, str, float]] = ()) -> None:
        """Plan all pairs of places, with a bare pan and with each container on it, and polish them.

        So 'no path' is found before anything moves. `carries`: places from and to, and spill limits [deg] of
        loaded motions that are to be polished too; others are planned when they are asked for.
        """
        names, present, carried = list(self._places), self._geometry, list(carries)
        for kind in (None, *containers):
            self._geometry = Geometry(present.cone_diameter_m, kind)
            for first, second in itertools.combinations(names, 2):
                self.move(self._posture(first), second)
            for first, second, limit_deg in carried:
                self.move(self._posture(first), second, spill_limit_deg=limit_deg, effort=POLISHED)
        self._geometry = present

    def move(
        self, start: Floats, goal: str | ApexPose, *, spill_limit_deg: float | None = None, effort: Effort = LIVE
    ) -> StoppableTrajectory:
        """A motion from rest at `start` to rest at a place or pose; `spill_limit_deg` for a loaded cone."""
        begin, goals, name = self._request(start, goal)
        if spill_limit_deg is None:
            return self._kept(begin, goals, name, None, effort)
        if not spill_limit_deg > 0:
            raise ValueError(f"a spill limit is an angle above zero, not {spill_limit_deg!r} deg")
        key = (begin.tobytes(), goals.tobytes(), self._geometry, spill_limit_deg)
        if key not in self._carries:
            carried = self._carried(begin, goals, name, spill_limit_deg, effort)
            self._carries[key] = self._stoppable(carried)
        return self._carries[key]

    def _carried(
        self, begin: Floats, goals: Floats, name: str, spill_limit_deg: float, effort: Effort
    ) -> JointTrajectory:
        """The empty cone's motion, slowed until it keeps the load; or one of the load's own, if that is quicker."""
        empty = self._kept(begin, goals, name, None, effort)
        factor = spill_stretch(empty, self._offset_m, spill_limit_deg) or math.inf
        if factor > EMPTY_WILL_DO:
            # In steps, so that loads that differ a little share their plans.
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
        key = (begin.tobytes(), goals.tobytes(), self._geometry, spill_limit_deg)
        if key not in self._plans:
            if len(goals) == 1 and key[1] < key[0]:
                self._require_free(begin)
                # Backwards, a motion keeps its path, its limits and its accelerations: it needs no new proof.
                there = self._kept(goals[0], begin[None, :], "its start", spill_limit_deg, effort)
                self._plans[key] = self._stoppable(there.reversed())
            else:
                planned = self._planned(begin, goals, name, spill_limit_deg, effort)
                self._plans[key] = self._stoppable(planned)
        return self._plans[key]

    def _planned(
        self, begin: Floats, goals: Floats, name: str, spill_limit_deg: float | None, effort: Effort
    ) -> JointTrajectory:
        """Planned anew, but for what was planned over the bare pan and is free of a container there too."""
        if self._is_posture(begin) and len(goals) == 1 and self._is_posture(goals[0]):
            if spill_limit_deg is None:
                effort = POLISHED
            if self._geometry.container is not None:
                with self._bare_pan():
                    over_bare_pan = self._kept(begin, goals, name, spill_limit_deg, effort)
                if self.scene().proves(over_bare_pan):
                    return over_bare_pan
        chain = self._chain(begin, goals, name, spill_limit_deg, effort)
        return standing(begin) if chain is None else chain.motion

    @contextmanager
    def _bare_pan(self) -> Iterator[None]:
        present = self._geometry
        self._geometry = Geometry(present.cone_diameter_m)
        try:
            yield
        finally:
            self._geometry = present

    def _is_posture(self, q: Floats) -> bool:
        return any(np.array_equal(posture, q) for posture in self._postures.values())

    def chain(
        self,
        start: Floats,
        goal: str | ApexPose,
        *,
        spill_limit_deg: float | None = None,
        effort: Effort = LIVE,
    ) -> Chain | None:
        """The same as `move`, planned anew, with how it was found; None where there is nothing to move."""
        return self._chain(*self._request(start, goal), spill_limit_deg, effort)

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
        if touching is not None and touching not in self._mortars:
            raise KeyError(f"no mortar stands at {touching!r}; there is one at: {', '.join(self._mortars) or 'none'}")
        if not waypoints:
            return self._stoppable(standing(begin))
        poses = [apex(begin, self._offset_m), *waypoints]
        times_s, positions_m, axes = contact_path.apex_path(poses, speed_m_per_s)
        if len(times_s) < 2:
            return self._stoppable(standing(begin))
        scene = self.scene(CLOSE_MARGIN_M, touching)
        if scene.hits(begin[None, :])[0]:
            raise SkillFailed(Code.ARM_START_IN_COLLISION, self._touching(scene, begin))
        phi = swivel_of(begin, self._offset_m)
        why = "the elbow would have to jump"
        for turn in contact_path.TURNS_OF_SWIVEL_RAD:
            swivels = contact_path.swivel_course(phi, turn, len(times_s))
            course = along(positions_m, axes, swivels, begin, self._offset_m)
            if course is None:
                continue
            course[0] = begin
            motion = through(times_s, course)
            motion = motion.stretched(max(1.0, self.rates.stretch_for(motion)))
            if spill_limit_deg is not None:
                factor = spill_stretch(motion, self._offset_m, spill_limit_deg)
                if factor is None:
                    why = f"the cone would have to lean more than {spill_limit_deg:.1f} deg"
                    continue
                motion = motion.stretched(factor).keeping(spill_limit_deg)
            if scene.proves(motion):
                return self._stoppable(motion)
            _, samples = scene.proving_samples(motion.at, motion.duration_s, motion.extremes()[1])
            hits = scene.hits(samples)
            if hits.any():
                why = self._touching(scene, samples[int(np.argmax(hits))])
        for pose in waypoints:
            self._require_reachable(pose, "a waypoint")
        raise SkillFailed(Code.ARM_NO_PATH, f"no way through the waypoints: {why}")

    # Within -----------------------------------------------------------------------------------------

    def _stoppable(self, motion: JointTrajectory) -> StoppableTrajectory:
        return StoppableTrajectory(motion, self.rates, self._offset_m)

    def _request(self, start: Floats, goal: str | ApexPose) -> tuple[Floats, Floats, str]:
        """The start, the goal's configurations (n, 7), and what to call the goal."""
        begin = self._settled(checked_joints(start))
        if isinstance(goal, str):
            return begin, self._posture(goal)[None, :], goal
        goals = solutions(goal, self._offset_m)
        if not len(goals):
            self._require_reachable(goal, "the pose")
        goals[:, 6] = begin[6]
        return begin, goals, f"({', '.join(f'{1e3 * x:.0f}' for x in goal.position_m)}) mm"

    def _settled(self, q: Floats) -> Floats:
        """The posture that the arm was sent to, where it reports to be within its own error of one."""
        for place in self._places:
            posture = self._posture(place)
            if np.abs(posture - q).max() <= SETTLED_RAD:
                return posture
        return q

    def _chain(
        self, begin: Floats, goals: Floats, name: str, spill_limit_deg: float | None, effort: Effort
    ) -> Chain | None:
        nearest = np.argsort(rest_to_rest_s(goals - begin, self.rates), kind="stable")
        ranked = goals[np.concatenate([nearest[k :: transfer.STRIDE] for k in range(transfer.STRIDE)])]
        for margin_m in (MARGIN_M, CLOSE_MARGIN_M):
            scene = self.scene(margin_m)
            start_free = not scene.hits(begin[None, :])[0]
            free, more = goals[:0], ranked
            while len(more) and not len(free):
                some, more = more[: transfer.GOALS_AT_ONCE], more[transfer.GOALS_AT_ONCE :]
                free = some[~scene.hits(some)]
            if start_free and len(free):
                break
        if not start_free:
            raise SkillFailed(Code.ARM_START_IN_COLLISION, self._touching(scene, begin))
        if not len(free):
            raise SkillFailed(Code.ARM_NO_PATH, self._blocked(scene, name, goals))
        if np.abs(free[0] - begin).max() < 1e-9:
            return None
        task = transfer.Task(begin, free, more, scene, self.rates, self._offset_m, spill_limit_deg)
        seed = _seed((begin.tobytes(), goals.tobytes(), self._geometry, spill_limit_deg))
        chain = transfer.plan(task, effort, seed)
        if chain is None:
            raise SkillFailed(Code.ARM_NO_PATH, f"no way to {name} was found that is free and keeps its limits")
        return chain

    def _require_free(self, begin: Floats) -> None:
        close = self.scene(CLOSE_MARGIN_M) if self.scene().hits(begin[None, :])[0] else None
        if close is not None and close.hits(begin[None, :])[0]:
            raise SkillFailed(Code.ARM_START_IN_COLLISION, self._touching(close, begin))

    def _blocked(self, scene: Scene, name: str, q: Floats) -> str:
        best_m, names = max(scene.clearance_m(one) for one in q[:: max(1, len(q) // 12)])
        return f"the arm cannot stand at {name} in any of its {len(q)} configurations: at best {names} " + (
            f"overlap by {-best_m * 1e3:.0f} mm" if best_m < 0 else f"are {best_m * 1e3:.1f} mm apart"
        )

    def _touching(self, scene: Scene, q: Floats) -> str:
        distance_m, names = scene.clearance_m(q)
        if distance_m < 0:
            return f"{names} overlap by {-distance_m * 1e3:.0f} mm"
        return f"{names} are {distance_m * 1e3:.1f} mm apart"

    def _posture(self, place: str) -> Floats:
        """The one configuration in which the arm stands at a place; another where geometry does not let it."""
        if place not in self._places:
            raise KeyError(f"there is no place {place!r}; there are: {', '.join(self._places) or 'none'}")
        key = (place, self._geometry)
        if key not in self._postures:
            usual = self._postures.get((place, Geometry()))
            fits = usual is not None and not self.scene().hits(usual[None, :])[0]
            self._postures[key] = usual if usual is not None and fits else self._canonical(place)
        return self._postures[key]

    def _canonical(self, place: str) -> Floats:
        pose = self._places[place]
        q = solutions(pose, self._offset_m)
        scene = self.scene()
        free = q[~scene.hits(q)]
        if not len(free):
            raise SkillFailed(Code.ARM_NO_PATH, self._blocked(scene, place, q))
        azimuth_rad = float(np.arctan2(pose.position_m[1], pose.position_m[0]))
        relaxed = np.array([azimuth_rad, *RELAXED_RAD])
        chosen: Floats = free[np.argmin(rest_to_rest_s(free - relaxed, self.rates))]
        exact = finest(pose, chosen, self._offset_m)
        return chosen if scene.hits(exact[None, :])[0] else exact

    def _require_reachable(self, pose: ApexPose, name: str) -> None:
        reason = unreachable_reason(pose, self._offset_m)
        if reason is None:
            return
        near = nearest_reachable(pose, self._offset_m)
        instead = "nothing near can be reached"
        if near is not None:
            x, y, z = near.position_m * 1e3
            instead = f"the nearest apex position it can take is ({x:.0f}, {y:.0f}, {z:.0f}) mm"
        raise SkillFailed(Code.ARM_UNREACHABLE, f"{name}: {reason}; {instead}")

    def _station(self, name: str) -> Station:
        try:
            return self._cell.stations[name]
        except KeyError:
            raise KeyError(f"the cell has no station {name!r}; it has: {', '.join(self._cell.stations)}") from None

    def scene(self, margin_m: float = MARGIN_M, touching: str | None = None) -> Scene:
        """The arm in the present geometry."""
        geometry = Geometry(self._geometry.cone_diameter_m, self._geometry.container, touching)
        key = (geometry, margin_m)
        if key not in self._scenes:
            shapes = self._arm.with_sheet(
                self._offset_m, self._cell.hand.sheet_radius_mm / 1e3, geometry.cone_diameter_m
            )
            solids, touchable = self._solids(geometry)
            self._scenes[key] = Scene(self._arm, shapes, solids, margin_m, self._threads, touchable)
        return self._scenes[key]

    def _solids(self, geometry: Geometry) -> tuple[list[Solid], list[str]]:
        solids = list(self._bench)
        touchable: list[str] = []
        for name, mortar in self._mortars.items():
            if name == geometry.touching:
                parts = cell_solids.hollow_mortar(self._station(name), mortar)
                touchable = [part.name for part in parts]
                solids += parts
            else:
                solids.append(cell_solids.full_mortar(self._station(name), mortar))
        if geometry.container is not None:
            solids.append(cell_solids.container(self._cell.station_of_kind("balance"), geometry.container))
        return solids, touchable
