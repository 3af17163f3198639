"""All that a plan will ask of the arm, found possible before it moves.

Between all places: empty past each container; with a fresh sheet's cone, where that is another than loads are carried
in; with the heaviest load from each mortar to each container and to where it is discarded, which are the ways back too;
straight down where a workflow says so; and for each mortar a stroke, in some direction, in the bed that the plan begins
with and in the one that it leaves, with the way out of it.
"""

from collections.abc import Collection, Iterator, Sequence
from itertools import combinations, islice, product

import numpy as np

from scuhand_bt.cell.carrying import carrying_limit_deg
from scuhand_bt.cell.places import all_places, over_balance
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.device_specs.hand import MOUNTED_DIAMETER_MM
from scuhand_bt.dosing.ladle import NoStrokeError, Stroke
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.lab import Lab, cell_mark, kept_by_changing
from scuhand_bt.motion import ApexPose, MotionPlanner
from scuhand_bt.problems import Problem
from scuhand_bt.recipe.demand import Demand
from scuhand_bt.recipe.plan import Plan
from scuhand_bt.run.mortar_places import Place, places_for
from scuhand_bt.run.stroke_ways import (
    LEAST_BED_MG,
    MortarCannotBeScooped,
    headings_deg,
    require_first,
    stroke_in,
    strokes_along,
    strokes_in_jar,
    swing_and_out,
    wishes_mg,
)
from scuhand_bt.specs import ContainerKind, Source

LOWERING_M_PER_S = 0.06
MOST_TRIED, MOST_EACH = 16, 4
"""Of the places for all mortars that stand badly so many are tried together; and so many for each but the last one."""


class MortarStandsBadly(SkillFailed):
    """A mortar, at this `station`, cannot be scooped from, stood over, or carried from."""

    def __init__(self, code: str, detail: str, station: str) -> None:
        super().__init__(code, detail)
        self.station = station


def prepare_ways(motion: MotionPlanner, plan: Plan, cell: CellSpec, kinds: Sequence[ContainerKind]) -> None:
    """Plan all of them; SkillFailed arm.* for one that there is not.

    MortarStandsBadly says where mortars might stand instead, all that stand badly: what is proposed has all the ways.
    No place helps where MortarCannotBeScooped is raised.
    """
    scooped = require_first_strokes(plan, cell)
    try:
        _ways(motion, plan, cell, kinds, scooped)
    except MortarCannotBeScooped:
        raise
    except SkillFailed:
        _require_strokes(cell, scooped)
        _require_destinations(motion, cell, kinds, scooped)
        motion.patience_s = 0.0  # from now on only whether there is a way counts, and not how quick it is
        lacks = [_lacks(motion, cell, kinds, demand) for demand in scooped]
        badly = [demand for demand, lack in zip(scooped, lacks, strict=True) if lack is not None]
        whys = [lack for lack in lacks if lack is not None]
        if not badly:
            raise
        where = _Elsewhere(motion, plan, cell, kinds, scooped, badly).said()
        why = "; ".join(lack.detail for lack in whys)
        raise MortarStandsBadly(whys[0].code, f"{why}. {where}", badly[0].source.station) from None


def require_first_strokes(plan: Plan, cell: CellSpec) -> list[Demand]:
    """What a plan scoops; MortarCannotBeScooped for what brings too little at a time."""
    scooped = [demand for demand in plan.demands if demand.needed_mg > 0]
    for demand in scooped:
        require_first(cell, demand)
    return scooped


def _require_strokes(cell: CellSpec, scooped: Sequence[Demand]) -> None:
    """MortarCannotBeScooped for a bowl that holds a bed, on a plan's way, of which no stroke brings anything."""
    for demand in scooped:
        if demand.source.mortar.corner_mm is None:
            for bed_mg in _beds_mg(demand):
                stroke_in(cell, demand.source, bed_mg)


