"""What a workflow does by its values in a dry run, and what it records."""

from pathlib import Path

import pytest
from running import dry_run

from scuhand_bt.journal.reader import open_contents, read
from scuhand_bt.report.weighing_record import weighing_csv


def test_a_mixture_doses_the_second_powder_by_what_was_measured_of_the_first_and_its_row_says_the_ratio(
    tmp_path: Path,
) -> None:
    samples = "samples:\n  - {id: x, first: beads, second: msg, container: alumina_crucible, mass: 400 mg, ratio: 50 %,"
    samples += " tolerance: 20 mg}\n"
    ran = dry_run(tmp_path, "workflow: mix_at_ratio\n" + samples, seed=3, controller=None)
    result = ran.sample("x")
    first, second = result.doses
    assert second.target_mg == pytest.approx(0.5 * first.dispensed_mg, abs=0.1)
    assert second.target_mg != pytest.approx(200.0, abs=1e-6), "of what was measured, not of what was asked"
    (value,) = result.recorded
    assert (value.name, value.unit) == ("ratio", "")
    assert value.value == pytest.approx(second.dispensed_mg / first.dispensed_mg, abs=0.001)
    with open_contents(ran.journal) as contents:
        rows = weighing_csv(contents).splitlines()
    assert any('"ratio"' in row and '"recorded"' in row for row in rows)


@pytest.mark.slow
def test_a_container_that_is_discarded_has_no_say_in_its_sample(tmp_path: Path) -> None:
    recipe = """\
workflow: prime_and_fill
samples: [{id: x, source: beads, container: xrd_holder, waste: waste_dish, mass: 50 mg, prime: 60 mg}]"""
    ran = dry_run(tmp_path, recipe, seed=2, controller=None)
    result = ran.sample("x")
    assert [dose.container for dose in result.doses] == ["x/container"]
    assert result.is_good
    doses = [row for row in read(ran.journal, "event") if row["kind"] == "container_discarded"]
    assert [row["payload"]["container"] for row in doses] == ["x/waste"]
    assert len(read(ran.journal, "dose")) == 2


def test_a_blank_is_recorded_and_good(tmp_path: Path) -> None:
    ran = dry_run(tmp_path, "workflow: weigh_blank\nsamples: [{id: x, container: xrd_holder}]", controller=None)
    result = ran.sample("x")
    assert (result.verdict, result.is_good, result.doses) == ("recorded", True, ())
    blank, uncertainty = result.recorded
    assert (blank.name, blank.unit, uncertainty.unit) == ("blank", "mg", "mg")
    assert isinstance(blank.value, float)
    assert isinstance(uncertainty.value, float)
    assert abs(blank.value) < 3 * uncertainty.value < 1.0
