"""Samples from a CSV file, as Excel and others write it: BOM, semicolons or tabs, decimal commas.

The first row names the columns; a column may carry its unit, as in `mass [mg]`. Each further row
becomes the same kind of node that a sample written in YAML is, with the place of every cell.
"""

import csv
import io
import re
from dataclasses import dataclass
from pathlib import Path

from scuhand_bt.problems import Mark, Problems, SourceError, shorten
from scuhand_bt.yaml_source import Entries, Scalar, read_text

_HEADER = re.compile(r"([A-Za-z_]\w*)\s*(?:[\[(]([^\])]+)[\])])?")
_NUMBER = re.compile(r"[+-]?[\d.]+(?:[eE][+-]?\d+)?")
_DECIMAL_COMMA = re.compile(r"([+-]?\d+),(\d+(?:[eE][+-]?\d+)?)(\s*[A-Za-zµμ°%]*)")
_SIGN_IN_NUMBER = re.compile(r"[+-]?\d+([.,])\d+\s*[A-Za-zµμ°%]*")
_PERHAPS_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}([.,])\d{3}\s*[A-Za-zµμ°%]*")


@dataclass(frozen=True)
class Column:
    """One column of the header; `unit` belongs to the plain numbers below it."""

    mark: Mark
    name: str
    unit: str


def read_table(path: Path, asked_at: Mark, problems: Problems) -> list[Entries]:
    """The rows of a CSV file that a recipe names at `asked_at`; what is wrong is added to `problems`.

    None of a file whose header is wrong: each would lack what the header does not name.
    """
    file, before = str(path), len(problems.found)
    try:
        text = read_text(path, "a table of samples (CSV)", asked_at)
    except SourceError as error:
        problems.found.extend(error.problems)
        return []
    lines = list(io.StringIO(text, newline=""))  # as csv wants them: only line ends end a line
    first = next(line for line in lines if line.strip())
    delimiter = max(";\t,", key=first.count)
    reader = csv.reader(lines, delimiter=delimiter, strict=True)
    header: list[Column | None] | None = None
    read: list[tuple[list[str], list[Mark]]] = []
    line_number = 1
    try:
        for cells in reader:
            begins_at, line_number = line_number, reader.line_num + 1
            if not any(cell.strip() for cell in cells):
                continue
            places = _cell_places(lines[begins_at - 1 : reader.line_num], delimiter)
            marks = [Mark(file, begins_at + line, column) for line, column in places]
            if header is None:
                header = _read_header(cells, marks, problems)
            else:
                read.append((cells, marks))
    except csv.Error as error:
        problems.add(Mark(file, line_number), f"is not valid CSV: {error}", code="bad-table")
    else:
        if not read:
            problems.add(Mark(file), "has no rows below its header", code="bad-table")
    if len(problems.found) > before:
        return []
    decimal = None if delimiter == "," else _decimal_sign([cells for cells, _ in read], header or [])
    return [_read_row(cells, marks, header or [], decimal, problems) for cells, marks in read]


def _decimal_sign(rows: list[list[str]], header: list[Column | None]) -> str:
    """A table's decimal sign, by its numbers without thousands; "" if they leave it open."""
    numbers = {
        text
        for cells in rows
        for cell, column in zip(cells, header, strict=False)
        if column is not None and column.name != "id"
        for text in [cell.strip()]
        if not _PERHAPS_THOUSANDS.fullmatch(text)
    }
    signs = {match[1] for match in map(_SIGN_IN_NUMBER.fullmatch, numbers) if match}
    return signs.pop() if len(signs) == 1 else ""


def _read_header(cells: list[str], marks: list[Mark], problems: Problems) -> list[Column | None]:
    columns: list[Column | None] = []
    for cell, mark in zip(cells, marks, strict=True):
        match = _HEADER.fullmatch(cell.strip())
        if match is None:
            if cell.strip():
                what = f"'{shorten(cell)}' is not a column name"
                problems.add(mark, what, "write a name such as id, container, mass or mass [mg]", code="bad-table")
            columns.append(None)
        elif match[1] in [column.name for column in columns if column]:
            problems.add(mark, f"the column '{match[1]}' is here a second time", code="bad-table")
            columns.append(None)
        else:
            columns.append(Column(mark, match[1], (match[2] or "").strip()))
    return columns


def _read_row(
    cells: list[str], marks: list[Mark], header: list[Column | None], decimal: str | None, problems: Problems
) -> Entries:
    """`decimal`: the sign of decimals that the table's other numbers have; None where a comma can be none.

    A cell that is refused has its key in the row, and no value.
    """
    row = Entries(marks[0], {}, {})
    for i, (cell, mark) in enumerate(zip(cells, marks, strict=True)):
        text = cell.strip()
        if not text:
            continue
        if i >= len(header):
            problems.add(
                mark,
                f"'{shorten(text)}' is beyond the last column",
                f"the header has {len(header)}",
                code="bad-table",
            )
            break
        column = header[i]
        if column is None:
            continue
        row.keys[column.name] = column.mark
        grouped = _PERHAPS_THOUSANDS.fullmatch(text)
        if decimal and grouped and grouped[1] != decimal and column.name != "id":
            what = (
                f"'{shorten(text)}' could mean thousands: this table's other numbers have '{decimal}' before decimals"
            )
            problems.add(mark, what, "write it without a thousands separator", code="bad-table")
            continue
        if decimal is not None and column.name != "id" and (match := _DECIMAL_COMMA.fullmatch(text)):
            text = f"{match[1]}.{match[2]}{match[3]}"
        if column.unit and _NUMBER.fullmatch(text):
            text = f"{text} {column.unit}"
        row.values[column.name] = Scalar(mark, text)
    return row


def _cell_places(lines: list[str], delimiter: str) -> list[tuple[int, int]]:
    """Where each cell of a record begins: its line (0: the record's first) and its column (from 1)."""
    places, is_quoted, may_open = [(0, 1)], False, True
    for line, text in enumerate(lines):
        for column, character in enumerate(text, start=1):
            if character == '"' and (is_quoted or may_open):
                is_quoted, may_open = not is_quoted, True  # a doubled quote closes and opens again
                continue
            may_open = character == delimiter and not is_quoted
            if may_open:
                places.append((line, column + 1))
    return places