def _require_destinations(
    motion: MotionPlanner, cell: CellSpec, kinds: Sequence[ContainerKind], scooped: Sequence[Demand]
) -> None:
    """SkillFailed for a place that powder goes to and the arm cannot stand at, with no mortar anywhere: moving one is
    of no help.
    """
    alone = _planner(motion, cell, kinds, [])
    for place in dict.fromkeys(place for demand in scooped for _, place, _ in _carries(cell, demand.source, kinds)):
        alone.standing_at(place)


def pan_in_no_zone(motion: MotionPlanner, lab: Lab) -> Iterator[Problem]:
    """Where containers come to the pan by themselves in no zone that the arm enters to stand over it."""
    names_by = dict[tuple[str, ...], list[str]]()
    for name, kept in kept_by_changing(lab).items():
        names_by.setdefault(kept, []).append(name)
    names_by.pop((), None)
    if lab.cell.changer.driver == "operator" or not names_by:
        return
    pan = lab.cell.station_of_kind("balance").name
    over = [motion.entered(motion.standing_at(place)) for place in motion.places if place.startswith(f"{pan}+")]
    for kept, names in names_by.items():
        if any(entered.isdisjoint(kept) for entered in over):
            what = f"over the pan the arm is in none of the zones that {', '.join(names)} leases ({', '.join(kept)})"
            remedy = (
                "nothing keeps it out of where containers come and go: lease the zone that holds all that moves there"
            )
            yield Problem(cell_mark(lab, "zones"), f"{what}: {remedy}", "pan-in-no-zone")


def _planner(
    motion: MotionPlanner, cell: CellSpec, kinds: Sequence[ContainerKind], standing: Sequence[Source]
) -> MotionPlanner:
    """As `motion`, of a cell in which these mortars stand; SkillFailed for a place that the arm cannot reach."""
    planner = MotionPlanner(motion.urdf, cell, {one.station: one.mortar for one in standing})
    planner.patience_s = motion.patience_s
    for name, position_mm in all_places(cell, {one.name: one for one in standing}, kinds).items():
        planner.add_place(name, ApexPose(np.array(position_mm) / 1000))
    return planner


def _carries(cell: CellSpec, source: Source, kinds: Sequence[ContainerKind]) -> list[tuple[str, str, float]]:
    """From a mortar and to where its powder goes, with the spill limit [deg] of the heaviest load."""
    goes_to = [*(over_balance(cell, kind)[0] for kind in kinds), *_discarding(cell, source)]
    return [(source.station, place, _limit_deg(cell, source)) for place in dict.fromkeys(goes_to)]


def _lacks(motion: MotionPlanner, cell: CellSpec, kinds: Sequence[ContainerKind], demand: Demand) -> SkillFailed | None:
    """Why a mortar, where it stands, cannot be stood over, carried from, or scooped from; None where it can."""
    source = demand.source
    try:
        motion.set_geometry()
        _carried(motion, cell, source, kinds)
        _strokes(motion, cell, demand)
    except SkillFailed as failure:
        return failure
    return None


def _carried(motion: MotionPlanner, cell: CellSpec, source: Source, kinds: Sequence[ContainerKind]) -> None:
    for station, place, limit_deg in _carries(cell, source, kinds):
        motion.move(motion.standing_at(station), place, spill_limit_deg=limit_deg)


def _beds_mg(demand: Demand) -> list[float]:
    """What the plan begins with in a mortar, what a refill brings it to, and what it leaves."""
    amount_mg = demand.source.amount_mg
    left_mg = max(amount_mg - demand.needed_mg, LEAST_BED_MG)
    return list(dict.fromkeys([amount_mg, demand.refilled_mg or amount_mg, left_mg]))


