"""runs, show, verify and export: what a person, or an auditor, gets to see of runs that are over."""

import csv
import io
import json
import re
import sqlite3
from contextlib import closing
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from conftest import Call
from journal_bench import HEADER, tamper, write_run, write_version_1

from scuhand_bt.api import PastRun
from scuhand_bt.events.doses import Dose
from scuhand_bt.events.weighings import DoseWeighed, Line, Tared
from scuhand_bt.journal.archive import summaries
from scuhand_bt.journal.events import Answered, Asked, JobEnded, JobStarted
from scuhand_bt.journal.export import canonical
from scuhand_bt.journal.presence import Presence
from scuhand_bt.journal.reader import open_contents, read
from scuhand_bt.journal.results import SampleResult, SoFar
from scuhand_bt.journal.run_events import Continued, Ended, Paused, Resumed, RunBegun
from scuhand_bt.journal.writer import Journal
from scuhand_bt.report.weighing_record import COLUMNS, weighing_csv
from tests.running import Ran, dry_run, make_lab

DOSES = """
recipe: two
workflow: fill_xrd_holder
defaults: {container: xrd_holder, source: beads}
samples:
  - {id: a, mass: 30 mg}
  - {id: b, mass: 40 mg}
"""
PLANNED = [{"id": name, "workflow": "fill_xrd_holder", "inputs": {}} for name in ("a", "b")]


@pytest.fixture
def run(tmp_path: Path) -> Path:
    journal = write_run(tmp_path / "r.sqlite")
    journal.close()
    return journal.path


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Ran:
    return dry_run(tmp_path_factory.mktemp("ran"), DOSES, seed=1)


def record(path: Path) -> list[dict[str, str]]:
    with open_contents(path) as contents:
        return list(csv.DictReader(io.StringIO(weighing_csv(contents))))


def test_runs_are_listed_newest_first_with_their_states(tmp_path: Path, command: Call) -> None:
    lab = make_lab(tmp_path / "lab")
    folder = lab / ".scuhand" / "runs"
    write_run(folder / "complete.sqlite").close()
    exit_codes = {"stopped": 130, "fault": 3, "cut": None, "held": None, "rest": None}
    for day, (name, ends) in enumerate(exit_codes.items(), start=5):
        journal = Journal(folder / f"{name}.sqlite", durable=False)
        started = f"2026-05-{day:02}T08:00:00+02:00"
        journal.event(RunBegun.model_validate({**HEADER, "started": started, "samples": PLANNED}))
        if ends is not None:
            journal.event(Ended(exit_code=ends, reason="a reason", complete=False))
        if name == "rest":
            journal.event(Paused())
        journal.close()
    (folder / "broken.sqlite").write_bytes(b"nothing")
    held = [Presence(folder / f"{name}.sqlite") for name in ("held", "rest")]
    try:
        code, out, _ = command("runs", "--json", "--lab", lab)
        shown = command("runs", "--lab", lab)[1]
    finally:
        for one in held:
            one.end()
    found = json.loads(out)
    assert code == 0
    states = {one["id"]: one["state"] for one in found}
    assert states == {
        "broken": "unreadable", "rest": "paused", "held": "running", "cut": "interrupted", "fault": "fault",
        "stopped": "stopped", "complete": "complete",
    }  # fmt: skip
    in_order = [one["id"] for one in found if one["id"] != "broken"]
    assert in_order == ["rest", "held", "cut", "fault", "stopped", "complete"]
    assert "SIMULATED" in shown
    assert "stopped: a reason" in shown
    assert found[-1]["good"] == found[-1]["total"] == 1
    assert next(one for one in found if one["id"] == "cut")["total"] == 2


def test_a_folder_without_runs_has_none(tmp_path: Path, command: Call) -> None:
    assert summaries(tmp_path) == []
    lab = make_lab(tmp_path / "lab")
    assert "There are no runs" in command("runs", "--lab", lab)[1]
    code, _, err = command("show", "last", "--lab", lab)
    assert (code, "there is no run 'last'" in err) == (2, True)


def test_show_tells_what_happened(run: Path, command: Call) -> None:
    code, out, _ = command("show", run)
    assert code == 0
    assert "r: SIMULATED, no powder was moved" in out
    assert "State: complete; 1 of 1 samples good." in out
    assert "dispense(mass 20): " in out
    assert "failed, hand.no_flow, no powder comes" in out
    assert "dose: 20.3 mg of 20.0 mg ± 0.05 mg, in tolerance (paper)" in out
    assert "entries, whole; head " in out


