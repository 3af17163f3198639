"""Problems of what a user wrote: what is wrong, where, and what would be right.

`Problems` collects everything that is wrong, so that a user sees all of it at once.
"""

import difflib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache

LONGEST_MESSAGE = 500
LONGEST_NAME = 80
"""Nothing longer is anyone's misspelling of a name."""


@dataclass(frozen=True, slots=True)
class Mark:
    """A place in a file; line and column count from 1. Line 0 is no file: an option of the command line."""

    file: str
    line: int = 1
    column: int = 1

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column}" if self.line else self.file


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong, where, and what would be right."""

    mark: Mark
    message: str
    code: str = ""
    """What kind of finding it is (`findings.py`); "" for what is no finding of a check."""
    is_warning: bool = False

    def __str__(self) -> str:
        return f"{self.mark}: {self.message}"


class SourceError(Exception):
    """Bad input: all problems found, in the order of the files."""

    def __init__(self, problems: Sequence[Problem]) -> None:
        self.problems = sorted(dict.fromkeys(problems), key=lambda p: (p.mark.file, p.mark.line, p.mark.column))
        super().__init__("\n".join(map(str, self.problems)))

    def __reduce__(self) -> tuple[type["SourceError"], tuple[list[Problem]]]:
        """From one process to another: by what was found, not by its text."""
        return SourceError, (self.problems,)


@dataclass
class Problems:
    """Collects problems; `raise_any` ends a stage that found an error."""

    found: list[Problem] = field(default_factory=list)

    def add(
        self,
        mark: Mark,
        what: str,
        allowed: str = "",
        unknown: str = "",
        known: Iterable[str] = (),
        *,
        code: str = "",
        is_warning: bool = False,
    ) -> None:
        """Note a problem: what is wrong; what is allowed; and, for an `unknown` name, the nearest known."""
        parts = [shorten(what, LONGEST_MESSAGE)]
        known = sorted(known)
        if allowed or known:
            parts.append(allowed or "known: " + (", ".join(known[:30]) + (", …" if len(known) > 30 else "")))
        if meant := nearest(unknown, tuple(known)):
            parts.append(f"did you mean '{meant}'?")
        self.found.append(Problem(mark, harmless("; ".join(parts)), code, is_warning))

    def warn(self, mark: Mark, what: str, remedy: str = "", *, code: str) -> None:
        """Note what is most likely not meant, and stops nothing."""
        self.add(mark, what, remedy, code=code, is_warning=True)

    @property
    def errors(self) -> list[Problem]:
        return [problem for problem in self.found if not problem.is_warning]

    def raise_any(self) -> None:
        if self.errors:
            raise SourceError(self.errors)


class Broken:
    """What a lab names and cannot be used, with what is wrong with it: by kind (skill, workflow, powder, …) and name.

    The name "" stands for all of a kind: those of a file that cannot be read.
    """

    def __init__(self) -> None:
        self._problems: dict[tuple[str, str], list[Problem]] = {}

    def add(self, kind: str, name: str, problems: Iterable[Problem]) -> None:
        self._problems.setdefault((kind, name), []).extend(problems)

    def of(self, kind: str, name: str) -> Sequence[Problem]:
        """What is wrong with it; nothing for what is not known to be broken."""
        return self._problems.get((kind, name)) or self._problems.get((kind, "")) or ()

    def tell(self, kind: str, name: str, problems: Problems) -> bool:
        """Note what is wrong with it for whoever uses it; False if it is not broken."""
        wrong = self.of(kind, name)
        problems.found.extend(wrong)
        return bool(wrong)


@cache
def nearest(unknown: str, known: tuple[str, ...]) -> str | None:
    """The known name that was probably meant; whoever writes `Mass` or `pellet-die` meant `mass`, `pellet_die`."""
    if not 0 < len(unknown) <= LONGEST_NAME:
        return None
    plain = {_plain_spelling(name): name for name in reversed(known) if len(name) <= LONGEST_NAME}
    found = difflib.get_close_matches(_plain_spelling(unknown), plain, 1, 0.6)
    return plain[found[0]] if found else None


def _plain_spelling(name: str) -> str:
    return name.lower().replace("-", "_").replace(" ", "_")


def shorten(text: str, length: int = 40) -> str:
    """Text on one line, cut for a message."""
    return harmless(text if len(text) <= length else text[: length - 1] + "…")


def harmless(text: str, *, keep: str = "") -> str:
    """Text from outside as it may be shown: on one line, and without a command to a terminal or a hidden sign."""
    if text.isprintable():
        return text
    shown = (c if c.isprintable() or c in keep else " " if c.isspace() else "\N{REPLACEMENT CHARACTER}" for c in text)
    return "".join(shown)
