"""The report of a run, or of two compared: one HTML page that needs nothing from elsewhere, made from the journals.

What it says of doses is what the table, the weighing record and the canonical export say: their functions make it.
Jinja2 and matplotlib are an optional extra (`pip install scuhand-bt[report]`), as is WeasyPrint, for the PDF.
"""

import base64
import gzip
import json
import shlex
import statistics
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from markupsafe import Markup

from scuhand_bt.failures import CATALOGUE
from scuhand_bt.journal.archive import Summary, summary_of
from scuhand_bt.journal.events import Asked
from scuhand_bt.journal.export import canonical_of
from scuhand_bt.journal.reader import Contents
from scuhand_bt.journal.results import SampleResult
from scuhand_bt.journal.run_events import FaultRules, RunBegun
from scuhand_bt.problems import Mark, Problem, SourceError
from scuhand_bt.quantity import format_duration, format_mass, format_tolerance
from scuhand_bt.report import viewer
from scuhand_bt.report.audit import deeds_of_run
from scuhand_bt.report.changer import slots_taken
from scuhand_bt.report.dose_curves import CurveOfDose, curves_of_doses
from scuhand_bt.report.doses import TEXT_COLUMNS, DoseRow, columns_for, dose_rows
from scuhand_bt.report.page import rendered
from scuhand_bt.report.powder_balance import SourceBalance, powder_balance
from scuhand_bt.report.run_figures import CurveFigures, errors_figure, times_figure
from scuhand_bt.report.run_scene import run_motions, run_scene
from scuhand_bt.report.time_spent import ACTIVITIES, TimeSpent, time_spent
from scuhand_bt.report.weighing_record import weighing_csv

NONE = "–"


