"""`# ok: CODE` at the end of a line: the warning of that code on that line is meant, and not told.

A silencer that silences nothing is a warning itself, so that none stays behind when its reason is gone.
"""

import io
import re
import tokenize
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import yaml

from scuhand_bt.findings import FINDINGS
from scuhand_bt.problems import Mark, Problem, Problems

_OK = re.compile(r"#\s*ok:\s*([\w-]+(?:\s*,\s*[\w-]+)*)")


@dataclass(frozen=True)
class Silencer:
    """A code that is silenced on a line."""

    mark: Mark
    code: str


def silencers_in(path: Path) -> list[Silencer]:
    """The silencers of a YAML or Python file; none of one that cannot be read."""
    try:
        text = path.read_text(encoding="utf-8-sig")
        comments = list(_comments(text, path.suffix)) if _OK.search(text) else []
    except (OSError, UnicodeDecodeError, yaml.YAMLError, tokenize.TokenError, SyntaxError):
        return []
    return [
        Silencer(Mark(str(path), line, column + match.start(1) + 1), code)
        for line, column, comment in comments
        if (match := _OK.match(comment))
        for code in re.split(r"\s*,\s*", match[1])
    ]


def _comments(text: str, suffix: str) -> Iterator[tuple[int, int, str]]:
    """Line (from 1), column (from 0) and text of each comment that could be a silencer."""
    if suffix == ".py":
        for token in tokenize.generate_tokens(io.StringIO(text).readline):
            if token.type == tokenize.COMMENT:
                yield token.start[0], token.start[1], token.string
        return
    scalars = [token for token in yaml.scan(text) if isinstance(token, yaml.ScalarToken)]
    for number, line in enumerate(text.splitlines(), 1):
        for match in _OK.finditer(line):
            at = (number - 1, match.start())
            if not any(
                (t.start_mark.line, t.start_mark.column) <= at < (t.end_mark.line, t.end_mark.column) for t in scalars
            ):
                yield number, match.start(), line[match.start() :]


def without_silenced(found: Iterable[Problem], files: Iterable[Path], unsure: Collection[str]) -> list[Problem]:
    """The problems less what is silenced in these files, and with the silencers that silence nothing.

    A file with errors may hide the warnings that its silencers are for, and a code of `unsure` depends on more than its
    file: they are not called unused.
    """
    found = list(found)
    silencers = {(s.mark.file, s.mark.line, s.code): s for path in files for s in silencers_in(path)}
    kept, used, wrong = [], set(), {problem.mark.file for problem in found if not problem.is_warning}
    for problem in found:
        key = (problem.mark.file, problem.mark.line, problem.code)
        if problem.is_warning and key in silencers:
            used.add(key)
        else:
            kept.append(problem)
    unused = Problems()
    for key, silencer in silencers.items():
        if key not in used and silencer.mark.file not in wrong and silencer.code not in unsure:
            known = [code for code, finding in FINDINGS.items() if finding.is_warning]
            what = f"'{silencer.code}' is silenced here, but this line has no such warning"
            if silencer.code not in known:
                what = f"'{silencer.code}' is not a warning"
                unused.add(
                    silencer.mark, what, unknown=silencer.code, known=known, code="unused-silencer", is_warning=True
                )
            else:
                unused.warn(silencer.mark, what, "remove it", code="unused-silencer")
    return kept + unused.found
