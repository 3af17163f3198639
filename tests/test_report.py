"""`report`: one page that tells a run's story, and needs nothing from elsewhere."""

import base64
import gzip
import hashlib
import re
import time
import tracemalloc
import warnings
from collections.abc import Callable
from html import escape
from pathlib import Path
from typing import Any

import pytest
from browser import browser_page, needs_browser, serious_faults
from conftest import Call
from journal_bench import HEADER, tamper, write_version_1
from page_text import Tables
from resuming import Run, Watch
from running import Ran, dry_run, make_lab

from scuhand_bt.events.cell import Returned, Scooped
from scuhand_bt.events.weighings import DoseBegun
from scuhand_bt.journal.events import ActionEnded, ActionStarted, Answered, ArmMoves, Asked, JobEnded, JobStarted
from scuhand_bt.journal.reader import Contents, open_contents
from scuhand_bt.journal.run_events import Continued, Ended, Paused, RunBegun
from scuhand_bt.journal.writer import Journal
from scuhand_bt.lab import starter_lab
from scuhand_bt.quantity import format_duration, format_mass
from scuhand_bt.report.audit import deeds_of_run
from scuhand_bt.report.dose_curves import curves_of_doses
from scuhand_bt.report.powder_balance import powder_balance
from scuhand_bt.report.run_figures import times_figure
from scuhand_bt.report.run_report import NONE, comparison, page_of_run
from scuhand_bt.report.time_spent import ACTIVITIES, JobTime, TimeSpent, time_spent
from scuhand_bt.run.operator import ANSWER_S, AT_HAND

EVIL = "<script>alert(1)</script>"
BATCH = f"""
recipe: four
workflow: fill_xrd_holder
defaults: {{container: xrd_holder, source: beads}}
samples:
  - {{id: first, mass: 30 mg}}
  - {{id: second, mass: 40 mg}}
  - {{id: salt, mass: 25 mg, source: msg}}
  - {{id: dry, mass: 25 mg, source: msg}}
on_failure: {{otherwise: skip_sample}}
sources:
  beads: {{station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 20 g, lot: "{EVIL}"}}
  msg: {{station: mortar_bay_2, container: small_agate_mortar, powder: monosodium_glutamate, amount: 8 g}}
"""
SOURCES = BATCH[BATCH.index("sources:") :]
NO_FLOW = "faults:\n  - {fault: valve.stuck_closed, sample: dry}\n"


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Ran:
    return dry_run(tmp_path_factory.mktemp("ran"), BATCH, controller=None, seed=3)


def page_of(journal: Path) -> str:
    with open_contents(journal) as contents:
        return page_of_run(contents)


@pytest.fixture(scope="module")
def whole(ran: Ran) -> str:
    """The page of `ran`."""
    return page_of(ran.journal)


def time_of(journal: Path) -> TimeSpent:
    with open_contents(journal) as contents:
        return time_spent(contents)


def is_refused(err: str) -> bool:
    """A file for its suffix."""
    return "must be a file of this kind" in " ".join(err.replace("│", " ").split())


def test_the_page_fetches_nothing_and_no_text_of_a_recipe_becomes_markup(whole: str) -> None:
    page = Tables(whole)
    assert [link for link in page.fetched if not link.startswith(("data:application/gzip;base64,", "#"))] == []
    assert page.elements.count("script") == 4, "the tables' own, and the viewer's with what it shows"
    assert EVIL not in whole
    assert whole.count(escape(EVIL)) >= 3, "its summary, its powder and the recipe"
    assert "default-src 'none'" in whole


def test_its_banner_says_that_no_powder_was_moved(whole: str) -> None:
    assert "SIMULATED: no powder was moved" in Tables(whole).text