HALTED = """\
from scuhand_bt.skill import Cell, Milligrams, Seconds, Skill, Steps, pause


class Hold(Skill[None]):
    \"\"\"Wait, and note when that is over.\"\"\"

    interrupted = "repeat"
    duration_s: Seconds
    masses: tuple[Milligrams, ...] = ()

    def run(self, cell: Cell) -> Steps[None]:
        try:
            yield from pause(cell, self.duration_s)
        finally:
            cell.record.note("lab.over", {"after": self.duration_s})
"""
BESIDE = """\
workflow: beside
inputs: {masses: [Mass]}
tree:
  sequence:
    - optional: {timeout: {duration: 2 s, child: {parallel: [{hold: {duration: 9 s}}, {hold: {duration: 1 s}}]}}}
    - hold: {duration: 1 s, masses: $masses}
    - record: {sum: sum($masses), n: count($masses)}
"""


def test_show_tells_units_and_what_a_halted_action_notes_as_its_doing(tmp_path: Path, command: Call) -> None:
    lab = make_lab(tmp_path / "lab", skills__hold=HALTED, trees__beside=BESIDE)
    recipe = "recipe: r\nworkflow: beside\nsamples: [{id: a, masses: [[20 mg, 0.03 g]]}]\n"
    shown = command("show", dry_run(tmp_path, recipe, lab=lab).journal)[1].splitlines()
    told = [line.split(" s  ", 1)[1] for line in shown if re.search("s  (hold|lab.over|record)", line)]
    assert told == [
        "hold(duration 9 s): 2.0 s, halted",
        "lab.over: after 9",
        "hold(duration 1 s): 1.0 s, done",
        "lab.over: after 1",
        "hold(duration 1 s, masses [20, 30] mg): 1.0 s, done",
        "lab.over: after 1",
        "record(sum 50 mg, n 2): 0.0 s, done",
        "recorded: sum 50 mg",
        "recorded: n 2",
    ]


def test_show_tells_of_questions_pauses_and_resumptions(tmp_path: Path, command: Call) -> None:
    journal = write_run(tmp_path / "r.sqlite")
    journal.event(Resumed(last_at="then", changes=["the recipe has changed"], version="", operator="eve"))
    journal.event(Asked(question="Is it?", choices=["done", "stop"]))
    journal.event(Answered(question="Is it?", answer="done"))
    journal.event(Paused())
    journal.event(Continued())
    journal.close()
    out = command("show", journal.path)[1]
    assert "resumed by eve; the last entry before was of then; accepted: the recipe has changed" in out
    assert "asked: Is it? [done/stop]" in out
    assert out.index("answered: done") < out.index("paused") < out.index("continued")
    assert "State: interrupted" in out


@pytest.mark.slow
def test_show_as_json_has_all_of_it(ran: Ran, command: Call) -> None:
    code, out, _ = command("show", ran.journal, "--json")
    story: dict[str, Any] = json.loads(out)
    assert code == 0
    assert [sample["id"] for sample in story["samples"]] == ["a", "b"]
    jobs = {job["name"]: job for job in story["run"] if job["kind"] == "job"}
    dispense = next(one for one in jobs["a"]["happened"] if one.get("skill") == "dispense")
    assert {"pulse", "dose"} <= {one["kind"] for one in dispense["happened"]}
    assert story["chain"]["head"] == ran.session.journal.head
    assert story["header"]["samples"][0]["id"] == "a"


def test_the_balances_own_lines_of_a_dose_are_kept(ran: Ran, command: Call) -> None:
    lines = json.loads(command("show", ran.journal, "--frames", "a", "--json")[1])
    assert len(lines) > 20
    assert all(line["raw"].endswith("\r\n") for line in lines)
    times_s = [line["time_s"] for line in lines]
    assert times_s == sorted(times_s)
    steps_s = [after - before for before, after in pairwise(times_s)]
    assert max(steps_s) < 1.5 * ran.session.cell.spec.balance.period_s  # of one dispense, none is missing
    code, _, err = command("show", ran.journal, "--frames", "z")
    assert code == 2
    assert "the samples are a, b" in err


