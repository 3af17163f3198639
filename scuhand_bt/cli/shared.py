"""What all commands share: the application, its two consoles, common options, and how errors end a command."""

import io
import json
import os
import signal
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from threading import Timer
from types import FrameType
from typing import TYPE_CHECKING, Annotated

import typer
from rich.text import Text

import scuhand_bt
from scuhand_bt.cli.streams import OutputLost, PlainConsole, watched
from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.failures import CATALOGUE, SkillFailed
from scuhand_bt.problems import Problem, SourceError, harmless, nearest

if TYPE_CHECKING:
    from scuhand_bt.api import Lab, OpenLab, Plan
    from scuhand_bt.api.books import LabState

PAGES = (".html", ".htm")
END_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

app = typer.Typer(
    help="Scoop and dispense powders by recipe. Exit codes: "
    + "; ".join(f"{code} {code.meaning}" for code in ExitCode)
    + ".",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
out = PlainConsole(width=None if sys.stdout.isatty() else 160)
err = PlainConsole(stderr=True, soft_wrap=True)

MOST_TOLD = 50
"""So many problems are told one by one."""
PATIENT_S = 3.0
"""Who waits for longer is told what for."""
GETS_READY = "Getting ready: compiled code and the arm's paths are kept, so that the next start takes only a moment."
EXIT_ALTERED = ExitCode.CELL_FAULT
"""A journal, or the lab's ledger, is not as it was written."""

RecipeArgument = Annotated[Path, typer.Argument(help="A recipe file (YAML).", show_default=False)]
RunArgument = Annotated[
    str, typer.Argument(metavar="RUN", help="A run's id, a unique beginning of it, or 'last'.", show_default=False)
]
JournalArgument = Annotated[
    str,
    typer.Argument(
        metavar="RUN", help="A run's id, a unique beginning of it, 'last', or a journal's file.", show_default=False
    ),
]
LabOption = Annotated[
    Path | None, typer.Option("--lab", help="The lab's folder; default: the nearest one above the recipe.")
]
SeedOption = Annotated[int, typer.Option(min=0, help="Seed of a simulation's random numbers.")]
FaultsOption = Annotated[
    Path | None, typer.Option("--faults", help="A file of what goes wrong in a simulation; `faults` lists all faults.")
]
UnattendedFlag = Annotated[
    bool, typer.Option("--unattended", help="Nobody is there: refuse a plan that needs a person, never wait for one.")
]
OperatorOption = Annotated[
    str | None,
    typer.Option("--operator", metavar="NAME", help="Who is at the cell; without it a run on the cell asks."),
]
NameArgument = Annotated[str | None, typer.Argument(help="Show this one in full.", show_default=False)]
JsonFlag = Annotated[bool, typer.Option("--json", help="Write JSON to the standard output.")]


def main() -> None:
    """Runs a command, and turns bad input into located lines and an exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal that cannot show '±' is no reason to break
    try:
        with watched():
            _run()
    except OutputLost as error:
        sys.stdout = None  # else what waits to be written there fails again at the end
        if error.is_unread:
            sys.exit(ExitCode.UNREAD)
        with suppress(OSError):
            print(f"It could not be finished: {error}.", file=sys.stderr)
        sys.exit(ExitCode.BAD_INPUT)


def _run() -> None:
    try:
        app()
    except OSError as error:
        _complain(f"It could not be finished: {error}.")
        sys.exit(ExitCode.BAD_INPUT)
    except SourceError as error:
        told, rest = first_of(error.problems)
        for problem in told:
            _complain(str(problem))
        if rest:
            _complain(rest)
        count = len(error.problems)
        if count > 1:
            _complain(f"{count} problems; nothing was moved.")
        sys.exit(ExitCode.BAD_INPUT)
    except SkillFailed as error:
        remedy = CATALOGUE[error.code].remedy if error.code in CATALOGUE else ""
        _complain(f"{error}. {remedy}".rstrip())
        # No way, or nobody to ask, is found before anything moves; a device that does not answer is the cell's fault.
        sys.exit(ExitCode.BAD_INPUT if error.code.startswith(("arm.", "operator.")) else ExitCode.CELL_FAULT)


def first_of(problems: Sequence[Problem]) -> tuple[Sequence[Problem], str]:
    """As many as a person reads, in their order, the errors if there are more; and a line that counts the others."""
    if len(problems) <= MOST_TOLD:
        return problems, ""
    told = sorted(problems, key=lambda problem: problem.is_warning)[:MOST_TOLD]
    return told, f"… and {len(problems) - MOST_TOLD} more; `scuhand-bt check … --json` has them all."


def _complain(text: str) -> None:
    with suppress(OSError, OutputLost):  # who cannot be told has the exit code
        err.print(Text(text))


def _version(wanted: bool) -> None:
    if wanted:
        out.print(f"scuhand-bt {scuhand_bt.__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    pass


@contextmanager
def told_if_long(what: str, *, quiet: bool) -> Iterator[None]:
    """Tell who waits at a terminal what for, if it lasts."""
    timer = Timer(PATIENT_S, lambda: err.print(Text(what)))
    timer.daemon = True
    if err.is_terminal and not quiet:
        timer.start()
    try:
        yield
    finally:
        timer.cancel()


@contextmanager
def on_signals(stop: Callable[[], None], others: Mapping[signal.Signals, Callable[[], None]] = {}) -> Iterator[None]:
    """Ctrl-C, SIGTERM and a closed terminal end what goes on safely, not the process at once; `others` as they say."""
    wishes = {**dict.fromkeys(END_SIGNALS, stop), **others}

    def handle(number: int, frame: FrameType | None) -> None:
        wishes[signal.Signals(number)]()

    before = {number: signal.signal(number, handle) for number in wishes}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def the_lab(folder: Path | None, recipe: Path | None = None) -> "Lab":
    """The lab of `--lab`, else the nearest one upward from the recipe (or from here), else the starter lab.

    What is wrong in its files, and breaks only what uses them, is noted.
    """
    from scuhand_bt.api import open_lab

    lab = open_lab(folder, recipe=recipe).require_cell()
    note_problems(lab)
    return lab


def the_plan(recipe: Path, folder: Path | None) -> "tuple[Plan, OpenLab]":
    """A recipe's plan, and the lab it is for; SourceError for all that is wrong with it."""
    from scuhand_bt.api import open_lab

    opened = open_lab(folder, recipe=recipe)
    made = opened.plan(recipe)
    note_problems(opened.lab)
    return made, opened


def notes_of(made: "Plan", opened: "OpenLab", *, quiet: bool, ways: bool = False) -> list[str]:
    """What a run on the real cell would be refused for, or ask; shown beside the result, as a dry run does not mind."""
    notes = [str(problem) for problem in opened.notes(made, ways=ways)]
    for note in () if quiet else notes:
        err.print(Text(f"Note: {note}"))
    return notes


def note_problems(lab: "Lab") -> None:
    """Tell of files of the lab that are wrong, where what is asked for does not need them."""
    for problem in lab.problems:
        if not problem.is_warning:
            err.print(Text(f"Note: {problem}"))


def lab_state(lab: "Lab") -> "LabState":
    """What was learnt and measured in a lab."""
    from scuhand_bt.api import OpenLab
    from scuhand_bt.api.books import LabState

    return LabState(OpenLab(lab).state)


def print_json(values: object) -> None:
    """Values as JSON on the standard output; what is not ASCII is escaped, so that nothing in it is lost or shown."""
    out.file.write(json.dumps(values, indent=2) + "\n")
    out.file.flush()


def unknown(what: str, name: str, known: Iterable[str]) -> typer.BadParameter:
    """The error for a name that is not known, with the nearest that is."""
    known = sorted(known)
    meant = nearest(name, tuple(known))
    hint = f"; did you mean '{meant}'?" if meant else ""
    return typer.BadParameter(harmless(f"unknown {what} '{name}'; known: {', '.join(known) or 'none'}{hint}"))


def of_kind(path: Path, *suffixes: str, option: str = "--output") -> Path:
    """A file to write that says by its suffix what will be in it. Raises BadParameter for any other suffix."""
    if path.suffix.lower() not in suffixes:
        raise typer.BadParameter(f"'{path}' must be a file of this kind: {', '.join(suffixes)}", param_hint=option)
    return path


def require_can_write(path: Path, *modules: str, extra: str) -> None:
    """Before long work: raises BadParameter where a file cannot be written at its end, or its `extra` is missing."""
    for name in modules:
        if find_spec(name) is None:
            raise typer.BadParameter(f"'{path}' needs {name}: pip install 'scuhand-bt[{extra}]'")
    is_new = not os.path.lexists(path)
    try:
        path.open("ab").close()
        if is_new:
            path.unlink()
    except OSError as error:
        raise typer.BadParameter(f"'{path}' cannot be written: {error.strerror}") from None


def write_picture(path: Path, write: Callable[[], object]) -> None:
    """Draw into a file, and say what it lacks. BadParameter where it cannot be, or the extra that draws is missing."""
    try:
        with warnings.catch_warnings(record=True) as lacks:
            write()
    except OSError as error:
        raise typer.BadParameter(f"'{path}' cannot be written: {error.strerror}") from None
    except ModuleNotFoundError as error:
        raise typer.BadParameter(f"'{path}' needs {error.name}: pip install 'scuhand-bt[plot]'") from None
    for one in lacks:
        err.print(Text(f"Note: {path}: {one.message}"), soft_wrap=True)
