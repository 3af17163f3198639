"""Draws `docs/run.svg`, the live view in the seventh dose of a dry run: `python docs/draw_run.py`."""

import io
import tempfile
from pathlib import Path

from py_trees.behaviour import Behaviour
from rich.console import Console
from rich.terminal_theme import MONOKAI

from scuhand_bt.lab import load_lab, starter_lab
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.report.live import LiveView
from scuhand_bt.report.picture import Picture
from scuhand_bt.run.options import Options
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun

RECIPE = "xrd_holders"
SAMPLES, OPENING_MM = 6, 0.4
"""It is drawn when so many have ended, and the valve is open as wide as this again."""


class Drawing(LiveView):
    """The live view, drawn once."""

    def __init__(self, console: Console, session: Session, mode: str) -> None:
        super().__init__(console, session.cell, session.plan, session.control, mode)
        self._console, self._hand, self._is_drawn = console, session.cell.hand, False

    def ticked(self, root: Behaviour) -> None:
        super().ticked(root)
        if not self._is_drawn and len(self._results) == SAMPLES and self._hand.opening_mm > OPENING_MM:
            self._is_drawn = True
            self._console.print(Picture(self.shown()))


def main() -> None:
    """Run it, and write the picture."""
    lab = load_lab(starter_lab())
    plan = make_plan(load_recipe(starter_lab() / "recipes" / f"{RECIPE}.yaml", lab), lab)
    with tempfile.TemporaryDirectory() as runs:
        console = Console(record=True, width=100, height=35, file=io.StringIO())
        session = Session(plan, lab, Options(DryRun(0), None, Path(runs)))
        try:
            session.run(Drawing(console, session, "SIMULATED (seed 0)"))
        finally:
            session.close()
        title = f"scuhand-bt run recipes/{RECIPE}.yaml --dry-run --speed 20"
        svg = console.export_svg(title=title, theme=MONOKAI, unique_id="run")
    Path(__file__).with_name("run.svg").write_text(svg, encoding="utf-8")


if __name__ == "__main__":
    main()
