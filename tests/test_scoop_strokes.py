"""Which strokes a scoop makes, through whose zones, and where it puts what the cone held before."""

import math
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from zone_bench import CHANGER, Bench, first_headings_deg, scooping_bench, starter_motion

from scuhand_bt.bench_spec import Obstacle
from scuhand_bt.cell.believed_powder import InVessel
from scuhand_bt.cell.places import all_places
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.clock import Steps, Wake
from scuhand_bt.dosing.ladle import Stroke
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.lab import Lab
from scuhand_bt.motion import ApexPose, MotionPlanner
from scuhand_bt.motion.transfer import BRIEF
from scuhand_bt.specs import Source


@pytest.fixture(scope="module")
def motion(starter: Lab) -> MotionPlanner:
    return starter_motion(starter)


@pytest.fixture(scope="module")
def swept(starter: Lab) -> tuple[Lab, MotionPlanner]:
    """A lab whose changer sweeps over a mortar, below where the cone comes to it, and its planner."""
    x_mm, y_mm, _ = starter.cell.stations["mortar_bay"].position_mm
    sweep = Obstacle(name="pan", box_mm=(120.0, 120.0, 25.0), at_mm=(x_mm, y_mm, 12.5))
    lab = replace(starter, cell=starter.cell.model_copy(update={"zones": [sweep]}))
    mortar = lab.library.mortars["agate_mortar"]
    planner = lab.motion_planner({"mortar_bay": mortar})
    source = Source.model_construct(name="beads", station="mortar_bay", mortar=mortar)
    for name, position_mm in all_places(lab.cell, {"beads": source}, []).items():
        planner.add_place(name, ApexPose(np.array(position_mm) / 1000))
    return lab, planner


