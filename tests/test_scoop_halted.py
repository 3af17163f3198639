"""A scoop or a pouring that is halted: the cone comes out of its mortar upright, and nothing is spilled or made up."""

import math
from dataclasses import replace

import numpy as np
import pytest
from daily import first_daily
from zone_bench import Bench, first_headings_deg, scooping_bench, starter_motion

from scuhand_bt.cell.places import all_places
from scuhand_bt.clock import Wake
from scuhand_bt.failures import SkillFailed
from scuhand_bt.lab import Lab
from scuhand_bt.motion import ApexPose, MotionPlanner
from scuhand_bt.specs import Source


@pytest.fixture(scope="module")
def motion(starter: Lab) -> MotionPlanner:
    return starter_motion(starter)


@pytest.mark.parametrize("after_s", first_daily(2.5, 3.5, 4.5))
def test_a_scoop_that_is_halted_in_its_mortar_is_withdrawn(starter: Lab, motion: MotionPlanner, after_s: float) -> None:
    """On its way into the powder, along the wall, and as it turns upright."""
    bench, source = scooping_bench(starter, motion)
    cell = bench.cell
    scoop, withdraw, park = (starter.library.skills[name] for name in ("scoop", "withdraw", "park"))
    scooping = scoop(source=source).run(cell)
    while bench.clock.now_s < after_s:
        next(scooping)
        bench.clock.wait([Wake(bench.clock.now_s + 0.1)])
    scooping.close()
    cell.hand.stop()
    bench.do(bench.later(2.0, lambda: None))
    with pytest.raises(SkillFailed, match=r"arm.start_in_collision: .* the cone leaves mortar_bay by `withdraw`"):
        bench.do(park().run(cell))
    bench.do(withdraw().run(cell))
    bench.do(park().run(cell))
    assert (cell.believed.cone_mg, cell.believed.sources_mg["beads"]) == (0.0, pytest.approx(20_000.0))
    left_mg = bench.world.masses_mg["source:beads"] + bench.world.masses_mg["sheet"]
    assert left_mg == pytest.approx(20_000.0, abs=10.0)


def halt_scoop(bench: Bench, lab: Lab, source: Source, at_s: float, every_s: float = 0.1) -> None:
    """Begin a scoop, break it off at this time, and let arm and hand come to rest."""
    scooping = lab.library.skills["scoop"](source=source).run(bench.cell)
    while bench.clock.now_s < at_s:
        next(scooping)
        bench.clock.wait([Wake(bench.clock.now_s + every_s)])
    scooping.close()
    bench.cell.hand.stop()
    bench.do(bench.later(2.0, lambda: None))


@pytest.mark.parametrize("skill", ["scoop", "return_leftover", "discard"])
def test_what_empties_or_fills_a_cone_brings_it_out_of_the_mortar_that_its_scoop_was_halted_in(
    starter: Lab, motion: MotionPlanner, skill: str
) -> None:
    """As by a `timeout`: the run ended, and a person was to lead the arm clear by hand."""
    bench, source = scooping_bench(starter, motion)
    cell = bench.cell
    halt_scoop(bench, starter, source, 3.5)
    then = starter.library.skills[skill]
    bench.do(then(**({"source": source} if "source" in then.model_fields else {})).run(cell))
    bench.do(starter.library.skills["park"]().run(cell))
    assert (bench.world.masses_mg["cone"] > 1000.0) is (skill == "scoop")
    assert bench.world.masses_mg["spilled"] == 0.0


@pytest.mark.parametrize(
    ("skill", "is_same_lot", "halted_s"), [("withdraw", False, 2.0), ("withdraw", True, 2.6), ("discard", True, 2.6)]
)
def test_of_mortars_side_by_side_the_cone_is_withdrawn_from_the_one_that_it_was_halted_in(
    starter: Lab, skill: str, is_same_lot: bool, halted_s: float
) -> None:
    """Where its apex is behind the powder it is nearer to the other one."""
    stations = starter.cell.stations
    beside = stations["mortar_bay_2"].model_copy(update={"position_mm": (200.0, 345.0, 0.0)})
    lab = replace(starter, cell=starter.cell.model_copy(update={"stations": {**stations, "mortar_bay_2": beside}}))
    of = {"mortar_bay": lab.library.mortars["agate_mortar"], "mortar_bay_2": lab.library.mortars["small_agate_mortar"]}
    planner = lab.motion_planner(of)
    bench, source = scooping_bench(lab, planner)
    lot = source.lot if is_same_lot else "2"
    other = source.model_copy(update={"name": "a", "lot": lot, "station": "mortar_bay_2", "mortar": of["mortar_bay_2"]})
    bench = Bench(lab, planner, {"a": other, "beads": source})
    cell = bench.cell
    for name in ("a", "beads"):
        cell.believed.source_holds(name, 20_000.0)
    cell.places_mm = all_places(lab.cell, cell.sources, [])
    for name, position_mm in cell.places_mm.items():
        planner.add_place(name, ApexPose(np.array(position_mm) / 1000))
    cell.strokes_made["beads"] = first_headings_deg(lab, "mortar_bay", 3)
    halt_scoop(bench, lab, source, halted_s)
    out = lab.library.skills[skill]
    bench.do(out(**({"source": source} if "source" in out.model_fields else {})).run(cell))
    assert cell.believed.sheet == source.sheet_key
    assert cell.believed.sources_mg["a"] == 20_000.0
    if skill == "withdraw":
        assert math.dist(cell.apex_mm()[:2], cell.places_mm["mortar_bay"][:2]) < 5.0
    assert bench.world.masses_mg["source:a"] == 20_000.0
    assert bench.world.masses_mg["returned"] == bench.world.masses_mg["spilled"] == 0.0