def test_the_runs_summary_and_every_dose_with_its_curve_are_in_it(ran: Ran, whole: str) -> None:
    page = Tables(whole)
    good = sum(sample.is_good for sample in ran.result.samples)
    assert f"{good} of {len(ran.result.samples)}samples good" in page.text
    assert [row[0] for row in page.found["Doses"][1:]] == [sample.id for sample in ran.result.samples]
    slots = [row[:2] for row in page.found["slot, container, kind"][1:]]
    assert slots == [[str(slot), sample.id] for slot, sample in enumerate(ran.result.samples, 1)]
    dosed_mg = sum(dose.dispensed_mg for sample in ran.result.samples for dose in sample.doses)
    assert f"{format_mass(dosed_mg)}dosed" in page.text
    for sample in ran.result.samples:
        assert f"The course of the dose of {escape(sample.id)}" in whole
    assert page.elements.count("figure") == len(ran.result.samples)


def test_a_load_that_was_not_the_last_of_its_dose_is_not_told_with_its_verdict(tmp_path: Path) -> None:
    samples = "samples: [{id: a, source: beads, container: alumina_crucible, mass: 7 g, tolerance: 50 mg}]\n"
    ran = dry_run(tmp_path, f"recipe: large\nworkflow: scoop_and_dispense\n{samples}")
    captions = re.findall(r"<figcaption>(.*?)</figcaption>", page_of(ran.journal))
    *parts, whole = captions
    assert len(parts) >= 1
    assert all(caption.endswith('of 7.0000 g <span class="soft">so far</span>') for caption in parts)
    assert whole.endswith('<span class="good">in tolerance</span>')


def test_of_two_powders_each_dose_has_its_name_and_the_worst_is_so_by_its_own_tolerance(tmp_path: Path) -> None:
    asked = "masses: [300 mg, 300 mg], tolerances: [3 mg, 6 mg], first: beads, sources: [beads, msg]"
    sample = f"samples: [{{id: mix, container: alumina_crucible, {asked}}}]\n"
    recipe = f"recipe: two\nworkflow: weigh_in\n{sample}{SOURCES}"
    for seed in range(10):  # the last digits of a sum differ from processor to processor, and so does a dose
        (folder := tmp_path / str(seed)).mkdir()
        ran = dry_run(folder, recipe, controller=None, seed=seed)
        beads, msg = ran.result.samples[0].doses
        is_worst = abs(msg.error_mg) / 6.0 > abs(beads.error_mg) / 3.0
        if is_worst and abs(msg.error_mg) - 6.0 < abs(beads.error_mg) - 3.0:
            break
    else:
        pytest.fail("in no run the dose that is worst is farther from its bound in mg than the other one")
    text = page_of(ran.journal)
    assert f"{msg.error_mg:+.1f} mg of ±6worst error" in Tables(text).text
    assert "mix: glass_be…" in text
    assert "mix: monosodium_glutamate</text>" in text


def test_long_names_that_differ_by_their_ends_are_told_apart_below_a_picture() -> None:
    names = [f"batch-of-the-7th-of-november-sample-{number}" for number in (1, 2)]
    picture = times_figure([JobTime(name, name, 1, 0.0, 9.0, dict.fromkeys(ACTIVITIES, 1.0)) for name in names])
    assert [f"batch-of-the-…ember-sample-{number}</text>" in picture for number in (1, 2)] == [True, True]


def test_ids_in_another_script_are_drawn_as_text_without_a_word_about_fonts(tmp_path: Path) -> None:
    samples = "samples: [{id: 試料, source: beads, container: xrd_holder, mass: 50 mg}]\n"
    ran = dry_run(tmp_path, f"recipe: r\nworkflow: scoop_and_dispense\n{samples}")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pictures = re.findall(r"<svg.*?</svg>", page_of(ran.journal))
    assert any(">試料</text>" in picture for picture in pictures)


def test_who_reads_the_times_of_jobs_sees_their_unit(whole: str) -> None:
    """It stood in the table's name alone, which only a screen reader says."""
    assert "Run time, of each job in seconds." in Tables(whole).text


def test_the_data_in_it_are_what_export_writes(ran: Ran, whole: str, tmp_path: Path, command: Call) -> None:
    links = dict(re.findall(r'download="([^"]+)" href="data:application/gzip;base64,([^"]+)"', whole))
    for suffix in ("csv", "json"):
        assert command("export", ran.journal, f"--{suffix}", "-o", tmp_path / f"r.{suffix}")[0] == 0
        packed = base64.b64decode(links[f"{ran.journal.stem}.{suffix}.gz"])
        assert gzip.decompress(packed) == (tmp_path / f"r.{suffix}").read_bytes()


