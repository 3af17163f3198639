"""Plans everything that a plan will ask of the arm, so that what is impossible is found before anything moves.

The list is in docs/motion.md, "Before a run".
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
"""Speed of a descent into a container [m/s]."""
MOST_TRIED, MOST_EACH = 16, 4
"""How many combinations of places for badly placed mortars are tried; and how many places of each mortar but the
last."""


class MortarStandsBadly(SkillFailed):
    """The mortar at this `station` cannot be scooped from, stood over, or carried from."""

    def __init__(self, code: str, detail: str, station: str) -> None:
        super().__init__(code, detail)
        self.station = station


def prepare_ways(motion: MotionPlanner, plan: Plan, cell: CellSpec, kinds: Sequence[ContainerKind]) -> None:
    """Plan all ways. Raises SkillFailed arm.* if there is none for one of them.

    MortarStandsBadly names places for all badly placed mortars with which the plan has all its ways.
    MortarCannotBeScooped means that no place helps.
    """
    scooped = require_first_strokes(plan, cell)
    try:
        _ways(motion, plan, cell, kinds, scooped)
    except MortarCannotBeScooped:
        raise
    except SkillFailed:
        _require_strokes(cell, scooped)
        _require_destinations(motion, cell, kinds, scooped)
        motion.patience_s = 0.0  # from now on only whether there is a way matters, not how quick it is
        lacks = [_lacks(motion, cell, kinds, demand) for demand in scooped]
        badly = [demand for demand, lack in zip(scooped, lacks, strict=True) if lack is not None]
        whys = [lack for lack in lacks if lack is not None]
        if not badly:
            raise
        where = _Elsewhere(motion, plan, cell, kinds, scooped, badly).said()
        why = "; ".join(lack.detail for lack in whys)
        raise MortarStandsBadly(whys[0].code, f"{why}. {where}", badly[0].source.station) from None


def require_first_strokes(plan: Plan, cell: CellSpec) -> list[Demand]:
    """The demands of sources that a plan scoops from. MortarCannotBeScooped if one gives too little at a time."""
    scooped = [demand for demand in plan.demands if demand.needed_mg > 0]
    for demand in scooped:
        require_first(cell, demand)
    return scooped


def _require_strokes(cell: CellSpec, scooped: Sequence[Demand]) -> None:
    """Raises MortarCannotBeScooped if a bowl will hold a bed, in this plan, from which no stroke brings anything."""
    for demand in scooped:
        if demand.source.mortar.corner_mm is None:
            for bed_mg in _beds_mg(demand):
                stroke_in(cell, demand.source, bed_mg)


def _require_destinations(
    motion: MotionPlanner, cell: CellSpec, kinds: Sequence[ContainerKind], scooped: Sequence[Demand]
) -> None:
    """Raises SkillFailed if the arm cannot stand at a place that powder goes to, even without any mortar.

    Then moving a mortar would not help.
    """
    alone = _planner(motion, cell, kinds, [])
    for place in dict.fromkeys(place for demand in scooped for _, place, _ in _carries(cell, demand.source, kinds)):
        alone.standing_at(place)


def pan_in_no_zone(motion: MotionPlanner, lab: Lab) -> Iterator[Problem]:
    """A problem if a changer's skills lease zones, and none of these contains the arm over the pan."""
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
    """As `motion`, for a cell with these mortars. Raises SkillFailed for a place that the arm cannot reach."""
    planner = MotionPlanner(motion.urdf, cell, {one.station: one.mortar for one in standing})
    planner.patience_s = motion.patience_s
    for name, position_mm in all_places(cell, {one.name: one for one in standing}, kinds).items():
        planner.add_place(name, ApexPose(np.array(position_mm) / 1000))
    return planner


def _carries(cell: CellSpec, source: Source, kinds: Sequence[ContainerKind]) -> list[tuple[str, str, float]]:
    """Station, destination and spill limit [deg] of the heaviest load, for every destination of a source's powder."""
    goes_to = [*(over_balance(cell, kind)[0] for kind in kinds), *_discarding(cell, source)]
    return [(source.station, place, _limit_deg(cell, source)) for place in dict.fromkeys(goes_to)]


def _lacks(motion: MotionPlanner, cell: CellSpec, kinds: Sequence[ContainerKind], demand: Demand) -> SkillFailed | None:
    """Why a mortar, where it stands, cannot be stood over, carried from, or scooped from; None if it can."""
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
    """What a mortar holds at the plan's start, after its largest refill, and at the end."""
    amount_mg = demand.source.amount_mg
    left_mg = max(amount_mg - demand.needed_mg, LEAST_BED_MG)
    return list(dict.fromkeys([amount_mg, demand.refilled_mg or amount_mg, left_mg]))


