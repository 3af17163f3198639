"""Mutated recipes, tables, workflows, cells and fault files: a clean error or a correct run, never anything else.

python -m benchmarks.mutations [--count 10000] [--first 0] [--processes 2] [--json FILE]
"""

import argparse
import json
import multiprocessing
import os
import resource
import sys
import tempfile
from collections import Counter
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import asdict
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.table import Table

from harness.mutant_judge import Judge, Outcome
from harness.mutants import Mutant, mutant
from harness.structures import structures

CHUNK = 40
"""Mutants made and judged in a go; every fourth chunk is of whole workflows and recipes."""
MEMORY_BYTES = 6_000_000_000


def minimal(judge: Judge, found: Mutant, outcome: Outcome, tries: int = 60) -> Outcome:
    """The same finding with as few lines as can be found in some tries."""
    signature = outcome.wrong[0][:25]
    changes = dict(found.changes)
    for name in changes:
        step = max(1, len(changes[name].splitlines()) // 2)
        while step and tries:
            at = 0
            while at < len(lines := changes[name].splitlines(keepends=True)) and tries:
                tries -= 1
                fewer = {**changes, name: b"".join(lines[:at] + lines[at + step :])}
                again = judge.judge(Mutant(found.kind, found.how, found.recipe, fewer, found.faults))
                if any(wrong.startswith(signature) for wrong in again.wrong):
                    changes, outcome = fewer, again
                else:
                    at += step
            step //= 2
    return outcome


def mutants_of(first: int, originals: Mapping[str, str]) -> list[Mutant]:
    """The mutants of the chunk that begins with this number."""
    if (first // CHUNK) % 4 == 3:
        return structures(first, CHUNK)
    return [mutant(number, originals) for number in range(first, first + CHUNK)]


_judges: list[Judge] = []
"""This process's own."""


def _begin(folder: str) -> None:
    """A process that takes all memory must not take the machine's."""
    with suppress(ValueError):
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    _judges.append(Judge(Path(folder) / f"lab-{os.getpid()}"))


def _judge_chunk(first: int, minimise: bool) -> list[Outcome]:
    """All mutants of a chunk."""
    (judge,), outcomes = _judges, []
    for each in mutants_of(first, judge.originals):
        outcome = judge.judge(each)
        if outcome.wrong and minimise:
            outcome = minimal(judge, each, outcome)
        outcomes.append(outcome)
    return outcomes


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--as-found", action="store_true", help="Do not look for a smaller reproduction.")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    first = given.first - given.first % CHUNK
    outcomes: list[Outcome] = []
    context = multiprocessing.get_context("spawn")
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessPoolExecutor(given.processes, context, initializer=_begin, initargs=(folder,)) as pool,
    ):
        chunks = range(first, first + given.count, CHUNK)
        for found in pool.map(partial(_judge_chunk, minimise=not given.as_found), chunks):
            outcomes += found
            for outcome in found:
                if outcome.wrong:
                    print(f"{outcome.kind}, {outcome.how}: {'; '.join(outcome.wrong)}", file=sys.stderr, flush=True)
            if given.json is not None:
                _keep(outcomes, given.json)
    _show(outcomes)


def _counts(outcomes: list[Outcome]) -> dict[str, Counter[str]]:
    """How often each kind of mutant ended how."""
    kinds = sorted({outcome.kind for outcome in outcomes})
    return {kind: Counter(outcome.end for outcome in outcomes if outcome.kind == kind) for kind in kinds}


def _show(outcomes: list[Outcome]) -> None:
    counts = _counts(outcomes)
    table = Table("what came of it", *counts, "all", show_edge=False)
    for end in sorted({outcome.end for outcome in outcomes}):
        numbers = [count[end] for count in counts.values()]
        table.add_row(end, *map(str, numbers), str(sum(numbers)))
    console = Console(width=160)
    console.print(table)
    console.print(f"{len(outcomes)} mutants, {sum(bool(outcome.wrong) for outcome in outcomes)} findings.")


def _keep(outcomes: list[Outcome], path: Path) -> None:
    """Written again after each chunk: what was found is there even if the rest never comes."""
    findings = [asdict(outcome) for outcome in outcomes if outcome.wrong]
    values = {"mutants": len(outcomes), "ends": _counts(outcomes), "findings": findings}
    path.write_text(json.dumps(values, indent=1) + "\n")


if __name__ == "__main__":
    main()
