"""Shared by the tests: commands in this process, labs that can be changed, and a bench for trees."""

import compileall
import gc
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple, cast

import pytest

from scuhand_bt import cli
from scuhand_bt.cell.believed import Believed
from scuhand_bt.cell.cell import Cell
from scuhand_bt.cell.right_of_way import RightOfWay
from scuhand_bt.cell_spec import DEVICES
from scuhand_bt.clock import Signal, Steps, Wake
from scuhand_bt.journal.events import JobStarted
from scuhand_bt.journal.history import read_history
from scuhand_bt.journal.reader import read
from scuhand_bt.journal.writer import Journal
from scuhand_bt.lab import Lab, load_lab, read_lab, starter_lab
from scuhand_bt.problems import Problems, SourceError
from scuhand_bt.recipe.plan import Job
from scuhand_bt.recipe.recipe import Recipe, load_recipe
from scuhand_bt.record import Record
from scuhand_bt.run.clock import VirtualClock
from scuhand_bt.run.control import Control
from scuhand_bt.run.outcome import Outcome
from scuhand_bt.run.runner import Runner
from scuhand_bt.skill import Skill, SkillFailed
from scuhand_bt.tree.build import Tree
from scuhand_bt.tree.check import check_workflows
from scuhand_bt.tree.grammar import read_workflow
from scuhand_bt.tree.library import Library
from scuhand_bt.tree.replay import Replay
from scuhand_bt.yaml_source import parse

pytest_plugins = ["pytester", "real_time", "browser", "fleet_fixtures"]
REPOSITORY = Path(__file__).parent.parent


def pytest_configure(config: pytest.Config) -> None:
    """Caches of these tests' own, shared by the processes that run them: most plan the same ways of the same arm.

    And compiled modules are kept: hundreds of commands are begun in processes of their own. The skills
    are compiled before any test copies them.
    """
    if not hasattr(config, "workerinput"):
        os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
        for lab in (REPOSITORY, starter_lab()):
            compileall.compile_dir(lab / "skills", quiet=1)
        caches = tempfile.mkdtemp(prefix="scuhand-caches-")
        os.environ["XDG_CACHE_HOME"] = caches
        config.add_cleanup(lambda: shutil.rmtree(caches, ignore_errors=True))
    gc.set_threshold(10_000, 20)


def pytest_collection_finish() -> None:
    """All tests and what they import is here to stay: to look through it for garbage takes half a second each time."""
    gc.freeze()


def problems_of(action: Callable[[], object]) -> list[str]:
    """The problems that an action raises, as `line:column: message`."""
    try:
        action()
    except SourceError as error:
        return [f"{p.mark.line}:{p.mark.column}: {p.message}" for p in error.problems]
    return []


class Ended(NamedTuple):
    """What a command came to."""

    returncode: int
    stdout: str
    stderr: str


Call = Callable[..., Ended]


