"""Twins in a process of their own, from the point of view of a run on them. They outlive the run.

    FOLDER/world        the file with their world (`sim/world_file.py`)
    FOLDER/made.json    what that world was made of
    FOLDER/twins.lock   held by the process that has them (`run/twins_process.py`)
    FOLDER/arm, …       their ports, by the names of the devices
    FOLDER/log          output of a process that a run has started

What a person does at the cell is sent to the process in words (`run/hands.py`) over an abstract socket: one line of
JSON with the list of words, and one line with the `Answer`. The process itself sends only {"failed": WHY}, before it
ends.
"""

import json
import os
import select
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.journal.presence import is_held
from scuhand_bt.lab import Lab
from scuhand_bt.problems import Mark, Problem, SourceError
from scuhand_bt.run.control import address_of
from scuhand_bt.run.hands import Answer
from scuhand_bt.sim.plant import PlantError
from scuhand_bt.sim.world import masses_in
from scuhand_bt.specs import Container, Source

FOLDER, WORLD, MADE, LOCK, LOG = "twins", "world", "made.json", "twins.lock", "log"
ANSWER_S = 10.0
"""Twins on a busy computer answer within this time [s]; else they count as gone."""
BEGIN_S = 120.0
"""How long they may take to start [s]."""
GONE = "the twins have ended; their state is on disk, and `scuhand-bt resume` starts them again"


@dataclass(frozen=True)
class Made:
    """What a world was made of. A run cannot go on in the world of another cell, or with other powders."""

    cell: str
    sources: dict[str, str]
    """By name: which powder, in which mortar, where. The world itself knows how much is in it."""
    seed: int
    plant: str

    @classmethod
    def of(cls, lab: Lab, sources: Mapping[str, Source], seed: int, plant: str | None) -> "Made":
        powders = {
            name: f"{source.powder.name} in {source.mortar.name} at {source.station}"
            for name, source in sources.items()
        }
        return cls(lab.cell.cell, powders, seed, plant or lab.cell.plant or "scuhand_bt")

    def __str__(self) -> str:
        powders = ", ".join(f"'{name}' ({what})" for name, what in self.sources.items()) or "no powder"
        return f"the cell '{self.cell}' with {powders}, seed {self.seed}, plant {self.plant}"

    def require_same(self, folder: Path) -> None:
        """Raises SourceError if the world in this folder was made of something else."""
        if not (folder / WORLD).exists():
            return
        try:
            there = TypeAdapter(Made).validate_json((folder / MADE).read_bytes())
        except (OSError, ValidationError):
            raise _problem(
                folder / MADE, f"it does not say what the world in {folder} is of; begin a new one"
            ) from None
        if there != self:
            raise _problem(folder / WORLD, f"this world is of {there}, but the twins are of {self}: begin a new one")

    def write(self, folder: Path) -> None:
        (folder / MADE).write_text(json.dumps(asdict(self)), encoding="utf-8")


def folder_of_run(journal: Path) -> Path:
    """The folder of a rehearsal's twins, beside its journal."""
    return journal.with_suffix(".twins")


def have_their_process(folder: Path) -> bool:
    """Whether a process has the twins of this folder."""
    return is_held(folder / LOCK)


def say(folder: Path, words: Sequence[str]) -> Answer:
    """Send words to the twins of this folder. Raises SourceError if there are none."""
    if not have_their_process(folder):
        raise _problem(folder, "no twins are running here; `scuhand-bt twins` starts them")
    try:
        with _connected(folder) as line:
            return _Line(line).say(words)
    except (OSError, EOFError):
        raise _problem(folder, "the twins do not answer") from None