def test_every_moment_of_a_run_and_of_its_jobs_was_spent_on_one_thing(ran: Ran) -> None:
    spent = time_of(ran.journal)
    assert sum(spent.total_s.values()) == pytest.approx(ran.result.duration_s)
    for job in spent.jobs:
        assert sum(job.spent_s.values()) == pytest.approx(job.duration_s)
        assert min(job.spent_s.values()) >= 0
    by_job = sum(job.duration_s for job in spent.jobs)
    assert by_job <= ran.result.duration_s + 1e-6
    dosing = {job.sample: job.spent_s["dosing"] for job in spent.jobs}
    assert all(dosing[sample.id] > 0 for sample in ran.result.samples)
    by_the_sheet = "who changes the sheet for another powder was called ahead"
    assert spent.total_s["waiting for persons"] == pytest.approx(ANSWER_S * AT_HAND), by_the_sheet
    assert spent.total_s["other"] < 0.02 * ran.result.duration_s


def written(path: Path) -> Path:
    """A run of one job: 10 s of scooping, a dose of 20 s with the valve open for 3 s, a question and a pause in it."""
    journal = Journal(path, durable=False)
    now = 0.0
    journal.now_s = lambda: now
    journal.event(RunBegun.model_validate(HEADER))
    journal.job_started(JobStarted(name="s1", sample="s1", attempt=1, workflow="fill"))
    for skill, seconds in (("ladle", 10.0), ("pour", 20.0), ("sieve", 5.0)):  # a lab's own
        action = journal.action_started(ActionStarted(path=skill, visit=1, skill=skill, inputs={}), weighs=False)
        journal.action = action
        journal.event(ArmMoves(step_s=0.5, joints_rad=((0.0,) * 7,) * 5, cone_mm=44.0))
        if skill == "ladle":  # what was in the cone goes back before
            journal.event(Returned(source="s", expected_mg=0.2))
            journal.event(Scooped(source="s", expected_mg=1.0, open_mm=44.0, closed_mm=24.0))
        if skill == "pour":
            journal.event(DoseBegun(gross_mg=1.0, lot="s", target_mg=1.0))
            points = ((12.0, 0.0, 0.0, 0.0, False, 0.0), (14.0, 0.0, 0.5, 0.0, False, 0.0))
            points += (
                (16.0, 1.0, 0.0, 0.7, False, 1.0),
                (17.0, 2.0, 0.0, 0.0, True, 2.0),
                (29.0, 2.0, 0.0, 0.0, True, 2.0),
            )
            now = 20.0
            journal.event(Asked(question="ready?", choices=["done", "stop"]))
            now = 22.0
            journal.event(Paused())
            now = 23.0
            journal.event(Continued())
            now = 24.0
            journal.event(Answered(question="ready?", answer="done"))
            for point in points:
                journal.course(point)
            now = 10.0
        now += seconds
        journal.action_ended(action, ActionEnded(outcome="done", code=None, result=None))
    now += 4.0
    journal.job_ended(JobEnded(outcome="done"))
    now += 1.0
    journal.event(Ended(exit_code=0, reason="", complete=True))
    journal.close()
    return path


def test_who_waits_waits_whatever_the_skill_and_an_open_valve_doses(tmp_path: Path) -> None:
    spent = time_of(written(tmp_path / "r.sqlite"))
    (job,) = spent.jobs
    assert {name: spent_s for name, spent_s in job.spent_s.items() if spent_s} == pytest.approx(
        {
            "scooping": 10.0,
            "dosing": 3.0,
            "waiting for persons": 3.0,
            "paused": 1.0,
            "settling and weighing": 13.0,
            "moving": 2.0,
            "other": 7.0,
        }
    )
    assert sum(spent.total_s.values()) == pytest.approx(40.0)