def test_a_scoop_from_a_mortar_in_a_zone_that_another_has_waits_until_it_is_free(
    swept: tuple[Lab, MotionPlanner], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It failed at once, and ended the run. Of the directions, which are all looked at in vain, one is enough."""
    lab, planner = swept
    of_skill = sys.modules[lab.library.skills["scoop"].__module__]
    monkeypatch.setattr(of_skill, "HEADINGS_DEG", vars(of_skill)["HEADINGS_DEG"][:1])
    bench, source = scooping_bench(lab, planner)
    bench.have_the_pan()
    scooping = lab.library.skills["scoop"](source=source).run(bench.cell)
    bench.do(scooping, bench.later(20.0, lambda: bench.way.leave(CHANGER, ["changer"])))
    assert min(now_s for now_s, _, is_in in bench.seen if is_in) > 20.0
    assert bench.world.masses_mg["cone"] > 1000.0


def test_a_stroke_keeps_the_zone_that_it_was_planned_through_while_the_arm_comes_to_where_it_begins(
    swept: tuple[Lab, MotionPlanner],
) -> None:
    """It stands outside of it there: another got the zone then, and the stroke went into it all the same."""
    lab, planner = swept
    bench, source = scooping_bench(lab, planner)
    free: list[tuple[float, bool]] = []

    def look() -> Steps[None]:
        while bench.clock.now_s < 12.0:
            free.append((bench.clock.now_s, not bench.way.is_crossed("pan", CHANGER)))
            yield Wake(bench.clock.now_s + 0.05)

    bench.do(lab.library.skills["scoop"](source=source).run(bench.cell), look())
    is_in_s = [now_s for now_s, _, is_in in bench.seen if is_in]
    assert is_in_s
    assert not any(is_free for now_s, is_free in free if now_s <= max(is_in_s))
    assert free[-1][1]


@pytest.mark.parametrize(("rest_mg", "begins_at"), [(0.0, "over the pan"), (60.0, "at the mortar")])
def test_what_a_dose_that_gave_out_has_left_in_the_cone_is_poured_into_the_mortar_before_the_next_scoop(
    starter: Lab, motion: MotionPlanner, monkeypatch: pytest.MonkeyPatch, rest_mg: float, begins_at: str
) -> None:
    """It would fall on the pan, or beside the mortar, where the cone tips on its way to the stroke."""
    bench, source = scooping_bench(starter, motion)
    cell, aside_mm = bench.cell, []
    bench.do(cell.move_to(bench.over))
    if rest_mg:
        bench.world.load_cone("beads", rest_mg)
        cell.believed.scooped(source, 3000.0)
        cell.believed.gave_out(is_short=False)
    forming = MotionPlanner.forming

    def seen(planner: MotionPlanner, *asked: Any) -> Any:
        aside_mm.append(cell.aside_of_pan_mm())
        return forming(planner, *asked)

    monkeypatch.setattr(MotionPlanner, "forming", seen)
    bench.do(starter.library.skills["scoop"](source=source).run(cell))
    assert ("over the pan" if aside_mm[0] < 1.0 else "at the mortar") == begins_at
    masses_mg = bench.world.masses_mg
    assert masses_mg["spilled"] == masses_mg["pan"] == 0.0
    assert not cell.believed.has_rest


@pytest.fixture
def unmoved(starter: Lab, monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[Stroke], bool], int], list[Stroke]]:
    """Scoops whose motions are not made, by an arm that can make such strokes only: what was chosen."""
    mortars = {"mortar_bay": starter.library.mortars["agate_mortar"]}
    bench, source = scooping_bench(starter, starter.motion_planner(mortars))
    cell, skill = bench.cell, starter.library.skills["scoop"]

    def done(*asked: Any) -> Iterator[Any]:
        yield from ()
        return 80.0

    monkeypatch.setattr(type(cell), "make_stroke", done)
    monkeypatch.setattr(type(cell), "move_to", done)

    def scoops(can: Callable[[Stroke], bool], count: int) -> list[Stroke]:
        made = list[Stroke]()

        def planned(self: Any, cell: Any, wished: Iterator[Stroke]) -> tuple[Stroke, Any]:
            made.append(next(stroke for stroke in wished if can(stroke)))
            return made[-1], SimpleNamespace(duration_s=4.0)

        monkeypatch.setattr(skill, "_planned", planned)
        for _ in range(count):
            bench.do(skill(source=source).run(cell))
            cell.believed.emptied()
        return made

    return scoops


def test_where_the_arm_can_make_strokes_in_few_directions_they_take_turns(
    starter: Lab, unmoved: Callable[[Callable[[Stroke], bool], int], list[Stroke]]
) -> None:
    """Most went the same way, along which the others had left nothing: a dose took ten scoops, now four."""
    can_deg = first_headings_deg(starter, "mortar_bay", 2)
    made = unmoved(lambda stroke: stroke.heading_deg in can_deg, 5)
    assert [stroke.heading_deg for stroke in made] == [can_deg[number % 2] for number in range(5)]


@pytest.mark.parametrize(("shut_in", "made"), [(1, 1), (math.inf, 0)])
def test_a_stroke_out_of_which_a_way_is_soon_found_comes_before_others(
    starter: Lab, motion: MotionPlanner, monkeypatch: pytest.MonkeyPatch, shut_in: float, made: int
) -> None:
    """It was made, and then a way out looked for until the run was ended, with the load in the mortar."""
    bench, source = scooping_bench(starter, motion)
    ends, move = list[bytes](), MotionPlanner.move

    def moves(planner: MotionPlanner, start: Any, *asked: Any, **how: Any) -> Any:
        if how.get("effort") == BRIEF:
            ends.append(start.tobytes())
            if len(set(ends)) <= shut_in:
                raise SkillFailed(Code.ARM_NO_PATH, "no way out")
        return move(planner, start, *asked, **how)

    monkeypatch.setattr(MotionPlanner, "move", moves)
    bench.do(starter.library.skills["scoop"](source=source).run(bench.cell))
    assert bench.cell.strokes_made == {"beads": [first_headings_deg(starter, "mortar_bay", 2)[made]]}
    assert len(ends) == min(shut_in + 1, 6)
    assert bench.cell.apex_mm() == pytest.approx(bench.cell.places_mm["mortar_bay"], abs=0.5)


def test_where_the_arm_cannot_bring_the_lip_so_low_a_stroke_for_less_is_made(
    unmoved: Callable[[Callable[[Stroke], bool], int], list[Stroke]],
) -> None:
    """A dose was lost to `arm.no_path` with 25 g in the mortar."""
    wished = list[Stroke]()

    def is_higher(stroke: Stroke) -> bool:
        wished.append(stroke)
        return stroke.gap_mm > wished[0].gap_mm

    (made,) = unmoved(is_higher, 1)
    assert made.gap_mm >= wished[0].gap_mm + 1.0
    assert made.open_mm == wished[0].open_mm
    assert len({stroke.open_mm for stroke in wished}) == 4, "after all narrower rims"


@pytest.mark.slow
@pytest.mark.parametrize("is_vessel", [False, True])
def test_what_such_a_dose_has_left_goes_to_waste_before_the_next_scoop_where_leftovers_do(
    starter: Lab, motion: MotionPlanner, monkeypatch: pytest.MonkeyPatch, is_vessel: bool
) -> None:
    """A chemist who discards wants nothing that was in the cone back in the mortar."""
    monkeypatch.setattr(CellSpec, "vessels", property(lambda spec: [spec.stations["waste"]] * is_vessel))
    bench, source = scooping_bench(starter, motion)
    source, cell = source.model_copy(update={"leftover": "discard"}), bench.cell
    cell.sources = {"beads": source}
    bench.do(cell.move_to("waste"))
    bench.world.load_cone("beads", 60.0)
    cell.believed.scooped(source, 3000.0)
    cell.believed.gave_out(is_short=False)
    before_mg = bench.world.masses_mg["waste"]
    bench.do(starter.library.skills["scoop"](source=source).run(cell))
    assert bench.world.masses_mg["vessel:waste" if is_vessel else "waste"] - before_mg == pytest.approx(60.0, abs=1.0)
    touched = {"waste": InVessel(source.sheet_key, 0.0)} if is_vessel else {}
    assert cell.believed.vessels == touched, "of how much nobody knows"
    assert bench.world.masses_mg["spilled"] == 0.0
    assert not cell.believed.has_rest


def test_a_vessel_that_a_cone_was_not_emptied_into_to_the_end_is_known_to_hold_that_lot(
    starter: Lab, motion: MotionPlanner, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(CellSpec, "vessels", property(lambda spec: [spec.stations["waste"]]))
    bench, source = scooping_bench(starter, motion)
    cell, source = bench.cell, source.model_copy(update={"leftover": "discard"})
    cell.sources = {"beads": source}
    cell.believed.scooped(source, 3000.0)

    def broken(*_: object, **__: object) -> Steps[None]:
        raise SkillFailed(Code.HAND_CONE_EMPTY, "a stall")
        yield

    monkeypatch.setattr(cell, "touch", broken)
    with pytest.raises(SkillFailed):
        bench.do(starter.library.skills["return_leftover"](source=source).run(cell))
    assert cell.believed.vessels == {"waste": InVessel(source.sheet_key, 0.0)}
    assert cell.believed.cone_mg == 3000.0


def test_a_powder_that_would_not_slide_out_of_a_cone_that_is_poured_is_let_out_through_the_valve(
    starter: Lab, motion: MotionPlanner
) -> None:
    """Poured, all of it stayed in a cone that was believed to be empty."""
    bench, source = scooping_bench(starter, motion)
    steep = {"repose_deg": 80.0, "wall_friction_deg": 75.0}
    source, cell = source.model_copy(update={"powder": source.powder.model_copy(update=steep)}), bench.cell
    bench = Bench(starter, motion, {"beads": source})
    cell = bench.cell
    cell.places_mm = all_places(starter.cell, cell.sources, [])
    cell.believed.source_holds("beads", 20_000.0)
    bench.do(cell.move_to("mortar_bay"))
    bench.world.load_cone("beads", 3000.0)
    cell.believed.scooped(source, 3000.0)
    bench.do(starter.library.skills["return_leftover"](source=source).run(cell))
    assert (cell.believed.cone_mg, cell.believed.cone_source) == (0.0, None)
    assert bench.world.masses_mg["cone"] == pytest.approx(0.0, abs=1.0)


def test_a_scoop_pours_what_its_mortar_gave_before_back_over_the_lip(starter: Lab, motion: MotionPlanner) -> None:
    """And no motor shakes meanwhile, so that it may be done while a container changes."""
    bench, source = scooping_bench(starter, motion)
    scoop = starter.library.skills["scoop"](source=source)
    bench.do(scoop.run(bench.cell))
    began_s = bench.clock.now_s
    assert bench.world.masses_mg["cone"] > 1000.0
    bench.do(bench.way.unshaken(scoop.run(bench.cell)))
    assert bench.clock.now_s - began_s < 25.0
    believed, masses_mg = bench.cell.believed, bench.world.masses_mg
    assert masses_mg["spilled"] == 0.0
    assert masses_mg["cone"] == pytest.approx(believed.cone_mg, rel=0.2), "of one scoop, not of two"
    assert believed.cone_mg + believed.sources_mg["beads"] == pytest.approx(20_000.0)
