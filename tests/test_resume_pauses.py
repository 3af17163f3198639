"""A run that is paused, or stops when its sample is done: what is at work meanwhile, and that it goes on."""

import threading
from pathlib import Path
from typing import Any

import pytest
from resuming import Run, Watch, actions
from running import make_lab

from scuhand_bt.events.entry import Event, Note
from scuhand_bt.journal.reader import read
from scuhand_bt.journal.run_events import Paused
from scuhand_bt.run.guards import Guards
from scuhand_bt.skill import SkillFailed


@pytest.fixture
def run(tmp_path: Path) -> Run:
    return Run(tmp_path, make_lab(tmp_path / "lab"))


@pytest.mark.slow
def test_a_paused_action_is_settled_and_begun_again(run: Run) -> None:
    def when_paused(event: Event | Note) -> None:
        if isinstance(event, Paused):
            watch.session.control.wish("continue")

    watch = Watch("pause_now", 60)
    assert run.go(watch, heard=when_paused).exit_code == 0
    kinds = [event["kind"] for event in read(run.journal, "event")]
    assert kinds.index("paused") < kinds.index("continued")
    assert "interrupted" in [outcome for _, outcome in actions(run.journal)]


def test_a_pause_begins_no_action_and_halts_none(run: Run) -> None:
    seen: list[str] = []

    def when_paused(event: Event | Note) -> None:
        if isinstance(event, Paused):
            seen.extend(outcome for _, outcome in actions(run.journal))
            watch.session.control.wish("continue")

    watch = Watch("pause", 60)
    assert run.go(watch, heard=when_paused).exit_code == 0
    assert seen
    assert set(seen) <= {"done", "failed"}


@pytest.mark.slow
def test_a_run_that_stops_after_its_sample_leaves_it_finished(run: Run) -> None:
    stopped = run.go(Watch("stop", 20))
    assert [sample.verdict for sample in stopped.samples] == ["in tolerance", "not run", "not run"]
    assert not stopped.is_complete
    assert run.go(Watch(), resumes=True).exit_code == 0


@pytest.mark.parametrize("pause", ["pause", "pause_now"])
def test_a_paused_run_that_is_stopped_moves_nothing_more_and_can_be_resumed(run: Run, pause: str) -> None:
    class Stopping(Watch):
        def ticked(self, root: Any) -> None:
            super().ticked(root)
            if self.ticks == 40:
                self.session.control.wish(pause)
                self.session.control.wish("stop")

    stopped = run.go(Stopping())
    assert stopped.exit_code == 130
    kinds = [event["kind"] for event in read(run.journal, "event")]
    assert kinds.count("paused") <= 1
    assert run.go(Watch(), resumes=True).exit_code == 0


@pytest.mark.slow
@pytest.mark.parametrize("pause", ["pause", "pause_now"])
def test_a_guard_that_trips_in_a_pause_ends_the_run_and_the_sample_is_interrupted(
    run: Run, pause: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    look = Guards.look
    pressed: list[SkillFailed] = []
    monkeypatch.setattr(Guards, "look", lambda guards: pressed[0] if pressed else look(guards))

    class Pressing(Watch):
        def ticked(self, root: Any) -> None:
            super().ticked(root)
            if self.ticks == 40:
                control = self.session.control
                control.wish(pause)

                def press() -> None:
                    pressed.append(SkillFailed("device.emergency_stop", "pressed"))
                    control.news.fire()

                heard = self.session.journal.heard
                self.session.journal.heard = lambda event: (
                    threading.Timer(0.2, press).start() if isinstance(event, Paused) else heard(event)
                )

    result = run.go(Pressing())
    assert result.exit_code == 3
    assert "emergency_stop" in result.reason
    assert result.samples[0].verdict == "interrupted"
    pressed.clear()
    assert run.go(Watch(), resumes=True).exit_code == 0
