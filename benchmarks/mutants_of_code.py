"""Mutation tests: does a test notice when a line of the code is wrong?

    python -m benchmarks.mutants_of_code [--target guards] [--processes 2] [--again] [--json FILE]

Every mutant of a target (`benchmarks/code_mutator.py`) is put into a copy of the checkout, and the target's test
modules are run until the first failure. What no test notices has survived: either a test is missing, or the mutant
does what the code does, and `benchmarks/equivalent_mutants.yaml` says why. Tests in real time and slow ones are left
out: they notice the computer, too. Results are in `benchmarks/mutants_of_code_results.json`, target by target.
"""

import argparse
import importlib
import json
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import pytest
import yaml

from benchmarks.code_mutator import CodeMutant, mutants_of

ROOT = Path(__file__).parent.parent
RESULTS = Path(__file__).with_name("mutants_of_code_results.json")
EQUIVALENT = Path(__file__).with_name("equivalent_mutants.yaml")
COPIED = (
    "scuhand_bt",
    "skills",
    "trees",
    "robot",
    "recipes",
    "docs",
    "tests",
    "harness",
    "pyproject.toml",
    "README.md",
)
PRELOADED = ("numpy", "scipy.optimize", "pinocchio", "coal", "ruckig", "hypothesis", "pydantic", "pint", "typer")
PRELOADED += ("rich.console", "py_trees", "yaml", "dynamixel_sdk", "serial")
"""Other people's modules, which take a second to import, are imported once."""
SLOWER, SLACK_S = 4.0, 20.0
"""A mutant has not ended if it takes so many times the tests' own time, and this much more."""
MEMORY_BYTES = 8_000_000_000


@dataclass(frozen=True)
class Target:
    """A part of the code, and the tests that are to notice whatever is wrong with it."""

    name: str
    file: str
    functions: tuple[str, ...]
    """Of the file; empty for all of it."""
    tests: tuple[str, ...]


TARGETS = (
    Target("verdict", "scuhand_bt/dosing/verdict.py", (), ("verdict", "lumps", "dispense")),
    Target("bracket", "scuhand_bt/dosing/bracket.py", (), ("bracket",)),
    Target("weighings about a container", "scuhand_bt/cell/pan_bracket.py", (), ("believed", "bracket")),
    Target("load", "scuhand_bt/cell/load.py", (), ("believed",)),
    Target("unseen", "scuhand_bt/dosing/unseen.py", (), ("dosing_knowledge", "rare_readings")),
    Target("weighing", "scuhand_bt/cell/weighing.py", (), ("weighing", "zero_steps")),
    Target("pan_cleared", "scuhand_bt/cell/pan_cleared.py", (), ("weighing", "container_again", "zero_steps")),
    Target("outcome", "scuhand_bt/run/outcome.py", (), ("outcome",)),
    Target(
        "dispense", "skills/dispense.py", ("Dispense.run", "Dispense._dose", "Dispense._raise_failure"), ("dispense",)
    ),
    Target("verdict of a controller", "scuhand_bt/dosing/knowledge.py", ("Knowledge.verdict",), ("dispense",)),
    Target("dose loop", "scuhand_bt/cell/dose_loop.py", (), ("dose_loop",)),
    Target("guards", "scuhand_bt/run/guards.py", (), ("guard_limits", "guards")),
    Target("spill", "scuhand_bt/motion/spill.py", (), ("motion_spill",)),
    Target("journal", "scuhand_bt/journal/writer.py", (), ("journal_writer", "journal", "journal_store")),
    Target("journal file", "scuhand_bt/journal/store.py", (), ("journal_writer", "journal_store", "fencing")),
    Target("hash chain", "scuhand_bt/journal/hash_chain.py", (), ("journal_writer", "journal")),
    Target("hand protocol, CRC", "scuhand_bt/devices/hand_protocol.py", (), ("hand_protocol",)),
    Target(
        "Dynamixel frames",
        "scuhand_bt/sim/wire/dynamixel.py",
        ("_crc_table", "crc16", "stuffed", "packet", "PacketReader", "fast_status"),
        ("dynamixel_packets",),
    ),
    Target("Dynamixel stuffing", "scuhand_bt/devices/dynamixel/bus.py", ("_Packets",), ("dynamixel_packets",)),
    Target("balance lines", "scuhand_bt/devices/balances/frames.py", (), ("balance_dialects",)),
    Target("balance A&D", "scuhand_bt/devices/balances/and_standard.py", (), ("balance_dialects",)),
    Target("balance MT-SICS", "scuhand_bt/devices/balances/mt_sics.py", (), ("balance_dialects",)),
    Target("balance SBI", "scuhand_bt/devices/balances/sbi.py", (), ("balance_dialects",)),
    Target("balance Shimadzu", "scuhand_bt/devices/balances/shimadzu.py", (), ("balance_dialects",)),
    Target("leases", "scuhand_bt/tree/leases.py", (), ("leases",)),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--target", action="append", choices=[target.name for target in TARGETS])
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--again", action="store_true", help="Only those that survived the last time.")
    parser.add_argument("--json", type=Path, default=RESULTS)
    given = parser.parse_args()
    for module in PRELOADED:
        importlib.import_module(module)
    results = json.loads(given.json.read_text()) if given.json.exists() else {}
    for target in TARGETS:
        if given.target is None or target.name in given.target:
            before = results.get(target.name) if given.again else None
            results[target.name] = examine(target, given.processes, before)
            given.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    print("\n".join(table(results)))


def examine(target: Target, processes: int, before: Mapping[str, object] | None) -> dict[str, object]:
    """What became of each mutant of a target; of those that survived `before`, if that is given."""
    mutants = mutants_of((ROOT / target.file).read_text(encoding="utf-8"), target.functions)
    equivalent = (yaml.safe_load(EQUIVALENT.read_text(encoding="utf-8")) or {}).get(target.name, {})
    if unknown := equivalent.keys() - {mutant.name for mutant in mutants}:
        sys.exit(f"{EQUIVALENT.name}: no mutant of '{target.name}' is called {sorted(unknown)}")
    judged = [mutant for mutant in mutants if mutant.name not in equivalent]
    survived_before = set(before["survived"]) if before else None  # type: ignore[call-overload]
    tried = [mutant for mutant in judged if survived_before is None or mutant.name in survived_before]
    ends: dict[str, str] = {}
    with tempfile.TemporaryDirectory() as folder:
        copies = [_copy(Path(folder) / str(number)) for number in range(processes)]
        limit_s = _time_of_tests(copies[0], target) * SLOWER + SLACK_S
        for mutant, end in _ends(tried, target, copies, limit_s):
            ends[mutant.name] = end
            print(f"\r{target.name}: {len(ends)} of {len(tried)}", end="", file=sys.stderr, flush=True)
            if end == "survived":
                print(f"\n  {target.file}:{mutant.line}: {mutant.name}", file=sys.stderr)
    print(file=sys.stderr)
    survived = [mutant.name for mutant in judged if ends.get(mutant.name) == "survived"]
    endless = [name for name, end in ends.items() if end == "endless"]
    if before:
        endless = sorted({*endless, *before["endless"]})  # type: ignore[misc]
    return {
        "file": target.file,
        "mutants": len(mutants),
        "equivalent": len(equivalent),
        "killed": len(judged) - len(survived),
        "endless": endless,
        "survived": survived,
    }


def table(results: Mapping[str, Mapping[str, object]]) -> Iterator[str]:
    """The results as a table in Markdown."""
    yield "| part | file | mutants | equivalent | noticed | of the others |"
    yield "| --- | --- | --- | --- | --- | --- |"
    for name, found in results.items():
        judged = int(found["mutants"]) - int(found["equivalent"])  # type: ignore[call-overload]
        share = 100.0 * int(found["killed"]) / max(judged, 1)  # type: ignore[call-overload]
        columns = (name, f"`{found['file']}`", found["mutants"], found["equivalent"], found["killed"], f"{share:.1f} %")
        yield f"| {' | '.join(map(str, columns))} |"


# --- running tests on a mutant


def _copy(folder: Path) -> Path:
    folder.mkdir()
    for name in COPIED:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__", ".*_cache"))
        else:
            shutil.copy(ROOT / name, folder / name)
    return folder


def _time_of_tests(copy: Path, target: Target) -> float:
    """How long the tests take where nothing is wrong [s]; they must hold."""
    began_s = time.monotonic()
    child = _begin_tests(copy, target, 3600.0)
    if os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) != 0:
        sys.exit(f"{target.name}: the tests fail without a mutant:\n{(copy / 'output').read_text()[-3000:]}")
    return time.monotonic() - began_s