@pytest.fixture
def command(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Call:
    """The command in this process, as the entry point runs it."""
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.chdir(REPOSITORY)

    def call(*arguments: object) -> Ended:
        monkeypatch.setattr(sys, "argv", ["scuhand-bt", *map(str, arguments)])
        capsys.readouterr()
        try:
            cli.main()
            code = 0
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else int(end.code is not None)
        return Ended(code, *capsys.readouterr())

    return call


@dataclass
class Desk:
    """A folder for recipes and tables, and the lab that they are checked against."""

    folder: Path
    lab: Lab

    def write(self, name: str, content: str | bytes) -> Path:
        path = self.folder / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    def load(self, recipe: str | bytes) -> Recipe:
        return load_recipe(self.write("recipe.yaml", recipe), self.lab)

    def problems(self, recipe: str | bytes) -> list[str]:
        return problems_of(lambda: self.load(recipe))


@dataclass
class LabFolder:
    """A lab of one's own: a copy of the repository's, to be changed."""

    folder: Path

    def write(self, name: str, content: str) -> Path:
        path = self.folder / name
        path.write_text(content, encoding="utf-8")
        return path

    def replace(self, name: str, old: str, new: str) -> None:
        text = (self.folder / name).read_text(encoding="utf-8")
        assert old in text
        self.write(name, text.replace(old, new))

    def load(self) -> Lab:
        return load_lab(self.folder)

    def problems(self) -> list[str]:
        """All errors of the lab, as `file:line:column: message`, the file without its folder."""
        lab = read_lab(self.folder)
        problems = Problems([problem for problem in lab.problems if not problem.is_warning])
        check_workflows(lab.library, lab.library.workflows, problems)
        return [str(problem).removeprefix(f"{self.folder}/") for problem in SourceError(problems.errors).problems]


@pytest.fixture(scope="session")
def starter() -> Lab:
    return load_lab(REPOSITORY)


@pytest.fixture
def desk(tmp_path: Path, starter: Lab) -> Desk:
    return Desk(tmp_path, starter)


@pytest.fixture
def lab_folder(tmp_path: Path) -> LabFolder:
    folder = tmp_path / "lab"
    for part in ("robot", "skills", "trees"):  # with skills as they were compiled, as in `make_lab`
        shutil.copytree(REPOSITORY / part, folder / part)
    (folder / "recipes").mkdir()
    return LabFolder(folder)


# --- a bench: trees on devices that only say whether they have stopped


class FakeDevice:
    def __init__(self) -> None:
        self.news = Signal()
        self.is_stopped = True
        self.fault: SkillFailed | None = None

    def stop(self) -> None:
        pass


class Agenda:
    """What happens at which run time."""

    def __init__(self) -> None:
        self._events: list[tuple[float, Callable[[], None]]] = []

    def at(self, time_s: float, action: Callable[[], None]) -> None:
        self._events.append((time_s, action))
        self._events.sort(key=lambda event: event[0])

    def step(self, now_s: float, limit_s: float) -> float:
        if not self._events or self._events[0][0] > limit_s:
            return limit_s
        time_s, action = self._events.pop(0)
        action()
        return time_s

    def save(self) -> None:
        """Nothing of it outlives the test."""


@dataclass
class FakeCell:
    clock: VirtualClock
    devices: Mapping[str, FakeDevice] = field(default_factory=lambda: {name: FakeDevice() for name in DEVICES})
    log: list[Any] = field(default_factory=list)
    believed: Believed = field(default_factory=Believed)
    record: Record = field(default_factory=Record)
    spec: Any = field(default_factory=lambda: SimpleNamespace(zone_names=("pan",)))
    right_of_way: RightOfWay = field(init=False)
    entered: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        self.right_of_way = RightOfWay(cast(Cell, self))

    @property
    def arm(self) -> FakeDevice:
        return self.devices["arm"]

    def zones_entered(self) -> frozenset[str]:
        return self.entered

    def device(self, name: str) -> FakeDevice:
        return self.devices[name]

    @property
    def every_device(self) -> Mapping[str, FakeDevice]:
        return self.devices

    def note(self, what: str) -> None:
        """Write down what happens and when."""
        self.log.append((self.clock.now_s, what))


class NoGuards:
    """A cell without devices that could fail has nothing to guard."""

    def wakes(self) -> list[Wake]:
        return []

    def look(self) -> None:
        return None


class Bench:
    """Runs workflows, given as text, with skills, given as classes, on a cell of fake devices."""

    def __init__(self, folder: Path) -> None:
        self.agenda = Agenda()
        self.cell = FakeCell(VirtualClock(self.agenda))
        self.control = Control()
        self.trees: list[Any] = []
        self._folder = folder

    def run(
        self,
        tree: str,
        skills: Mapping[str, type[Skill[Any]]],
        others: Mapping[str, str] = {},
        *,
        resumes: bool = False,
    ) -> Outcome:
        """Run a tree (the YAML below `tree:`), after its check; `others` are workflows by name, whole.

        `resumes`: go on with what the last call has left.
        """
        problems = Problems()
        texts = {"main": f"workflow: main\ntree:\n{_indented(tree)}", **others}
        workflows = {
            name: read_workflow(parse(text, name, "a workflow"), name, problems) for name, text in texts.items()
        }
        problems.raise_any()
        library = Library(skills, workflows, zones=("pan",))  # type: ignore[arg-type]
        check_workflows(library, ["main"], problems)
        problems.raise_any()
        journal = Journal(self._folder / "journal.sqlite", durable=False)
        journal.now_s = lambda: self.cell.clock.now_s
        replay = Replay()
        if resumes:
            job = read_history(journal.path).jobs["main", 1]
            replay = job.replay(None)
            journal.job_resumed(job.seq, job.so_far)
        else:
            journal.job_started(JobStarted(name="main", sample=None, attempt=1, workflow="main"))
        try:
            runner = Runner(self.cell, library, journal, self.control, NoGuards(), self)  # type: ignore[arg-type]
            return runner.run(Job("main", "main", {}), {}, replay)
        finally:
            journal.close()

    def tree_made(self, tree: Tree) -> None:
        pass

    def ticked(self, root: Any) -> None:
        self.trees.append(root)

    def paused(self) -> None:
        pass

    def continued(self) -> None:
        pass

    @property
    def log(self) -> list[tuple[float, str]]:
        return self.cell.log

    def actions(self) -> list[tuple[str, str]]:
        """The journal's actions: skill and outcome."""
        return [(row["skill"], row["outcome"]) for row in read(self._folder / "journal.sqlite", "action")]


def _indented(text: str) -> str:
    return "\n".join("  " + line for line in text.strip("\n").splitlines())


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def wait_until(cell: FakeCell, time_s: float) -> Steps[None]:
    while cell.clock.now_s < time_s:
        yield Wake(time_s)