class Twins:
    """The twins' process of one run. `tell` is called with the reason if their world cannot be saved."""

    def __init__(
        self, folder: Path, line: socket.socket, process: subprocess.Popen[bytes] | None, tell: Callable[[str], None]
    ) -> None:
        """Use `open_twins`."""
        self._folder, self._line, self._process = folder, _Line(line), process
        self._tell: Callable[[str], None] | None = tell

    def port_of(self, device: str) -> str:
        return str(self._folder / device)

    def say(self, *words: str) -> Mapping[str, Any]:
        """Send words, and return what was found. Raises ValueError if it was not done; else as `check`."""
        try:
            answer = self._line.say(words)
        except (OSError, EOFError):
            raise SkillFailed(Code.DEVICE_LOST, GONE) from None
        if (why := answer.found.get("not_kept")) is not None and self._tell is not None:
            tell, self._tell = self._tell, None
            tell(str(why))
        if not answer.is_done:
            raise ValueError(answer.said)
        return answer.found

    def check(self) -> None:
        """Raises SkillFailed device.lost if they have ended, PlantError with the reason if they failed."""
        try:
            self._line.hear_what_comes()
        except (OSError, EOFError):
            raise SkillFailed(Code.DEVICE_LOST, GONE) from None

    # --- the hands of the run's person

    def place(self, container: Container) -> None:
        self.say("place", container.name, container.id)

    def remove(self) -> None:
        self.say("remove")

    def swap_sheet(self) -> None:
        self.say("sheet")

    def refill(self, source: str, mass_mg: float) -> None:
        self.say("refill", source, f"{mass_mg!r} mg")

    def weigh(self, mass_mg: float) -> None:
        """Put a check weight on the pan; 0 mg removes it."""
        self.remove()
        if mass_mg > 0.0:
            self.say("weight", f"{mass_mg!r} mg")

    def begin_sample(self, sample: str, attempt: int) -> None:
        self.say("sample", sample, str(attempt))

    def comes(self, fault: str, now_s: float) -> bool:
        """Whether this momentary fault occurs now."""
        return bool(self.say("comes", fault)["comes"])

    # --- for judging, never for skills

    @property
    def masses_mg(self) -> Mapping[str, float]:
        """What is in every compartment [mg]; from the file if the twins have ended. Empty if nobody knows."""
        with suppress(SkillFailed, PlantError):
            masses_mg: Mapping[str, float] = self.say("look")["masses_mg"]
            return masses_mg
        with suppress(SourceError):
            return masses_in(self._folder / WORLD)
        return {}

    def true_mass(self, container_id: str) -> float:
        """What is in this container [mg]."""
        return self.masses_mg.get(f"container:{container_id}", 0.0)

    @property
    def fault_account(self) -> Sequence[Mapping[str, Any]]:
        """Each rule's fault, and when it came [s]; empty if the twins have ended."""
        with suppress(SkillFailed, PlantError):
            account: Sequence[Mapping[str, Any]] = self.say("look")["faults"]
            return account
        return ()

    def end(self) -> None:
        """End the twins; their state stays on disk."""
        with suppress(SkillFailed, PlantError):
            self.say("end")
        self._line.close()
        until_s = time.monotonic() + ANSWER_S
        while have_their_process(self._folder) and time.monotonic() < until_s:
            time.sleep(0.01)
        if self._process is not None:
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(ANSWER_S)


def open_twins(folder: Path, made: Made, command: Sequence[str], tell: Callable[[str], None]) -> Twins:
    """The twins of a run: those already running in this folder, else a new process that restores or makes their world.

    `command` are the arguments of `scuhand-bt twins` that make them. Raises SourceError for a world that was made of
    something else, and for twins that do not start.
    """
    made.require_same(folder)
    process: subprocess.Popen[bytes] | None = None
    until_s = time.monotonic() + BEGIN_S
    while True:
        if process is None and not have_their_process(folder):
            process = _begun(folder, command)
        try:
            line = _connected(folder)
            _Line(line).say(["look"])  # a process that is being killed still accepts connections
            return Twins(folder, line, process, tell)
        except (OSError, EOFError):
            ended = process is not None and process.poll() is not None
            if not (ended or time.monotonic() > until_s):
                time.sleep(0.02)
                continue
        if process is not None and not ended:
            process.kill()
            process.wait()
        with suppress(OSError):
            raise _problem(folder, f"the twins did not begin: {(folder / LOG).read_text(errors='replace').strip()}")
        raise _problem(folder, "the twins do not answer")


def _begun(folder: Path, command: Sequence[str]) -> subprocess.Popen[bytes]:
    """Start a process that no signal from this terminal reaches, and that finds the same modules."""
    whole = [sys.executable, "-m", "scuhand_bt", "twins", *command, "--at", str(folder), "--of-run"]
    paths = os.pathsep.join(path for path in sys.path if path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / LOG).open("wb") as log:
            return subprocess.Popen(
                whole,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
                env=os.environ | {"PYTHONPATH": paths},
            )
    except OSError as error:
        raise _problem(folder, f"the twins cannot be started: {error}") from None


def _connected(folder: Path) -> socket.socket:
    line = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    line.settimeout(ANSWER_S)
    try:
        line.connect(address_of(folder))
    except OSError:
        line.close()
        raise
    return line


class _Line:
    """Lines of JSON over a socket. Every method raises OSError or EOFError if the other end is gone."""

    def __init__(self, line: socket.socket) -> None:
        self._line = line
        self._heard = b""

    def say(self, words: Sequence[str]) -> Answer:
        """Send words and return the answer. Raises PlantError if the twins have failed."""
        self._line.sendall(json.dumps(words).encode() + b"\n")
        while b"\n" not in self._heard:
            self._hear()
        said, _, self._heard = self._heard.partition(b"\n")
        answer = json.loads(said)
        if "failed" in answer:
            raise PlantError(answer["failed"])
        return Answer(**answer)

    def hear_what_comes(self) -> None:
        """Read what has come unasked, which is only the reason of a failure; raises it as PlantError."""
        while select.select([self._line], [], [], 0)[0]:
            self._hear()
            if b"\n" in self._heard:
                raise PlantError(json.loads(self._heard.partition(b"\n")[0])["failed"])

    def _hear(self) -> None:
        if not (data := self._line.recv(65536)):
            raise EOFError
        self._heard += data

    def close(self) -> None:
        self._line.close()


def _problem(path: Path, what: str) -> SourceError:
    return SourceError([Problem(Mark(str(path), 0), what)])
