"""Batches in which something fails, or that are stopped: policies, verdicts, and safe ends."""

import re
from pathlib import Path

import pytest
from batch_bench import ONE_DOSE, TWO_DOSES, assert_safe
from running import dry_run, make_lab

from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.journal.reader import read
from scuhand_bt.problems import SourceError
from scuhand_bt.run.resume import checked_history
from scuhand_bt.run.runner import Runner


class LaterNan:
    """A plant that is sound when it is tried, and breaks in the run."""

    class Flow:
        steps = 0

        def step(self, dt_s: float, opening_mm: float, vibration: float, in_cone_mg: float, rng: object) -> float:
            type(self).steps += 1
            return float("nan") if self.steps > 100 else 0.0

    def flow(self, powder: object) -> "LaterNan.Flow":
        return self.Flow()


def test_an_overshoot_is_flagged_and_never_reported_as_in_tolerance(tmp_path: Path) -> None:
    ran = dry_run(tmp_path, TWO_DOSES % ("flag", "stop"), plant="batch_bench:Gusher")
    assert ran.result.exit_code == ExitCode.FLAGGED
    for sample in ran.result.samples:
        assert (sample.verdict, sample.code) == ("over", "dose.overshoot")
        assert sample.dispensed_mg > 102
        assert sample.dispensed_mg == pytest.approx(sample.true_mg, abs=2)
    assert_safe(ran)


def test_stop_ends_the_batch_and_what_was_not_run_says_so(tmp_path: Path) -> None:
    ran = dry_run(tmp_path, TWO_DOSES % ("stop", "stop"), plant="batch_bench:Gusher")
    assert ran.result.exit_code == ExitCode.CELL_FAULT
    assert "dose.overshoot" in ran.result.reason
    assert [sample.verdict for sample in ran.result.samples] == ["over", "not run"]
    assert_safe(ran)


def test_skip_sample_goes_on_with_the_next(tmp_path: Path) -> None:
    ran = dry_run(tmp_path, TWO_DOSES % ("skip_sample", "stop"), plant="batch_bench:Gusher")
    assert ran.result.exit_code == ExitCode.FLAGGED
    assert [sample.verdict for sample in ran.result.samples] == ["skipped", "skipped"]
    not_good = "Not good: 'a' (skipped, dose.overshoot), 'b' (skipped, dose.overshoot). For these, begin a new run"
    with pytest.raises(SourceError, match=re.escape(f"the run is complete: nothing is done again. {not_good}")):
        checked_history(ran.journal)


def test_redo_doses_a_new_container_once_and_then_flags(tmp_path: Path) -> None:
    ran = dry_run(tmp_path, TWO_DOSES % ("redo", "stop"), plant="batch_bench:Gusher")
    attempts = [(row["sample"], row["attempt"]) for row in read(ran.journal, "job") if row["sample"]]
    assert attempts == [("a", 1), ("a", 2), ("b", 1), ("b", 2)]
    assert ran.result.exit_code == ExitCode.FLAGGED
    assert ran.sample("a").true_mg == pytest.approx(ran.sample("a").dispensed_mg, abs=2)
    assert [dose.container for dose in ran.sample("a").doses] == ["a#2"]


def test_a_plant_that_breaks_in_the_run_ends_it_safe_and_is_named(tmp_path: Path) -> None:
    ran = dry_run(tmp_path, ONE_DOSE, plant="test_run_batch_failures:LaterNan")
    assert ran.result.exit_code == ExitCode.CELL_FAULT
    assert "LaterNan" in ran.result.reason
    assert [sample.verdict for sample in ran.result.samples] == ["interrupted"]


BROKEN_SKILL = '''
"""A skill with a bug."""
from scuhand_bt.skill import Cell, Skill, Steps, pause

class Broken(Skill[None]):
    """Divide by nothing while the valve is open."""
    devices = ("hand",)
    def run(self, cell: Cell) -> Steps[None]:
        cell.hand.set_opening(2.0)
        cell.hand.set_vibration(1.0)
        yield from pause(cell, 1.0)
        1 / 0
'''


def test_a_bug_in_a_skill_stops_the_run_safe_and_says_which(tmp_path: Path) -> None:
    tree = "workflow: w\ninputs: {source: Source}\ntree: {sequence: [{park: }, {broken: }]}\n"
    lab = make_lab(tmp_path / "lab", skills__broken=BROKEN_SKILL, trees__w=tree)
    ran = dry_run(tmp_path, "recipe: r\nworkflow: w\nsamples: [{id: a, source: beads}]\n", lab=lab)
    assert ran.result.exit_code == ExitCode.CELL_FAULT
    assert "the skill broken broke: ZeroDivisionError: division by zero (broken.py, line 12)" in ran.result.reason
    assert [sample.verdict for sample in ran.result.samples] == ["interrupted"]
    assert_safe(ran)


