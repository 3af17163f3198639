"""Commands about failures: what a code means and what to do about it, and what can be made to fail in a simulation."""

from dataclasses import asdict

from rich.table import Table
from rich.text import Text

from scuhand_bt.cli.shared import JsonFlag, LabOption, NameArgument, app, err, out, print_json, the_lab, unknown
from scuhand_bt.problems import SourceError


@app.command()
def explain(code: NameArgument = None, lab: LabOption = None, as_json: JsonFlag = False) -> None:
    """Explain a failure code: meaning, remedy, who raises it, what a recipe can do about it; or list all of them.

    It also explains what `check` finds.
    """
    from scuhand_bt.failures import CATALOGUE
    from scuhand_bt.findings import FINDINGS
    from scuhand_bt.recipe.recipe import ACTIONS, DEFAULT_ON_FAILURE
    from scuhand_bt.tree.check import Library
    from scuhand_bt.tree.grammar import Branch, Decorator, walk

    try:
        library = the_lab(lab).library
    except SourceError as error:  # the shared catalogue is explained all the same
        library = Library({}, {})
        err.print(Text(f"Without what this lab's skills add, as it cannot be read: {error.problems[0]}"))
    if code is not None and code in FINDINGS:
        finding = FINDINGS[code]
        if as_json:
            print_json({code: asdict(finding)})
        else:
            out.print(
                Text(f"{code}, {'a warning' if finding.is_warning else 'an error'} of `check`: {finding.meaning}")
            )
            out.print(Text(f"What to do: {finding.remedy}"))
        return
    failures = library.failures()
    if code is not None and code not in failures:
        raise unknown("failure code", code, failures)
    retried = {
        name: {code for node in walk(workflow.tree) if isinstance(node, Branch | Decorator) for code in node.codes}
        for name, workflow in library.workflows.items()
    }
    explained = {
        name: {
            "meaning": failure.meaning,
            "remedy": failure.remedy,
            "defined_by": [skill for skill, made in library.skills.items() if name in made.failures],
            "raised_by": [skill for skill, made in library.skills.items() if name in made.raises],
            "raised_in": [f"scuhand_bt/{room}" for room in failure.raised_in],
            "retried_by": [workflow for workflow, codes in retried.items() if name in codes],
            "on_failure": DEFAULT_ON_FAILURE.get(name, DEFAULT_ON_FAILURE["otherwise"]),
        }
        for name, failure in sorted(failures.items())
        if code in (None, name)
    }
    if as_json:
        print_json(explained)
    elif code is None:
        table = Table("code", "meaning", "remedy", show_edge=False)
        for name, values in explained.items():
            table.add_row(name, str(values["meaning"]), str(values["remedy"]))
        out.print(table)
    else:
        values = explained[code]
        raised = [f"the skill {skill}" for skill in values["raised_by"]]
        raised += [f"{part}, within any skill" for part in values["raised_in"]]
        out.print(Text(f"{code}: {values['meaning']}"))
        out.print(Text(f"What to do: {values['remedy']}"))
        out.print(Text(f"Raised by: {'; '.join(raised) or 'nothing that names it'}."))
        if code not in CATALOGUE:
            out.print(f"Defined by this lab's skill {', '.join(values['defined_by'])}.")
        if values["retried_by"]:
            out.print(f"Tried again by the workflows: {', '.join(values['retried_by'])}.")
        out.print(f"In a recipe's `on_failure: {{{code}: …}}`, for the sample that failed so:")
        for action, meaning in ACTIONS.items():
            out.print(f"  {action:12} {meaning}{'  (the default)' if action == values['on_failure'] else ''}")


@app.command()
def faults() -> None:
    """List what can go wrong in a simulated cell, as `--faults FILE` has it (docs/faults.md)."""
    from scuhand_bt.sim.fault_rules import KINDS, OPPORTUNITIES, TO_THE_END

    table = Table("fault", "what happens", "for", "when it may begin, if not told", show_edge=False)
    for name, kind in KINDS.items():
        lasts = "once" if kind.is_momentary else "to the end" if kind.lasts_s == TO_THE_END else f"{kind.lasts_s:g} s"
        table.add_row(name, kind.summary, lasts, OPPORTUNITIES[kind.opportunity])
    out.print(table)
