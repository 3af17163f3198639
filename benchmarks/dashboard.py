"""What the dashboard costs, and how soon it shows: `python -m benchmarks.dashboard [--samples 1000] [--json FILE]`.

A journal is written as a run would write it, and Debian's Chromium has its page open: from an entry's commit to the
page's text; what the server takes of a core, and the first paint, with a run of many samples that goes on at the pace
of a real one, its journal copied entry by entry; what a page that is open costs a dry run, in processor time and in
wall time, by pairs of runs; and whether ten thousand connections, opened and dropped while a run goes on, change
anything in it.
"""

import argparse
import json
import os
import shutil
import socket
import sqlite3
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import sync_playwright

from benchmarks.batch import generated_recipe
from benchmarks.figures import show
from scuhand_bt.dashboard.serving import listen_at
from scuhand_bt.journal.events import JobStarted
from scuhand_bt.journal.presence import Presence
from scuhand_bt.journal.run_events import RunBegun
from scuhand_bt.journal.writer import Journal
from scuhand_bt.lab import starter_lab

CHROMIUM = "/usr/bin/chromium"
ARGUMENTS = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
TICK_S = 1.0 / os.sysconf("SC_CLK_TCK")
WATCHED_S = 30.0
TIMES = 200
CALLS = 10_000
SEEN = """window.late = []; new MutationObserver(() => {
  const at = Number(document.getElementById("job").textContent);
  if (at && at !== window.before) { window.before = at; window.late.push(Date.now() - at); }
}).observe(document, {childList: true, subtree: true, characterData: true});"""


@contextmanager
def serving(folder: Path) -> Iterator[tuple[str, int]]:
    """A dashboard in a process of its own: its address, and its process."""
    with listen_at("127.0.0.1", 0) as listener:
        port = listener.getsockname()[1]
        process = subprocess.Popen(
            [sys.executable, "-m", "scuhand_bt.dashboard.serving", str(folder), str(listener.fileno())],
            stdin=subprocess.PIPE,
            pass_fds=[listener.fileno()],
        )
    assert process.stdin is not None
    address = f"http://127.0.0.1:{port}"
    with urllib.request.urlopen(address, timeout=60):  # it has begun
        pass
    try:
        yield address, process.pid
    finally:
        process.stdin.close()
        process.wait(20)


@contextmanager
def browser() -> Iterator[Any]:
    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=CHROMIUM, args=list(ARGUMENTS))
        try:
            yield opened.new_page()
        finally:
            opened.close()


def latency(folder: Path) -> dict[str, float]:
    """From the commit of an entry to the text on the page, in a real browser."""
    path = folder / "state" / "runs" / "one.sqlite"
    path.parent.mkdir(parents=True)
    journal = Journal(path, durable=True)
    header = {"run": "one", "recipe": "latency", "recipe_hash": "", "recipe_path": "", "cell": "", "simulated": False}
    more = {"mode": "real devices", "controller": "", "version": "", "started": "2026-01-01T00:00:00+00:00"}
    journal.event(RunBegun.model_validate({**header, **more}))
    with Presence(path), serving(folder / "state") as (address, _), browser() as page:
        page.add_init_script(SEEN)
        page.goto(f"{address}/runs/one")
        page.locator("#recipe", has_text="latency").wait_for()
        for k in range(TIMES):
            now_ms = time.time() * 1000
            journal.job_started(JobStarted(name=f"{now_ms:.0f}", sample=None, attempt=1, workflow="w"))
            page.wait_for_timeout(120 + 13 * (k % 9))
        late_ms = page.evaluate("window.late")
    journal.close()
    return {"to_page_ms_p50": float(np.percentile(late_ms, 50)), "to_page_ms_p95": float(np.percentile(late_ms, 95))}


def dry_run(recipe: Path, folder: Path, *more: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "scuhand_bt", "run", str(recipe), "--dry-run", "--quiet", "--lab", str(folder)]
    return subprocess.Popen([*command, *more], stdout=subprocess.DEVNULL)


def make_lab(folder: Path) -> Path:
    for part in ("robot", "skills", "trees"):
        shutil.copytree(starter_lab() / part, folder / part)
    return folder


def many_samples(folder: Path, samples: int, whole: Path | None) -> dict[str, float]:
    """A page of a run of many samples that goes on at the pace of a real one; `whole` is the journal of such a run."""
    if whole is None:
        lab = make_lab(folder / "many")
        dry_run(generated_recipe(lab, samples), lab).wait()
        (whole,) = (lab / ".scuhand" / "runs").glob("*.sqlite")
    path = folder / "fed" / "runs" / "many.sqlite"
    path.parent.mkdir(parents=True)
    shutil.copy(whole, path)
    with closing(sqlite3.connect(path, isolation_level=None)) as fed:
        fed.execute("PRAGMA journal_mode=WAL")
        (split,) = fed.execute(
            "SELECT seq FROM entry WHERE kind = 'job_started' ORDER BY seq DESC LIMIT 1 OFFSET 12"
        ).fetchone()
        rest = fed.execute("SELECT * FROM entry WHERE seq >= ? ORDER BY seq", (split,)).fetchall()
        fed.execute("DROP TRIGGER entries_last")
        fed.execute("DELETE FROM entry WHERE seq >= ?", (split,))
        with Presence(path), serving(path.parent.parent) as (address, server), browser() as page:
            page.goto(f"{address}/runs/many")
            page.locator("#samples tr").nth(samples - 1).wait_for()
            paint_ms = page.evaluate("performance.getEntriesByName('first-contentful-paint')[0].startTime")
            rows_ms = page.evaluate("performance.now()")
            page.locator("#scene canvas").wait_for()
            marks = ", ".join("?" * len(rest[0]))
            began_s, before_s, first_s = time.monotonic(), used_s(server), rest[0][4]
            for row in rest:
                if (wait_s := row[4] - first_s - (time.monotonic() - began_s)) > 0:
                    page.wait_for_timeout(1000 * wait_s)
                if time.monotonic() - began_s > WATCHED_S:
                    break
                fed.execute(f"INSERT INTO entry VALUES ({marks})", row)
            share = (used_s(server) - before_s) / (time.monotonic() - began_s)
    return {"many_first_paint_ms": paint_ms, "many_all_rows_ms": rows_ms, "many_server_core_share": share}


