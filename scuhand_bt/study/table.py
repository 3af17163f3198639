"""Trials as a table for other programs: one row for each sample of each trial."""

import csv
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

from scuhand_bt.problems import Mark, Problem, SourceError
from scuhand_bt.study.trial import Task, Trial

TABLE_KINDS = (".csv", ".parquet")


def write_table(path: Path, trials: Sequence[tuple[Task, Trial]]) -> None:
    """Write the table in the format of its suffix. SourceError if that fails; ImportError without pyarrow."""
    found = list(_rows(trials))
    try:
        if path.suffix.lower() == ".parquet":
            _write_parquet(path, found)
            return
        with path.open("w", newline="", encoding="utf-8") as file:
            table = csv.DictWriter(file, found[0] if found else [])
            table.writeheader()
            table.writerows(found)
    except OSError as error:
        why = error.strerror or str(error)
        raise SourceError([Problem(Mark(str(path)), f"cannot be written: {why}")]) from None


def _write_parquet(path: Path, rows: list[dict[str, Any]]) -> None:
    """Columns of numbers are numeric, and an empty column has the type that it has in other studies."""
    import pyarrow
    from pyarrow import parquet

    for place in [name for name in (rows[0] if rows else ()) if "." in name]:
        with suppress(ValueError):
            numbers = [float(row[place]) for row in rows]
            rows = [{**row, place: number} for row, number in zip(rows, numbers, strict=True)]
    table = pyarrow.Table.from_pylist(rows)
    for number, column in enumerate(table.schema):
        if pyarrow.types.is_null(column.type):
            kind = pyarrow.string() if column.name == "code" else pyarrow.float64()
            table = table.set_column(number, column.name, table.column(number).cast(kind))
    parquet.write_table(table, path)


def _rows(trials: Sequence[tuple[Task, Trial]]) -> Iterator[dict[str, Any]]:
    for (setup, seed), one in trials:
        for sample in one.samples:
            yield {"seed": seed, "run_s": round(one.duration_s, 1), **dict(setup.changes), **asdict(sample)}
