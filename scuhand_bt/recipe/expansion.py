"""Expands the entries of `samples` to single samples: rows of a table, parallel lists, repeats."""

import re
from collections.abc import Callable, Collection, Iterator
from pathlib import Path

from scuhand_bt.problems import Mark, Problems, shorten
from scuhand_bt.quantity import counted
from scuhand_bt.recipe.table import read_table
from scuhand_bt.yaml_source import Entries, Items, Node, Scalar, describe, parse

MAX_SAMPLES = 20_000
"""Most samples of one recipe: about a week's work for a cell."""


ListInputs = Callable[[Entries], Collection[str]]


def expand(
    node: Node, folder: Path, lab: Path, problems: Problems, list_inputs: ListInputs = lambda entry: ()
) -> Iterator[Entries]:
    """The samples that one entry of `samples` stands for.

    A table's path is relative to the recipe's `folder`, and must be within that or the `lab`. `list_inputs` names the
    inputs of an entry's workflow that take a list: there a list is one value, and a list of lists has one for each
    sample.
    """
    if not isinstance(node, Entries):
        problems.add(
            node.mark,
            f"a sample cannot be {describe(node)}",
            "write - {id: …, container: …, mass: …}",
            code="wrong-shape",
        )
        return
    table = node.get("table")
    if table is None:
        yield from _expand_lists(node, problems, list_inputs(node))
    elif not isinstance(table, Scalar) or not table.text:
        problems.add(table.mark, f"'table' must be a file name, not {describe(table)}", code="wrong-shape")
    elif not _is_within(folder / table.text, folder, lab):
        what = f"'{shorten(table.text, 120)}' is neither in the recipe's folder nor in the lab"
        problems.add(table.mark, what, "put the table beside the recipe", code="table-elsewhere")
    else:
        shared = node.without("table")
        rows = read_table(folder / table.text, table.mark, problems)
        if rows and not any("id" in row.keys for row in (shared, *rows)):
            what = "has no column 'id', which a table of samples needs"
            meant = next((name for row in rows for name in row.keys if name.lower() == "id"), None)
            allowed = f"write 'id' for '{meant}'" if meant else "such as id, container, mass [mg], …"
            problems.add(Mark(rows[0].mark.file), what, allowed, code="bad-table")
            return
        for row in rows:
            if "table" in row.keys:
                problems.add(row.keys["table"], "a table cannot name another table", code="bad-table")
            merged = _merge(shared, row)
            yield from _expand_lists(merged, problems, list_inputs(merged))


def tables_named(text: str, file: str) -> Iterator[Scalar]:
    """The tables that the samples of a recipe's text name, as written."""
    root = parse(text, file, "a recipe")
    samples = root.get("samples") if isinstance(root, Entries) else None
    for sample in samples if isinstance(samples, Items) else ():
        table = sample.get("table") if isinstance(sample, Entries) else None
        if isinstance(table, Scalar) and table.text:
            yield table


def _is_within(path: Path, *folders: Path) -> bool:
    """Whether a file is in one of the folders once symbolic links are resolved."""
    try:
        return any(path.resolve().is_relative_to(folder.resolve()) for folder in folders)
    except (OSError, ValueError, RuntimeError):  # a name with a NUL, links in a circle
        return False


def _merge(shared: Entries, row: Entries) -> Entries:
    return Entries(row.mark, {**shared.keys, **row.keys}, {**shared.values, **row.values})


def _expand_lists(entry: Entries, problems: Problems, list_inputs: Collection[str]) -> Iterator[Entries]:
    """Parallel lists give one sample for each of their items; `repeat: n` gives n samples."""
    lists = {
        key: value.items
        for key, value in entry.values.items()
        if isinstance(value, Items) and (key not in list_inputs or any(isinstance(one, Items) for one in value.items))
    }
    count = len(next(iter(lists.values()), ()))
    for key, items in lists.items():
        if len(items) != count:
            first = next(iter(lists))
            problems.add(
                entry.values[key].mark,
                f"'{key}' lists {counted(len(items), 'value')}, but '{first}' lists {count}",
                code="uneven-lists",
            )
            return
    if (repeat := entry.get("repeat")) is not None:
        text = repeat.text if isinstance(repeat, Scalar) else None
        if text is None or not re.fullmatch(r"[1-9][0-9]{0,4}", text) or int(text) > MAX_SAMPLES:
            problems.add(
                repeat.mark,
                f"'repeat' must be a number of samples, not {describe(repeat)}",
                f"1 to {MAX_SAMPLES}",
                code="bad-repeat",
            )
            return
        if lists:
            problems.add(repeat.mark, "a sample has both 'repeat' and a list", "use one of them", code="bad-repeat")
            return
        count = int(text)
    elif not lists:
        yield entry
        return
    if count == 0:
        problems.add(entry.mark, "an empty list gives no sample", code="uneven-lists")
    digits = len(str(count))
    id_node = entry.get("id")
    for number in range(1, count + 1):
        values = {key: lists[key][number - 1] if key in lists else value for key, value in entry.values.items()}
        if isinstance(id_node, Scalar) and id_node.text:
            values["id"] = Scalar(id_node.mark, f"{id_node.text}-{number:0{digits}d}")
        yield Entries(entry.mark, entry.keys, values)