def test_the_powder_of_each_source_adds_up(ran: Ran) -> None:
    with open_contents(ran.journal) as contents:
        beads, msg = powder_balance(contents)
    samples = {sample.id: sample for sample in ran.result.samples}
    for source, names in ((beads, ("first", "second")), (msg, ("salt", "dry"))):
        doses = [dose for name in names for dose in samples[name].doses]
        assert source.dosed_mg == pytest.approx(sum(dose.dispensed_mg for dose in doses))
        assert source.dosed_uncertainty_mg == pytest.approx(sum(dose.uncertainty_mg**2 for dose in doses) ** 0.5)
        assert source.unaccounted_mg == pytest.approx(0.0, abs=10.0)
        assert source.truly_left_mg == pytest.approx(source.left_mg, abs=20.0)
        assert source.scoops >= 1
    assert (beads.start_mg, msg.start_mg) == (20_000.0, 8_000.0)


def test_books_that_close_are_not_told_as_weighed(whole: str) -> None:
    """It was told with the doses' uncertainty alone, -0.2 ± 0.1 mg, where 200 mg were elsewhere."""
    page = Tables(whole)
    heads, *rows = next(table for table in page.found.values() if table and "not booked" in table[0])
    assert [row[heads.index("not booked")].count("±") for row in rows] == [0, 0]
    assert [row[heads.index("dosed, weighed")].count("±") for row in rows] == [1, 1]
    assert "not weighed: how uncertain that is nobody knows" in " ".join(page.text.split())


@pytest.mark.slow
def test_what_failed_and_who_did_what_is_told(tmp_path: Path) -> None:
    ran = dry_run(tmp_path, BATCH, controller=None, faults=NO_FLOW)
    page = Tables(page_of(ran.journal))
    failed = next(sample for sample in ran.result.samples if sample.code is not None)
    assert any(row[0] == failed.id and str(failed.code) in row[3] for row in page.found["job, attempt, outcome, why"])
    assert ["cone_holds", "hand.cone_empty"] in [row[:2] for row in page.found["skill, code, times, meaning"]]
    assert any(row[2] == "answered 'done'" for row in page.found["at, who, what, why"])
    assert any(row[0] == "valve.stuck_closed" and row[1] != "never" for row in page.found["fault, came at"])
    assert "--faults" in page.text


def test_how_to_do_it_again_is_told(ran: Ran, whole: str) -> None:
    page = Tables(whole)
    assert "scuhand-bt run recipe.yaml --dry-run --seed 3" in page.text
    assert ran.session.journal.head in page.text
    assert ran.session.plan.recipe.hash in page.text
    assert any(row[0] == "robot/cell.yaml" for row in page.found["file, hash"])


def test_a_journal_that_was_altered_is_said_to_be_and_gives_no_data(ran: Ran, tmp_path: Path, command: Call) -> None:
    journal = tmp_path / "altered.sqlite"
    journal.write_bytes(ran.journal.read_bytes())
    tamper(journal, "UPDATE entry SET at = '2020-01-01T00:00:00+00:00' WHERE seq = 60")
    code, _, err = command("report", journal, "-o", tmp_path / "r.html")
    assert (code, "not as it was written" in err) == (3, True)
    page = Tables((tmp_path / "r.html").read_text(encoding="utf-8"))
    assert "NOT AS IT WAS WRITTEN" in page.text
    assert "Inside this file" not in page.text


@pytest.mark.slow
def test_a_run_that_was_stopped_and_resumed_is_told_as_one(tmp_path: Path) -> None:
    lab = make_lab(tmp_path / "lab")
    run = Run(tmp_path, lab, BATCH.partition("sources:")[0])
    assert run.go(Watch("stop_now", 60)).exit_code == 130
    page = Tables(page_of(run.journal))
    assert "There is no dose to show." in page.text
    assert page.found["job, attempt, outcome, why"][1][:3] == ["first", "1", "interrupted"]
    assert run.go(Watch(), resumes=True).exit_code <= 1
    page = Tables(page_of(run.journal))
    assert page.elements.count("figure") == 4
    assert any(row[2].startswith("resumed it with") for row in page.found["at, who, what, why"])
    spent = time_of(run.journal)
    assert all(sum(job.spent_s.values()) == pytest.approx(job.duration_s) for job in spent.jobs)