def test_a_scoop_that_is_halted_where_the_arm_cannot_go_straight_up_comes_up_with_the_cone_turned(
    starter: Lab,
) -> None:
    """A wrist's joint would be a degree beyond its limit: a run that was killed there could not be resumed."""
    mortar = starter.library.mortars["small_agate_mortar"]
    planner = starter.motion_planner({"mortar_bay_2": mortar})
    bench, source = scooping_bench(starter, planner, "mortar_bay_2", "small_agate_mortar", 8000.0)
    cell = bench.cell
    planner.add_place("mortar_bay_2", cell.place("mortar_bay_2"))
    cell.strokes_made["beads"] = first_headings_deg(starter, "mortar_bay_2", 5)
    halt_scoop(bench, starter, source, 6.96, every_s=0.05)
    bench.do(starter.library.skills["withdraw"]().run(cell))
    assert cell.apex_mm() == pytest.approx(cell.places_mm["mortar_bay_2"], abs=0.5)
    assert bench.world.masses_mg["spilled"] == 0.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("skill", "leftover", "rest_mg", "goes_to"),
    [("return_leftover", "return", 0.0, "source:beads"), ("scoop", "discard", 60.0, "waste")],
)
@pytest.mark.parametrize("tilt_deg", [45.0, 75.0])
def test_a_cone_that_is_halted_while_it_is_poured_out_is_turned_upright_and_poured_again(
    starter: Lab, motion: MotionPlanner, skill: str, leftover: str, rest_mg: float, goes_to: str, tilt_deg: float
) -> None:
    """It leans more than any load is carried, so that from there no motion kept that: the run could not be resumed."""
    bench, source = scooping_bench(starter, motion)
    source, cell = source.model_copy(update={"leftover": leftover}), bench.cell
    cell.sources = {"beads": source}
    bench.do(cell.move_to("waste" if rest_mg else "mortar_bay"))
    held_mg = rest_mg or 3000.0
    bench.world.load_cone("beads", held_mg)
    cell.believed.scooped(source, 3000.0)
    if rest_mg:
        cell.believed.gave_out(is_short=False)
    before_mg = bench.world.masses_mg[goes_to]
    pours = starter.library.skills[skill](source=source)
    pouring = pours.run(cell)
    while cell.apex().axis[2] > np.cos(np.radians(tilt_deg)):
        next(pouring)
        bench.clock.wait([Wake(bench.clock.now_s + 0.1)])
    pouring.close()
    bench.do(bench.later(2.0, lambda: None))
    bench.do(pours.settle(cell))
    bench.do(pours.run(cell) if rest_mg == 0.0 else cell.move_to("park"))
    assert bench.world.masses_mg["spilled"] == 0.0
    assert bench.world.masses_mg[goes_to] - before_mg == pytest.approx(held_mg, abs=1.0)


def test_a_cone_whose_emptying_is_halted_is_known_to_be_loaded_and_no_powder_is_made_of_it(
    starter: Lab, motion: MotionPlanner
) -> None:
    """What it may hold was added to the mortar each time: 5 g that never were."""
    bench, source = scooping_bench(starter, motion)
    cell = bench.cell
    scoop = starter.library.skills["scoop"](source=source)
    scooping = scoop.run(cell)
    while bench.clock.now_s < 3.5:
        next(scooping)
        bench.clock.wait([Wake(bench.clock.now_s + 0.1)])
    scooping.close()
    cell.hand.stop()
    for halts in (True, False):
        bench.do(bench.later(2.0, lambda: None))
        settling = scoop.settle(cell)
        for _ in settling:
            bench.clock.wait([Wake(bench.clock.now_s + 0.1)])
            if halts and cell.hand.opening_mm > 0.0:
                settling.close()
                cell.hand.stop()
                assert cell.believed.cone_mg == source.powder.load_limit_mg
        assert cell.believed.cone_mg + cell.believed.sources_mg["beads"] == pytest.approx(20_000.0)
    assert cell.believed.cone_source is None
