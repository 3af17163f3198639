"""What may be written into the journal, by whom; and that what is written is what the models, and the docs, say."""

import json
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any, ClassVar

import pytest
from conftest import Call
from running import dry_run, make_lab

from scuhand_bt.events.catalogue import SKILL_EVENTS
from scuhand_bt.events.entry import Event, Note
from scuhand_bt.events.weighings import Tared
from scuhand_bt.journal import describe
from scuhand_bt.journal.archive import summary
from scuhand_bt.journal.events import Asked
from scuhand_bt.journal.export import canonical
from scuhand_bt.journal.kinds import KINDS, parsed
from scuhand_bt.journal.reader import read
from scuhand_bt.journal.run_events import Ended
from scuhand_bt.journal.writer import Journal
from scuhand_bt.record import Record

DOCS = Path(__file__).parent.parent / "docs"
SIEVE = """
from scuhand_bt.events.entry import SkillEvent
from scuhand_bt.journal.run_events import Ended
from scuhand_bt.skill import Cell, Skill, Steps, pause


class Sieve(Skill[None]):
    \"\"\"Sieve the powder.\"\"\"

    devices = ("hand",)

    def run(self, cell: Cell) -> Steps[None]:
        yield from pause(cell, 1.0)
        {write}
"""
RECIPE = """
recipe: sieved
workflow: sieved
samples:
  - {id: a}
  - {id: b}
"""
WORKFLOW = "workflow: sieved\ntree:\n  sequence: [{sieve: }]\n"


def sieving(folder: Path, write: str) -> Path:
    return make_lab(folder / "lab", skills__sieve=SIEVE.format(write=write), trees__sieved=WORKFLOW)


@pytest.mark.parametrize(
    ("write", "why"),
    [
        ('cell.record.event("sample", {"id": "a"})', "'sample' is not an entry that a skill may write"),
        ('cell.record.note("sample", {"id": "a"})', 'write `cell.record.note("lab.sample", {…})`'),
        ('cell.record.event(Ended(exit_code=0, reason=""))', "Ended is not an entry that a skill may write"),
        (
            'cell.record.event(type("Mine", (SkillEvent,), {"KIND": "sample"})())',
            "Mine is not an entry that a skill may",
        ),
        ('getattr(cell.record, "job_ended")("done")', "'Record' object has no attribute 'job_ended'"),
        (
            'cell.record.note("lab.sieved", {"mesh_mm": float("nan")})',
            "nan among the values of 'lab.sieved' is not JSON",
        ),
    ],
)
def test_a_skill_that_writes_the_engines_entries_is_a_bug_and_leaves_a_journal_that_all_can_read(
    tmp_path: Path, command: Call, write: str, why: str
) -> None:
    ran = dry_run(tmp_path, RECIPE, lab=sieving(tmp_path, write))
    assert ran.result.exit_code == 3
    assert ran.result.reason.startswith("the skill sieve broke: ")
    assert why in ran.result.reason
    assert [sample.verdict for sample in ran.result.samples] == ["interrupted", "not run"]
    for words in (("show",), ("show", "--json"), ("verify",), ("export", "--json"), ("export", "--csv")):
        code, out, err = command(words[0], ran.journal, *words[1:])
        assert (code, err) == (0, ""), words
        assert out


def test_a_lab_writes_its_own_kinds_of_entries_and_they_are_shown_and_exported(tmp_path: Path, command: Call) -> None:
    lab = sieving(tmp_path, 'cell.record.note("lab.sieved", {"kind": "coarse", "mesh_mm": [0.5, 1]})')
    ran = dry_run(tmp_path, RECIPE, lab=lab)
    assert ran.result.exit_code == 0
    assert "lab.sieved: kind coarse, mesh_mm [0.5, 1]" in command("show", ran.journal)[1]
    notes = [event for event in json.loads(canonical(ran.journal))["events"] if event["kind"] == "lab.sieved"]
    assert notes == [
        {"kind": "lab.sieved", "time_s": time_s, "values": {"kind": "coarse", "mesh_mm": [0.5, 1]}}
        for time_s in (1.0, notes[1]["time_s"])
    ]


@pytest.mark.parametrize("kind", ["", "lab", "lab.", "lab.Sieved", "lab.sieved\n", "sieved", "lab.a b", "LAB.x", 3])
def test_a_kind_without_the_prefix_of_labs_is_refused_when_it_is_made(kind: Any) -> None:
    with pytest.raises(ValueError, match=r'write `cell\.record\.note\("lab\.[a-z0-9_]+", {…}\)`'):
        Record().note(kind, {})


