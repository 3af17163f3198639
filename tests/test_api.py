"""scuhand_bt from Python: recipes as dicts and files, results as records."""

import threading
from pathlib import Path
from typing import Any

import pytest
from conftest import REPOSITORY
from running import shared_planner

from scuhand_bt import api
from scuhand_bt.run.batch import BatchObserver
from scuhand_bt.run.make_cell import DryRun
from scuhand_bt.run.options import Options
from scuhand_bt.run.session import Session

SOURCE = {"station": "mortar_bay", "container": "agate_mortar", "powder": "glass_beads", "amount": "5 g"}
RECIPE: dict[str, Any] = {
    "workflow": "fill_xrd_holder",
    "sources": {"beads": SOURCE},
    "samples": [{"id": "a", "source": "beads", "container": "xrd_holder", "mass": "50 mg"}],
}


@pytest.fixture(scope="module")
def lab() -> api.OpenLab:
    return api.open_lab(REPOSITORY)


def test_the_lines_of_the_readme_print_a_table_of_doses(capsys: pytest.CaptureFixture[str], monkeypatch: Any) -> None:
    readme = (REPOSITORY / "README.md").read_text(encoding="utf-8")
    (text,) = (block.split("```")[0] for block in readme.split("```python\n")[1:] if "api" in block.split("```")[0])
    assert len(text.strip().splitlines()) <= 11
    monkeypatch.chdir(REPOSITORY)
    exec(compile(text, "README.md", "exec"), {})
    printed = capsys.readouterr().out
    assert "('xrd-3', 6" in printed or "('xrd-3', 59" in printed
    assert printed.count("in tolerance") == 3


def test_a_recipe_in_a_dict_is_checked_as_one_in_a_file_each_problem_by_its_keys(lab: api.OpenLab) -> None:
    assert lab.check(RECIPE) == []
    wrong = {**RECIPE, "samples": [{**RECIPE["samples"][0], "mass": "50 s"}], "ordr": "as_written"}
    said = [str(problem) for problem in lab.check(wrong)]
    assert len(said) == 2
    assert any(one.startswith("recipe.samples[0].mass: 'mass': 's' is a unit of duration") for one in said), said
    assert any("unknown key 'ordr'" in one and "did you mean 'order'?" in one for one in said)


def test_a_dry_run_gives_its_doses_as_records_and_tells_of_each_sample(lab: api.OpenLab, tmp_path: Path) -> None:
    told: list[str] = []
    two = {**RECIPE, "samples": [{**RECIPE["samples"][0], "id": name} for name in ("a", "b")]}
    result = lab.dry_run(two, seed=1, journals=tmp_path, on_sample=lambda sample: told.append(sample.id))
    assert set(told) == {"a", "b"}
    assert [dose.sample for dose in result.doses] == ["a", "b"]
    dose = result.doses[0]
    assert (dose.target_mg, dose.lot, dose.verdict) == (50.0, "glass_beads", "in tolerance")
    assert dose.dispensed_mg == pytest.approx(dose.true_mg, abs=1.0)
    assert result.exit_code == 0
    assert result.rows()[1]["sample"] == "b"
    assert len(list(tmp_path.glob("*.sqlite"))) == 1


def test_a_sample_that_failed_has_a_row_with_its_code(lab: api.OpenLab, tmp_path: Path) -> None:
    faults = tmp_path / "faults.yaml"
    faults.write_text("faults: [{fault: container.wrong}]", encoding="utf-8")
    (row,) = lab.dry_run(RECIPE | {"on_failure": {"otherwise": "flag"}}, faults=faults).rows()
    assert (row["sample"], row["code"], row["lot"]) == ("a", "container.wrong_mass", None)


def test_two_threads_run_their_own_recipes_of_one_lab(lab: api.OpenLab) -> None:
    alone = lab.dry_run(RECIPE, seed=3).rows()
    found: list[Any] = [None, None]

    def run(number: int) -> None:
        found[number] = lab.dry_run(RECIPE, seed=3).rows()

    threads = [threading.Thread(target=run, args=(number,)) for number in (0, 1)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [alone, alone]


def test_a_session_that_is_run_in_another_thread_is_refused_clearly(lab: api.OpenLab, tmp_path: Path) -> None:
    plan = lab.plan(RECIPE)
    session = Session(plan, lab.lab, Options(DryRun(), None, tmp_path), shared_planner(plan, lab.lab))
    said: list[str] = []

    def run() -> None:
        try:
            session.run(BatchObserver())
        except RuntimeError as error:
            said.append(str(error))

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    session.close()
    assert said == ["a session is run in the thread in which it was made: make it there"]
