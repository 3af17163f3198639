"""An index of a folder's runs, so that listing ten thousand of them does not open ten thousand journals.

It is a cache, in a file beside the folder: a run is looked up by what the system says of its journal's files (inode,
size, times), and read anew when that has changed. It may be deleted at any time, and where it cannot be read or
written, every journal is.
"""

import os
import sqlite3
import time
from collections.abc import Collection, Mapping
from contextlib import closing, suppress
from pathlib import Path

VERSION = 1
"""One more when what is kept of a run changes its shape."""
SETTLED_S = 2.0
"""A file that was written less than this ago may be written again within the same tick of its clock."""
_SCHEMA = "CREATE TABLE run (name TEXT PRIMARY KEY, stamp TEXT NOT NULL, summary TEXT NOT NULL) STRICT"

Kept = tuple[str, str]
"""The stamp of a journal's files, and what was kept of the run as JSON."""


def stamps(folder: Path) -> dict[str, str]:
    """For the journal of each run, by its file's name: its stamp, or "" where a program has it or has just had it."""
    found: dict[str, dict[str, str]] = {".sqlite": {}, ".sqlite-wal": {}, ".lock": {}}
    with suppress(FileNotFoundError), os.scandir(folder) as entries:
        for entry in entries:
            stem, dot, suffix = entry.name.rpartition(".")
            if (of := found.get(dot + suffix)) is not None:
                of[stem] = _stamp(entry)
    journals, logs, locks = found.values()
    for stem in logs.keys() & journals.keys():
        journals[stem] = f"{journals[stem]} {logs[stem]}" if journals[stem] and logs[stem] else ""
    for stem in locks.keys() & journals.keys():
        journals[stem] = ""
    return {f"{stem}.sqlite": stamp for stem, stamp in journals.items()}


def _stamp(entry: "os.DirEntry[str]") -> str:
    try:
        status = entry.stat()
    except OSError:
        return ""
    if abs(time.time() - max(status.st_mtime, status.st_ctime)) < SETTLED_S:
        return ""
    return f"{status.st_ino} {status.st_size} {status.st_mtime_ns} {status.st_ctime_ns}"


def read_index(folder: Path) -> dict[str, Kept]:
    """What was kept, by the journal's name; nothing where there is no index that can be read."""
    try:
        with closing(sqlite3.connect(f"{_file(folder).absolute().as_uri()}?mode=ro", uri=True)) as database:
            if database.execute("PRAGMA user_version").fetchone()[0] != VERSION:
                return {}
            return {name: (stamp, text) for name, stamp, text in database.execute("SELECT * FROM run")}
    except sqlite3.Error:
        return {}


def write_index(folder: Path, kept: Mapping[str, Kept], gone: Collection[str]) -> None:
    """Keep these as well, and forget those that are gone; where it cannot be written, it is not."""
    with suppress(sqlite3.Error, OSError), closing(sqlite3.connect(_file(folder), isolation_level=None)) as database:
        database.execute("BEGIN IMMEDIATE")
        if database.execute("PRAGMA user_version").fetchone()[0] != VERSION:
            database.execute("DROP TABLE IF EXISTS run")
            database.execute(_SCHEMA)
            database.execute(f"PRAGMA user_version={VERSION}")
        database.executemany("DELETE FROM run WHERE name = ?", ((name,) for name in gone))
        rows = ((name, stamp, text) for name, (stamp, text) in kept.items())
        database.executemany("INSERT OR REPLACE INTO run VALUES (?, ?, ?)", rows)
        database.execute("COMMIT")


def _file(folder: Path) -> Path:
    return folder.with_name(f"{folder.name}.index")
