"""A run that was interrupted goes on: nothing twice, nothing lost, and never unnoticed on other ground."""

import fcntl
import random
import sqlite3
import threading
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any, ClassVar

import pytest
from conftest import Bench
from daily import first_daily
from running import HEAD, make_lab, shared_planner

from harness.kill import Tally, at_any_time, at_ticks, kill_until_done, make_batch
from scuhand_bt.clock import Steps
from scuhand_bt.events.entry import Event, Note
from scuhand_bt.journal.presence import is_held
from scuhand_bt.journal.reader import read
from scuhand_bt.journal.run_events import Paused
from scuhand_bt.lab import Lab, load_lab
from scuhand_bt.problems import SourceError
from scuhand_bt.recipe.plan import Job, Plan, make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.report.live import PlainLines
from scuhand_bt.run.control import Control
from scuhand_bt.run.guards import Guards
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.run.options import Options
from scuhand_bt.run.resume import checked_history, find_run, resumable
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun
from scuhand_bt.skill import Condition, Ratio, Seconds, Skill, SkillFailed, pause

RECIPE = """
recipe: three
workflow: fill_xrd_holder
defaults: {source: beads, container: xrd_holder, tolerance: 2 mg}
samples:
  - {id: a, mass: 20 mg}
  - {id: b, mass: 80 mg}
  - {id: c, mass: 200 mg, container: alumina_crucible, workflow: scoop_and_dispense}
"""


class Watch(BatchObserver):
    """Wishes something of the run at a tick, and waits for no one."""

    def __init__(self, wish: str | None = None, at_tick: int = 10**9) -> None:
        self.session: Any = None
        self._wish, self._at, self.ticks = wish, at_tick, 0

    def ticked(self, root: Any) -> None:
        self.ticks += 1
        if self.ticks == self._at:
            self.session.control.wish(self._wish)


class Run:
    """A recipe in a folder, run and resumed in this process."""

    def __init__(self, folder: Path, lab: Path, recipe: str = RECIPE) -> None:
        self.folder, self.recipe = folder / "runs", folder / "recipe.yaml"
        self.lab_folder = lab
        self.recipe.write_text(recipe + HEAD, encoding="utf-8")

    def plan(self) -> tuple[Plan, Lab]:
        lab = load_lab(self.lab_folder)
        return make_plan(load_recipe(self.recipe, lab), lab), lab

    @property
    def journal(self) -> Path:
        return find_run(self.folder, "last")

    def go(
        self,
        watch: Watch,
        *,
        resumes: bool = False,
        accept_changes: bool = False,
        heard: Callable[[Event | Note], None] | None = None,
        **options: Any,
    ) -> Any:
        plan, lab = self.plan()
        found = None
        if resumes:
            history = checked_history(self.journal)
            found = resumable(self.journal, history, plan, lab, accept_changes=accept_changes)
        chosen = Options(**{"simulation": DryRun(), "folder": self.folder, **options})
        session = Session(plan, lab, chosen, shared_planner(plan, lab), resumes=found)
        if heard is not None:
            session.journal.heard = heard
        watch.session = session
        try:
            return session.run(watch)
        finally:
            session.close()


@pytest.fixture
def run(tmp_path: Path) -> Run:
    return Run(tmp_path, make_lab(tmp_path / "lab"))


def actions(journal: Path) -> list[tuple[str, str]]:
    return [(row["skill"], row["outcome"]) for row in read(journal, "action")]


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


def test_a_complete_run_has_nothing_left_to_do(run: Run) -> None:
    run.go(Watch())
    with pytest.raises(SourceError, match="complete"):
        checked_history(run.journal)


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


# --- replaying, on a bench of fake devices


class Work(Skill[float]):
    """Take a while; give the time at which it was done."""

    devices = ("hand",)
    interrupted = "repeat"
    duration_s: Seconds = 1.0

    def run(self, cell: Any) -> Steps[float]:
        yield from pause(cell, self.duration_s)
        cell.note("worked")
        return float(cell.clock.now_s)


class Move(Work):
    """The same with another device."""

    devices = ("arm",)


class Fail(Skill[None]):
    """Fail after a while, until it has failed often enough."""

    interrupted = "repeat"
    times_ratio: Ratio = 2.0
    failed: ClassVar[list[float]] = []

    def run(self, cell: Any) -> Steps[None]:
        yield from pause(cell, 0.5)
        if len(self.failed) < self.times_ratio:
            self.failed.append(cell.clock.now_s)
            raise SkillFailed("hand.cone_empty", "again")


class Early(Condition):
    """Hold in the first ten seconds."""

    watches = ("balance",)

    def check(self, cell: Any) -> None:
        if cell.clock.now_s > 10.0:
            raise SkillFailed("hand.no_flow", "late")


SKILLS: dict[str, type[Skill[Any]]] = {"work": Work, "move": Move, "fail": Fail, "early": Early}
TREES = {
    "sequence": "sequence: [{work: }, {early: }, {move: }, {work: }]",
    "retry": "retry: {attempts: 4, child: {sequence: [{work: }, {fail: }, {move: }]}}",
    "repeat": "repeat: {times: 3, child: {sequence: [{work: }, {move: }]}}",
    "parallel": "sequence: [{parallel: [{work: {duration: 3 s}}, {sequence: [{move: }, {move: }]}]}, {work: }]",
    "timeout": "fallback: [{timeout: {duration: 2 s, child: {repeat: {times: 9, child: {work: }}}}}, {move: }]",
    "while": "fallback: [{while: {guards: [{early: }], child: {repeat: {times: 99, child: {work: }}}}}, {move: }]",
}


