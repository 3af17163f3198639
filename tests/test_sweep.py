"""The carousel hits a cone that is in its way: the dry run's world shows what leases have let happen, by itself."""

from pathlib import Path

import numpy as np
import pytest
from conftest import read
from daily import first_daily
from running import make_lab
from zone_bench import RECIPE, Bench, run_dry, starter_motion

from scuhand_bt.bench_spec import Obstacle
from scuhand_bt.cell.right_of_way import RightOfWay
from scuhand_bt.lab import Lab, load_lab
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.sim.cone_over import ConePose
from scuhand_bt.sim.mass_ledger import in_container, in_source
from scuhand_bt.sim.sweep import Sweep
from scuhand_bt.specs import Container, Source

TWO = RECIPE.replace("mass: 500 mg}\n", "mass: 500 mg}\n  - {id: b, mass: 5 g}\n")
UP = np.array([0.0, 0.0, 1.0])
FROM_PAN_TO_MORTAR = "{name: pan, box: [400 mm, 120 mm, 260 mm], at: [265 mm, 120 mm, 130 mm], yaw: 118 deg}"


@pytest.fixture(scope="module")
def motion(starter: Lab) -> MotionPlanner:
    return starter_motion(starter)


@pytest.mark.parametrize(
    ("apex_mm", "is_hit"),
    [
        ((330.0, 0.0, 150.0), True),
        ((197.0, 240.0, 20.0), True),
        ((330.0, 0.0, 270.0), False),
        ((330.0, 240.0, 20.0), False),
        ((180.0, 0.0, 180.0), False),
    ],
)
def test_a_cone_is_hit_in_the_zone_that_the_pan_is_in_and_nowhere_else(
    starter: Lab, apex_mm: tuple[float, ...], is_hit: bool
) -> None:
    turned = Obstacle(name="pan", at_mm=(265.0, 120.0, 130.0), box_mm=(400.0, 120.0, 260.0), yaw_deg=118.0)
    elsewhere = Obstacle(name="door", at_mm=(330.0, 240.0, 20.0), cylinder_mm=(60.0, 60.0))
    sweep = Sweep(starter.cell.model_copy(update={"zones": [turned, elsewhere]}))
    assert sweep.meets(ConePose(np.array(apex_mm), UP, 48.0, 50.0)) == is_hit


@pytest.mark.parametrize("are_leased", first_daily(False, True))
def test_a_scoop_where_the_carousel_swings_is_made_after_it_or_upsets_the_container(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, are_leased: bool
) -> None:
    lab = make_lab(tmp_path / "lab")
    cell = lab / "robot" / "cell.yaml"
    before, zones = cell.read_text(encoding="utf-8").split("zones:")
    after = zones[zones.index("geometry:") :]
    cell.write_text(f"{before}zones:\n  - {FROM_PAN_TO_MORTAR}\n{after}", encoding="utf-8")
    if not are_leased:
        monkeypatch.setattr(RightOfWay, "closed", frozenset())
        for name in ("is_crossed", "is_stood_in"):
            monkeypatch.setattr(RightOfWay, name, lambda *_: False)
    ran, journal = run_dry(tmp_path / "runs", load_lab(lab), recipe=TWO)
    came_to = ("in tolerance", None) if are_leased else ("skipped", "container.missing")
    assert [(sample.verdict, sample.code) for sample in ran.samples] == [came_to] * 2
    masses_mg = [row["payload"] for row in read(journal, "event") if row["kind"] == "matter"][-1]
    assert masses_mg["spilled"] == 0.0


@pytest.mark.parametrize("is_over", [True, False])
def test_what_a_container_held_that_is_hit_is_spilled(starter: Lab, motion: MotionPlanner, is_over: bool) -> None:
    mortar, powder = starter.library.mortars["agate_mortar"], starter.library.powders["glass_beads"]
    source = Source(name="beads", station="mortar_bay", mortar=mortar, powder=powder, amount_mg=20_000.0)
    bench = Bench(starter, motion, {"beads": source})
    holder = starter.library.containers["xrd_holder"]
    first, second = (Container(**holder.model_dump(), id=name) for name in "ab")
    bench.world.place(first)
    bench.world.ledger.transfer(in_source("beads"), in_container("a"), 300.0)
    if is_over:
        bench.do(bench.cell.move_to(bench.over))
    for until_s, brought in ((10.0, None), (20.0, second)):
        bench.world.swing(until_s, brought)
        bench.do(bench.later(until_s - bench.clock.now_s, lambda: None))
    assert bench.world.pan.container_id == (None if is_over else "b")
    masses_mg = bench.world.masses_mg
    assert (masses_mg["spilled"], masses_mg["container:a"]) == ((300.0, 0.0) if is_over else (0.0, 300.0))