def test_verify_says_whole_altered_or_cut_off(run: Path, command: Call) -> None:
    with open_contents(run) as contents:
        head = contents.verified.head
    code, out, _ = command("verify", run)
    assert code == 0
    assert head in out
    assert "could have written a whole other chain: a head noted elsewhere" in out
    assert "nothing was altered, added or cut off since" in command("verify", run, "--head", head.upper())[1]
    assert command("verify", run, "--head", "0" * 64)[0] == 3
    assert command("verify", run, "--head", "abc")[0] == 2
    other = run.with_name("s.sqlite")
    other.write_bytes(run.read_bytes())
    code, _, err = command("verify", other)
    assert code == 3
    assert "the journal of another run, r" in err
    tamper(run, "DELETE FROM entry WHERE kind = 'ended'")
    code, out, _ = command("verify", run)
    assert code == 0
    assert "The run has no end" in out
    code, _, err = command("verify", run, "--head", head)
    assert code == 3
    assert "are missing" in err
    with closing(sqlite3.connect(run, isolation_level=None)) as database:
        database.execute("UPDATE entry SET time_s = 99 WHERE seq = 3")
    code, _, err = command("verify", run)
    assert code == 3
    assert "entry 3 (action_started," in err


def test_what_is_told_in_pieces_is_what_json_writes_at_once(ran: Ran, tmp_path: Path, command: Call) -> None:
    code, out, _ = command("export", ran.journal, "--json")
    assert (code, out) == (0, json.dumps(json.loads(out), indent=1, sort_keys=True) + "\n")
    assert out == canonical(ran.journal)
    code, out, _ = command("show", ran.journal, "--json")
    assert (code, out) == (0, json.dumps(PastRun(ran.journal).story(), indent=2) + "\n")
    empty = Journal(tmp_path / "e.sqlite", durable=False)
    empty.event(RunBegun.model_validate(HEADER))
    empty.close()
    out = command("export", empty.path, "--json")[1]
    assert out == json.dumps(json.loads(out), indent=1, sort_keys=True) + "\n"


def test_show_tells_each_job_with_all_that_is_of_it_however_late_it_came(tmp_path: Path, command: Call) -> None:
    journal = Journal(tmp_path / "r.sqlite", durable=False)
    journal.event(RunBegun.model_validate(HEADER))
    jobs = []
    for name in ("a", "b"):
        journal.job_started(JobStarted(name=name, sample=name, attempt=1, workflow="w"))
        jobs.append(journal.job)
        journal.job_ended(JobEnded(outcome="done"))
    assert jobs[0] is not None
    journal.job_resumed(jobs[0], SoFar())
    journal.event(Continued())
    journal.close()
    story = json.loads(command("show", journal.path, "--json")[1])
    assert [(one["kind"], one["seq"]) for one in story["run"]] == [("job", job) for job in jobs]
    within = [[inner["kind"] for inner in one["happened"]] for one in story["run"]]
    assert "continued" in within[0]
    assert "continued" not in within[1]


def test_views_that_are_not_as_made_are_not_believed(run: Path, command: Call) -> None:
    """The chain is of the entries: who writes a journal's file can make its views say anything."""
    exported = command("export", run, "--json")[1]
    with closing(sqlite3.connect(run, isolation_level=None)) as database:
        database.execute("DROP VIEW action")
        database.execute("CREATE VIEW action AS SELECT 1 AS id, 1 AS job, 'another' AS skill, 'done' AS outcome")
    assert command("export", run, "--json")[1] == exported
    assert "another" not in command("show", run)[1]


def test_an_export_that_cannot_be_written_leaves_the_file_as_it_was(run: Path, tmp_path: Path, command: Call) -> None:
    file = tmp_path / "r.json"
    file.write_text("before")
    tamper(run, "UPDATE entry SET payload = '{}' WHERE kind = 'dose'")
    assert command("export", run, "--json", "-o", file)[0] == 3
    assert [one.name for one in tmp_path.glob("r.json*")] == ["r.json"]
    assert file.read_text() == "before"


def test_an_altered_journal_is_shown_up_to_there_and_not_exported(run: Path, command: Call) -> None:
    tamper(run, "UPDATE entry SET payload = '{}' WHERE kind = 'dose'")
    code, out, err = command("show", run)
    assert code == 3
    assert "NOT AS IT WAS WRITTEN" in out
    assert "dose:" not in out
    assert "(dose, " in err
    assert "State: altered" in out
    for form in ("--csv", "--json"):
        code, out, err = command("export", run, form)
        assert (code, out) == (3, "")
        assert "Nothing was exported" in err