def test_a_journal_of_version_1_has_a_report(tmp_path: Path) -> None:
    write_version_1(tmp_path / "old.sqlite")
    page = Tables(page_of(tmp_path / "old.sqlite"))
    assert "none: an older scuhand-bt wrote it" in page.text
    assert len(page.found["Doses"]) > 1


def test_a_run_that_had_not_begun_has_no_report(tmp_path: Path, command: Call) -> None:
    journal = Journal(tmp_path / "r.sqlite", durable=False)
    journal.event(Ended(exit_code=3, reason="", complete=False))
    journal.close()
    code, _, err = command("report", journal.path, "-o", tmp_path / "r.html")
    assert (code, "had not begun" in err, (tmp_path / "r.html").exists()) == (2, True, False)


@pytest.mark.parametrize(("name", "options"), [("r.txt", []), ("r.pdf", []), ("r.html", ["--pdf"])])
def test_a_suffix_that_it_does_not_write_is_refused(
    ran: Ran, tmp_path: Path, command: Call, name: str, options: list[str]
) -> None:
    code, _, err = command("report", ran.journal, "-o", tmp_path / name, *options)
    assert (code, is_refused(err), (tmp_path / name).exists()) == (2, True, False)


@pytest.mark.parametrize(
    "arguments",
    [
        ["reach", "-o", "x.png"],
        ["show-move", "park", "mortar_bay", "-o", "x.svg"],
        ["plot", "last", "a", "-o", "x.html"],
        ["export", "last", "--csv", "-o", "x.json"],
        ["export", "last", "--json", "-o", "x.csv"],
    ],
)
def test_no_command_writes_another_kind_of_file_than_its_name_says(command: Call, arguments: list[str]) -> None:
    code, _, err = command(*arguments)
    assert (code, is_refused(err)) == (2, True)


def test_two_runs_are_compared_sample_by_sample(ran: Ran, tmp_path: Path) -> None:
    other = dry_run(tmp_path, BATCH.replace("mass: 40 mg", "mass: 45 mg"), controller=None, seed=4)
    with open_contents(ran.journal) as a, open_contents(other.journal) as b:
        text = comparison(a, b)
    page = Tables(text)
    rows = {row[0]: row for row in page.found["Samples"]}
    for one, two in zip(ran.result.samples, other.result.samples, strict=True):
        assert one.error_mg is not None
        assert two.error_mg is not None
        assert rows[one.id][2].startswith(f"{one.error_mg:+.1f}")
        assert rows[one.id][3].startswith(f"{two.error_mg:+.1f}")
        assert rows[one.id][4] == f"{two.error_mg - one.error_mg:+.1f}"
        assert rows[one.id][7:] == [one.verdict, two.verdict]
    both = {row[0]: row[1:] for row in page.found["Summary"]}
    assert both["seed"] == ["3", "4"]
    assert both["run time"] == [format_duration(one.result.duration_s) for one in (ran, other)]
    shaded = re.findall(r'<tr class="differs"><td>([^<]*)', text)
    assert {"seed", "recipe&#39;s SHA-256", "run time"} <= set(shaded)
    assert not {"cell", "controller", "numpy"} & set(shaded)


