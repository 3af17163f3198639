"""Answers to requests for motions from rest to rest, of an empty cone or a load. Each is planned once.

Between two places, where the arm goes again and again, the empty cone's motion is polished. It is planned over the
bare pan, and also used with something on the pan if it is proven free of that.

A load is planned for by a ladder of spill limits, the rungs (docs/motion.md, "Loads"). The motions of all rungs up to
its own, and the empty cone's, are each timed for the load's own limit, and the quickest is taken. So a load that may
lean more is never slower, whatever was asked before. The loosest rung is searched first, as its motion is mostly good
enough to end the ladder.

Answers are kept in memory and on disk. Those cut short by `Patience` are not, as they depend on the machine.

Joints in radians, shape (7,), goals (n, 7), spill limits in degrees. Raises SkillFailed arm.no_path and
arm.start_in_collision.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from scuhand_bt.motion import explain, transfer
from scuhand_bt.motion.kinematics import ApexPose, Floats, Mount
from scuhand_bt.motion.pace import Pace
from scuhand_bt.motion.patience import Patience
from scuhand_bt.motion.places import Places
from scuhand_bt.motion.plan_store import PlanStore
from scuhand_bt.motion.proof import is_whole
from scuhand_bt.motion.recent import Recent
from scuhand_bt.motion.requests import Request
from scuhand_bt.motion.scenes import CLOSE_MARGIN_M, MARGIN_M, Geometry, Scenes
from scuhand_bt.motion.stopping import StoppableTrajectory
from scuhand_bt.motion.timelaw import rest_to_rest_s
from scuhand_bt.motion.trajectory import JointTrajectory, begun_later, standing
from scuhand_bt.motion.transfer import ATTEMPTS, POLISHED, PREPARED, AtHand, Effort

SURE = 1.01
"""A load's motion within this factor of the least that any other rung may take ends the search."""
NEAR_OPTIMUM = 1.15
"""A load is measured by a motion of the empty cone; a direct one within this factor of the bound suffices for that."""
RUNGS = {10.0: 1.10, 20.0: 1.07, 30.0: 1.04, 45.0: 1.02}
"""The spill limits [deg] that loads are planned for: those up to a load's own limit, and always the first. Similar
loads share them; in between, and below the first, motions are slowed. The values are the least duration of a rung's
motions, relative to the empty cone's. So stricter rungs need no search if a looser one is already as quick."""
STRICTEST_DEG = min(RUNGS)
PLANS_KEPT = 256
"""How many answers are kept in memory."""

Found = TypeVar("Found", bound=JointTrajectory)


def _rungs_up_to(limit_deg: float) -> list[float]:
    """The rungs up to a load's own limit, the loosest first."""
    return [rung_deg for rung_deg in reversed(RUNGS) if rung_deg <= max(limit_deg, STRICTEST_DEG)]


@dataclass(frozen=True, slots=True)
class Way:
    """A request without the load; `name` is what messages call its goal."""

    begin: Floats
    goals: Floats
    name: str
    geometry: Geometry
    effort: Effort
    patience: Patience = field(default_factory=Patience)
    pose: ApexPose | None = None
    """The pose whose configurations the goals are, if any."""

    def request(self, spill_limit_deg: float | None) -> Request:
        """The key under which its answer is kept."""
        return Request.of(self.begin, self.goals, self.geometry, spill_limit_deg, self.effort)

    @property
    def back(self) -> "Way":
        """The reverse request between two configurations."""
        return replace(self, begin=self.goals[0], goals=self.begin[None, :])


