"""How the commands list things: as a table, or by lines where a terminal is too narrow for it."""

from rich.console import Console, ConsoleOptions, RenderResult
from rich.measure import Measurement
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

ANY_WIDTH = 10_000


class Listing(Table):
    """A table of which nothing is cut off: a run's id is there to be copied, and the end of a file's name to be read.

    Where its words do not fit into the terminal's width, each row is told by lines of its own.
    """

    def __init__(self, *heads: str) -> None:
        super().__init__(*heads, show_edge=False)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        needed = Measurement.get(console, options.update(width=ANY_WIDTH), self).minimum
        yield from self._table(console, options) if needed <= options.max_width else self._lines()

    def _table(self, console: Console, options: ConsoleOptions) -> RenderResult:
        for column in self.columns:
            column.no_wrap = not any(" " in str(cell) for cell in (column.header, *column.cells))
            column.overflow = "fold"
        return super().__rich_console__(console, options)

    def _lines(self) -> RenderResult:
        heads = [str(column.header) for column in self.columns]
        for cells in zip(*(column.cells for column in self.columns), strict=True):
            (head, name), *told = [(head, str(cell)) for head, cell in zip(heads, cells, strict=True) if str(cell)]
            named, others = [f"{head} {cell}" for head, cell in told if head], [cell for head, cell in told if not head]
            yield Text(f"{head} {name}", overflow="fold")
            for line in (", ".join(named), *others):
                yield Padding.indent(Text(line, overflow="fold"), 2)