def test_what_was_dosed_before_a_bug_in_a_skill_is_told_and_not_called_not_run(tmp_path: Path) -> None:
    inputs = "{source: Source, container: Container, mass: Mass}"
    dosed = "scoop_and_dispense: {source: $source, container: $container, mass: $mass}"
    tree = f"workflow: w\ninputs: {inputs}\ntree: {{sequence: [{{{dosed}}}, {{broken: }}]}}\n"
    lab = make_lab(tmp_path / "lab", skills__broken=BROKEN_SKILL, trees__w=tree)
    samples = "samples: [{id: [a, b], source: beads, container: xrd_holder, mass: [50 mg, 50 mg]}]\n"
    ran = dry_run(tmp_path, f"recipe: r\nworkflow: w\n{samples}", lab=lab)
    a, b = ran.result.samples
    assert (a.verdict, b.verdict) == ("interrupted", "not run")
    assert a.dispensed_mg == pytest.approx(50.0, abs=2.0)
    assert a.true_mg == pytest.approx(a.dispensed_mg, abs=1.0)


STUCK_SKILL = '''
"""A skill that waits for nothing."""
from scuhand_bt.skill import Cell, Signal, Skill, Steps, Wake

class Stuck(Skill[None]):
    """Wait for a signal that nobody fires."""
    def run(self, cell: Cell) -> Steps[None]:
        yield Wake.on(Signal())

'''
BUSY_SKILL = '''
"""A skill that never lets time pass."""
from scuhand_bt.skill import Cell, Skill, Steps, Wake

class Stuck(Skill[None]):
    """Ask for the next tick at once, for ever."""
    def run(self, cell: Cell) -> Steps[None]:
        while True:
            yield Wake(cell.clock.now_s)
'''


@pytest.mark.parametrize(("skill", "words"), [(STUCK_SKILL, "never comes"), (BUSY_SKILL, "without letting time")])
def test_a_skill_that_would_hang_ends_the_run(tmp_path: Path, skill: str, words: str) -> None:
    tree = "workflow: w\ninputs: {source: Source}\ntree: {stuck: }\n"
    lab = make_lab(tmp_path / "lab", skills__stuck=skill, trees__w=tree)
    ran = dry_run(tmp_path, "recipe: r\nworkflow: w\nsamples: [{id: a, source: beads}]\n", lab=lab)
    assert ran.result.exit_code == ExitCode.CELL_FAULT
    assert words in ran.result.reason


def test_a_stop_that_comes_while_the_tree_is_ticked_is_heard_at_once(tmp_path: Path) -> None:
    waiting = "workflow: waiting\ninputs: {container: Container}\ntree: {sequence: [{wait: {duration: 60 s}}]}\n"
    recipe = "recipe: r\nworkflow: waiting\nsamples: [{id: a, container: xrd_holder}]\n"
    ran = dry_run(tmp_path, recipe, lab=make_lab(tmp_path / "lab", trees__waiting=waiting), stop_at=1)
    assert ran.result.exit_code == ExitCode.INTERRUPTED
    assert ran.session.cell.clock.now_s < 5.0


@pytest.mark.parametrize("stop_at", [1, 7, 20, 33, 60])
def test_a_stop_at_any_tick_ends_safe_with_a_verdict_for_every_sample(tmp_path: Path, stop_at: int) -> None:
    ran = dry_run(tmp_path, TWO_DOSES % ("flag", "flag"), stop_at=stop_at)
    assert ran.result.exit_code == ExitCode.INTERRUPTED
    assert [sample.verdict for sample in ran.result.samples] == ["interrupted", "not run"]
    assert_safe(ran)
    assert read(ran.journal, "event")[-1]["kind"] == "matter"


def test_a_stop_on_a_disk_that_is_full_by_then_is_a_fault_as_nobody_can_read_how_the_run_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Making the cell safe is told that the journal is lost, goes on all the same, and was the only one to know."""
    make_safe = Runner.make_safe

    def on_a_full_disk(one: Runner) -> bool:
        monkeypatch.setattr(Runner, "make_safe", make_safe)
        one._journal._store.db.execute("PRAGMA query_only=ON")  # as a full disk
        return make_safe(one)

    monkeypatch.setattr(Runner, "make_safe", on_a_full_disk)
    ran = dry_run(tmp_path, ONE_DOSE, stop_at=33)
    assert ran.result.exit_code == ExitCode.CELL_FAULT
    assert ran.result.reason.startswith("how the run ended is not written")
    assert_safe(ran)