def used_s(process: int) -> float:
    """Processor time of a process."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) * TICK_S


def slower(folder: Path, pairs: int) -> dict[str, float]:
    """How much more a dry run takes while its page is open, by pairs of runs.

    In wall time one at twenty times real time, its page drawn on the same computer; in processor time one as fast as
    can be, its page told of it and drawn elsewhere.
    """
    lab = make_lab(folder / "pairs")
    (lab / ".scuhand" / "runs").mkdir(parents=True)
    paced, free = lab / "paced.yaml", generated_recipe(lab, 60)
    paced.write_text((starter_lab() / "recipes" / "xrd_holders.yaml").read_text())
    walls, cores = [], []
    with serving(lab / ".scuhand") as (address, _), browser() as page:
        for _ in range(pairs):
            alone, watched = (_timed(paced, lab, opens, "--speed", "20") for opens in (None, _shown_by(page, address)))
            walls.append(watched[0] / alone[0] - 1)
            page.goto("about:blank")
            alone, watched = (_timed(free, lab, opens) for opens in (None, _told_by(address)))
            cores.append(watched[1] / alone[1] - 1)
    return {"slower_share_wall": statistics.median(walls), "slower_share_processor": statistics.median(cores)}


def _shown_by(page: Any, address: str) -> Callable[[str], object]:
    return lambda run: page.goto(f"{address}/runs/{run}", wait_until="commit")


def _told_by(address: str) -> Callable[[str], object]:
    def told(run: str) -> None:
        def listen() -> None:
            with urllib.request.urlopen(f"{address}/api/runs/{run}/news", timeout=60) as answer:
                for line in answer:
                    if b'"state": "complete"' in line:
                        return

        threading.Thread(target=listen, daemon=True).start()

    return told


def _timed(recipe: Path, lab: Path, opens: Callable[[str], object] | None, *more: str) -> tuple[float, float]:
    """Wall time from its first entry to its last, and processor time, of a dry run; `opens` is told that it began."""
    runs = lab / ".scuhand" / "runs"
    before = set(runs.glob("*.sqlite"))
    process = dry_run(recipe, lab, *more)
    while not (new := set(runs.glob("*.sqlite")) - before):
        time.sleep(0.02)
    journal = new.pop()
    if opens is not None:
        opens(journal.stem)
    _, _, usage = os.wait4(process.pid, 0)
    process.returncode = 0
    with closing(sqlite3.connect(journal)) as database:
        ends = database.execute("SELECT MIN(at), MAX(at) FROM entry").fetchone()
    first, last = map(datetime.fromisoformat, ends)
    return (last - first).total_seconds(), usage.ru_utime + usage.ru_stime


def flooded(folder: Path) -> dict[str, float]:
    """Connections that are opened and dropped while a run goes on; whether its record is that of another run."""
    lab, exports = make_lab(folder / "flooded"), []
    recipe = generated_recipe(lab, 20)
    with serving(lab / ".scuhand") as (address, _):
        port, answered = int(address.rpartition(":")[2]), True
        for is_flooded in (False, True):
            file = folder / f"{is_flooded}.json"
            process = dry_run(recipe, lab, "--json", str(file))
            threads = [threading.Thread(target=_flood, args=(port, CALLS // 4)) for _ in range(4 * is_flooded)]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
            process.wait()
            exports.append(json.loads(file.read_text()))
        with urllib.request.urlopen(f"{address}/api/runs", timeout=10) as answer:
            answered = len(json.loads(answer.read())) == 2
    return {"flooded_same_record": float(exports[0] == exports[1]), "flooded_still_answers": float(answered)}


def _flood(port: int, calls: int) -> None:
    for k in range(calls):
        with socket.create_connection(("127.0.0.1", port)) as caller:
            caller.sendall((b"", b"GET /api/ru", b"\xff" * 50)[k % 3])


GOALS = {
    "to_page_ms_p95": "< 250",
    "many_first_paint_ms": "< 1500",
    "many_server_core_share": "< 0.1",
    "slower_share_wall": "<= 0.02",
    "slower_share_processor": "<= 0.02",
    "flooded_same_record": "1",
    "flooded_still_answers": "1",
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=1000)
    parser.add_argument("--journal", type=Path, help="of a dry run of so many generated samples; else one is made")
    parser.add_argument("--pairs", type=int, default=5)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        figures = {
            **latency(folder),
            **many_samples(folder, options.samples, options.journal),
            **slower(folder, options.pairs),
            **flooded(folder),
        }
    show(f"The dashboard ({options.samples} generated samples)", figures, GOALS, options.json)


if __name__ == "__main__":
    main()