@pytest.mark.parametrize(
    "values", [[], {1: 2}, {"a": (1, 2)}, {"a": {"b": b"x"}}, {"a": [float("inf")]}, {"a": object()}]
)
def test_values_that_are_no_json_are_refused_when_they_are_made(values: Any) -> None:
    with pytest.raises(ValueError, match=r"among the values of 'lab\.sieved' is not JSON: write finite numbers"):
        Note("lab.sieved", values)


def test_no_kind_is_written_by_two_and_none_is_a_labs() -> None:
    assert len(KINDS) == len({*KINDS.values()})
    assert not any(kind.startswith("lab.") for kind in KINDS)
    assert {event.KIND for event in SKILL_EVENTS} < set(KINDS)


def test_all_that_a_run_writes_is_what_the_models_say(tmp_path: Path) -> None:
    recipe = """
recipe: all
workflow: scoop_and_dispense
defaults: {source: beads, container: alumina_crucible}
samples: [{id: a, mass: 30 mg}, {id: b, mass: 40 mg, source: msg}]
"""
    ran = dry_run(tmp_path, recipe, faults="faults: [{fault: balance.silent, at_pulse: 9}]")
    seen = set()
    for row in read(ran.journal, "entry"):
        event = parsed(row["kind"], row["payload"])
        assert event is not None, row["kind"]
        kind, payload = event.entry()
        assert (kind, json.loads(payload)) == (row["kind"], row["payload"])
        assert "opening_mm" not in row["payload"] or row["payload"].get("kind") != "settle"
        seen.add(kind)
    assert {"run", "action_ended", "pulse", "scoop", "tare", "container", "matter", "fault_rules", "frames"} <= seen


def test_an_end_of_before_it_said_whether_it_is_complete_says_so_by_its_code() -> None:
    assert [Ended(exit_code=code, reason="").is_complete for code in (0, 1, 3, 130)] == [True, True, False, False]
    assert not Ended(exit_code=0, reason="", complete=False).is_complete


def test_what_a_newer_program_adds_to_an_entry_is_passed_over() -> None:
    assert parsed("asked", {"question": "Is it?", "choices": ["yes"], "by": "eve"}) == Asked(
        question="Is it?", choices=["yes"]
    )
    assert parsed("weather", {"is": "fine"}) is None


def test_an_entry_of_a_newer_shape_is_not_misread(tmp_path: Path, command: Call) -> None:
    class Newer(Ended):
        SHAPE: ClassVar = 2

    journal = Journal(tmp_path / "r.sqlite", durable=False)
    journal.event(Newer(exit_code=0, reason=""))
    journal.close()
    code, _, err = command("show", journal.path)
    assert code == 2
    assert "a newer scuhand-bt wrote it ('ended' of shape 2; this one reads up to 1): use that one" in err


def test_what_no_program_wrote_is_said_in_a_line(tmp_path: Path) -> None:
    path = tmp_path / "r.sqlite"
    Journal(path, durable=False).close()
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute("INSERT INTO entry VALUES (1, 'ended', NULL, NULL, 0, '', '{\"reason\": 1}', NULL, NULL, x'')")
    assert summary(path).reason.endswith("(ValueError: 'ended' has at 'exit_code': field required)")


def test_a_text_that_utf_8_cannot_hold_and_a_number_that_is_none_do_not_stop_a_run(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "r.sqlite", durable=False)
    journal.event(Asked(question="Where is \udcff?", choices=[]))
    journal.event(Tared(gross_mg=float("nan")))
    journal.close()
    asked, tared = read(journal.path, "event")
    assert asked["payload"]["question"] == "Where is \\udcff?"
    event = parsed("tare", tared["payload"])
    assert isinstance(event, Tared)
    assert event.gross_mg != event.gross_mg


def test_the_docs_describe_every_kind_as_the_models_have_it() -> None:
    text = (DOCS / "journal.md").read_text(encoding="utf-8")
    assert describe.with_tables(text) == text, "run `python -m scuhand_bt.journal.describe docs`"
    assert (DOCS / "journal.schema.json").read_text(encoding="utf-8") == describe.schema()
    assert (DOCS / "events.schema.json").read_text(encoding="utf-8") == describe.schema_of_lines()


def test_the_description_has_a_sentence_for_every_kind_and_names_every_field() -> None:
    table = describe.with_tables((DOCS / "journal.md").read_text(encoding="utf-8"))
    for kind, model in KINDS.items():
        (row,) = [line for line in table.splitlines() if line.startswith(f"| `{kind}` |")]
        assert all(f"`{name}`" in row for name in model.model_fields)
        assert model.__doc__
        assert model.__doc__ is not Event.__doc__