def _ways(
    motion: MotionPlanner, plan: Plan, cell: CellSpec, kinds: Sequence[ContainerKind], scooped: Sequence[Demand]
) -> None:
    """Plan all ways of a plan. Raises SkillFailed if there is none for one of them."""
    motion.set_geometry()
    for demand in scooped:  # strokes first: they fail most often, and take less time than the ways between places
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
    """The spill limit of the heaviest load [deg]."""
    return carrying_limit_deg(cell, source.powder, source.powder.load_limit_mg, MOUNTED_DIAMETER_MM)


def _discarding(cell: CellSpec, source: Source) -> list[str]:
    if not source.is_discarded:
        return []
    return [source.leftover_to or cell.station_of_kind("waste").name]


def _with_fresh_sheet(motion: MotionPlanner, cell: CellSpec, pans: Sequence[tuple[ContainerKind, str]]) -> None:
    """Plan the ways of a fresh sheet's cone, if loads are carried in one of another size.

    It goes everywhere except over a container.
    """
    fresh_mm, over = cell.hand.options.start_diameter_mm, {place for _, place in pans}
    if fresh_mm == MOUNTED_DIAMETER_MM:
        return
    for kind in (None, *(kind for kind, _ in pans)):
        motion.set_geometry(fresh_mm / 1000, kind)
        for first, second in combinations([name for name in motion.places if name not in over], 2):
            motion.move(motion.standing_at(first), second)
    motion.set_geometry()


def _strokes(motion: MotionPlanner, cell: CellSpec, demand: Demand) -> None:
    """In a bowl, plan the first strokes that may be made and the last; in a jar, as many as bring what is needed."""
    if demand.source.mortar.corner_mm is not None:
        strokes_in_jar(motion, cell, demand)
        return
    for bed_mg, wanted_mg in _asked_mg(demand):
        _stroke(motion, cell, demand.source, bed_mg, wanted_mg)


def _strokes_there(motion: MotionPlanner, cell: CellSpec, demand: Demand, asked_mg: list[tuple[float, float]]) -> None:
    """As `_strokes`, for one of several places, without long searches.

    The case that fails is moved to the front of `asked_mg`, to be tried first at the next place.
    """
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
    """The beds of a bowl, each with how much a scoop is to bring."""
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
    """Plan a stroke in any direction, and the way from its end to where loads are carried from.

    `at_length`: search longer for that way if no direction gives one quickly.
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
    """Finds places for all badly placed mortars with which a plan has all its ways."""

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
        """These places, or that none of those tried would do, as a sentence."""
        look_at = "look at `scuhand-bt reach --task scoop`"
        names = [f"'{one.source.station}'" for one in self._badly if not any(self._good(one, []))]
        if names:
            return f"none of the places that were tried, nor stands, suits {' and '.join(names)}: {look_at}"
        for together in islice(self._together([], self._badly), MOST_TRIED):
            if self._do([place for place in together if place.is_elsewhere]):
                there = " and ".join(place.said() for place in together)
                return f"With {there} it can scoop there, and carry what it has scooped to where it goes"
        names = [f"'{one.source.station}'" for one in self._badly]
        return f"Of the places that were tried for {' and '.join(names)} none leaves the arm all its paths: {look_at}"

    def _together(self, placed: Sequence[Place], left: Sequence[Demand]) -> Iterator[Sequence[Place]]:
        """Combinations of places that are good for each mortar by itself, and clear of each other."""
        if not left:
            yield placed
            return
        demand, *others = left
        for place in islice(self._good(demand, placed), MOST_EACH if others else None):
            yield from self._together([*placed, place], others)

    def _good(self, demand: Demand, placed: Sequence[Place]) -> Iterator[Place]:
        """The places where one mortar, beside `placed` ones and without other badly placed ones, has its ways.

        Only brief searches are made for its strokes, and it must not block any other place.
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
        """Whether the plan has all its ways with mortars at these places. Without a move it is known not to."""
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
        """The cell with these stations moved, and without those put aside."""
        there = {place.station: place.really_mm for place in moved}
        stations = {
            name: station.model_copy(update={"position_mm": there.get(name, station.position_mm)})
            for name, station in self._cell.stations.items()
            if name in there or name not in aside
        }
        return self._cell.model_copy(update={"stations": stations})