class Answers:
    """The answers of one cell. `mount_of` gives the mount for a geometry's cone."""

    def __init__(
        self,
        scenes: Scenes,
        places: Places,
        pace: Pace,
        mount_of: Callable[[Geometry], Mount],
        store: PlanStore | None,
    ) -> None:
        self._scenes, self._places, self._pace, self._mount_of, self._store = scenes, places, pace, mount_of, store
        self._plans: Recent[Request, StoppableTrajectory | None] = Recent(PLANS_KEPT)
        self._carries: Recent[Request, StoppableTrajectory] = Recent(PLANS_KEPT)

    def empty(self, way: Way) -> StoppableTrajectory:
        """An empty cone's motion."""
        return self._found(self._kept(way, None), way)

    def loaded(self, way: Way, spill_limit_deg: float) -> StoppableTrajectory:
        """A load's motion."""

        def made() -> StoppableTrajectory:
            return self._pace.stoppable(self._carried(way, spill_limit_deg), self._mount_of(way.geometry))

        return self._carries.of(way.request(spill_limit_deg), made, lambda: not way.patience.cut_short)

    def _found(self, motion: Found | None, way: Way) -> Found:
        if motion is None:
            raise explain.no_way(self._scenes.of(way.geometry, CLOSE_MARGIN_M), way.name, way.begin, way.goals)
        return motion

    # Loads ------------------------------------------------------------------------------------------

    def _carried(self, way: Way, spill_limit_deg: float) -> JointTrajectory:
        """The quickest of the empty cone's motion and those of all rungs, each timed for this limit.

        No rung's motion is quicker than its floor: one that is begins later by the difference.
        """
        # All motions of a stricter limit are among these, where they are no quicker. What ends the search early is
        # within SURE of the floors of the remaining rungs, as floors grow with strictness. So a looser limit is never
        # slower by more than SURE.
        rungs_deg = _rungs_up_to(spill_limit_deg)
        empty, mount = self._emptied(way), self._mount_of(way.geometry)
        bound_s = float(rest_to_rest_s(way.goals - way.begin, self._pace.rates).min())
        best = self._pace.timed(empty, mount, spill_limit_deg)
        for rung_deg in rungs_deg:
            floor_s = self._floor_s(empty, rung_deg)
            is_sure = best is not None and best.duration_s <= SURE * max(floor_s, bound_s)
            if is_sure or way.patience.ends(best is not None):
                break
            motion = self._pace.timed(self._kept(way, rung_deg), mount, spill_limit_deg)
            if motion is not None and (best is None or max(floor_s, motion.duration_s) < best.duration_s):
                best = begun_later(motion, floor_s - motion.duration_s)
        if best is None and spill_limit_deg > rungs_deg[0]:
            # After an interruption the load may lean more than the rungs allow, though not more than its own limit.
            best = self._pace.timed(self._kept(way, spill_limit_deg), mount, spill_limit_deg)
        return self._found(best, way).keeping(spill_limit_deg)

    def _floor_s(self, empty: JointTrajectory | None, limit_deg: float) -> float:
        """The floor of a rung's motions [s], also for limits above it; 0 without an empty cone's motion."""
        quickest = self._pace.quick(empty)
        return 0.0 if quickest is None else RUNGS[_rungs_up_to(limit_deg)[0]] * quickest.duration_s

    def _emptied(self, way: Way) -> StoppableTrajectory | None:
        """The empty cone's motion that a load is measured by. It is searched for longer than for its own sake."""
        closer = replace(way.effort, near_optimum=min(way.effort.near_optimum, NEAR_OPTIMUM))
        return self._kept(replace(way, effort=closer), None)

    # Answers that are kept --------------------------------------------------------------------------

    def _kept(self, way: Way, spill_limit_deg: float | None) -> StoppableTrajectory | None:
        """The plan of a request, made once; None if no way is found. Raises SkillFailed if an end is not free.

        Between two configurations only one direction is planned.
        """
        if self._between_places(way):
            way = replace(way, effort=POLISHED if spill_limit_deg is None else PREPARED)
        key, mount = way.request(spill_limit_deg), self._mount_of(way.geometry)

        def made() -> StoppableTrajectory | None:
            is_reversed = len(way.goals) == 1 and key.goals < key.begin
            if is_reversed:
                self._require_free_ends(way)
                # A reversed motion has the same path, limits and accelerations, so it needs no new proof.
                there = self._kept(way.back, spill_limit_deg)
                return None if there is None else self._pace.stoppable(there.reversed(), mount)
            found = self._from_store(key)
            if found is None:
                found = self._planned(way, spill_limit_deg)
                if found is not None and self._store is not None and is_final() and way.geometry.occupied is None:
                    self._store.keep(key.written, found, is_common=self._between_places(way))
            if found is None:
                return None
            # A load's motion is slowed for the servos later, together with its own limit.
            return self._pace.stoppable(self._pace.borne(found, mount) if spill_limit_deg is None else found, mount)

        def is_final() -> bool:
            return not way.patience.cut_short

        return self._plans.of(key, made, is_final)

    def _from_store(self, request: Request) -> JointTrajectory | None:
        """The stored plan of a request, if it satisfies everything that a new plan would."""
        limit_deg, geometry = request.spill_limit_deg, request.geometry
        motion = self._store.found(request.written, limit_deg) if self._store is not None else None
        if motion is None or not is_whole(motion, self._pace.rates, self._mount_of(geometry), limit_deg):
            return None
        if not request.has_ends_of(motion):
            return None
        scene = self._scenes.of(geometry)
        if scene.hits(np.stack([motion.start, motion.end])).any():
            scene = self._scenes.of(geometry, CLOSE_MARGIN_M)
        return motion if scene.proves(motion) else None

    def _planned(self, way: Way, spill_limit_deg: float | None) -> JointTrajectory | None:
        """A new plan; or the one for the usual geometry, if it is proven free of the container or zones here."""
        if way.geometry != (bare := way.geometry.usual) and self._between_places(way):
            over_bare_pan = self._kept(replace(way, geometry=bare), spill_limit_deg)
            if over_bare_pan is not None and self._scenes.of(way.geometry).proves(over_bare_pan):
                return over_bare_pan
        if spill_limit_deg is None:
            return self._searched(way, None, AtHand(patience=way.patience))
        return self._planned_for_load(way, spill_limit_deg)

    def _planned_for_load(self, way: Way, rung_deg: float) -> JointTrajectory | None:
        """A rung's motion. Only simple searches are made if they, or other rungs, have found one."""
        empty, mount = self._emptied(way), self._mount_of(way.geometry)
        floor_s, will_do = self._floor_s(empty, rung_deg), self._pace.timed(empty, mount, rung_deg) is not None
        at_hand = AtHand(least_s=floor_s, enough_s=SURE * floor_s, will_do=will_do, patience=way.patience)
        if rung_deg == STRICTEST_DEG:
            return self._searched(way, rung_deg, replace(at_hand, attempts=2 * ATTEMPTS))
        # Not started from a stricter rung's motion, which is level and may be too slow to be improved on.
        if (quick := self._searched(way, rung_deg, replace(at_hand, is_quick=True))) is not None:
            return quick
        stricter_deg = max(one for one in RUNGS if one < rung_deg)
        known = self._pace.timed(self._kept(way, stricter_deg), mount, rung_deg)
        return known if will_do or known is not None else self._searched(way, rung_deg, at_hand)

    def _searched(self, way: Way, spill_limit_deg: float | None, known: AtHand) -> JointTrajectory | None:
        for margin_m in (MARGIN_M, CLOSE_MARGIN_M):
            scene = self._scenes.of(way.geometry, margin_m)
            start_free = not scene.hits(way.begin[None, :])[0]
            ranked = transfer.Goals.ranked(way.goals, way.begin, self._pace.rates, scene)
            if start_free and len(ranked.free):
                break
        if not start_free:
            raise explain.start_in_collision(scene, way.begin)
        if not len(ranked.free):
            raise explain.goal_blocked(scene, way.name, way.goals)
        if np.abs(ranked.free[0] - way.begin).max() < 1e-9:
            return standing(way.begin)
        mount = self._mount_of(way.geometry)
        task = transfer.Task(way.begin, ranked, scene, self._pace.rates, mount, spill_limit_deg, way.pose)
        return transfer.plan(task, way.effort, way.request(spill_limit_deg).seed, known)

    def _require_free_ends(self, way: Way) -> None:
        if not self._scenes.of(way.geometry).hits(np.vstack([way.begin, way.goals])).any():
            return
        close = self._scenes.of(way.geometry, CLOSE_MARGIN_M)
        if close.hits(way.begin[None, :])[0]:
            raise explain.start_in_collision(close, way.begin)
        if close.hits(way.goals).all():
            raise explain.goal_blocked(close, way.name, way.goals)

    def _between_places(self, way: Way) -> bool:
        ends = (way.begin, *way.goals[:2])
        return len(way.goals) == 1 and all(self._places.is_posture(q, way.geometry) for q in ends)
