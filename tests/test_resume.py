"""A run that was interrupted goes on: nothing twice, and nothing lost."""

import random
from pathlib import Path
from typing import Any

import pytest
from daily import first_daily
from resuming import RECIPE, Run, Watch, actions
from running import HEAD, make_lab

from harness.kill import Tally, at_any_time, at_ticks, kill_until_done, make_batch
from scuhand_bt.journal.reader import read


@pytest.fixture
def run(tmp_path: Path) -> Run:
    return Run(tmp_path, make_lab(tmp_path / "lab"))


@pytest.mark.parametrize(
    ("kills_in_all", "at_any_time_too"), [(10, False), pytest.param(40, True, marks=pytest.mark.slow)]
)
def test_a_batch_that_is_killed_again_and_again_ends_with_every_dose_once(
    tmp_path: Path, kills_in_all: int, at_any_time_too: bool
) -> None:
    recipe = tmp_path / "recipe.yaml"
    recipe.write_text(RECIPE + HEAD, encoding="utf-8")
    rng, tally = random.Random(5), Tally()
    motion = None
    for seed in range(20):
        if tally.kills >= kills_in_all:
            break
        batch = make_batch(recipe, tmp_path / f"runs-{seed}", seed, motion)
        motion = batch.motion
        kills = at_any_time(rng, 1.0, 10) if at_any_time_too and seed == 0 else at_ticks(rng, 400, 10)
        kill_until_done(batch, kills, tally)
    assert not tally.problems
    assert tally.kills >= kills_in_all
    assert tally.while_dosing
    assert tally.while_resuming


@pytest.mark.parametrize("at_tick", first_daily(40, 1, 7, 90, 140))
def test_a_stopped_run_goes_on_where_it_was(run: Run, at_tick: int) -> None:
    stopped = run.go(Watch("stop_now", at_tick))
    assert stopped.exit_code == 130
    before = actions(run.journal)
    ended = run.go(Watch(), resumes=True)
    assert ended.exit_code == 0
    assert ended.is_complete
    assert [sample.verdict for sample in ended.samples] == ["in tolerance"] * 3
    finished = [action for action in before if action[1] == "done"]
    assert [action for action in actions(run.journal) if action[1] == "done"][: len(finished)] == finished
    places = [
        row["inputs"]
        for row in read(run.journal, "action")
        if row["skill"] == "place_container" and row["outcome"] == "done"
    ]
    assert len(places) == 3


def test_a_full_disk_ends_the_run_safe_and_says_so(run: Run) -> None:
    class Filling(Watch):
        def ticked(self, root: Any) -> None:
            super().ticked(root)
            if self.ticks == 60:
                database = self.session.journal._store.db
                pages = database.execute("PRAGMA page_count").fetchone()[0]
                database.execute(f"PRAGMA max_page_count={pages}")

    watch = Filling()
    result = run.go(watch)
    assert result.exit_code == 3
    assert "cannot be written any more" in result.reason
    assert all(watch.session.cell.device(name).is_stopped for name in ("arm", "hand", "balance", "changer"))
    assert watch.session.cell.hand.opening_mm == 0.0
    assert run.go(Watch(), resumes=True).exit_code == 0


TAKEN_OFF = """
workflow: taken_off
inputs: {source: Source, container: Container, mass: Mass, tolerance: {type: Mass, default: 2 mg}}
tree:
  sequence:
    - place_container: {container: $container}
    - tare:
    - fill: {source: $source, container: $container, mass: $mass, tolerance: $tolerance}
    - park:
    - remove_container:
    - wait: {duration: 20 s}
"""


class WatchBracket(Watch):
    """Stops the run once a container has gone within the job of its own sample."""

    def ticked(self, root: Any) -> None:
        if any(closed.container == "b" for closed in self.session.cell.believed.closed):
            self.session.control.wish("stop_now")


def test_a_container_that_went_before_its_sample_was_interrupted_confirms_it_when_it_goes_on(tmp_path: Path) -> None:
    run = Run(tmp_path, make_lab(tmp_path / "lab", trees__taken_off=TAKEN_OFF))
    text = "recipe: two\nworkflow: taken_off\ndefaults: {source: beads, container: xrd_holder}\n"
    run.recipe.write_text(text + "samples: [{id: a, mass: 20 mg}, {id: b, mass: 30 mg}]\n" + HEAD, encoding="utf-8")
    assert run.go(WatchBracket()).exit_code == 130
    ended = run.go(Watch(), resumes=True)
    assert [(sample.id, sample.is_good) for sample in ended.samples] == [("a", True), ("b", True)]
