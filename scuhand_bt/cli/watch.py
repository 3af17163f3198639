"""The command that watches a run from another terminal than its own."""

import time
from contextlib import ExitStack
from typing import TYPE_CHECKING

import typer
from rich.text import Text

from scuhand_bt.cli.shared import LabOption, RunArgument, app, err, out
from scuhand_bt.exit_codes import ExitCode

if TYPE_CHECKING:
    from scuhand_bt.api import PastRun

LOOKS_PER_S = 4


@app.command()
def watch(run: RunArgument, lab: LabOption = None) -> None:
    """Watch a run from another terminal, to its end, without affecting it. Ctrl-C ends only the watching."""
    from scuhand_bt.api import find_run

    its = find_run(run, lab)
    try:
        _follow(its)
    except KeyboardInterrupt:
        raise typer.Exit from None
    ended = its.summary()
    why = f": {ended.reason}" if ended.reason else ""
    out.print(Text(f"{its.id} ({ended.mode}): {ended.state}{why}; {ended.good} of {ended.total} samples good."))
    can_go_on = ended.state in ("stopped", "fault", "interrupted")
    again = f"`scuhand-bt resume {its.id}` goes on with it, " if can_go_on else ""
    what = f"{again}`scuhand-bt report {its.id}` writes its report, `scuhand-bt show {its.id}` shows all."
    out.print(Text(what), soft_wrap=True)


def _follow(its: "PastRun") -> None:
    """Show the run until it has ended, or its process has: as a picture on a terminal, else a line for each sample."""
    from rich.live import Live

    from scuhand_bt.report import Picture, PlainLines, doses_table, shown_of

    now, lines = its.follow(), PlainLines(lambda line: out.print(Text(line), soft_wrap=True))
    with ExitStack() as opened:
        live = opened.enter_context(Live(console=out, auto_refresh=False, screen=True)) if out.is_terminal else None
        while its.is_about_to_begin:
            time.sleep(1 / LOOKS_PER_S)
        while True:
            is_going_on = its.is_going_on  # before the look: what was written until then is seen
            results = now.look()
            if live is None:
                for result in results:
                    lines.sample_ended(result)
            elif now.begun is not None:
                live.update(Picture(shown_of(now, now.begun, its.balance())), refresh=True)
            if now.ended is not None or not is_going_on:
                break
            time.sleep(1 / LOOKS_PER_S)
    if now.begun is None:
        err.print(Text(f"{its.id}: it had not begun."))
        raise typer.Exit(ExitCode.BAD_INPUT)
    # `samples` has the one that was told last behind all others; the table is that of the run, in the plan's order
    place = {sample.id: number for number, sample in enumerate(now.begun.samples or ())}
    ordered = sorted(now.samples.values(), key=lambda sample: place.get(sample.id, len(place)))
    out.print(doses_table(ordered, out.width))
