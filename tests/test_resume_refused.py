"""What is not resumed, or only if that is accepted: changed, altered, complete, held or not kept."""

import fcntl
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from resuming import Run, Watch
from running import make_lab, shared_planner

from scuhand_bt.journal.presence import is_held
from scuhand_bt.journal.reader import read
from scuhand_bt.problems import SourceError
from scuhand_bt.run.options import Options
from scuhand_bt.run.resume import checked_history, resumable
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun


@pytest.fixture
def run(tmp_path: Path) -> Run:
    return Run(tmp_path, make_lab(tmp_path / "lab"))


def test_a_complete_run_has_nothing_left_to_do(run: Run) -> None:
    run.go(Watch())
    with pytest.raises(SourceError, match="complete"):
        checked_history(run.journal)


def test_a_changed_recipe_or_lab_is_refused_and_may_be_accepted(run: Run) -> None:
    run.go(Watch("stop_now", 60))
    run.recipe.write_text(run.recipe.read_text().replace("80 mg", "90 mg"), encoding="utf-8")
    (run.lab_folder / "trees" / "fill.yaml").write_text(
        (run.lab_folder / "trees" / "fill.yaml").read_text().replace("attempts: 24", "attempts: 9"), encoding="utf-8"
    )
    with pytest.raises(SourceError) as refused:
        run.go(Watch(), resumes=True)
    assert "the recipe" in str(refused.value)
    assert "trees/fill.yaml has changed" in str(refused.value)
    ended = run.go(Watch(), resumes=True, accept_changes=True)
    assert ended.exit_code == 0
    resumed = [event["payload"] for event in read(run.journal, "event") if event["kind"] == "resumed"]
    assert len(resumed[-1]["changes"]) == 2
    assert next(sample for sample in ended.samples if sample.id == "b").target_mg == 90.0


@pytest.mark.parametrize(
    ("before", "after", "what"),
    [
        ("  - {id: b, mass: 80 mg}\n", "", "'b' was under way, but this plan no longer has it"),
        (
            "  - {id: b,",
            "  - {id: new, mass: 50 mg}\n  - {id: b,",
            "'b' had begun, but in this plan 'new' comes before",
        ),
    ],
)
def test_nothing_may_come_before_what_was_under_way(run: Run, before: str, after: str, what: str) -> None:
    """It would find another container on the pan, and powder in the cone that nobody knows of."""

    class InB(Watch):
        def sample_ended(self, result: Any) -> None:
            if result.id == "a":
                self._wish, self._at = "stop_now", self.ticks + 30

    assert run.go(InB()).samples[1].verdict == "interrupted"
    run.recipe.write_text(run.recipe.read_text().replace(before, after), encoding="utf-8")
    with pytest.raises(SourceError, match=what):
        run.go(Watch(), resumes=True, accept_changes=True)


@pytest.mark.parametrize(
    ("before", "after", "now"),
    [
        ("powder: glass_beads", "powder: glass_beads, lot: L8", "glass_beads/L8 in 'agate_mortar'"),
        ("powder: glass_beads", "powder: monosodium_glutamate", "monosodium_glutamate in 'agate_mortar'"),
        ("container: agate_mortar", "container: small_agate_mortar", "glass_beads in 'small_agate_mortar'"),
    ],
)
def test_no_source_becomes_another_powder_while_its_run_is_broken_off(
    run: Run, before: str, after: str, now: str
) -> None:
    """The beads in the cone were dosed, and told in tolerance, as the other powder."""
    run.go(Watch("stop_now", 60))
    text = run.recipe.read_text()
    assert before in text
    run.recipe.write_text(text.replace(before, after, 1), encoding="utf-8")
    was = "source '.*' was glass_beads in 'agate_mortar' when this run began, and is "
    with pytest.raises(SourceError, match=f"{was}{now} now; put it back in the recipe"):
        run.go(Watch(), resumes=True, accept_changes=True)


def test_an_altered_journal_is_not_resumed(run: Run) -> None:
    run.go(Watch("stop_now", 60))
    with closing(sqlite3.connect(run.journal)) as database, database:
        database.execute("DROP TRIGGER entries_stay")
        database.execute("UPDATE entry SET payload = replace(payload, 'place', 'Place') WHERE kind = 'action_started'")
    with pytest.raises(SourceError, match="altered"):
        checked_history(run.journal)


def test_a_run_in_progress_is_not_resumed_by_another(run: Run) -> None:
    class Meddling(Watch):
        def ticked(self, root: Any) -> None:
            super().ticked(root)
            if self.ticks == 30:
                plan, lab = run.plan()
                found = resumable(run.journal, checked_history(run.journal), plan, lab, accept_changes=False)
                with pytest.raises(SourceError, match="another process"):
                    Session(plan, lab, Options(DryRun(), folder=run.folder), shared_planner(plan, lab), resumes=found)

    assert run.go(Meddling()).exit_code == 0


class Unwritable:
    """A plant whose powder cannot be saved."""

    class Flow:
        def __init__(self) -> None:
            self.hidden = lambda: None

        def step(self, dt_s: float, opening_mm: float, vibration: float, in_cone_mg: float, rng: object) -> float:
            return min(in_cone_mg, 100.0 * opening_mm * dt_s)

    def flow(self, powder: object) -> "Unwritable.Flow":
        return self.Flow()


def test_a_run_whose_world_could_not_be_kept_says_so_instead_of_being_resumed(run: Run) -> None:
    plan, lab = run.plan()
    options = Options(DryRun(plant="test_resume_refused:Unwritable"), folder=run.folder)
    session = Session(plan, lab, options, shared_planner(plan, lab))
    watch = Watch("stop_now", 500)
    watch.session = session
    try:
        session.run(watch)
    finally:
        session.close()
    with pytest.raises(SourceError, match=r"Unwritable cannot be written down.*start a new run"):
        checked_history(run.journal)


def test_a_run_that_is_looked_at_is_not_held(tmp_path: Path) -> None:
    journal = tmp_path / "a.sqlite"
    with journal.with_suffix(".lock").open("w+") as looking:
        fcntl.flock(looking, fcntl.LOCK_SH)  # as another who looks whether the run is held
        assert not is_held(journal)