@dataclass(frozen=True)
class RunFacts:
    """A run as far as its journal is whole. Raises SourceError where nothing of it had begun."""

    contents: Contents

    @property
    def id(self) -> str:
        return self.contents.path.stem

    @cached_property
    def run(self) -> RunBegun:
        row = next((row for row in self._events if row["kind"] == RunBegun.KIND), None)
        if row is None:
            raise SourceError(
                [Problem(Mark(str(self.contents.path), 0), "the run had not begun: there is nothing to report")]
            )
        return RunBegun.model_validate(row["payload"])

    @cached_property
    def summary(self) -> Summary:
        return summary_of(self.contents.path, self.contents.database)

    @cached_property
    def results(self) -> Sequence[SampleResult]:
        """The last that was said of each sample, in the order in which they came first."""
        found = {row["payload"]["id"]: row["payload"] for row in self._events if row["kind"] == SampleResult.KIND}
        return [SampleResult.model_validate(values) for values in found.values()]

    @cached_property
    def time(self) -> TimeSpent:
        return time_spent(self.contents)

    @cached_property
    def powder(self) -> Sequence[SourceBalance]:
        return powder_balance(self.contents)

    @cached_property
    def curves(self) -> Sequence[CurveOfDose]:
        return list(curves_of_doses(self.contents))

    @cached_property
    def fault_rules(self) -> Sequence[FaultRules]:
        return [FaultRules.model_validate(row["payload"]) for row in self._events if row["kind"] == FaultRules.KIND]

    @cached_property
    def questions(self) -> int:
        return sum(row["kind"] == Asked.KIND for row in self._events)

    @cached_property
    def _events(self) -> Sequence[Mapping[str, Any]]:
        kinds = (RunBegun.KIND, SampleResult.KIND, FaultRules.KIND, Asked.KIND)
        query = f"SELECT kind, payload FROM entry WHERE kind IN ({', '.join('?' * len(kinds))}) ORDER BY seq"
        rows = self.contents.database.execute(query, kinds)
        return [{"kind": kind, "payload": json.loads(payload)} for kind, payload in rows]

    def figures(self) -> Iterator[tuple[str, str]]:
        """What the run came to, in a few figures: name and value."""
        one = self.summary
        yield "samples good", f"{one.good}" if one.total is None else f"{one.good} of {one.total}"
        doses = [dose for result in self.results for dose in result.doses]
        if doses:
            yield "median |error|", f"{statistics.median(abs(dose.error_mg) for dose in doses):.1f} mg"
            worst = max(doses, key=lambda dose: abs(dose.error_mg) / dose.tolerance_mg if dose.tolerance_mg else 0.0)
            yield "worst error", f"{worst.error_mg:+.1f} mg of ±{format_tolerance(worst.tolerance_mg)}"
            yield "dosed", format_mass(sum(dose.dispensed_mg for dose in doses))
        yield "run time", format_duration(sum(self.time.total_s.values()))
        waited_s = self.time.total_s["waiting for persons"]
        times = "once" if self.questions == 1 else f"{self.questions} times"
        yield "waited for persons", f"{format_duration(waited_s)}, {times}" if self.questions else "never"

    def about(self) -> Iterator[tuple[str, str]]:
        """What the run was: name and value."""
        run = self.run
        verdicts = Counter(result.verdict for result in self.results)
        yield "verdicts", ", ".join(f"{count} {verdict}" for verdict, count in verdicts.most_common()) or NONE
        yield "started", run.started
        yield "operator", (run.operator or NONE) + (" (PIN)" if run.signed else "")
        yield "cell", run.cell
        yield "controller", run.controller
        if (balance := run.devices.get("balance")) is not None:
            yield "balance", f"{balance['driver']}, readability {balance['readability_mg']:g} mg"
        for name, source in run.sources.items():
            yield (
                f"source '{name}'",
                source.powder + (f", lot {source.lot}" if source.lot else "") + f", at {source.station}",
            )
        yield "sheets, scoops", f"{self._sheets}, {sum(source.scoops for source in self.powder)}"

    def provenance(self) -> Iterator[tuple[str, str]]:
        """What one has to have to do it again, or to know that this is what was done: name and value."""
        run, verified = self.run, self.contents.verified
        yield "recipe file", run.recipe_path
        yield "recipe's SHA-256", run.recipe_hash
        if run.seed is not None:
            yield "seed", str(run.seed)
            yield "physics", str(run.plant)
        if run.faults_hash is not None:
            yield "fault file's SHA-256", run.faults_hash
        yield "scuhand_bt", run.version
        yield from run.libraries.items()
        yield "entries of the journal", str(verified.entries)
        yield "head of its chain", verified.head if self.contents.is_chained else "none: an older scuhand-bt wrote it"
        yield "head of the lab's ledger before", run.ledger or NONE

    def command(self) -> str | None:
        """What does it again; None for a run on real devices, or on twins of another program."""
        run = self.run
        if run.seed is None:
            return None
        words = [
            "scuhand-bt",
            "run",
            Path(run.recipe_path).name,
            "--rehearse" if "REHEARSAL" in run.mode else "--dry-run",
        ]
        words += ["--seed", str(run.seed)]
        for option in ("controller", "plant", "faults"):
            if (value := getattr(run.options, option)) is not None:
                words += [f"--{option}", value]
        return shlex.join(words)

    @cached_property
    def _sheets(self) -> int:
        states = self.contents.database.execute(
            "SELECT state FROM entry WHERE state IS NOT NULL ORDER BY seq DESC LIMIT 1"
        )
        row = states.fetchone()
        return int(json.loads(row[0])["believed"]["sheets_used"]) if row is not None else 0


def page_of_run(contents: Contents) -> str:
    """A run's page. Raises SourceError for a run that had not begun."""
    facts = RunFacts(contents)
    run, problem = facts.run, contents.verified.problem
    packed, drawing_note = _motions(contents)
    columns = columns_for(facts.results)
    return rendered(
        "run.html",
        packed=packed,
        drawing_note=drawing_note,
        id=facts.id,
        run=run,
        problem=problem,
        state="altered" if problem is not None else facts.summary.state,
        reason=facts.summary.reason,
        figures=list(facts.figures()),
        about=list(facts.about()),
        errors=Markup(errors_figure([facts.results])),
        columns=columns,
        text_columns=TEXT_COLUMNS,
        doses=[list(dose_rows(result)) for result in facts.results],
        slots=slots_taken(contents),
        time_total=list(_time_total(facts.time)),
        times=Markup(times_figure(facts.time.jobs)),
        activities=_activities(facts.time),
        jobs=facts.time.jobs,
        powder_columns=_powder_columns(facts.powder),
        powder=list(_powder_rows(facts.powder)),
        failed_jobs=list(_failed_jobs(contents)),
        failures=list(_failures(contents)),
        fault_rules=[
            (rule.fault, ", ".join(f"{came_s:.1f} s" for came_s in rule.came_s) or "never")
            for rules in facts.fault_rules
            for rule in rules.rules
        ],
        deeds=[(deed.at, deed.who, deed.what, deed.why) for deed in deeds_of_run(contents)],
        curves=_curves(facts),
        command=facts.command(),
        provenance=list(facts.provenance()),
        data=list(_data(contents)) if problem is None else [],
    )


