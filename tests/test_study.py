"""A trial: the same anywhere, in a cell of its own, and what it says came of the run."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from dose_bench import shipped_powders
from study_bench import FLOW, RECIPE

from scuhand_bt.lab import Lab
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.recipe.plan import Plan
from scuhand_bt.run.prepared_motion import prepared_motion
from scuhand_bt.sim.powder import OurPowderFlow
from scuhand_bt.study.change import files_hash
from scuhand_bt.study.pool import all_trials, executor_of
from scuhand_bt.study.some_cell import SomeCell
from scuhand_bt.study.trial import Setup, trial
from tests.conftest import Call

pytestmark = pytest.mark.usefixtures("no_ways")


def test_a_trial_is_the_same_in_any_process_and_after_any_other(setup: Setup) -> None:
    here = [trial(setup, 3), trial(setup, 4), trial(setup, 3)]
    assert here[0] == here[2] != here[1]
    with executor_of(1, None) as executor:
        assert dict(all_trials([(setup, 3)], executor)) == {(setup, 3): here[0]}
    assert not (setup.lab / ".scuhand").exists(), "it leaves no run behind"


@pytest.mark.slow
def test_nobody_is_told_of_a_trial(setup: Setup, tmp_path: Path) -> None:
    cell, told = setup.lab / "robot" / "cell.yaml", tmp_path / "told"
    cell.write_text(f"{cell.read_text(encoding='utf-8')}\nnotify: {{command: [touch, {told}]}}\n", encoding="utf-8")
    assert trial(setup, 1).exit_code == 0
    assert not told.exists()


def test_a_trial_says_what_came_of_the_run(setup: Setup) -> None:
    one = trial(setup, 1)
    assert [sample.id for sample in one.samples] == ["a", "b", "c"]
    assert [sample.target_mg for sample in one.samples] == [50.0, 50.0, 30.0]
    dosed_mg = sum(sample.true_mg or 0.0 for sample in one.samples)
    assert dosed_mg == pytest.approx(130.0, abs=9.0)
    assert dosed_mg <= one.used_mg["beads"] < 500.0
    assert one.scoops["beads"] >= 1
    assert one.began_s["a"] == 0.0 < one.began_s["b"] < one.began_s["c"] < one.duration_s


@pytest.mark.slow
def test_another_study_in_one_process_is_of_the_files_of_today(setup: Setup) -> None:
    before = trial(replace(setup, files=files_hash(setup.recipe, setup.lab)), 0)
    setup.recipe.write_text(RECIPE.replace("30 mg", "31 mg"), encoding="utf-8")
    after = trial(replace(setup, files=files_hash(setup.recipe, setup.lab)), 0)
    assert [one.samples[2].target_mg for one in (before, after)] == [30.0, 31.0], "as on a Dask worker"


@pytest.mark.slow
def test_the_command_tries_the_physics_that_it_is_told(command: Call, setup: Setup) -> None:
    """A yield of nothing, where the simulation's own fills all."""
    shown = command("study", setup.recipe, "--trials", 1, "--workers", 1, "--plant", "test_own_plant:Nothing").stdout
    assert "scoop.nothing" in shown


def test_draws_of_a_recipe_share_its_lab_and_its_motions_and_have_the_figures_of_one_alone(
    setup: Setup, monkeypatch: pytest.MonkeyPatch
) -> None:
    setup.recipe.write_text(RECIPE.partition("  - {id: b")[0], encoding="utf-8")
    setup = replace(setup, files=files_hash(setup.recipe, setup.lab))
    prepared = []

    def prepare(plan: Plan, lab: Lab) -> MotionPlanner:
        prepared.append(plan)
        return prepared_motion(plan, lab)

    monkeypatch.setattr("scuhand_bt.study.dry_run.prepared_motion", prepare)
    of_recipe = [replace(setup, changes=(("recipe.samples.0.mass", mass),)) for mass in ("20 mg", "30 mg", "40 mg")]
    found = [trial(one, 1) for one in of_recipe]
    assert len(prepared) == 1
    assert [one.samples[0].target_mg for one in found] == [20.0, 30.0, 40.0]
    trial(replace(setup, changes=((FLOW, "75"),)), 1)
    trial(replace(setup, changes=(("recipe.sources.beads.station", "mortar_bay_2"),)), 1)
    assert len(prepared) == 3, "another lab, and another place of the mortar"
    assert trial(replace(of_recipe[0], files=""), 1) == found[0]
    assert len(prepared) == 4, "which files they are nobody has told"


def test_three_trials_have_lumps_of_three_kinds() -> None:
    powder = shipped_powders()["titanium_dioxide"]
    kinds = set()
    for SomeCell.seed in range(3):
        narrow, wide = (lumps_mg(SomeCell().flow(powder), opening_mm) for opening_mm in (0.8, 1.6))
        kinds.add((bool(wide.std() < 0.2 * wide.mean()), bool(wide.mean() > 3.0 * narrow.mean())))
    assert kinds == {(False, False), (True, False), (False, True)}, "equal, and growing with the gap"


def test_scoops_bring_more_or_less_in_each_trial() -> None:
    powder, rng, yields = shipped_powders()["glass_beads"], np.random.default_rng(1), list[float]()
    for SomeCell.seed in range(40):
        scoop = SomeCell().scoop(powder)
        yields.append(float(np.mean([scoop.collect(3000.0, 9000.0, rng) for _ in range(400)])) / 3000.0)
    assert yields[0] == pytest.approx(1.0, abs=0.02), "the first cell is in the middle"
    low, high = np.quantile(yields, (0.05, 0.95))
    assert (low, high) == (pytest.approx(0.78, abs=0.04), pytest.approx(1.28, abs=0.06))


def lumps_mg(flow: OurPowderFlow, opening_mm: float) -> np.ndarray:
    """What comes at once of a full cone that is shaken."""
    rng = np.random.default_rng(1)
    steps_mg = np.array([flow.step(0.02, opening_mm, 1.0, 4000.0, rng) for _ in range(4000)])
    return steps_mg[steps_mg > 0.6]