@pytest.mark.parametrize("form", [("show",), ("verify",), ("export", "--csv"), ("plot", "a")])
def test_what_is_no_journal_is_refused_cleanly(tmp_path: Path, command: Call, form: tuple[str, ...]) -> None:
    broken = tmp_path / "broken.sqlite"
    broken.write_bytes(b"SQLite format 3\0" + bytes(range(256)) * 40)
    for path in (broken, tmp_path / "gone.sqlite"):
        code, _, err = command(form[0], path, *form[1:])
        assert code == 2
        assert str(path) in err
        assert "Traceback" not in err


def test_the_weighing_record_has_every_weighing_with_all_an_auditor_asks_for(ran: Ran) -> None:
    rows = record(ran.journal)
    doses = {row["sample"]: row for row in rows if row["weighing"] == "dose"}
    brackets = {row["sample"]: row for row in rows if row["weighing"] == "result"}
    assert [row["weighing"] for row in rows].count("result") == len(brackets) == 2
    assert {row["weighing"] for row in rows} == {
        "container",
        "container again",
        "tare",
        "dose",
        "lifted",
        "bare pan",
        "result",
    }
    for name in ("a", "b"):
        row, bracket, result = doses[name], brackets[name], ran.sample(name)
        drift_mg, earlier_mg, net_mg = (float(row[name]) for name in ("drift_mg", "earlier_mg", "net_mg"))
        assert float(row["gross_mg"]) - float(row["tare_mg"]) - drift_mg + earlier_mg == pytest.approx(net_mg, abs=1e-3)
        for weighed in ("tare", "gross"):
            shown_mg = [1000 * float(line.split()[-2]) for line in row[f"{weighed}_lines"].split(" | ")]
            assert sum(shown_mg) / len(shown_mg) == pytest.approx(float(row[f"{weighed}_mg"]), abs=1e-3)
        assert float(bracket["net_mg"]) == pytest.approx(result.dispensed_mg, abs=1e-4)
        assert float(bracket["standard_uncertainty_mg"]) == pytest.approx(result.uncertainty_mg, abs=1e-4)
        assert float(bracket["standard_uncertainty_mg"]) < float(row["standard_uncertainty_mg"])
        assert bracket["verdict"] == result.verdict
        same = ("container", "container_kind", "source", "powder", "sheet", "target_mg", "attempt", "controller")
        assert [bracket[column] for column in same] == [row[column] for column in same]
    first = doses["a"]
    assert first["simulated"] == "yes"
    assert first["stable"] == "yes"
    assert first["lines_unit"] == "g"
    assert first["readability_mg"] == "0.1000"
    assert first["balance_identity"] == "simulated"
    assert (first["source"], first["powder"], first["sheet"]) == ("beads", "glass_beads", "1")
    assert "guard band" in first["tolerance_convention"]
    assert first["operator"]
    assert first["at"][-6] in "+-"
    assert first["software"].startswith("scuhand_bt ")
    entry = next(row for row in read(ran.journal, "entry") if row["seq"] == int(first["entry"]))
    assert (entry["kind"], entry["hash"].hex()) == ("dose", first["entry_hash"])
    entry = next(row for row in read(ran.journal, "entry") if row["seq"] == int(brackets["a"]["entry"]))
    assert (entry["kind"], entry["hash"].hex()) == ("sample", brackets["a"]["entry_hash"])


def lines(gross_mg: float) -> tuple[Line, ...]:
    return (Line(value_mg=gross_mg, unit="mg", stable=True, time_s=1.0, raw=f"{gross_mg:.1f} mg"),)


