"""Which sheet is in the hand, and which powder in the cone, over an interruption."""

from pathlib import Path
from typing import Any

import pytest
from resuming import Run, Watch, actions
from running import make_lab

from scuhand_bt.journal.reader import read
from scuhand_bt.recipe.plan import Job
from scuhand_bt.report.live import PlainLines

TO_AND_FRO = """
recipe: to-and-fro
order: as_written
workflow: fill_xrd_holder
defaults: {container: xrd_holder, tolerance: 2 mg}
samples:
  - {id: s0, mass: 20 mg, source: beads}
  - {id: s1, mass: 20 mg, source: msg}
  - {id: s2, mass: 20 mg, source: beads}
  - {id: s3, mass: 20 mg, source: msg}
"""


class Telling(Watch):
    """As whoever resumes a run without a terminal sees it."""

    def __init__(self, lines: list[str], total: int) -> None:
        super().__init__()
        plain = PlainLines(lines.append, total)
        self.job_started, self.sample_ended = plain.job_started, plain.sample_ended
        self.sample_known = plain.sample_known


@pytest.mark.slow
def test_powders_that_change_to_and_fro_are_changed_every_time_over_a_stop(tmp_path: Path) -> None:
    run = Run(tmp_path, make_lab(tmp_path / "lab"), TO_AND_FRO)

    class StopAt(Watch):
        """Stop as soon as this sample begins."""

        def job_started(self, job: Any, number: int) -> None:
            if job.name == "s2":
                self.session.control.wish("stop")

    assert run.go(StopAt()).exit_code == 130
    lines: list[str] = []
    ended = run.go(Telling(lines, 4), resumes=True)
    assert [sample.verdict for sample in ended.samples] == ["in tolerance"] * 4
    told = [line.partition(":")[0].split(" for ")[-1] for line in lines]
    new = list(dict.fromkeys(told))  # a bracket that ends later may show a tenth of a milligram otherwise, and tells it
    new.remove("[3/4] s2")
    assert new == ["s3", "[4/4] s3", "finish the batch"], "what is new, and counted on from what was there"
    jobs = [row["name"] for row in read(run.journal, "job") if row["outcome"] == "done"]
    assert [name.split(" for ")[-1] for name in jobs if name.startswith("change")] == ["s1", "s2", "s3"]
    assert [skill for skill, outcome in actions(run.journal) if outcome == "done"].count("swap_sheet") == 3


TWO_SOURCES = """
workflow: blend
inputs: {first: Source, second: Source, container: Container, mass: Mass}
tree:
  sequence:
    - place_container: {container: $container}
    - tare:
    - fill: {source: $first, container: $container, mass: $mass, tolerance: 10 mg}
    - change_powder: {source: $first}
    - fill: {source: $second, container: $container, mass: $mass, tolerance: 10 mg}
    - cone_holds: {powder: $first.powder}   # which it does not
"""


@pytest.mark.slow
def test_the_cone_of_a_failed_blend_goes_into_one_source_over_a_stop(tmp_path: Path) -> None:
    sample = "{id: a, workflow: blend, first: beads, second: msg, container: alumina_crucible, mass: 60 mg}"
    recipe = f"\nrecipe: blends\nsamples: [{sample}]\non_failure: {{otherwise: flag}}\n"
    run = Run(tmp_path, make_lab(tmp_path / "lab", trees__blend=TWO_SOURCES), recipe)

    class StopOnceEmptied(Watch):
        """Stop on the way from the mortar, when the cone tells no more what it was filled from."""

        def ticked(self, root: Any) -> None:
            names = [row["name"] for row in read(run.journal, "job")]
            if names[-1].startswith("after") and self.session.cell.believed.cone_source is None:
                self.session.control.wish("stop_now")

    assert run.go(StopOnceEmptied()).exit_code == 130
    ended = run.go(Watch(), resumes=True)
    assert (ended.exit_code, ended.samples[0].code) == (1, "hand.wrong_powder")
    jobs = [(row["name"], row["outcome"]) for row in read(run.journal, "job")]
    assert jobs == [("a", "failed"), ("after a with msg", "done"), ("finish the batch", "done")]


class StopOnce(Watch):
    """Stops a run once a sheet that has touched this lot (None: a fresh one) is in the hand within a job."""

    def __init__(self, job: str, sheet: str | None) -> None:
        super().__init__()
        self._job, self._sheet, self._at_work = job, sheet, ""

    def attempt_started(self, job: Job, attempt: int) -> None:
        self._at_work = job.name

    def ticked(self, root: Any) -> None:
        if (self._at_work, self.session.cell.believed.sheet) == (self._job, self._sheet):
            self.session.control.wish("stop_now")


MIXED = """
workflow: mixed
inputs: {first: Source, second: Source, container: Container, mass: Mass, tolerance: Mass}
tree:
  sequence:
    - place_container: {container: $container}
    - tare:
    - fill: {source: $first, container: $container, mass: $mass, tolerance: $tolerance}
    FAILS
    - change_powder: {source: $first}
    - fill: {source: $second, container: $container, mass: $mass, tolerance: $tolerance}
    - park:
"""
AFTER_MIXED = """
recipe: two
workflow: fill_xrd_holder
order: as_written
defaults: {container: alumina_crucible, mass: 50 mg, tolerance: 5 mg}
samples:
  - {id: blend, workflow: mixed, first: msg, second: beads}
  - {id: plain, source: beads}
on_failure: {otherwise: skip_sample}
"""
CHANGE = "change powder to glass_beads for plain after msg"


@pytest.mark.parametrize("sheet", ["monosodium_glutamate", None])
def test_a_run_that_ended_while_a_sheet_was_changed_that_no_plan_has_goes_on_with_it(
    tmp_path: Path, sheet: str | None
) -> None:
    """A mixture has failed with the sheet of its first powder, and the next sample begins with the second."""
    mixed = MIXED.replace("FAILS", "- invert: {wait: {duration: 1 s}}")
    run = Run(tmp_path, make_lab(tmp_path / "lab", trees__mixed=mixed), AFTER_MIXED)
    run.go(StopOnce(CHANGE, sheet))
    assert read(run.journal, "job")[-1]["name"] == CHANGE
    assert read(run.journal, "job")[-1]["outcome"] != "done"
    resumed = run.go(Watch(), resumes=True)
    assert [sample.verdict for sample in resumed.samples] == ["skipped", "in tolerance"]
    assert [(row["name"], row["outcome"]) for row in read(run.journal, "job")].count((CHANGE, "done")) == 1
    assert [skill for skill, outcome in actions(run.journal) if outcome == "done"].count("swap_sheet") == 1


def test_a_mixture_that_is_taken_up_again_keeps_the_sheet_of_its_second_powder(tmp_path: Path) -> None:
    mixed = MIXED.replace("FAILS", "- wait: {duration: 1 s}")
    run = Run(tmp_path, make_lab(tmp_path / "lab", trees__mixed=mixed), AFTER_MIXED)
    run.go(StopOnce("blend", "glass_beads"))
    assert run.go(Watch(), resumes=True).exit_code == 0
    assert [row["name"] for row in read(run.journal, "job")] == ["blend", "plain", "finish the batch"]
