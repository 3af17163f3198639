"""The command that leads through a new cell to its first dose."""

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table
from rich.text import Text

from scuhand_bt.cli.shared import JsonFlag, LabOption, OperatorOption, app, err, out, print_json, the_lab, unknown
from scuhand_bt.exit_codes import ExitCode

if TYPE_CHECKING:
    from scuhand_bt.api import Lab
    from scuhand_bt.commissioning import Record


class AtTerminal:
    """The person at this terminal; see `scuhand_bt.commissioning.step.Dialogue`."""

    def tell(self, text: str) -> None:
        out.print(Text(text), soft_wrap=True)

    def ask(self, question: str, choices: Sequence[str] = ("done", "stop")) -> str:
        while True:
            answer = self._said(f"{question} [{'/'.join(choices)}]")
            if answer in choices:
                return answer
            self.tell(f"'{answer}' is not an answer; the answers are: {', '.join(choices)}")

    def measure(self, question: str) -> float:
        while True:
            answer = self._said(f"{question} (or stop)")
            try:
                value = float(answer)
            except ValueError:
                value = math.nan
            if 0.0 <= value < math.inf:
                return value
            self.tell(f"'{answer}' is not a number, such as 88.5")

    @staticmethod
    def _said(prompt: str) -> str:
        from scuhand_bt.commissioning import Left

        try:
            said: str = typer.prompt(prompt)
        except typer.Abort:  # Ctrl-C, or nobody there
            raise Left from None
        if (answer := said.strip().lower()) == "stop":
            raise Left
        return answer


def _list(record: "Record", lab: "Lab", *, as_json: bool) -> None:
    from scuhand_bt.commissioning import STEPS, changed

    rows = [
        (step, done, changed(step, last, lab.cell) if done is not None else [])
        for simulated in (False, True)
        for last in [record.last(simulated=simulated)]
        for step in STEPS
        if (done := last.get(step.name)) is not None or not simulated
    ]
    if as_json:
        print_json(
            [
                {"step": step.name, "summary": step.summary, "done": asdict(done) if done is not None else None}
                | {"changed_since": changes}
                for step, done, changes in rows
            ]
        )
        return
    table = Table("step", "what", "done", "by", "found", "changed since", show_edge=False)
    for step, done, changes in rows:
        if done is None:
            table.add_row(step.name, step.summary, "-", "", "", "")
            continue
        at = f"{done.at[:16].replace('T', ' ')}{' SIMULATED' if done.simulated else ''}"
        found = "; ".join(f"{what}: {value}" for what, value in done.found.items())
        table.add_row(step.name, step.summary, at, Text(done.by), Text(found), ", ".join(changes))
    out.print(table)


@app.command()
def commission(
    step: Annotated[
        str | None,
        typer.Argument(
            help="The step to do, or to do again; default: the first one that is not done.", show_default=False
        ),
    ] = None,
    listed: Annotated[bool, typer.Option("--list", help="Show the steps, who has done them, and when.")] = False,
    operator: OperatorOption = None,
    lab: LabOption = None,
    as_json: JsonFlag = False,
) -> None:
    """Set up a new cell step by step, up to its first dose. You may stop at any time and continue later."""
    from scuhand_bt.api import OpenLab, SkillFailed
    from scuhand_bt.commissioning import STEPS, Left, NotFound, Record, Site, carry_out, next_step, on_twins

    loaded = the_lab(lab)
    state = OpenLab(loaded).state
    names = [one.name for one in STEPS]
    if step is not None and step not in names:
        raise unknown("step", step, names)
    if listed or as_json:
        _list(Record(state), loaded, as_json=as_json)
        return
    from scuhand_bt.cli.persons import the_person
    from scuhand_bt.failures import CATALOGUE

    who = the_person(operator, state, is_asked=True)
    assert who is not None
    chosen = next((one for one in STEPS if one.name == step), None)
    try:
        simulated = on_twins(loaded.cell)
        if simulated:
            out.print("TWINS: nothing that is measured here is used for a real cell.")
        while (now := chosen or next_step(Record(state).last(simulated=simulated), loaded.cell)) is not None:
            out.print(Text(f"{now.name}: {now.summary}", style="bold"))
            site = Site(loaded, AtTerminal(), state, who, simulated)
            done = carry_out(now, site)
            if done is None or chosen is not None:
                break
            loaded = the_lab(lab)
        else:
            out.print("All steps are done; `scuhand-bt doctor` looks at the cell.")
    except Left:
        out.print("Stopped here. `scuhand-bt commission` continues.")
        raise typer.Exit(ExitCode.INTERRUPTED) from None
    except NotFound as error:
        err.print(Text(f"{error}."), soft_wrap=True)
        raise typer.Exit(ExitCode.CELL_FAULT) from None
    except SkillFailed as error:
        err.print(Text(f"{error.code}: {error.detail}. {CATALOGUE[error.code].remedy}"), soft_wrap=True)
        raise typer.Exit(ExitCode.CELL_FAULT) from None
