"""scuhand_bt from Python: recipes as dicts and files, results as records, and everything that happens as events."""

import gc
import json
import sqlite3
import threading
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from conftest import REPOSITORY, Call, LabFolder
from quiet_skill import QUIET

from scuhand_bt import api
from scuhand_bt.journal import telling
from scuhand_bt.journal.reader import read
from scuhand_bt.motion.collision import Scene

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


def test_the_example_of_events_tells_of_every_action(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (REPOSITORY / "docs" / "python.md").read_text(encoding="utf-8")
    (text,) = (
        block.split("```")[0] for block in page.split("```python\n")[1:] if "on_event=tell" in block.split("```")[0]
    )
    monkeypatch.chdir(REPOSITORY)
    exec(compile(text, "python.md", "exec"), {})
    skills = [line.split()[1] for line in capsys.readouterr().out.splitlines()]
    assert [skill for skill in skills if skill in ("tare", "scoop", "dispense")] == ["scoop", "tare", "dispense"]


def test_a_recipe_in_a_dict_is_checked_as_one_in_a_file_each_problem_by_its_keys(lab: api.OpenLab) -> None:
    assert lab.check(RECIPE, fast=True).problems == ()
    wrong = {**RECIPE, "samples": [{**RECIPE["samples"][0], "mass": "50 s"}], "ordr": "as_written"}
    found = lab.check(wrong, fast=True)
    said = [str(problem) for problem in found.errors]
    assert len(said) == 2
    assert found.plan is None
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


@pytest.mark.slow
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


def test_warnings_are_found_beside_errors(lab: api.OpenLab) -> None:
    unused = {**RECIPE, "sources": {"beads": SOURCE, "more": {**SOURCE, "station": "mortar_bay_2"}}}
    found = lab.check(unused, fast=True)
    assert [(problem.code, problem.is_warning) for problem in found.problems] == [("unused-source", True)]
    assert found.plan is not None
    assert not found.errors


def test_a_check_plans_the_ways_unless_it_is_to_be_fast(lab_folder: LabFolder) -> None:
    opened = api.open_lab(lab_folder.folder)
    assert not (opened.state / "planned.json").exists()
    assert opened.check(RECIPE, fast=True).problems == ()
    assert not (opened.state / "planned.json").exists()
    assert opened.check(RECIPE).problems == ()
    assert (opened.state / "planned.json").exists()


@pytest.mark.slow
def test_a_session_may_be_run_in_another_thread_than_it_was_made_in(lab: api.OpenLab, tmp_path: Path) -> None:
    session = lab.prepare(RECIPE, api.DryRun(), journals=tmp_path)
    came: list[Any] = []

    def run() -> None:
        with api.closing(session):
            came.append(session.run(api.BatchObserver()))

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    (result,) = came
    assert [sample.verdict for sample in result.samples] == ["in tolerance"]
    assert read(session.journal.path, "event")[-1]["kind"] == "matter"


@pytest.mark.slow
def test_runs_of_one_process_leave_no_scenes_descriptors_nor_threads_behind(lab: api.OpenLab) -> None:
    """Not even until Python collects what refers to itself: a run's scenes take 70 MB, of few objects."""

    def left() -> tuple[int, int, int]:
        scenes = sum(isinstance(one, Scene) for one in gc.get_objects())
        return len([*Path("/proc/self/fd").iterdir()]), threading.active_count(), scenes

    gc.collect()
    gc.disable()
    try:
        lab.dry_run(RECIPE, seed=1)
        before = left()
        lab.dry_run(RECIPE, seed=2)
        assert left() == before
    finally:
        gc.enable()


def test_a_session_is_run_once(lab: api.OpenLab, tmp_path: Path) -> None:
    with api.closing(lab.prepare(RECIPE, api.DryRun(), journals=tmp_path)) as session:
        session.run(api.BatchObserver())
        with pytest.raises(RuntimeError, match="a session is run once: make another one"):
            session.run(api.BatchObserver())


def test_another_thread_stops_a_run_by_its_control(lab: api.OpenLab, tmp_path: Path) -> None:
    control = api.Control()

    def stop(event: api.RunEvent) -> None:
        if event.kind == "job_started":
            control.wish("stop_now")

    two = {**RECIPE, "samples": [{**RECIPE["samples"][0], "id": f"s{n}"} for n in range(40)]}
    result = lab.dry_run(two, journals=tmp_path, control=control, on_event=stop)
    assert result.exit_code == 130
    assert result.samples[-1].verdict == "not run"


def test_on_the_cell_a_name_is_asked_for_and_a_pin_of_who_has_one(lab_folder: LabFolder) -> None:
    from scuhand_bt.lab_state.persons import Persons

    lab = api.open_lab(lab_folder.folder)
    Persons(lab.state).enrol("Ada", "123456")
    for operator, pin, said in (("", None, "a person's name"), ("Ada", None, "give it"), ("Ada", "654321", "not it")):
        with pytest.raises(ValueError, match=said):
            lab.run(RECIPE, operator=operator, pin=pin)


# --- events


def test_every_entry_of_the_journal_is_told_in_order_and_fits_the_schema(lab: api.OpenLab, tmp_path: Path) -> None:
    told: list[api.RunEvent] = []
    result = lab.dry_run(RECIPE, seed=1, journals=tmp_path, on_event=told.append)
    (journal,) = tmp_path.glob("*.sqlite")
    rows = read(journal, "entry")
    assert [(event.seq, event.kind, event.time_s, event.job, event.action) for event in told] == [
        (row["seq"], row["kind"], row["time_s"], row["job"], row["action"]) for row in rows
    ]
    for event, row in zip(told, rows, strict=True):
        assert {key: value for key, value in event.values.items() if key != "lines"} == row["payload"]
    assert {"run", "job_started", "action_started", "pulse", "frames", "dose", "sample", "ended"} <= {
        event.kind for event in told
    }
    lines = [line for event in told if event.kind == "frames" for line in event.values["lines"]]  # type: ignore[union-attr]
    assert len(lines) == sum(event.values["readings"] for event in told if event.kind == "frames")  # type: ignore[misc]
    assert all(len(line) == 5 and isinstance(line[1], str) for line in lines)  # type: ignore[arg-type,index]
    schema = json.loads((REPOSITORY / "docs" / "events.schema.json").read_text(encoding="utf-8"))
    judge = jsonschema.Draft202012Validator(schema)
    for event in told:
        judge.validate(json.loads(event.line()))
    assert result.notices == ()
    for wrong in ({"kind": "pulsed"}, {"seq": 0}, {"values": {"net_mg": "much"}}, {"version": 2}, {"more": 1}):
        pulse = next(event for event in told if event.kind == "pulse")
        assert not judge.is_valid({**json.loads(pulse.line()), **wrong}), wrong


@pytest.mark.slow
def test_what_a_listener_breaks_or_never_hears_is_a_notice_and_the_run_ends_as_without(
    lab: api.OpenLab, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(telling, "PATIENCE_S", 0.2)
    released = threading.Event()

    def breaks(event: api.RunEvent) -> None:
        if event.seq == 3:
            raise ValueError("of mine")

    def hangs(event: api.RunEvent) -> None:
        if event.seq == 3:
            released.wait(60)

    listeners: list[tuple[Callable[[api.RunEvent], None], str]] = [
        (breaks, "entry 2: ValueError: of mine"),
        (hangs, "entry 2: nobody hears any more"),
    ]
    for listener, said in listeners:
        result = lab.dry_run(RECIPE, seed=1, on_event=listener)
        assert result.doses[0].verdict == "in tolerance"
        assert [notice.removeprefix("what happened was told up to ") for notice in result.notices] == [said]
    released.set()


@pytest.mark.slow
def test_a_slow_listener_hears_all_and_the_run_does_not_wait_for_it(lab: api.OpenLab) -> None:
    told: list[tuple[int, float]] = []
    ended: list[float] = []

    def slow(event: api.RunEvent) -> None:
        if event.kind == "run":
            time.sleep(0.5)
        told.append((event.seq, time.monotonic()))

    lab.dry_run(RECIPE, seed=1, on_event=slow, on_sample=lambda sample: ended.append(time.monotonic()))
    assert [seq for seq, _ in told] == list(range(1, len(told) + 1))
    assert told[-1][1] > ended[-1]


def test_events_go_to_a_file_or_alone_to_the_standard_output(command: Call, lab_folder: LabFolder) -> None:
    recipe = lab_folder.write("recipes/one.yaml", json.dumps({"recipe": "one", **RECIPE}))
    into = lab_folder.folder / "events.jsonl"
    ended = command("run", recipe, "--dry-run", "--events", into)
    assert ended.returncode == 0
    lines = [json.loads(line) for line in into.read_text(encoding="utf-8").splitlines()]
    assert [line["seq"] for line in lines] == list(range(1, len(lines) + 1))
    assert lines[-1]["kind"] == "matter"
    assert "in tolerance" in ended.stdout
    ended = command("run", recipe, "--dry-run", "--events", "-")
    alone = [json.loads(line) for line in ended.stdout.splitlines()]
    beside = ("frames", "dose_curve")  # written in parts as large as the wall's time makes them
    assert [line["kind"] for line in alone if line["kind"] not in beside] == [
        line["kind"] for line in lines if line["kind"] not in beside
    ]
    assert "in tolerance" in ended.stderr
    refused = command("run", recipe, "--dry-run", "--events", into / "none" / "x")
    assert refused.returncode == 2
    assert "cannot be written" in refused.stderr.replace("\n", " ")


def two_samples() -> dict[str, Any]:
    return {**RECIPE, "samples": [{**RECIPE["samples"][0], "id": name} for name in ("a", "b")]}


def stopped_after_the_first(lab: api.OpenLab, recipe: Any, told: list[api.RunEvent]) -> api.Result:
    """Of two samples, in the lab's own journals."""
    control = api.Control()
    return lab.dry_run(
        recipe,
        seed=1,
        journals=lab.state / "runs",
        control=control,
        on_sample=lambda sample: control.wish("stop"),
        on_event=told.append,
    )


def test_the_command_resumes_from_the_entry_where_a_run_was(command: Call, lab_folder: LabFolder) -> None:
    recipe = lab_folder.write("recipes/two.yaml", json.dumps({"recipe": "two", **two_samples()}))
    before = list[api.RunEvent]()
    assert stopped_after_the_first(api.open_lab(lab_folder.folder), recipe, before).exit_code == 130
    ended = command("resume", "last", "--lab", lab_folder.folder, "--events", "-")
    after = [json.loads(line) for line in ended.stdout.splitlines()]
    assert ended.returncode == 0
    assert after[0]["kind"] == "resumed"
    assert [one["seq"] for one in after] == list(range(before[-1].seq + 1, before[-1].seq + 1 + len(after)))
    assert [one["values"]["id"] for one in after if one["kind"] == "sample"][-1] == "b"


@pytest.mark.slow
def test_any_thread_resumes_a_run_and_what_it_came_to_is_read_back_as_it_was_given(lab_folder: LabFolder) -> None:
    lab, before, after = api.open_lab(lab_folder.folder), list[api.RunEvent](), list[api.RunEvent]()
    stopped = stopped_after_the_first(lab, two_samples(), before)  # a dict has no file to be read anew
    (one,) = api.runs(lab_folder.folder)
    assert (stopped.exit_code, one.id, one.state, one.total) == (130, stopped.run, "stopped", 2)
    past = api.find_run("last", lab_folder.folder)
    assert replace(past.result(), notices=()) == stopped
    came: list[api.Result] = []
    resume = threading.Thread(target=lambda: came.append(api.resume(past, on_event=after.append)))
    resume.start()
    resume.join()
    (result,) = came
    assert (result.run, result.exit_code, result.reason) == (stopped.run, 0, "")
    assert [(dose.sample, dose.verdict) for dose in result.doses] == [("a", "in tolerance"), ("b", "in tolerance")]
    assert result.doses[0].true_mg == stopped.doses[0].true_mg, "nothing is done twice"
    assert after[0].kind == "resumed"
    assert list(past.events()) == [*before, *after]
    assert replace(result, duration_s=0.0) == replace(past.result(), duration_s=0.0)
    assert past.result().rows() == result.rows()
    assert json.loads(past.export())["end"]["exit_code"] == 0
    with pytest.raises(api.SourceError, match="the run is complete"):
        api.resume(past)


def test_what_has_changed_since_is_refused_or_accepted_by_name(lab_folder: LabFolder) -> None:
    recipe = lab_folder.write("recipes/two.yaml", json.dumps({"recipe": "two", **two_samples()}))
    stopped_after_the_first(api.open_lab(lab_folder.folder), recipe, [])
    lab_folder.write("recipes/two.yaml", json.dumps({"recipe": "two", "summary": "other", **two_samples()}))
    with pytest.raises(api.SourceError, match="has changed"):
        api.resume(lab=lab_folder.folder)
    with api.take_up(api.find_run("last", lab_folder.folder), accept_changes=True) as found:
        (change,) = found.changes
        assert "two.yaml or one of its tables has changed" in change
        assert "1 of 2 samples are finished." in found.known
        assert found.known[-1].startswith("The cone held "), "nothing was at work: there is no action before which"
        assert not found.is_on_the_cell
        with pytest.raises(api.SourceError, match="another process"):
            api.resume(lab=lab_folder.folder, accept_changes=True)
    assert api.resume(lab=lab_folder.folder, accept_changes=True).exit_code == 0


def test_a_run_is_recorded_with_the_files_that_it_has_read(lab_folder: LabFolder) -> None:
    """A lab that was edited as a run began was recorded as it was then, and resumed without a word."""
    recipe = lab_folder.write("recipes/two.yaml", json.dumps({"recipe": "two", **two_samples()}))
    opened = api.open_lab(lab_folder.folder)
    cell = lab_folder.folder / "robot/cell.yaml"
    before = cell.read_text(encoding="utf-8")
    cell.write_text(before.replace("period: 100 ms", "period: 200 ms"), encoding="utf-8")
    stopped_after_the_first(opened, recipe, [])
    with pytest.raises(api.SourceError, match=r"the lab's robot/cell.yaml has changed"):
        api.resume(lab=lab_folder.folder)
    cell.write_text(before, encoding="utf-8")
    assert api.resume(lab=lab_folder.folder).exit_code == 0


def test_a_run_that_had_to_ask_and_nobody_was_there_goes_on_with_somebody(lab_folder: LabFolder) -> None:
    """It stayed unattended, and stopped at the same question each time that it was resumed."""
    lab_folder.write("skills/quiet.py", QUIET)
    lab_folder.write("trees/ask.yaml", "workflow: ask\ntree: {quiet: }\n")
    recipe = lab_folder.write("recipes/ask.yaml", "recipe: ask\nworkflow: ask\nsamples: [{id: a}]\n")
    lab = api.open_lab(lab_folder.folder)
    begun = lab.dry_run(recipe, journals=lab.state / "runs", unattended=True)
    assert (begun.exit_code, "operator.absent: " in begun.reason) == (3, True)
    as_begun = api.resume(lab=lab_folder.folder)
    assert (as_begun.exit_code, "operator.absent: " in as_begun.reason) == (3, True)
    assert api.resume(lab=lab_folder.folder, attended=True).exit_code == 0


def test_a_run_that_needs_a_person_is_not_resumed_where_nobody_stays(lab_folder: LabFolder, command: Call) -> None:
    lab_folder.replace("robot/cell.yaml", "{driver: carousel, slots: 24}", "{driver: operator}")
    recipe = lab_folder.write("recipes/two.yaml", json.dumps({"recipe": "two", **two_samples()}))
    stopped_after_the_first(api.open_lab(lab_folder.folder), recipe, [])
    refused = command("resume", "last", "--lab", lab_folder.folder, "--unattended")
    assert refused.returncode == 2
    assert "an unattended run cannot wait for a person, but one is needed" in refused.stderr


def test_of_an_altered_journal_nothing_is_a_result(lab_folder: LabFolder) -> None:
    lab = api.open_lab(lab_folder.folder)
    lab.dry_run(RECIPE, journals=lab.state / "runs")
    past = api.find_run("last", lab_folder.folder)
    assert past.problem() is None
    with closing(sqlite3.connect(past.path)) as database, database:
        for (trigger,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'").fetchall():
            database.execute(f"DROP TRIGGER {trigger}")
        database.execute("UPDATE entry SET payload = replace(payload, '50.0', '51.0') WHERE kind = 'sample'")
    assert past.problem() is not None
    for read_it in (past.result, past.export, lambda: list(past.events())):
        with pytest.raises(api.SourceError, match="not as it was written"):
            read_it()


@pytest.mark.slow
def test_the_example_of_runs_of_before_goes_on_with_the_last(
    lab_folder: LabFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    stopped_after_the_first(api.open_lab(lab_folder.folder), two_samples(), [])
    page = (REPOSITORY / "docs" / "python.md").read_text(encoding="utf-8")
    (text,) = (block.split("```")[0] for block in page.split("```python\n")[1:] if "resume" in block.split("```")[0])
    exec(compile(text.replace("my-lab", str(lab_folder.folder)), "python.md", "exec"), {})
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith("stopped 0 of 2"), "the first is open until the bare pan confirms it"
    assert lines[1].endswith(" resumed")
    assert lines[-1] == "True"


def test_a_run_in_another_process_hears_and_says_why_it_does_not(lab_folder: LabFolder) -> None:
    lab = api.open_lab(lab_folder.folder)
    session = lab.prepare(RECIPE, api.DryRun(), journals=lab.state / "runs")
    past = api.find_run(session.run_id[:20], lab_folder.folder)
    with api.closing(session):
        assert past.is_going_on
        assert past.question() is None
        past.wish("pause")
        assert session.control.is_pausing
        past.wish("continue")
        asked = api.Question(7, "?", ("done",), "")
        with pytest.raises(api.NotHeard, match=r"another question is waiting now|answered already"):
            past.answer(asked, "done")
    assert not past.is_going_on
    with pytest.raises(api.NotHeard, match="it is not running"):
        past.wish("stop")