def test_a_module_of_ones_own_that_a_run_was_made_of_is_told_as_the_labs_files_are(
    ran: Ran, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    mine = tmp_path / "pauses_of_report.py"
    mine.write_text("LONG_S = 1.0\n", encoding="utf-8")
    digest = hashlib.sha256(mine.read_bytes()).hexdigest()
    lab = make_lab(tmp_path / "lab", skills___pauses="from pauses_of_report import LONG_S\n")
    other = dry_run(tmp_path, BATCH, controller=None, seed=3, lab=lab)
    with open_contents(ran.journal) as a, open_contents(other.journal) as b:
        pages = page_of_run(b), comparison(a, b)
    rows = [row for page in pages for table in Tables(page).found.values() for row in table if row[0] == mine.stem]
    assert rows == [[mine.stem, digest], [mine.stem, NONE, digest]]


@pytest.mark.slow
def test_the_pdf_is_one(ran: Ran, tmp_path: Path, command: Call) -> None:
    try:
        import weasyprint  # noqa: F401
    except OSError as error:
        pytest.skip(f"WeasyPrint lacks a library of the system: {error}")
    path = tmp_path / "r.pdf"
    assert command("report", ran.journal, "--pdf", "-o", path)[0] == 0
    assert path.read_bytes().startswith(b"%PDF-")


@needs_browser
def test_in_a_browser_it_sorts_its_tables_and_keeps_nobody_out(whole: str, tmp_path: Path, browser: Any) -> None:
    path = tmp_path / "r.html"
    path.write_text(whole, encoding="utf-8")
    with browser_page(browser, viewport={"width": 390, "height": 844}, color_scheme="dark") as page:
        page.goto(path.as_uri())
        assert page.evaluate("document.documentElement.scrollWidth") <= 390, "nothing but the tables scrolls sideways"
        button = page.get_by_role("region", name="Doses").get_by_role("button", name="target")
        for way, order in (("ascending", sorted), ("descending", lambda masses: sorted(masses, reverse=True))):
            button.press("Enter")
            cells = page.locator("[aria-label=Doses] tbody tr td:nth-child(3)").all_inner_texts()
            masses = [float(cell.removesuffix(" mg")) for cell in cells]
            assert masses == order(masses)
            assert button.locator("..").get_attribute("aria-sort") == way
        assert serious_faults(page) == []
        page.emulate_media(color_scheme="light")
        assert serious_faults(page) == []


@needs_browser
@pytest.mark.slow
def test_in_a_browser_the_hashes_of_files_that_differ_are_seen_whole_without_scrolling(
    ran: Ran, tmp_path: Path, browser: Any
) -> None:
    lab = make_lab(tmp_path / "lab")
    skill = lab / "skills" / "park.py"
    skill.write_text(skill.read_text(encoding="utf-8") + "# of ours\n", encoding="utf-8")
    other = dry_run(tmp_path, BATCH, controller=None, seed=3, lab=lab)
    with open_contents(ran.journal) as a, open_contents(other.journal) as b:
        (tmp_path / "two.html").write_text(comparison(a, b), encoding="utf-8")
    digest = hashlib.sha256(skill.read_bytes()).hexdigest()
    with browser_page(browser, viewport={"width": 1200, "height": 844}) as page:
        page.goto((tmp_path / "two.html").as_uri())
        files = page.locator(".wide").nth(1)
        assert digest in files.inner_text()
        assert files.evaluate("it => it.scrollWidth - it.clientWidth") == 0


@pytest.mark.slow
def test_the_report_of_a_night_is_small_and_quick(tmp_path: Path) -> None:
    recipe = (starter_lab() / "recipes" / "xrd_holders.yaml").read_text(encoding="utf-8")
    ran = dry_run(tmp_path, recipe, controller=None)
    began_s = time.process_time()
    text = page_of(ran.journal)
    of_24 = 24 / len(ran.result.samples)
    assert len(text.encode()) * of_24 < 5e6
    assert (time.process_time() - began_s) * of_24 < 5.0


@pytest.mark.parametrize(
    "told", [lambda of: list(deeds_of_run(of)), powder_balance, time_spent, lambda of: list(curves_of_doses(of))]
)
def test_what_is_told_of_a_long_run_is_read_entry_by_entry(tmp_path: Path, told: Callable[[Contents], object]) -> None:
    """`audit` had all entries in memory at once: of 5000 samples 1.4 GB."""
    journal = Journal(tmp_path / "r.sqlite", durable=False)
    journal.event(RunBegun.model_validate(HEADER))
    for _ in range(100):
        journal.event(Asked(question=100_000 * "?", choices=["done"]))
    journal.close()
    with open_contents(journal.path) as contents:
        tracemalloc.start()
        told(contents)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
    assert peak < 2e6, "of 10 MB"
