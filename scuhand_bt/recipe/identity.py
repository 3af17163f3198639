"""Ids that people cannot confuse.

An id has letters of one script, ASCII digits and `. _ - +`, in Unicode's normal form NFKC. Japanese, Korean and
Chinese may be combined with Latin, as in the 'highly restrictive' profile of UTS 39 (Unicode security mechanisms).
Within a recipe all ids are of one script, and no two differ only by case or by characters that look alike in print.
"""

import re
import unicodedata
from collections.abc import Iterable

from scuhand_bt.problems import Mark, shorten

ALLOWED = "letters, digits and . _ - +, at most 64, beginning with a letter or digit"
_ID = re.compile(r"[^\W_][\w.+-]{0,63}")
_WITH_LATIN = ({"LATIN", "CJK", "HIRAGANA", "KATAKANA"}, {"LATIN", "CJK", "BOPOMOFO"}, {"LATIN", "CJK", "HANGUL"})
_LAST_LATIN = "\u017f"
"""The last Latin letter of European alphabets. Later ones are mostly phonetic symbols that look like other letters."""
_ALIKE = str.maketrans("0I1一ニエカロトハタヘベペリ", "Ollー二工力口卜八夕へべぺり")
"""Characters that look alike within one script, or in scripts that may be combined."""


def wrong_id(text: str) -> tuple[str, str] | None:
    """What is wrong with an id by itself, and the remedy; None if it is good."""
    normal = unicodedata.normalize("NFKC", text)
    if normal != text and _is_id(normal):
        return "can be written in several ways", f"write '{normal}'"
    if not _is_id(text):
        return "is not a valid id", ALLOWED
    scripts = _scripts(text)
    if not _go_together(scripts):
        return f"mixes {' and '.join(sorted(scripts))} letters", "write it in one script"
    return None


class Ids:
    """The ids of one recipe so far, each with its place."""

    def __init__(self) -> None:
        self._by_look: dict[tuple[str, str], tuple[str, Mark]] = {}
        self._by_script: dict[str, tuple[str, Mark]] = {}

    def add(self, text: str, mark: Mark) -> tuple[str, str] | None:
        """Add an id; or why it cannot stand beside an earlier one, and where that is."""
        looks = {"looks like '{}'": text.translate(_ALIKE), "differs from '{}' only by case": text.casefold()}
        scripts = _scripts(text)
        for how, look in looks.items():
            if (how, look) in self._by_look:
                other, first = self._by_look[how, look]
                said = f"the id '{shorten(text)}' is taken" if other == text else f"'{text}' {how.format(other)}"
                return said, _where(first, mark)
        for script, (other, first) in self._by_script.items():
            if not _go_together({script, *scripts}):
                return f"'{text}' is written in another script than '{other}'", _where(first, mark)
        self._by_look |= dict.fromkeys(looks.items(), (text, mark))
        for script in scripts:
            self._by_script.setdefault(script, (text, mark))
        return None


def _where(first: Mark, mark: Mark) -> str:
    return f"first in {f'line {first.line}' if first.file == mark.file else first}"


def _is_id(text: str) -> bool:
    return _ID.fullmatch(text) is not None and all(_is_plain(sign) for sign in text)


def _is_plain(sign: str) -> bool:
    """Whether a character is ASCII, or a letter that ids may have."""
    if sign.isascii():
        return True
    is_latin = unicodedata.name(sign, "").startswith("LATIN ")
    return sign.isalpha() and sign != "ı" and (not is_latin or sign <= _LAST_LATIN)


def _scripts(text: str) -> set[str]:
    """The scripts of the text's letters, taken from the first word of their Unicode names."""
    return {re.split(r"[ -]", unicodedata.name(sign, "unknown"))[0] for sign in text if sign.isalpha()}


def _go_together(scripts: Iterable[str]) -> bool:
    together = set(scripts)
    return len(together) <= 1 or any(together <= group for group in _WITH_LATIN)
