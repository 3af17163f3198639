"""Two who would go on with one run, or use one cell: one of them does, and the other moves and writes nothing."""

from pathlib import Path
from typing import Any

import pytest
from conftest import Call, LabFolder
from resuming import Run, Watch, actions
from running import make_lab

from scuhand_bt.api import interrupted
from scuhand_bt.events.entry import Note
from scuhand_bt.journal.presence import is_held
from scuhand_bt.journal.reader import open_contents
from scuhand_bt.journal.writer import Journal
from scuhand_bt.lab_state.ledger import Ledger
from scuhand_bt.problems import SourceError
from scuhand_bt.record import RecordLost
from scuhand_bt.report.proof import proof_of
from scuhand_bt.run.holds import take_cell, take_run
from scuhand_bt.run.options import Options
from scuhand_bt.run.resume import checked_history, resumable
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun


@pytest.fixture
def run(tmp_path: Path) -> Run:
    return Run(tmp_path, make_lab(tmp_path / "lab"))


def test_of_two_resumes_the_one_that_waited_at_its_prompt_while_the_other_dosed_moves_nothing(run: Run) -> None:
    run.go(Watch("stop_now", 60))
    plan, lab = run.plan()
    waiting = resumable(run.journal, checked_history(run.journal), plan, lab, accept_changes=False)
    run.go(Watch("stop_now", 60), resumes=True)
    before = actions(run.journal)
    with pytest.raises(SourceError, match="has gone on with it meanwhile"):
        Session(plan, lab, Options(DryRun(), folder=run.folder), resumes=waiting)
    assert actions(run.journal) == before
    assert not is_held(run.journal)
    assert run.go(Watch(), resumes=True).exit_code == 0


@pytest.mark.slow
def test_a_run_is_held_from_before_its_history_is_read(
    run: Run, command: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    run.go(Watch("stop_now", 60))
    lab, journal = run.lab_folder, run.journal
    there = lab / ".scuhand" / "runs" / journal.name
    there.parent.mkdir(parents=True)
    for part in run.folder.glob(f"{journal.stem}.*"):
        part.rename(there.with_name(part.name))
    seen = []

    def looked(*arguments: Any) -> list[str]:
        seen.append(is_held(there))
        with pytest.raises(SourceError, match="another process"):
            take_run(there)
        return []

    monkeypatch.setattr(interrupted, "what_is_known", looked)
    command("resume", there.stem, "--lab", lab)
    assert seen == [True]
    assert not is_held(there)


def test_who_was_overtaken_cannot_add_to_the_journal(tmp_path: Path) -> None:
    path = tmp_path / "r.sqlite"
    first = Journal(path, durable=False)
    first.event(Note("lab.first", {}))
    second = Journal(path, durable=False)
    second.event(Note("lab.second", {}))
    with pytest.raises(RecordLost, match="another process has gone on with this run"):
        first.event(Note("lab.lost", {}))
    second.event(Note("lab.third", {}))
    first.close()
    second.close()
    with open_contents(path) as contents:
        assert [row["kind"] for row in contents.rows("entry")] == ["lab.first", "lab.second", "lab.third"]
        assert contents.verified.problem is None


def test_a_run_that_is_overtaken_ends_safe_with_code_3_and_says_why(run: Run) -> None:
    class Overtaking(Watch):
        def ticked(self, root: Any) -> None:
            super().ticked(root)
            if self.ticks == 60:
                self.session.journal.path.with_suffix(".lock").unlink()  # as a tidy person may
                other = Journal(self.session.journal.path, durable=False)
                other.event(Note("lab.overtaken", {}))
                other.close()

    watch = Overtaking()
    result = run.go(watch)
    assert result.exit_code == 3
    assert "another process has gone on with this run" in result.reason
    assert all(watch.session.cell.device(name).is_stopped for name in ("arm", "hand", "balance", "changer"))
    with open_contents(run.journal) as contents:
        assert contents.rows("entry")[-1]["kind"] == "lab.overtaken"
        assert contents.verified.problem is None
        ledger = Ledger(run.journal.parent.parent).verified()
        assert proof_of(contents, ledger).problem is None, "the ledger has no head of what was rescued elsewhere"


def test_what_a_run_has_in_the_cell_is_not_corrected_beside_it(command: Call, lab_folder: LabFolder) -> None:
    folder = lab_folder.folder
    running = take_cell(folder / ".scuhand")
    refused = command("inventory", "set", "cone", "0 mg", "--lab", folder)
    assert refused.returncode == 2
    assert "is in use" in refused.stderr
    running.end()
    assert command("inventory", "set", "cone", "0 mg", "--lab", folder).returncode == 0


@pytest.mark.parametrize("words", [("powders", "forget", "glass_beads"), ("balance", "forget")])
def test_what_a_run_believes_is_not_forgotten_beside_it(
    command: Call, lab_folder: LabFolder, words: tuple[str, ...]
) -> None:
    """It would go on with it, and write it again as it ends."""
    running = take_cell(lab_folder.folder / ".scuhand")
    refused = command(*words, "--lab", lab_folder.folder)
    assert (refused.returncode, "is in use" in refused.stderr, "Forgotten" in refused.stdout) == (2, True, False)
    running.end()
    assert command(*words, "--lab", lab_folder.folder).returncode == 0


def test_two_runs_do_not_have_one_cell(command: Call, lab_folder: LabFolder) -> None:
    lab_folder.replace("robot/cell.yaml", "driver: carousel", "driver: operator")
    recipe = lab_folder.write("recipes/one.yaml", "recipe: one\nworkflow: park_only\nsamples: [{id: a}]\n")
    lab_folder.write("trees/park_only.yaml", "workflow: park_only\ntree: {park: }\n")
    other = take_cell(lab_folder.folder / ".scuhand")
    refused = command("run", recipe, "--operator", "Eve")
    other.end()
    assert refused.returncode == 2
    assert "is in use" in refused.stderr
    assert not list((lab_folder.folder / ".scuhand").glob("runs/*")), "nothing is left of a run that did not begin"