def _ways(
    motion: MotionPlanner, plan: Plan, cell: CellSpec, kinds: Sequence[ContainerKind], scooped: Sequence[Demand]
) -> None:
    """All ways of a plan that scoops so much; SkillFailed for one that there is not."""
    motion.set_geometry()
    for demand in scooped:  # mostly what fails, and soon known beside all ways between places
        _strokes(motion, cell, demand)
    pans = [(kind, over_balance(cell, kind)[0]) for kind in kinds]
    limits_deg = {demand.source.name: _limit_deg(cell, demand.source) for demand in scooped}
    motion.prepare(pans, [carry for demand in scooped for carry in _carries(cell, demand.source, kinds)])
    _with_fresh_sheet(motion, cell, pans)
    for (kind, place), demand in product(pans, scooped):
        motion.set_geometry(container=kind)
        begin, limit_deg = motion.standing_at(demand.source.station), limits_deg[demand.source.name]
        for from_above_mm in sorted(above_mm for over, above_mm in plan.descents if over == place):
            down = motion.descent(place, from_above_mm / 1000, LOWERING_M_PER_S, limit_deg)
            motion.move(begin, down.start, spill_limit_deg=limit_deg)
    motion.set_geometry()


def _limit_deg(cell: CellSpec, source: Source) -> float:
    """Of the heaviest load."""
    return carrying_limit_deg(cell, source.powder, source.powder.load_limit_mg, MOUNTED_DIAMETER_MM)


def _discarding(cell: CellSpec, source: Source) -> list[str]:
    if not source.is_discarded:
        return []
    return [source.leftover_to or cell.station_of_kind("waste").name]


def _with_fresh_sheet(motion: MotionPlanner, cell: CellSpec, pans: Sequence[tuple[ContainerKind, str]]) -> None:
    """A fresh sheet's cone goes everywhere but over a container: loads are carried in another."""
    fresh_mm, over = cell.hand.options.start_diameter_mm, {place for _, place in pans}
    if fresh_mm == MOUNTED_DIAMETER_MM:
        return
    for kind in (None, *(kind for kind, _ in pans)):
        motion.set_geometry(fresh_mm / 1000, kind)
        for first, second in combinations([name for name in motion.places if name not in over], 2):
            motion.move(motion.standing_at(first), second)
    motion.set_geometry()


def _strokes(motion: MotionPlanner, cell: CellSpec, demand: Demand) -> None:
    """In a mortar the first strokes that may be made and the last; in a jar as many as should bring what is needed."""
    if demand.source.mortar.corner_mm is not None:
        strokes_in_jar(motion, cell, demand)
        return
    for bed_mg, wanted_mg in _asked_mg(demand):
        _stroke(motion, cell, demand.source, bed_mg, wanted_mg)


def _strokes_there(motion: MotionPlanner, cell: CellSpec, demand: Demand, asked_mg: list[tuple[float, float]]) -> None:
    """Those at one of several places, soon found: what fails of a bowl comes first in `asked_mg`, for the next one."""
    if demand.source.mortar.corner_mm is not None:
        strokes_in_jar(motion, cell, demand)
        return
    for number, (bed_mg, wanted_mg) in enumerate(asked_mg):
        try:
            _stroke(motion, cell, demand.source, bed_mg, wanted_mg, at_length=False)
        except SkillFailed:
            asked_mg.insert(0, asked_mg.pop(number))
            raise


def _asked_mg(demand: Demand) -> list[tuple[float, float]]:
    """The beds of a bowl, and what is wanted of each."""
    return list(product(_beds_mg(demand), wishes_mg(demand)))


def _stroke(
    motion: MotionPlanner,
    cell: CellSpec,
    source: Source,
    bed_mg: float,
    wanted_mg: float,
    *,
    at_length: bool = True,
) -> None:
    """A stroke in some direction, and from its end to where loads are carried from.

    `at_length`: that is searched for longer where it is not soon found for any.
    """
    why, tried = "", list[Stroke]()

    def is_possible(stroke: Stroke, *, is_brief: bool) -> bool:
        nonlocal why
        try:
            swing_and_out(motion, cell, source, stroke, is_brief=is_brief)
        except (NoStrokeError, SkillFailed) as error:
            why = why or str(error)
            return False
        return True

    for stroke in strokes_along(cell, source, bed_mg, wanted_mg, list(headings_deg(cell, source.station))):
        if is_possible(stroke, is_brief=True):
            return
        tried.append(stroke)
    if at_length and any(is_possible(stroke, is_brief=False) for stroke in tried):
        return
    where = f"at '{source.station}' no stroke is possible in any direction"
    raise SkillFailed(Code.ARM_NO_PATH, f"{where}: {why}")