def comparison(first: Contents, second: Contents) -> str:
    """A page about two runs. Raises SourceError for one that had not begun."""
    a, b = RunFacts(first), RunFacts(second)
    both: list[tuple[str, str, str]] = []
    for pairs in (RunFacts.figures, RunFacts.about, RunFacts.provenance):
        of_a, of_b = dict(pairs(a)), dict(pairs(b))
        both += [(name, of_a.get(name, NONE), of_b.get(name, NONE)) for name in dict.fromkeys([*of_a, *of_b])]
    files = [
        (name, a.run.code_files.get(name, NONE), b.run.code_files.get(name, NONE))
        for name in sorted({*a.run.code_files, *b.run.code_files})
    ]
    return rendered(
        "compare.html",
        a=_side(a),
        b=_side(b),
        facts_of_both=both,
        code_files=[one for one in files if one[1] != one[2]],
        errors=Markup(errors_figure([a.results, b.results])),
        samples=list(_side_by_side(a.results, b.results)),
        times=[
            (
                name,
                *(format_duration(one.time.total_s[name]) for one in (a, b)),
                _change_s(a.time.total_s[name], b.time.total_s[name]),
            )
            for name in ACTIVITIES
            if a.time.total_s[name] or b.time.total_s[name]
        ],
    )


def write_pdf(page: str, path: Path) -> None:
    """Print a page. Raises ImportError without WeasyPrint, and OSError where it, or the file, lacks something."""
    from weasyprint import HTML

    HTML(string=page).write_pdf(path)


def _time_total(time: TimeSpent) -> Iterator[tuple[str, str, str]]:
    whole_s = sum(time.total_s.values())
    for name, spent_s in sorted(time.total_s.items(), key=lambda one: -one[1]):
        if spent_s > 0:
            yield name, format_duration(spent_s), f"{spent_s / whole_s:.0%}"
    yield "all", format_duration(whole_s), "100%"


def _activities(time: TimeSpent) -> list[str]:
    return [name for name in ACTIVITIES if time.total_s[name] > 0]


def _powder_columns(powder: Sequence[SourceBalance]) -> list[str]:
    truly = ["truly left (sim.)"] if any(one.truly_left_mg is not None for one in powder) else []
    weighed = ["dosed, weighed", "returned", "discarded", "in the cone", "left", "not booked"]
    return ["source", "powder", "at the start", "scoops", "sheets, rollers, clamp", "scooped", *weighed, *truly]


def _powder_rows(powder: Sequence[SourceBalance]) -> Iterator[list[str]]:
    for one in powder:
        row = [
            one.name,
            one.powder + (f"/{one.lot}" if one.lot else ""),
            _mass(one.start_mg),
            str(one.scoops),
            f"{len(one.sheets)} ×" if one.sheets else NONE,
            _mass(one.scooped_mg),
        ]
        row += [
            f"{_mass(one.dosed_mg)} ± {one.dosed_uncertainty_mg:.1f} mg",
            _mass(one.returned_mg),
            _mass(one.discarded_mg),
        ]
        unaccounted_mg = one.unaccounted_mg
        row += [_mass(one.in_cone_mg), _mass(one.left_mg)]
        row.append(NONE if unaccounted_mg is None else f"{unaccounted_mg:+.1f} mg")
        yield row + ([_mass(one.truly_left_mg)] if one.truly_left_mg is not None else [])


def _mass(mass_mg: float | None) -> str:
    return NONE if mass_mg is None else format_mass(mass_mg)


def _failed_jobs(contents: Contents) -> Iterator[tuple[str, str, str, str]]:
    for row in contents.rows("job"):
        if row["outcome"] != "done":
            why = ": ".join(word for word in (row["code"], row["detail"]) if word)
            yield row["name"], str(row["attempt"]), row["outcome"] or "has not ended", why


def _failures(contents: Contents) -> Iterator[tuple[str, str, str, str]]:
    counts = Counter((row["skill"], row["code"]) for row in contents.rows("action") if row["code"])
    for (skill, code), count in counts.most_common():
        yield skill, code, str(count), CATALOGUE[code].meaning if code in CATALOGUE else ""


