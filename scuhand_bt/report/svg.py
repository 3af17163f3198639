"""A matplotlib figure as SVG to stand in a page: small, in the page's own ink, without anything from elsewhere.

What is drawn in `INK` takes the colour of the text around it, so that one picture serves light, dark and paper.
"""

import io
import re
import warnings
from contextlib import AbstractContextManager

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

INK = "#010203"
_SETTINGS = {
    "svg.fonttype": "none",  # text stays text, in the page's font
    "svg.hashsalt": "scuhand_bt",  # the same figure has the same ids
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "hatch.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "font.size": 9,
    "hatch.linewidth": 0.5,
}
_FONT = re.compile(r"font-family: [^;\"]*;? ?|font: ([0-9.]+px)[^;\"]*;? ?")
_FINE = re.compile(r"(\d+\.\d)\d+")
_GROUP_ID = re.compile(r'<g id="[^"]*"')


def new_figure(width_in: float, height_in: float, *, is_laid_out: bool = True) -> Figure:
    """An empty figure, transparent. Draw in it within `drawing()`."""
    figure = Figure(figsize=(width_in, height_in), layout="constrained" if is_laid_out else None)
    FigureCanvasSVG(figure)
    figure.patch.set_visible(False)
    return figure


def drawing() -> AbstractContextManager[None]:
    """The settings with which a figure is made and drawn."""
    return rc_context(_SETTINGS)


def as_svg(figure: Figure, label: str) -> str:
    """The figure's `<svg>` element; `label` says in words what it shows, and is escaped by nobody but this."""
    text = io.StringIO()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from font", UserWarning)  # the page's font has it
        figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    svg = text.getvalue()
    svg = svg[svg.index("<svg") :].strip()
    svg = _FONT.sub(lambda found: f"font-size: {found[1]}; " if found[1] else "", svg)
    svg = _GROUP_ID.sub("<g", _FINE.sub(r"\1", svg)).replace(INK, "currentColor")
    svg = re.sub(r" *\n *", " ", svg).replace("> <", "><")
    head, rest = svg.split(">", 1)
    return re.sub(r'(width|height)="[^"]*"', "", head) + f' role="img" aria-label="{_attribute(label)}">' + rest


def plain_axes(axes: Axes) -> Axes:
    """Without a background of its own."""
    axes.patch.set_visible(False)
    return axes


def _attribute(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