def outcomes(bench: Bench) -> list[tuple[str, str]]:
    return [action for action in bench.actions() if action[1] in ("done", "failed")]


@pytest.mark.parametrize("tree", TREES)
def test_a_job_stopped_at_any_tick_repeats_no_finished_action(tree: str, tmp_path: Path) -> None:
    def bench(name: str) -> Bench:
        Fail.failed.clear()
        folder = tmp_path / name
        folder.mkdir()
        made = Bench(folder)
        for beat in range(40):
            made.agenda.at(0.5 * beat, made.cell.devices["balance"].news.fire)
        return made

    whole = bench("whole")
    ended = whole.run(TREES[tree], SKILLS)
    for tick in range(1, len(whole.trees), max(1, len(whole.trees) // 12)):
        stopped = bench(f"stopped-{tick}")

        def ticked(root: Any, stopped: Bench = stopped, tick: int = tick) -> None:
            stopped.trees.append(root)
            if len(stopped.trees) == tick:
                stopped.control.wish("stop_now")

        stopped.ticked = ticked
        first = stopped.run(TREES[tree], SKILLS)
        finished = outcomes(stopped)
        stopped.control = Control()
        if first.interrupted is None:
            continue
        again = stopped.run(TREES[tree], SKILLS, resumes=True)
        assert (again.failure is None) == (ended.failure is None)
        assert outcomes(stopped)[: len(finished)] == finished
        if tree not in ("timeout", "while"):  # which begin anew, so that what they bound may do more
            assert sorted(outcomes(stopped)) == sorted(outcomes(whole))


def test_an_action_that_only_a_person_can_settle_is_asked_about(tmp_path: Path) -> None:
    class Press(Skill[None]):
        """Press a pellet: nobody should do that twice."""

        def run(self, cell: Any) -> Steps[None]:
            yield from pause(cell, 5.0)
            cell.note("pressed")

    class Answers:
        def __init__(self) -> None:
            self.asked: list[str] = []

        def ask(self, question: str, choices: Any) -> Steps[str]:
            self.asked.append(question)
            yield from ()
            return "done"

    bench = Bench(tmp_path)
    bench.agenda.at(3.0, lambda: bench.control.wish("stop_now"))
    bench.run("press:", {"press": Press})
    bench.control, operator = Control(), Answers()
    bench.cell.operator = operator  # type: ignore[attr-defined]
    outcome = bench.run("press:", {"press": Press}, resumes=True)
    assert outcome.failure is None
    assert "is it done" in operator.asked[0]
    assert not bench.log


@pytest.mark.parametrize(("duration", "failed"), [("8 s", None), ("4 s", "workflow.timeout")])
def test_a_timeout_counts_from_where_an_interrupted_action_goes_on(
    tmp_path: Path, duration: str, failed: str | None
) -> None:
    """Not from where a person was asked what became of it."""

    class Press(Skill[None]):
        """Press a pellet: nobody should do that twice."""

        def run(self, cell: Any) -> Steps[None]:
            yield from pause(cell, 5.0)
            cell.note("pressed")

    class Thinks:
        def ask(self, question: str, choices: Any) -> Steps[str]:
            yield from pause(bench.cell, 60.0)  # type: ignore[arg-type]
            return "again"

    bench, tree = Bench(tmp_path), f"timeout: {{duration: {duration}, child: {{press: }}}}"
    bench.agenda.at(3.0, lambda: bench.control.wish("stop_now"))
    bench.run(tree, {"press": Press})
    bench.control = Control()
    bench.cell.operator = Thinks()  # type: ignore[attr-defined]
    outcome = bench.run(tree, {"press": Press}, resumes=True)
    assert (outcome.failure and outcome.failure.code) == failed
    assert bench.cell.clock.now_s == 3.0 + 60.0 + (5.0 if failed is None else 4.0)


def test_what_a_workflow_kept_is_kept_over_an_interruption(tmp_path: Path) -> None:
    class Say(Skill[None]):
        """Note a duration."""

        interrupted = "repeat"
        duration_s: Seconds

        def run(self, cell: Any) -> Steps[None]:
            yield from pause(cell, 1.0)
            cell.note(f"{self.duration_s:g}")

    class Give(Skill[Seconds]):
        """Give a duration."""

        interrupted = "repeat"

        def run(self, cell: Any) -> Steps[float]:
            yield from pause(cell, 1.0)
            return 4.5

    bench = Bench(tmp_path)
    bench.agenda.at(1.5, lambda: bench.control.wish("stop_now"))
    tree = "sequence: [{give: {as: long}}, {say: {duration: $long}}]"
    bench.run(tree, {"say": Say, "give": Give})
    bench.control = Control()
    bench.run(tree, {"say": Say, "give": Give}, resumes=True)
    assert [what for _, what in bench.log] == ["4.5"]


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
    options = Options(DryRun(plant="test_resume:Unwritable"), folder=run.folder)
    session = Session(plan, lab, options, shared_planner(plan, lab))
    watch = Watch("stop_now", 500)
    watch.session = session
    try:
        session.run(watch)
    finally:
        session.close()
    with pytest.raises(SourceError, match=r"Unwritable cannot be written down.*start a new run"):
        checked_history(run.journal)


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


def test_a_run_that_is_looked_at_is_not_held(tmp_path: Path) -> None:
    journal = tmp_path / "a.sqlite"
    with journal.with_suffix(".lock").open("w+") as looking:
        fcntl.flock(looking, fcntl.LOCK_SH)  # as another who looks whether the run is held
        assert not is_held(journal)


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
