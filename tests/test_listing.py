"""What the commands list is whole on every terminal: as a table, or by lines where that is too narrow."""

import io

import pytest
from conftest import Call
from rich.console import Console

from scuhand_bt.cli import shared
from scuhand_bt.cli.listing import Listing

RUN, FILE = "20261128-214212-xrd-holders-7fa3", "/srv/labs/east/robot/powders.yaml:115:1:"
ROWS = [
    ("54", "salt", "2026-11-28 21:43", RUN, f"failed: {FILE} is no YAML"),
    ("55", "long", "2026-11-28 21:44", "", ""),
]


def shown(width: int) -> list[str]:
    """The lines that a terminal of this width shows."""
    listing = Listing("job", "recipe", "heard of", "run", "")
    for row in ROWS:
        listing.add_row(*row)
    console = Console(file=io.StringIO(), width=width, highlight=False)
    console.print(listing)
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue().splitlines()


@pytest.mark.parametrize("width", [110, 160])
def test_a_table_that_fits_is_one_whose_ids_are_whole(width: int) -> None:
    lines = shown(width)
    assert "job ┃ recipe ┃" in lines[0]
    assert any(RUN in line for line in lines)
    assert "…" not in "".join(lines)


def test_a_narrow_terminal_gets_each_row_in_lines_with_all_of_its_words() -> None:
    assert shown(80) == [
        "job 54",
        f"  recipe salt, heard of 2026-11-28 21:43, run {RUN}",
        f"  failed: {FILE} is no YAML",
        "job 55",
        "  recipe long, heard of 2026-11-28 21:44",
    ]


def test_what_is_longer_than_the_terminal_is_folded() -> None:
    assert FILE in "".join(line.strip() for line in shown(30))


def test_what_is_believed_of_powders_is_read_in_80_columns(command: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shared.out, "width", 80)
    said = command("powders").stdout
    assert "vibration 100%, doses 0, by first guess" in said
    assert max(map(len, said.splitlines())) <= 80