class _Elsewhere:
    """Where all mortars that stand badly might stand instead, so that a plan has all its ways."""

    def __init__(
        self,
        motion: MotionPlanner,
        plan: Plan,
        cell: CellSpec,
        kinds: Sequence[ContainerKind],
        scooped: Sequence[Demand],
        badly: Sequence[Demand],
    ) -> None:
        self._motion, self._plan, self._cell, self._kinds = motion, plan, cell, kinds
        self._scooped, self._badly, self._sources = scooped, badly, list(plan.recipe.sources.values())
        self._asked_mg = {demand.source.station: _asked_mg(demand) for demand in badly}
        self._is_good = dict[Place, bool]()

    def said(self) -> str:
        """These places, or that none that were tried would do; a sentence."""
        look_at = "look at `scuhand-bt reach --task scoop`"
        names = [f"'{one.source.station}'" for one in self._badly if not any(self._good(one, []))]
        if names:
            return f"{' and '.join(names)} may be at none of the places that were tried, nor on stands: {look_at}"
        for together in islice(self._together([], self._badly), MOST_TRIED):
            if self._do([place for place in together if place.is_elsewhere]):
                there = " and ".join(place.said() for place in together)
                return f"With {there} it can scoop there, and carry what it has scooped to where it goes"
        names = [f"'{one.source.station}'" for one in self._badly]
        return f"Of the places that were tried for {' and '.join(names)} none leaves the arm all its ways: {look_at}"

    def _together(self, placed: Sequence[Place], left: Sequence[Demand]) -> Iterator[Sequence[Place]]:
        """Places that are good for each by itself, and clear of each other."""
        if not left:
            yield placed
            return
        demand, *others = left
        for place in islice(self._good(demand, placed), MOST_EACH if others else None):
            yield from self._together([*placed, place], others)

    def _good(self, demand: Demand, placed: Sequence[Place]) -> Iterator[Place]:
        """Those for one mortar beside others that are placed: with what stands badly put aside it has its ways there.

        Its strokes are soon found, and it is in the way of no other place.
        """
        source = demand.source
        aside = {one.source.station for one in self._badly} - {source.station}
        cell = self._cell_with(placed, aside)
        beside = [one for one in self._sources if one.station not in aside - {place.station for place in placed}]
        for place in places_for(cell, source, beside, may_stay=bool(aside)):
            if place not in self._is_good:
                self._is_good[place] = self._is_good_at(place, demand, aside)
            if self._is_good[place]:
                yield place

    def _is_good_at(self, place: Place, demand: Demand, aside: Collection[str]) -> bool:
        cell = self._cell_with([place], aside)
        standing = [one for one in self._sources if one.station not in aside]
        try:
            planner = _planner(self._motion, cell, self._kinds, standing)
            _strokes_there(planner, cell, demand, self._asked_mg[place.station])
            _carried(planner, cell, demand.source, self._kinds)
            for name in planner.places:
                planner.standing_at(name)
        except SkillFailed:
            return False
        return True

    def _do(self, moved: Sequence[Place]) -> bool:
        """Whether with mortars at these places the plan has all its ways; with none moved it has not."""
        if not moved:
            return False
        cell = self._cell_with(moved, ())
        try:
            _ways(
                _planner(self._motion, cell, self._kinds, self._sources), self._plan, cell, self._kinds, self._scooped
            )
        except SkillFailed:
            return False
        return True

    def _cell_with(self, moved: Sequence[Place], aside: Collection[str]) -> CellSpec:
        """The cell without the stations that are put aside, and with these where they are moved to."""
        there = {place.station: place.really_mm for place in moved}
        stations = {
            name: station.model_copy(update={"position_mm": there.get(name, station.position_mm)})
            for name, station in self._cell.stations.items()
            if name in there or name not in aside
        }
        return self._cell.model_copy(update={"stations": stations})
