"""Some mutated recipes, tables, workflows, cells and fault files; `benchmarks.mutations` has the thousands."""

from pathlib import Path

import pytest

from harness import mutant_judge
from harness.mutant_judge import Judge
from harness.mutants import Mutant, mutant
from harness.structures import structures
from scuhand_bt.lab import Lab
from scuhand_bt.recipe.recipe import Recipe
from scuhand_bt.sim.world import World


@pytest.fixture(scope="module")
def judge(tmp_path_factory: pytest.TempPathFactory) -> Judge:
    return Judge(tmp_path_factory.mktemp("mutants") / "lab")


@pytest.mark.parametrize("first", [0, *(pytest.param(first, marks=pytest.mark.slow) for first in range(20, 160, 20))])
def test_a_changed_file_is_a_clean_error_or_a_correct_run(judge: Judge, first: int) -> None:
    outcomes = [judge.judge(mutant(number, judge.originals)) for number in range(first, first + 20)]
    assert [outcome for outcome in outcomes if outcome.wrong] == []


@pytest.mark.parametrize("count", [10, pytest.param(40, marks=pytest.mark.slow)])
def test_a_workflow_put_together_at_random_is_a_clean_error_or_a_correct_run(judge: Judge, count: int) -> None:
    outcomes = [judge.judge(each) for each in structures(0, count)]
    assert [outcome for outcome in outcomes if outcome.wrong] == []
    assert any(not outcome.end.startswith("refused") for outcome in outcomes)


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("robot/cell.yaml", "port: /dev/ttyACM0", "sheet_radius: 40 mm"),
        ("robot/cell.yaml", "port: /dev/ttyACM0", "options: {start_diameter: 1 m}"),
        ("robot/cell.yaml", "port: /dev/ttyACM0", "max_opening: 1 km"),
        ("robot/cell.yaml", "port: /dev/ttyACM0", "valve_speed: 1e-9 mm/s"),
        ("robot/cell.yaml", "port: /dev/ttyUSB0", "speed: 1e-300 %"),
        ("robot/powders.yaml", "packing_variation: 3 %", "packing_variation: 1e9 %"),
        ("robot/powders.yaml", "spread: 15 %", "spread: 15 %, exponent: 1000"),
        ("robot/powders.yaml", "residue: 2 mg", "surge_exponent: 1000"),
        ("trees/fill.yaml", "attempts: 24", "attempts: " + "9" * 400),
        ("trees/fill_xrd_holder.yaml", "- park:", "- repeat: {times: " + "9" * 400 + ", child: {park: }}"),
    ],
)
def test_a_number_beyond_all_measure_is_refused(judge: Judge, file: str, old: str, new: str) -> None:
    text = judge.originals[file]
    assert old in text
    changed = {file: text.replace(old, new, 1).encode()}
    outcome = judge.judge(Mutant("words", "extreme", "recipes/small.yaml", changed))
    assert (outcome.end, outcome.wrong) == ("refused", ())


def test_the_judge_sees_an_error_that_is_not_clean(judge: Judge, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(path: Path, lab: Lab) -> Recipe:
        raise KeyError("unforeseen")

    monkeypatch.setattr(mutant_judge, "load_recipe", broken)
    outcome = judge.judge(Mutant("bytes", "none", "recipes/small.yaml", {}))
    assert outcome.end == "broken"
    assert "KeyError at test_mutations.py" in outcome.wrong[0]


def test_the_judge_sees_a_verdict_that_is_not_true(judge: Judge, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mutant_judge, "RUN_CPU_S", 60.0)  # to its end, on a slow computer too
    monkeypatch.setattr(World, "true_mass", lambda world, container: 10.0)
    outcome = judge.judge(Mutant("bytes", "none", "recipes/small.yaml", {}))
    assert outcome.wrong[0].startswith("'a' is called in tolerance")
