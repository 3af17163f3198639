"""A lab in one file, to be kept elsewhere: its own folders, its database, and the journals of all runs.

It is a ZIP archive with a list of all that is in it, `manifest.json`: SHA-256 by name. Databases are copied as of one
moment while a run may go on, each as one file. What comes back is what was copied, or nothing.
"""

import hashlib
import json
import os
import shutil
import zipfile
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory

import scuhand_bt
from scuhand_bt.clock import wall_time
from scuhand_bt.journal.copies import copy_database
from scuhand_bt.problems import Mark, Problem, SourceError

MANIFEST = "manifest.json"
FOLDERS = ("robot", "skills", "trees", "recipes")
STATE = ".scuhand"


def back_up(lab: Path, state: Path, archive: Path) -> int:
    """Write a lab and its state into a new archive; how many files. Raises SourceError where that cannot be."""
    for part in FOLDERS:
        if archive.resolve().is_relative_to((lab / part).resolve()):
            raise _problem(archive, f"the backup would be part of what it copies; write it outside of {part}/")
    for copied_from in (*(lab / part for part in FOLDERS), state):
        for _ in os.walk(copied_from, onerror=_refuse):
            pass
    files: dict[str, str] = {}
    new = archive.with_name(f"{archive.name}.new")
    try:
        with TemporaryDirectory() as folder, zipfile.ZipFile(new, "w", zipfile.ZIP_DEFLATED, allowZip64=True) as into:
            for name, path in _all_of(lab, state):
                copied = path
                if path.suffix in (".sqlite", ".db"):
                    copied = Path(folder) / "copy"
                    copied.unlink(missing_ok=True)
                    copy_database(path, copied)
                into.write(copied, name)
                files[name] = hashlib.sha256(copied.read_bytes()).hexdigest()
            at = wall_time()
            manifest = {"version": scuhand_bt.__version__, "at": at, "lab": str(lab.absolute()), "files": files}
            into.writestr(MANIFEST, json.dumps(manifest, indent=1))
        new.replace(archive)
    except OSError as error:
        raise _problem(archive, f"the backup cannot be written: {error.strerror or error}") from None
    finally:
        new.unlink(missing_ok=True)
    return len(files)


def restore(archive: Path, folder: Path) -> list[Path]:
    """Make the lab of an archive anew in a folder that is not there yet; the journals of its runs.

    Raises SourceError for an archive that is damaged or none, and for a folder that is there; then nothing is made.
    """
    if folder.exists():
        raise _problem(folder, "it exists already; a lab is restored into a new folder")
    new = folder.with_name(f"{folder.name}.new")
    try:
        shutil.rmtree(new, ignore_errors=True)
        with zipfile.ZipFile(archive) as stored:
            files = json.loads(stored.read(MANIFEST))["files"]
            if sorted([*files, MANIFEST]) != sorted(stored.namelist()):
                raise _problem(archive, "its list of files does not match the files in it")
            for name, expected in files.items():
                _write(stored, name, expected, new, archive)
        new.replace(folder)
    except (OSError, zipfile.BadZipFile, KeyError, TypeError, ValueError, AttributeError) as error:
        why = getattr(error, "strerror", None) or f"{type(error).__name__}: {error}"
        raise _problem(archive, f"it cannot be restored: {why}") from None
    finally:
        shutil.rmtree(new, ignore_errors=True)
    return sorted(folder.glob(f"{STATE}/runs/*.sqlite"))


def _all_of(lab: Path, state: Path) -> Iterator[tuple[str, Path]]:
    """Every file that belongs to the lab, by its name in the archive. A journal comes before its simulated world."""
    for part in FOLDERS:
        for path in sorted((lab / part).rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts:
                yield f"{part}/{path.relative_to(lab / part).as_posix()}", path
    for pattern in ("lab.db", "runs/*.sqlite", "runs/*.world", "runs/*.twins/*"):
        for path in sorted(filter(Path.is_file, state.glob(pattern))):  # a port is none
            yield f"{STATE}/{path.relative_to(state).as_posix()}", path


def _refuse(error: OSError) -> None:
    """What is in a folder that cannot be listed is not known, and `glob` leaves it out without a word."""
    if not isinstance(error, FileNotFoundError):
        raise _problem(Path(error.filename), f"it cannot be copied: {error.strerror}")


def _write(stored: zipfile.ZipFile, name: str, expected: str, folder: Path, archive: Path) -> None:
    parts = PurePosixPath(name).parts
    if parts[0] not in (*FOLDERS, STATE) or ".." in parts or "\\" in name:
        raise _problem(archive, f"'{name}' in it is not a file of a lab")
    content = stored.read(name)
    if hashlib.sha256(content).hexdigest() != expected:
        raise _problem(archive, f"'{name}' in it is not what was copied")
    path = folder.joinpath(*parts)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)


def _problem(path: Path, what: str) -> SourceError:
    return SourceError([Problem(Mark(str(path)), what)])
