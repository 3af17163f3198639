"""The command that watches a run from another terminal than its own."""

import time
from contextlib import ExitStack, suppress
from pathlib import Path

import typer
from rich.text import Text

from scuhand_bt.cli.ongoing import RunArgument, runs_folder
from scuhand_bt.cli.shared import LabOption, app, err, out
from scuhand_bt.exit_codes import ExitCode

LOOKS_PER_S = 4


@app.command()
def watch(run: RunArgument, lab: LabOption = None) -> None:
    """Watch a run from another terminal, to its end; the run does not know of it. Ctrl-C ends only the watching."""
    from scuhand_bt.journal.archive import summary
    from scuhand_bt.run.resume import find_run

    journal = find_run(runs_folder(lab), run)
    try:
        _follow(journal)
    except KeyboardInterrupt:
        raise typer.Exit from None
    ended = summary(journal)
    why = f": {ended.reason}" if ended.reason else ""
    out.print(Text(f"{journal.stem} ({ended.mode}): {ended.state}{why}; {ended.good} of {ended.total} samples good."))
    can_go_on = ended.state in ("stopped", "fault", "interrupted")
    again = f"`scuhand-bt resume {journal.stem}` goes on with it, " if can_go_on else ""
    what = f"{again}`scuhand-bt report {journal.stem}` writes its report, `scuhand-bt show {journal.stem}` tells all."
    out.print(Text(what), soft_wrap=True)


def _follow(journal: Path) -> None:
    """Show the run until it has ended, or its process has: as a picture on a terminal, else a line for each sample."""
    from rich.live import Live

    from scuhand_bt.journal.follow import Follower
    from scuhand_bt.journal.presence import is_held
    from scuhand_bt.report.doses import doses_table
    from scuhand_bt.report.live import PlainLines
    from scuhand_bt.report.picture import Picture
    from scuhand_bt.report.watching import shown_of
    from scuhand_bt.run.control import balance_now

    now, lines = Follower(journal), PlainLines(lambda line: out.print(Text(line), soft_wrap=True))
    with ExitStack() as opened:
        live = opened.enter_context(Live(console=out, auto_refresh=False, screen=True)) if out.is_terminal else None
        while True:
            is_going_on = is_held(journal)  # before the look: what was written until then is seen
            results = now.look()
            if live is None:
                for result in results:
                    lines.sample_ended(result)
            elif now.begun is not None:
                balance = None
                with suppress(TimeoutError):  # a run that is too busy, or is stopped
                    balance = balance_now(journal)
                live.update(Picture(shown_of(now, now.begun, balance)), refresh=True)
            if now.ended is not None or not is_going_on:
                break
            time.sleep(1 / LOOKS_PER_S)
    if now.begun is None:
        err.print(Text(f"{journal.stem}: it had not begun."))
        raise typer.Exit(ExitCode.BAD_INPUT)
    out.print(doses_table(list(now.samples.values()), out.width))