def _ends(
    mutants: Sequence[CodeMutant], target: Target, copies: Sequence[Path], limit_s: float
) -> Iterator[tuple[CodeMutant, str]]:
    """Each mutant with what became of it, as they end; as many at a time as there are copies."""
    waiting, free = list(reversed(mutants)), list(copies)
    running: dict[int, tuple[CodeMutant, Path, float]] = {}
    while waiting or running:
        while waiting and free:
            mutant, copy = waiting.pop(), free.pop()
            (copy / target.file).write_text(mutant.source, encoding="utf-8")
            running[_begin_tests(copy, target, limit_s)] = (mutant, copy, time.monotonic() + limit_s)
        for child, (mutant, copy, deadline_s) in list(running.items()):
            ended, status = os.waitpid(child, os.WNOHANG)
            if not ended and time.monotonic() < deadline_s:
                continue
            if not ended:
                os.killpg(child, signal.SIGKILL)
                os.waitpid(child, 0)
            with suppress(ProcessLookupError):
                os.killpg(child, signal.SIGKILL)  # what the tests have started
            del running[child]
            (copy / target.file).write_bytes((ROOT / target.file).read_bytes())
            free.append(copy)
            is_endless = not ended or os.WIFSIGNALED(status)
            yield mutant, "endless" if is_endless else "noticed" if os.waitstatus_to_exitcode(status) else "survived"
        time.sleep(0.02)


def _begin_tests(copy: Path, target: Target, limit_s: float) -> int:
    """Run the target's tests in a process of their own, a fork that has other people's modules already."""
    child = os.fork()
    if child:
        return child
    os.setsid()
    output = os.open(copy / "output", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    for stream in (1, 2):
        os.dup2(output, stream)
    resource.setrlimit(resource.RLIMIT_CPU, (int(limit_s), int(limit_s) + 1))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    os.chdir(copy)
    sys.path[:] = [str(copy), *(path for path in sys.path if path not in ("", str(ROOT)))]
    sys.dont_write_bytecode = True  # a mutant's file may be as old and as long as the one before
    options = [
        "-x",
        "-q",
        "-n0",
        "-p",
        "no:cacheprovider",
        "-m",
        "not slow and not real_time",
        f"--basetemp={copy}/temporary",
    ]
    options += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]  # of what was imported beforehand
    code = 1
    try:
        code = pytest.main([*options, *(f"tests/test_{name}.py" for name in target.tests)])
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


if __name__ == "__main__":
    main()
