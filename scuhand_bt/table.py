"""Samples from a CSV file, as Excel and others write it: BOM, semicolons or tabs, decimal commas.

The first row names the columns; a column may carry its unit, as in `mass [mg]`. Each further row
becomes the same kind of node that a sample written in YAML is, with the place of every cell.
"""

import csv
import re
from pathlib import Path

from scuhand_bt.yaml_source import Entries, Mark, Problems, Scalar, SourceError, read_text, shorten

_HEADER = re.compile(r"\s*([A-Za-z_]\w*)\s*(?:[\[(]\s*([^\])]+?)\s*[\])])?\s*")
_DECIMAL_COMMA = re.compile(r"([+-]?\d+),(\d+)(\s*[A-Za-zµμ°%]*)")


def read_table(path: Path, problems: Problems) -> list[Entries]:
    """The rows of a CSV file; what is wrong with the file is added to `problems`."""
    file = str(path)
    try:
        text = read_text(path, "a table of samples (CSV)")
    except SourceError as error:
        problems.found.extend(error.problems)
        return []
    lines = text.splitlines(keepends=True)
    first = next(line for line in lines if line.strip())
    delimiter = max(";\t,", key=first.count)
    reader = csv.reader(lines, delimiter=delimiter, strict=True)
    header: list[tuple[str, str] | None] | None = None
    rows: list[Entries] = []
    line_number = 1
    try:
        for cells in reader:
            begins_at, line_number = line_number, reader.line_num + 1
            if not any(cell.strip() for cell in cells):
                continue
            starts = _cell_starts(lines[begins_at - 1], delimiter)
            marks = [Mark(file, begins_at, starts[min(i, len(starts) - 1)]) for i in range(len(cells))]
            if header is None:
                header = _read_header(cells, marks, problems)
            else:
                rows.append(_read_row(cells, marks, header, delimiter != ",", problems))
    except csv.Error as error:
        problems.add(Mark(file, line_number), f"is no valid CSV: {error}")
    if header is not None and not rows:
        problems.add(Mark(file), "has no rows below its header")
    return rows


def _read_header(cells: list[str], marks: list[Mark], problems: Problems) -> list[tuple[str, str] | None]:
    columns: list[tuple[str, str] | None] = []
    for cell, mark in zip(cells, marks, strict=True):
        match = _HEADER.fullmatch(cell)
        if match is None:
            if cell.strip():
                what = f"'{shorten(cell)}' is no column name"
                problems.add(mark, what, "a name such as id, container, mass or mass [mg]")
            columns.append(None)
        elif match[1] in [column[0] for column in columns if column]:
            problems.add(mark, f"the column '{match[1]}' stands here a second time")
            columns.append(None)
        else:
            columns.append((match[1], match[2] or ""))
    return columns


def _read_row(
    cells: list[str], marks: list[Mark], header: list[tuple[str, str] | None], has_comma: bool, problems: Problems
) -> Entries:
    row = Entries(marks[0], {}, {})
    for i, (cell, mark) in enumerate(zip(cells, marks, strict=True)):
        text = cell.strip()
        if not text:
            continue
        if i >= len(header):
            problems.add(mark, f"'{shorten(text)}' stands beyond the last column", f"the header has {len(header)}")
            break
        column = header[i]
        if column is None:
            continue
        name, unit = column
        if has_comma and (match := _DECIMAL_COMMA.fullmatch(text)):
            text = f"{match[1]}.{match[2]}{match[3]}"
        if unit and re.fullmatch(r"[+-]?[\d.]+(?:[eE][+-]?\d+)?", text):
            text = f"{text} {unit}"
        row.keys[name] = mark
        row.values[name] = Scalar(mark, text)
    return row


def _cell_starts(line: str, delimiter: str) -> list[int]:
    """The column (from 1) that each cell of a line begins in."""
    starts, is_quoted = [1], False
    for column, character in enumerate(line, start=1):
        if character == '"':
            is_quoted = not is_quoted
        elif character == delimiter and not is_quoted:
            starts.append(column + 1)
    return starts