def test_a_dose_in_two_parts_is_weighed_against_the_empty_container_and_its_bracket_stands_once(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "r.sqlite", durable=False)
    journal.event(RunBegun.model_validate(HEADER))
    journal.job_started(JobStarted(name="a", sample="a", attempt=1, workflow="w"))
    dosed = {"container": "a", "lot": "glass_beads", "target_mg": 50.0, "tolerance_mg": 2.0, "uncertainty_mg": 0.2}
    cost = {"pulses": 1, "vibration_s": 0.0, "duration_s": 9.0, "controller": "paper"}
    # The zero has stepped by 4 mg between the parts; 0.5 mg of the second are drift.
    for before_mg, after_mg, gained_mg, net_mg in ((9000.0, 9020.0, 20.0, 20.0), (9024.0, 9055.0, 30.5, 50.5)):
        before = {"gross_mg": before_mg, "readings": lines(before_mg)}
        weighed = {"gross_mg": after_mg, "readings": lines(after_mg), "before": before, "gained_mg": gained_mg}
        weighed |= {"lot": "glass_beads", "gained_uncertainty_mg": 0.1, "drift_mg_per_s": 0.05}
        journal.event(DoseWeighed.model_validate(weighed))
        journal.event(Dose.model_validate(dosed | cost | {"dispensed_mg": net_mg, "verdict": "in tolerance"}))
    adjusted = dosed | {"dispensed_mg": 50.3, "tolerance_mg": 0.5, "verdict": "over", "bracket": "closed"}
    result = dict.fromkeys(SampleResult.model_fields) | cost | {"scoops": 1, "attempt": 1, "id": "a", "recorded": []}
    for _ in range(2):  # as when another of the sample's containers goes
        journal.event(SampleResult.model_validate(result | {"verdict": "over", "doses": [adjusted]}))
    journal.close()
    rows = record(journal.path)
    assert [row["weighing"] for row in rows] == ["dose", "dose", "result"]
    _, second, bracket = rows
    masses = ("tare_mg", "gross_mg", "drift_mg", "earlier_mg", "net_mg")
    assert [float(second[name]) for name in masses] == pytest.approx([9024.0, 9055.0, 0.5, 20.0, 50.5])
    assert (second["tare_lines"], second["gross_lines"]) == ("9024.0 mg", "9055.0 mg")
    assert [bracket[name] for name in masses] == ["", "", "", "", "50.3000"]
    assert (bracket["sample"], bracket["container"], bracket["failure_code"]) == ("a", "a", "")
    assert (second["verdict"], bracket["verdict"], bracket["tolerance_mg"]) == ("in tolerance", "over", "0.5000")


def test_a_text_that_would_be_a_formula_is_none(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "r.sqlite", durable=False)
    journal.event(
        RunBegun.model_validate({**HEADER, "operator": '=HYPERLINK("http://x")', "recipe": "@two", "samples": []})
    )
    journal.job_started(JobStarted(name="-1+1", sample="-1+1", attempt=1, workflow="w"))
    line = Line(value_mg=-5.0, unit="g", stable=True, time_s=1.0, raw="-  0.0050 g  \r\n")
    journal.event(Tared(gross_mg=-5.0, readings=(line,), balance="+cmd"))
    journal.close()
    (row,) = record(journal.path)
    assert row["operator"].startswith("'=")
    assert row["recipe"] == "'@two"
    assert row["sample"] == "'-1+1"
    assert row["balance_identity"] == "'+cmd"
    assert row["gross_lines"].startswith("'-")
    assert row["gross_mg"] == "-5.0000"  # a number is a number


def test_export_writes_files_that_spreadsheets_and_programs_read(run: Path, tmp_path: Path, command: Call) -> None:
    table, text = tmp_path / "record.csv", tmp_path / "export.json"
    assert command("export", run, "--csv", "-o", table)[0] == 0
    assert table.read_bytes().startswith(b'\xef\xbb\xbf"run","simulated",')
    assert b"\r\n" in table.read_bytes()
    assert command("export", run, "--json", "-o", text)[0] == 0
    assert json.loads(text.read_bytes())["samples"][0]["id"] == "a"
    out = command("export", run, "--csv")[1]
    assert next(csv.reader(out.splitlines())) == list(COLUMNS)
    assert command("export", run)[0] == 2
    assert command("export", run, "--csv", "-o", tmp_path)[0] == 2


def test_a_journal_of_version_1_is_listed_shown_exported_and_drawn(tmp_path: Path, command: Call) -> None:
    path = tmp_path / "old.sqlite"
    write_version_1(path)
    (found,) = summaries(tmp_path)
    assert (found.state, found.simulated, found.good) == ("interrupted", True, 1)
    code, out, _ = command("show", path)
    assert code == 0
    assert "Chain: none; an older scuhand-bt wrote this journal" in out
    assert "tare(): has not ended" in out
    code, _, err = command("verify", path)
    assert code == 2
    assert "without a chain" in err
    tare, dose = record(path)
    assert (tare["weighing"], dose["weighing"]) == ("tare", "dose")
    assert (dose["tare_mg"], dose["net_mg"], dose["entry"], dose["stable"]) == ("9200.0000", "20.3000", "", "")
    assert command("plot", path, "a", "-o", tmp_path / "a.png")[0] == 0
