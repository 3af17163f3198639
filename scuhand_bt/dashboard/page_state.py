"""What the page of a run is told: plain values, made from its journal alone.

A page that stays open is told what has changed: rows of samples, points of the dose's course; all else is small, and
told anew.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from scuhand_bt.journal.archive import state_of
from scuhand_bt.journal.events import JobStarted
from scuhand_bt.journal.follow import Follower
from scuhand_bt.journal.pace import pace_of, time_left_s
from scuhand_bt.journal.results import SampleResult
from scuhand_bt.journal.run_events import RunBegun, SamplePlanned
from scuhand_bt.quantity import format_mass
from scuhand_bt.report.doses import tone_of
from scuhand_bt.report.picture import in_words
from scuhand_bt.report.watching import about, asked_of, inputs_of, tree_of
from scuhand_bt.run.questions import MEANINGS

PSEUDO_TERMINALS = "/dev/pts/"


def banner(run: RunBegun) -> tuple[str, str]:
    """What a run moves, in a word and in words: nobody is to take one for another."""
    ports = [str(device.get("port", "")) for device in run.devices.values()]
    if run.mode.startswith("REHEARSAL"):
        return "REHEARSAL", "the real drivers, against twins of the devices; no powder is moved"
    if run.mode.startswith("TWINS"):
        return "TWIN", "the real drivers, against twins of another program; no powder is moved"
    if run.simulated:
        return "SIMULATED", "no device and no powder is moved"
    if any(port.startswith(PSEUDO_TERMINALS) for port in ports):
        return "TWIN", "the run takes its devices for real; they are on pseudo-terminals, as twins are"
    return "REAL", "real devices and real powder"


@dataclass
class Page:
    """What one page has been told of a run that it follows."""

    now: Follower
    _has_told: bool = False
    _resumed: int = 0
    _job: JobStarted | None = None
    _points: int = 0
    _move_s: float | None = None

    def news(self, *, is_held: bool) -> dict[str, Any]:
        """What it is to be told now: all there is, the first time. Raises SourceError as `Follower.look`."""
        now, results = self.now, self.now.look()
        run = now.begun
        if run is None:
            return {"state": "about to begin"}
        if now.resumed != self._resumed:  # what was not run is to come again
            self._resumed, self._has_told, self._job = now.resumed, False, None
        state, reason, since = state_of(run, now.waiting, now.ended, is_paused=now.is_paused, is_held=is_held)
        told: dict[str, Any] = {
            "state": state,
            "reason": reason,
            "time_s": now.time_s,
            "at": now.at,
            "soon": str(now.soon or "") if is_held else "",
            "left_s": time_left_s(now, run),
            "pace": asdict(pace_of(now, run)),
            "question": _question(now, since) if state == "waiting for a person" else None,
            "job": {"name": now.job.name, "about": about(now, run)} if now.job is not None else None,
            "tree": [asdict(node) for node in tree_of(now)],
            "dose": _dose(run, now.job),
            "reading": now.reading,
            "holds": list(_holds(run, now.state.get("believed", {}))),
            "pan": (now.state.get("believed", {}).get("pan") or {}).get("name"),
            "joints_rad": now.state.get("joints_rad"),
            "rest_s": now.state_s,
        }
        if not self._has_told:
            told["run"] = _about(run, now.path.stem)
            results = list(now.samples.values())
            told["rows"] = [*_to_come(run.samples or ())]
        told["rows"] = [*told.get("rows", ()), *(_row(one) for one in results)]
        if now.job is not None and now.job.sample is not None and now.job is not self._job and now.job_ended is None:
            told["rows"].append({"id": now.job.sample, "verdict": "under way", "tone": ""})
        self._has_told = True
        if now.job is not self._job:
            self._job, self._points = now.job, 0
        told["course_from"], told["course"] = self._points, now.course[self._points :]
        self._points = len(now.course)
        if now.move is not None and now.move[0] != self._move_s:
            self._move_s, move = now.move
            told["move"] = {"at_s": self._move_s, **move.model_dump(mode="json")}
        return told


def _about(run: RunBegun, name: str) -> dict[str, Any]:
    """What does not change in a run."""
    word, meaning = banner(run)
    return {
        "id": name,
        "recipe": run.recipe,
        "banner": word,
        "meaning": meaning,
        "speed": run.options.speed if run.mode == "SIMULATED" else 1.0,
        "about": [
            ["started", run.started],
            ["operator", run.operator or "unknown"],
            ["cell", run.cell],
            ["controller", run.controller],
            *([["seed", str(run.seed)]] if run.seed is not None else []),
            ["program", f"scuhand_bt {run.version}"],
        ],
    }


def _to_come(samples: Iterable[SamplePlanned]) -> Iterator[dict[str, Any]]:
    for sample in samples:
        doses = (f"{mass} from {source}" if source else mass for mass, source in asked_of(sample.inputs))
        what = " + ".join(doses).strip()
        yield {"id": sample.id, "what": what, "tone": "", "verdict": "to come", "told": "", "done_s": sample.done_s}


def _row(result: SampleResult) -> dict[str, Any]:
    return {"id": result.id, "tone": tone_of(result), "verdict": result.verdict, "told": in_words(result)}


def _question(now: Follower, since: str) -> dict[str, Any] | None:
    asked = now.waiting.asked
    if asked is None:
        return None
    choices = [{"answer": choice, "meaning": MEANINGS.get(choice, "as the question says")} for choice in asked.choices]
    return {"text": asked.question, "since": since, "choices": choices}


def _dose(run: RunBegun, job: JobStarted | None) -> dict[str, Any] | None:
    """What the job's sample is to hold, also in words."""
    inputs = inputs_of(run, job.sample) if job is not None else {}
    mass, tolerance = inputs.get("mass"), inputs.get("tolerance")
    if not isinstance(mass, float | int):
        return None
    within_mg = tolerance if isinstance(tolerance, float | int) else 0.0
    words = " + ".join(asked for asked, _ in asked_of(inputs))
    return {"target_mg": mass, "tolerance_mg": within_mg, "words": words}


def _holds(run: RunBegun, believed: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """The inventory of the cell, as it is believed to be."""
    if not believed:
        return
    for name, mass_mg in believed["sources_mg"].items():
        source = run.sources.get(name)
        lot = f", lot {source.lot}" if source is not None and source.lot else ""
        of = f" of {source.powder}{lot}, at {source.station}" if source is not None else ""
        yield f"source {name}", f"about {format_mass(mass_mg)}{of}"
    source_of_cone, in_cone = believed["cone_source"], format_mass(believed["cone_mg"])
    yield "cone", f"about {in_cone} from {source_of_cone}" if source_of_cone else in_cone
    for station, held in believed.get("vessels", {}).items():
        mass = format_mass(held["mass_mg"])
        yield f"vessel {station}", f"about {mass} of {held['lot']}" if held["lot"] else mass
    pan = believed["pan"]
    yield "pan", f"{pan['id']} ({pan['name']})" if pan else "nothing that is known"
    yield (
        "sheet",
        f"number {believed['sheets_used']}, " + (f"touched {believed['sheet']}" if believed["sheet"] else "fresh"),
    )
    for kind, used in believed["containers_used"].items():
        yield kind, f"{used} used"
