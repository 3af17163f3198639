"""Figures with names of any script: matplotlib's own font has no Chinese, Japanese or Korean letters."""

import warnings
from pathlib import Path

from matplotlib import font_manager, rc_context
from matplotlib.figure import Figure
from matplotlib.text import Text

LAST_RESORT = "Last Resort"
"""matplotlib's font that has a box for every letter begins with this name."""


def write_figure(figure: Figure, path: Path, dpi: int) -> None:
    """Write it, as its suffix says, with fonts of this computer for what matplotlib's own lacks.

    Where no font here has some letters, an SVG's texts stay texts, drawn by the fonts of whoever looks at it; of a PNG,
    which has boxes for them, UserWarning says so in words.
    """
    texts = figure.findobj(Text)
    lacking, fonts = _fonts_for({letter for text in texts for letter in text.get_text() if letter.isprintable()})
    for text in texts:
        text.set_fontfamily([*text.get_fontfamily(), *fonts])
    with rc_context({"svg.fonttype": "none"} if lacking else {}), warnings.catch_warnings():
        for letter in lacking:  # a line for each, and each time that it is drawn
            warnings.filterwarnings("ignore", f"Glyph {ord(letter)} .* missing from font", UserWarning)
        figure.savefig(path, dpi=dpi)
    if lacking and path.suffix.lower() != ".svg":
        what = f"no font of this computer has '{''.join(sorted(lacking))}'"
        warnings.warn(f"{what}: install one, such as Debian's fonts-noto-cjk, or write an SVG", stacklevel=2)


def _fonts_for(letters: set[str]) -> tuple[set[str], list[str]]:
    """What no font has of these, and the fonts that have the others, beside the one that texts are drawn in."""
    lacking, found = letters - _letters_of(font_manager.findfont(font_manager.FontProperties())), list[str]()
    for font in font_manager.fontManager.ttflist if lacking else ():
        is_plain = font.style == "normal" and font.weight == 400 and not font.name.startswith(LAST_RESORT)
        if is_plain and (has := lacking & _letters_of(font.fname)):
            lacking, found = lacking - has, [*found, font.name]
    return lacking, found


def _letters_of(file: str) -> set[str]:
    return set(map(chr, font_manager.get_font(file).get_charmap()))
