"""The streams of a command: text that is only text, output that may be lost, and output that no run waits for."""

import io
import os
import queue
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, redirect_stdout, suppress
from pathlib import Path
from typing import Any, TextIO, cast

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from scuhand_bt.problems import harmless

MOST_WAITING = 1000
"""So many parts of the output may wait for who reads it; what comes then is left out."""
LONGEST_READING_S = 2.0
"""So long a program waits at its end for who reads its output."""


class PlainConsole(Console):
    """A console on which text is only text, wherever it comes from: no markup, and no command to the terminal."""

    def __init__(self, **options: Any) -> None:
        super().__init__(highlight=False, markup=False, emoji=False, **options)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterator[Segment]:
        for segment in super().render(renderable, options):
            yield segment if segment.control else segment._replace(text=harmless(segment.text, keep="\n"))


class OutputLost(Exception):  # noqa: N818 - it says what happened
    """A standard stream takes no more: its reader has gone, or its disk is full.

    No OSError, so that nobody who reads or writes a file of his own takes it for that file's.
    """

    def __init__(self, error: OSError) -> None:
        super().__init__(str(error))
        self.is_unread = isinstance(error, BrokenPipeError)
        """Its reader has gone, as `head` does that has what it wants."""


class Watched:
    """A standard stream that tells by OutputLost that it takes no more, and is that stream in all else."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        with _or_lost():
            return self._stream.write(text)

    def writelines(self, parts: Iterable[str]) -> None:
        for part in parts:
            self.write(part)

    def flush(self) -> None:
        with _or_lost():
            self._stream.flush()


@contextmanager
def _or_lost() -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise OutputLost(error) from None


@contextmanager
def watched() -> Iterator[None]:
    """In here the standard streams raise OutputLost; so it does at the end, where what waits is not taken."""
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (cast(TextIO, Watched(stream)) for stream in before)
    try:
        try:
            yield
        finally:
            sys.stdout.flush()
    finally:
        sys.stdout, sys.stderr = before


class Beside(io.TextIOBase):
    """A stream to whoever watches, which nobody waits for: it is written on a thread, and may vanish."""

    def __init__(self, stream: TextIO | None) -> None:
        self.is_gone = stream is None
        """Nobody is there any more."""
        self._stream = stream
        self._parts: queue.Queue[str | None] = queue.Queue(MOST_WAITING)
        self._thread = threading.Thread(target=self._write, daemon=True, name="output")
        self._thread.start()

    @property
    def encoding(self) -> str:  # type: ignore[override]
        return getattr(self._stream, "encoding", None) or "utf-8"

    def isatty(self) -> bool:
        return self._stream is not None and self._stream.isatty()

    def write(self, text: str) -> int:
        if not isinstance(text, str):  # typer tries so whether a stream takes bytes
            raise TypeError(f"text is written here, not {type(text).__name__}")
        if not self.is_gone:
            with suppress(queue.Full):
                self._parts.put_nowait(text)
        return len(text)

    def __enter__(self) -> "Beside":
        return self

    def __exit__(self, *exception: object) -> None:
        with suppress(queue.Full):
            self._parts.put(None, timeout=LONGEST_READING_S)
            self._thread.join(LONGEST_READING_S)

    def _write(self) -> None:
        put = putting(self._stream) if self._stream is not None else len
        while (part := self._parts.get()) is not None:
            if not self.is_gone:
                try:
                    put(part)
                except (OSError, OutputLost, ValueError):
                    self.is_gone = True


def putting(stream: TextIO) -> Callable[[str], object]:
    """How a part is written at once: past the stream's own buffer, whose lock the program's end would wait for."""
    try:
        stream.flush()
        file = stream.fileno()
    except (OSError, OutputLost, ValueError):
        return lambda part: (stream.write(part), stream.flush())
    encoding, errors = stream.encoding or "utf-8", stream.errors or "strict"

    def put(part: str) -> None:
        left = memoryview(part.encode(encoding, errors))
        while left:
            left = left[os.write(file, left) :]

    return put


@contextmanager
def lines_into(file: str | None) -> Iterator[Callable[[str], object] | None]:
    """How a line is written into a file, or for `-` to the standard output, which then has nothing else; None for none.

    Raises OSError for a file that cannot be written.
    """
    if file is None:
        yield None
        return
    with ExitStack() as opened:
        if file == "-":
            put = putting(sys.stdout)
            opened.enter_context(redirect_stdout(sys.stderr))
        else:
            put = putting(opened.enter_context(Path(file).open("w", encoding="utf-8")))
        yield lambda line: put(f"{line}\n")


@contextmanager
def unwatched() -> Iterator[None]:
    """What is done in here goes on whatever becomes of the standard streams."""
    before = sys.stdout, sys.stderr
    with Beside(sys.stdout) as sys.stdout, Beside(sys.stderr) as sys.stderr:
        try:
            yield
        finally:
            sys.stdout, sys.stderr = before
