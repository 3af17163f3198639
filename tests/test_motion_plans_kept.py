"""Plans on disk: found again where nothing has changed, and never believed."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from running import make_lab

from harness.motion_audit import Audit
from harness.own_workflow import write_own
from scuhand_bt import api
from scuhand_bt.bench_spec import Obstacle
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.lab import load_lab, starter_lab
from scuhand_bt.motion import ApexPose, MotionPlanner, transfer
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.prepared_motion import motion_of, prepared_motion

LAB = load_lab(starter_lab())
AWAY = ApexPose(np.array([0.2, 0.24, 0.12]))
POST = Obstacle(name="post", at_mm=(230.0, 120.0, 90.0), box_mm=(20.0, 20.0, 180.0))
"""Between the park place and the other."""


def planner(plans: Path, cell: CellSpec = LAB.cell) -> MotionPlanner:
    made = MotionPlanner(LAB.urdf, cell, {}, plans)
    made.add_place("away", AWAY)
    return made


def planned(plans: Path, cell: CellSpec = LAB.cell) -> list[tuple[bytes, bytes]]:
    """An empty way and a load's, planned or found, and written."""
    made = planner(plans, cell)
    motions = [made.move(made.home(), "away"), made.move(made.home(), "away", spill_limit_deg=20.0)]
    made.keep_plans()
    return [(motion.knots_s.tobytes(), motion.coefficients.tobytes()) for motion in motions]


@pytest.fixture
def searches(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """Every search that is made."""
    made, search = [], transfer.plan

    def counted(*given, **named):
        made.append(given)
        return search(*given, **named)

    monkeypatch.setattr(transfer, "plan", counted)
    return made


def test_the_next_planner_of_the_same_cell_searches_for_nothing_and_answers_the_same(
    tmp_path: Path, searches: list[object]
) -> None:
    first = planned(tmp_path)
    assert searches
    searches.clear()
    assert planned(tmp_path) == first
    assert searches == []


def test_what_two_runs_of_the_same_cell_have_planned_beside_each_other_is_kept_of_both(
    tmp_path: Path, searches: list[object]
) -> None:
    """Of three that began together the last one's plans were left."""
    limits_deg = (10.0, 20.0)
    beside = [planner(tmp_path) for _ in limits_deg]
    for one, limit_deg in zip(beside, limits_deg, strict=True):
        one.move(one.home(), "away", spill_limit_deg=limit_deg)
    for one in beside:
        one.keep_plans()
    searches.clear()
    for limit_deg in limits_deg:
        last = planner(tmp_path)
        last.move(last.home(), "away", spill_limit_deg=limit_deg)
    assert searches == []


def test_a_cell_in_which_something_else_stands_is_planned_anew(tmp_path: Path, searches: list[object]) -> None:
    planned(tmp_path)
    searches.clear()
    planned(tmp_path, LAB.cell.model_copy(update={"geometry": [*LAB.cell.geometry, POST]}))
    assert searches
    assert len(list(tmp_path.glob("*.npz"))) == 2


def test_another_balance_port_or_sheet_is_no_other_geometry_and_another_hand_is(
    tmp_path: Path, searches: list[object]
) -> None:
    first = planned(tmp_path)
    searches.clear()
    arm = LAB.cell.arm.model_copy(update={"driver": "simulated", "port": "/dev/elsewhere"})
    balance = LAB.cell.balance.model_copy(update={"readability_mg": 1.0})
    stiffer = LAB.cell.hand.model_copy(update={"sheet_thickness_mm": 0.6})
    others = {"arm": arm, "balance": balance, "hand": stiffer}
    assert planned(tmp_path, LAB.cell.model_copy(update=others)) == first
    assert searches == []
    longer = LAB.cell.hand.model_copy(update={"apex_offset_mm": 125.0})
    planned(tmp_path, LAB.cell.model_copy(update={"hand": longer}))
    assert searches


def test_another_lab_of_the_same_cell_searches_for_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, searches: list[object]
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "caches"))
    for name in ("one", "other"):
        searches.clear()
        folder = make_lab(tmp_path / name)
        (folder / "recipes").mkdir()
        write_own(folder)
        lab = load_lab(folder)
        prepared_motion(make_plan(load_recipe(lab.folder / "recipes" / "one.yaml", lab), lab), lab)
        assert bool(searches) is (name == "one")
        assert not (lab.folder / ".scuhand").exists(), "a cache is no state of the lab's"


