"""Scoop powder out of a mortar into the cone, as a ladle does (docs/scoop.md).

The lip, the lowest point of the cone's rim, follows the mortar's wall; arm and roller move together. A scoop

* empties the cone,
* models the bed: the layer that the last stroke has left, plus what has come since,
* chooses a stroke: how deep the lip goes, by the mass wanted, and a direction that the arm can make it in,
* makes it, and keeps what the cone and the mortar should hold now.

The motion is in `scuhand_bt.dosing.swing`. The choice is in `scuhand_bt.dosing.strokes` for a bowl, in `jars` for a
jar.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from scuhand_bt.dosing.beds import AnyBed, bed_for, expected_mg, found_mg, layer_left, strokes_for_less, strokes_in
from scuhand_bt.dosing.jars import LEAST_MG
from scuhand_bt.dosing.ladle import LIP_GAP_MM, Ladle, NoStrokeError, Stroke
from scuhand_bt.dosing.sheet import LIP_FORCE_LIMIT_N, lip_force_n
from scuhand_bt.dosing.strokes import LOAD_AIM, scooped_for_mg
from scuhand_bt.dosing.swing import stroke_path
from scuhand_bt.dosing.vessel import Vessel
from scuhand_bt.quantity import format_mass
from scuhand_bt.skill import (
    Cell,
    Code,
    Milligrams,
    Millimetres,
    MillimetresPerSecond,
    Scooped,
    Skill,
    SkillFailed,
    Source,
    Steps,
)

from ._emptying import is_over, leave_mortar, out_of_mortar, pour_rest, put_away

if TYPE_CHECKING:
    from scuhand_bt.motion.stopping import StoppableTrajectory

RICH_YIELD, RICH_AIM = 1.25, 0.8
"""RICH_YIELD: the yield (what a source's scoops bring, as a multiple of what is expected) from which less is aimed at.
RICH_AIM: the share of the load limit aimed at then, as such loads were up to a quarter heavier than believed. It also
applies after a load that lacked much: poured back as a heap, it gave 4.1 g on average where 3.7 g were allowed."""
MAY_YIELD = 2.0
"""The largest yield allowed for in a source whose yield is unknown. With a true yield of 2, first loads were up to 10 g
where the cone may carry 5 g, and each was believed to be half of what it was."""
NOTHING_LEFT_MG = 30.0
"""A mortar believed to hold less than this counts as empty."""
PRESSED_BELOW_MG = 1500.0
"""With less in the mortar, the lip is pressed into the wall."""
MOST_SLOW_TO_LEAVE = 6
"""After so many strokes that have no quick way out of the mortar, the first of them is made, and its way out is
searched for at length."""
HEADINGS_DEG = (90.0, 270.0, 120.0, 240.0, 60.0, 300.0, 30.0, 330.0, 0.0, 180.0, 150.0, 210.0)
"""Directions of a swing, from straight out from the arm's base; the arm swings best across its reach, to and fro."""


class Scoop(Skill[Milligrams]):
    """Scoop powder from a source into the cone; returns the mass that the cone is expected to hold.

    What the cone still holds is let out first, to where the recipe's `leftover` says.
    """

    raises = (Code.HAND_WRONG_POWDER, Code.SOURCE_EMPTY, Code.ARM_NO_PATH)
    devices = ("arm", "hand")
    typical_s = 13.0
    interrupted = "repeat"

    source: Source
    wanted_mg: Milligrams | None = None
    """The mass to be dosed from this scoop; None for as much as the cone may carry."""
    may_scoop_again: bool = False
    """Whether a load that is too small is scooped again. Then the first load from an unknown source is half as large,
    so that the cone can carry it even if the source yields twice what is expected."""
    over_travel_mm: Annotated[Millimetres, Field(gt=0, le=3)] = 1.0
    speed_mm_per_s: Annotated[MillimetresPerSecond, Field(gt=0, le=200)] = 60.0

    def run(self, cell: Cell) -> Steps[Milligrams]:
        source, believed = self.source, cell.believed
        yield from out_of_mortar(cell)
        # A poor or bridged load is put away in any case, even if the sheet is refused below.
        if believed.is_load_doubted and believed.cone_source is not None:
            yield from put_away(cell)
        self._require_clean(cell)
        if believed.cone_source is not None:  # what is left would fall out as the cone is tilted
            yield from put_away(cell)
        if believed.has_rest:
            yield from pour_rest(cell, source)
        in_mortar_mg = believed.sources_mg[source.name]
        if in_mortar_mg < NOTHING_LEFT_MG:
            raise SkillFailed(Code.SOURCE_EMPTY, f"'{source.name}' is believed to hold {in_mortar_mg:.0f} mg")
        believed.touched(source)  # before the cone goes in: a scoop halted there is then known to be in this powder
        bed = self._bed(cell)
        stroke, motion = yield from cell.planned(lambda: self._planned(cell, self._candidates(cell, bed, in_mortar_mg)))
        open_mm = yield from cell.make_stroke(motion, source.station)
        cell.strokes_made.setdefault(source.name, []).append(stroke.heading_deg)
        held_mg = self._believe(cell, stroke, open_mm, motion.duration_s, bed)
        yield from cell.move_to(source.station)
        return held_mg

    def settle(self, cell: Cell) -> Steps[None]:
        """Lift the cone straight up out of the mortar, and let what it may hold back in, so that nothing is unknown."""
        if is_over(cell, self.source):
            yield from leave_mortar(cell, self.source)

    def _require_clean(self, cell: Cell) -> None:
        """Refuse a sheet that has touched another powder, or another lot."""
        believed = cell.believed
        if believed.sheet not in (None, self.source.sheet_key):
            raise SkillFailed(
                Code.HAND_WRONG_POWDER,
                f"the sheet has touched {believed.sheet}; swap it before {self.source.sheet_key}",
            )

    def _bed(self, cell: Cell) -> AnyBed:
        """What lies in the mortar, as its last strokes have left it."""
        source, believed = self.source, cell.believed
        return bed_for(
            source.mortar,
            believed.sources_mg[source.name],
            source.powder,
            Ladle.of(cell.spec.hand),
            believed.layers.get(source.name),
        )

    def _candidates(self, cell: Cell, bed: AnyBed, in_mortar_mg: float) -> Iterator[Stroke]:
        """The strokes that would do, best first (docs/scoop.md, Which stroke is made); those for less mass come last.

        Raises SkillFailed arm.no_path where the mortar allows no stroke at all.
        """
        source, ladle = self.source, Ladle.of(cell.spec.hand)
        yields = cell.believed.yields
        yielded = yields.get(source.name, 1.0)
        may_yield = MAY_YIELD if self.may_scoop_again and source.name not in yields else max(1.0, yielded)
        # Whatever the source yields, no stroke may bring more than the cone can carry.
        aim = RICH_AIM if yielded >= RICH_YIELD or bed.missed_mg > 0.0 else LOAD_AIM
        most_mg = aim * source.powder.load_limit_mg / may_yield
        wanted_mg = most_mg
        if self.wanted_mg is not None:
            wanted_mg = scooped_for_mg(self.wanted_mg, source.powder, is_discarded=source.is_discarded) / yielded
            # What the last stroke missed may lie in the way of this one, which would then be no deeper than that was.
            wanted_mg += bed.missed_mg
        is_jar = source.mortar.corner_mm is not None
        pressed_mm = min(self.over_travel_mm, LIP_FORCE_LIMIT_N / lip_force_n(1.0, cell.spec.hand))
        # Where the hand cannot go so low in any direction, the lip follows the wall.
        over_travels_mm = (0.0,) if is_jar or in_mortar_mg >= PRESSED_BELOW_MG else (pressed_mm, 0.0)
        wanted_mg, headings_deg = min(wanted_mg, most_mg), self._headings_deg(cell)
        why: NoStrokeError | None = None
        for over_mm in over_travels_mm:
            try:
                for stroke in strokes_in(bed, ladle, wanted_mg, headings_deg):
                    if not is_jar or yielded * expected_mg(stroke, bed, ladle.slant_mm) >= LEAST_MG:
                        yield self._as_made(stroke, over_mm)
            except NoStrokeError as error:
                why = error
        for stroke in strokes_for_less(bed, ladle, wanted_mg, headings_deg):
            why = None
            yield self._as_made(stroke, 0.0)
        if why is not None:
            raise SkillFailed(Code.ARM_NO_PATH, f"'{source.name}' cannot be scooped from: {why}")

    def _as_made(self, stroke: Stroke, over_mm: float) -> Stroke:
        """The stroke at this scoop's speed; a lip that follows the wall is pressed `over_mm` into it."""
        gap_mm = -over_mm if over_mm > 0.0 and stroke.gap_mm <= LIP_GAP_MM else stroke.gap_mm
        return replace(stroke, gap_mm=gap_mm, lip_speed_mm_per_s=self.speed_mm_per_s)

    def _out_of_reach(self, in_mortar_mg: float, *, was_scooped_from: bool) -> SkillFailed:
        """The failure of a jar in which powder is left, but next to none where strokes go."""
        source = self.source
        lies = (
            "in front of the jar's wall and beside the strokes" if was_scooped_from else "too thin on the jar's floor"
        )
        lot = f" --lot {source.lot}" if source.lot else ""
        say_so = f"scuhand-bt inventory set {source.station} MASS --powder {source.powder.name}{lot}"
        return SkillFailed(
            Code.SOURCE_EMPTY,
            f"a stroke in '{source.name}' would bring less than {format_mass(LEAST_MG)}. {format_mass(in_mortar_mg)} "
            f"should be left, but they lie {lies}. Pour more powder into the middle, enter the new mass ({say_so}) and "
            "resume. Or spread the powder, and begin a new run, which assumes that it lies level",
        )

    def _planned(self, cell: Cell, candidates: Iterator[Stroke]) -> "tuple[Stroke, StoppableTrajectory]":
        """The first candidate that the arm can make and soon leave the mortar with; else the first that it can make.

        Raises SkillFailed where it can make none: source.empty for a jar with too little in reach, else arm.no_path.
        """
        vessel, hand = Vessel.of(self.source.mortar), cell.spec.hand
        ladle = Ladle.of(hand)
        slow_to_leave = list[tuple[Stroke, "StoppableTrajectory"]]()
        why: Exception | None = None
        for stroke in candidates:
            try:
                motion = cell.plan_stroke(stroke_path(vessel, stroke, ladle), self.source)
            except (NoStrokeError, SkillFailed) as error:
                why = why or error
                continue
            if cell.soon_gets_out(motion, self.source):
                return stroke, motion
            slow_to_leave.append((stroke, motion))
            if len(slow_to_leave) == MOST_SLOW_TO_LEAVE:
                break
        if slow_to_leave:
            return slow_to_leave[0]
        was_scooped_from = self.source.name in cell.believed.layers
        if vessel.floor_mm > 0.0 and (why is None or was_scooped_from):
            in_mortar_mg = cell.believed.sources_mg[self.source.name]
            raise self._out_of_reach(in_mortar_mg, was_scooped_from=was_scooped_from)
        raise SkillFailed(Code.ARM_NO_PATH, f"at '{self.source.station}' no stroke is possible in any direction: {why}")

    def _headings_deg(self, cell: Cell) -> list[float]:
        """Directions in degrees: those not used in this mortar yet, then those used longest ago."""
        x_mm, y_mm, _ = cell.spec.stations[self.source.station].position_mm
        outward_deg = math.degrees(math.atan2(y_mm, x_mm))
        last = {heading_deg: number for number, heading_deg in enumerate(cell.strokes_made.get(self.source.name, ()))}
        return sorted(((outward_deg + deg) % 360.0 for deg in HEADINGS_DEG), key=lambda deg: last.get(deg, -1))

    def _believe(self, cell: Cell, stroke: Stroke, open_mm: float, duration_s: float, bed: AnyBed) -> float:
        """Keep and record what cone and mortar should hold after the stroke; returns the cone's mass in mg."""
        source, believed = self.source, cell.believed
        sheet_radius_mm = cell.spec.hand.sheet_radius_mm
        lifted_mg, layer = (rule(stroke, bed, sheet_radius_mm) for rule in (expected_mg, layer_left))
        believed.scooped(source, lifted_mg, layer, found_mg(stroke, bed, sheet_radius_mm))
        cell.record.event(
            Scooped(
                source=source.name,
                expected_mg=believed.cone_mg,
                open_mm=open_mm,
                closed_mm=stroke.closed_mm,
                heading_deg=stroke.heading_deg,
                gap_mm=stroke.gap_mm,
                lip_force_n=lip_force_n(max(0.0, -stroke.gap_mm), cell.spec.hand),
                lip_force_limit_n=LIP_FORCE_LIMIT_N,
                duration_s=duration_s,
            )
        )
        return believed.cone_mg