def _curves(facts: RunFacts) -> Iterator[tuple[str, str, str, Markup]]:
    """Caption, tone, verdict and picture of each dose: what is said of it last, and its course."""
    figures = CurveFigures()
    said: dict[tuple[str, int, str, str], DoseRow] = {}
    for result in facts.results:
        rows = list(dose_rows(result))
        for dosed, row in zip(result.doses, rows[-len(result.doses) :], strict=bool(result.doses)):
            said[result.id, result.attempt, dosed.container, dosed.lot] = row
    drawn = [curve for curve in facts.curves if curve.points]
    ends = {_dosed(curve): curve for curve in drawn}
    for curve in drawn:
        dose = curve.dose
        again = f", attempt {curve.attempt}" if curve.attempt > 1 else ""
        caption = f"{curve.sample}{again}: {format_mass(dose.dispensed_mg)} of {format_mass(dose.target_mg)}"
        tone, verdict = "good" if dose.verdict == "in tolerance" else "bad", str(dose.verdict)
        if curve is not ends[_dosed(curve)]:
            tone, verdict = "soft", "so far"
        elif (last := said.get(_dosed(curve))) is not None:
            tone, verdict = last.tone, last.cells["verdict"]
        yield caption, tone, verdict, Markup(figures.draw(curve))


def _dosed(curve: CurveOfDose) -> tuple[str, int, str, str]:
    """What a course is of: all loads of a lot into one container are one dose."""
    return curve.sample, curve.attempt, curve.dose.container, curve.dose.lot


def _motions(contents: Contents) -> tuple[Mapping[str, str] | None, str]:
    """The arm's motions in 3D, and what is to be known of the picture; none where the lab is not there to draw."""
    if not (motions := run_motions(contents)):
        return None, "The journal has no motion of the arm."
    try:
        scene = run_scene(contents.path)
    except SourceError as error:
        return None, f"Not drawn: {error.problems[0].message}."
    return viewer.packed(scene, motions, "The arm's motions in the cell, job by job"), scene["note"]


def _data(contents: Contents) -> Iterator[tuple[str, str]]:
    """The run's data as files inside the page: name and link."""
    name = contents.path.stem
    for suffix, text in (("csv", "\ufeff" + weighing_csv(contents)), ("json", canonical_of(contents))):
        packed = base64.b64encode(gzip.compress(text.encode(), mtime=0)).decode()
        yield f"{name}.{suffix}.gz", f"data:application/gzip;base64,{packed}"


def _side(facts: RunFacts) -> dict[str, Any]:
    return {
        "id": facts.id,
        "mode": facts.run.mode,
        "simulated": facts.run.simulated,
        "problem": facts.contents.verified.problem,
        "powder_columns": _powder_columns(facts.powder),
        "powder": list(_powder_rows(facts.powder)),
    }


def _side_by_side(first: Sequence[SampleResult], second: Sequence[SampleResult]) -> Iterator[dict[str, Any]]:
    of_a, of_b = ({result.id: result for result in results} for results in (first, second))
    for name in dict.fromkeys([*of_a, *of_b]):
        a, b = of_a.get(name), of_b.get(name)
        rows = [next(dose_rows(one)) if one is not None else None for one in (a, b)]
        errors = [one.error_mg if one is not None else None for one in (a, b)]
        change_mg = errors[1] - errors[0] if errors[0] is not None and errors[1] is not None else None
        target = next((row.cells["target"] for row in rows if row is not None and "target" in row.cells), "")
        yield {
            "id": name,
            "target": target,
            "target_mg": next(
                (row.numbers["target"] for row in rows if row is not None and "target" in row.numbers), None
            ),
            "a_mg": errors[0],
            "b_mg": errors[1],
            "a_error": rows[0].cells.get("error mg", NONE) if rows[0] is not None else "",
            "b_error": rows[1].cells.get("error mg", NONE) if rows[1] is not None else "",
            "change_mg": change_mg,
            "change": "" if change_mg is None else f"{change_mg:+.1f}",
            "a_s": a.duration_s if a is not None else None,
            "b_s": b.duration_s if b is not None else None,
            "a_seconds": rows[0].cells["seconds"] if rows[0] is not None else "",
            "b_seconds": rows[1].cells["seconds"] if rows[1] is not None else "",
            "verdicts": [(row.tone, row.cells["verdict"]) if row is not None else ("", "") for row in rows],
        }


def _change_s(before_s: float, after_s: float) -> str:
    sign = "−" if after_s < before_s else "+"
    return f"{sign}{format_duration(abs(after_s - before_s))}"