def test_once_written_ways_between_places_are_kept_and_those_from_elsewhere_are_asked_for_once(
    tmp_path: Path, searches: list[object]
) -> None:
    first = planner(tmp_path)
    first.keep_plans()  # as a run does that has prepared its ways, with none of them
    at_home = first.home()
    aside = at_home + np.radians([2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    for begin in (at_home, aside):
        first.move(begin, "away", spill_limit_deg=20.0)
    first.keep_plans()
    again = planner(tmp_path)
    searches.clear()
    again.move(again.home(), "away", spill_limit_deg=20.0)
    assert searches == []
    again.move(aside, "away", spill_limit_deg=20.0)
    assert searches


@pytest.mark.slow
def test_what_a_dry_run_has_planned_for_its_loads_the_next_one_finds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, searches: list[Any]
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "caches"))
    powder = {"station": "mortar_bay", "container": "agate_mortar", "powder": "glass_beads", "amount": "5 g"}
    samples = [{"id": "one", "source": "beads", "container": "xrd_holder", "mass": "50 mg"}]
    recipe = {"workflow": "fill_xrd_holder", "sources": {"beads": powder}, "samples": samples}
    lab = api.open_lab(starter_lab())
    lab.dry_run(recipe, seed=1)
    (limit_deg,) = {task.spill_limit_deg for task, *_ in searches} - {None}
    searches.clear()
    next_one = motion_of(lab.plan(recipe), LAB)
    next_one.move(next_one.standing_at("mortar_bay"), "balance+80mm", spill_limit_deg=limit_deg)
    assert searches == []


def test_a_plan_that_would_touch_something_is_not_used_whatever_file_it_is_in(tmp_path: Path) -> None:
    """The open cell's plans, under the name of those of the cell with a post in their way."""
    crowded = LAB.cell.model_copy(update={"geometry": [*LAB.cell.geometry, POST]})
    right = planned(tmp_path / "crowded", crowded)
    planned(tmp_path / "open")
    (mine,), (other,) = ((tmp_path / name).glob("*.npz") for name in ("crowded", "open"))
    mine.write_bytes(other.read_bytes())
    assert planned(tmp_path / "crowded", crowded) == right
    found = planner(tmp_path / "crowded", crowded)
    assert Audit(LAB.urdf, crowded, {}, None).of(found.move(found.home(), "away")).clearance_m > 0


@pytest.mark.parametrize("what", ["too quick", "jumps", "not a number", "another end", "cut off", "no archive"])
def test_a_file_that_was_changed_is_planned_anew(tmp_path: Path, searches: list[object], what: str) -> None:
    right = planned(tmp_path)
    (path,) = tmp_path.glob("*.npz")
    if what in ("cut off", "no archive"):
        path.write_bytes(path.read_bytes()[: 0 if what == "no archive" else 3000])
    else:
        with np.load(path) as kept:
            arrays = dict(kept)
        for name, values in arrays.items():
            if what == "too quick" and name.endswith(".knots"):
                half = name.removesuffix("knots") + "cubics"
                arrays[name] = values / 2
                arrays[half] = arrays[half] * np.array([1.0, 2.0, 4.0, 8.0])[:, None, None]
            elif what == "jumps" and name.endswith(".cubics"):
                values[0, len(values[0]) // 2 :] += 0.01
                values[0, -1] -= 0.01
            elif what == "not a number" and name.endswith(".cubics"):
                values[1, 0, 0] = np.nan
            elif what == "another end" and name.endswith(".cubics"):
                values[0] += 0.02
        np.savez(path, **arrays)
    searches.clear()
    assert planned(tmp_path) == right
    assert searches
