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
    from scuhand_bt.api.content import ACTIONS, explained
    from scuhand_bt.findings import FINDINGS

    library = None
    try:
        library = the_lab(lab).library
    except SourceError as error:  # the shared catalogue is explained all the same
        err.print(Text(f"This lab cannot be read, so the codes of its own skills are missing: {error.problems[0]}"))
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
    failures = explained(library)
    if code is not None and code not in failures:
        raise unknown("failure code", code, failures)
    if as_json:
        print_json({name: asdict(failure) for name, failure in failures.items() if code in (None, name)})
    elif code is None:
        table = Table("code", "meaning", "remedy", show_edge=False)
        for name, failure in failures.items():
            table.add_row(name, failure.meaning, failure.remedy)
        out.print(table)
    else:
        failure = failures[code]
        raised = [f"the skill {skill}" for skill in failure.raised_by]
        raised += [f"{part}, within any skill" for part in failure.raised_in]
        out.print(Text(f"{code}: {failure.meaning}"))
        out.print(Text(f"What to do: {failure.remedy}"))
        out.print(Text(f"Raised by: {'; '.join(raised) or 'nothing that names it'}."))
        if failure.defined_by:
            out.print(f"Defined by this lab's skill {', '.join(failure.defined_by)}.")
        if failure.retried_by:
            out.print(f"Tried again by the workflows: {', '.join(failure.retried_by)}.")
        if not failure.on_failure:
            out.print("`on_failure` does not apply: it ends the run, or concerns a sample whose job is over.")
            return
        out.print(f"What `on_failure: {{{code}: …}}` in a recipe can do with the failed sample:")
        for action, meaning in ACTIONS.items():
            out.print(f"  {action:12} {meaning}{'  (the default)' if action == failure.on_failure else ''}")


@app.command()
def faults() -> None:
    """List what can go wrong in a simulated cell, as written in a file for `--faults` (docs/faults.md)."""
    from scuhand_bt.api import content

    table = Table("fault", "what happens", "for", "when it may begin by default", show_edge=False)
    for fault in content.faults():
        table.add_row(fault.name, fault.summary, fault.lasts, fault.begins)
    out.print(table)
