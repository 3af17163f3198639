"""The command that checks a lab and a recipe, and tells everything that it finds."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.text import Text

from scuhand_bt.cli.shared import JsonFlag, LabOption, app, first_of, notes_of, out, print_json
from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.quantity import counted

if TYPE_CHECKING:
    from scuhand_bt.problems import Problem


@app.command()
def check(
    recipe: Annotated[Path | None, typer.Argument(help="A recipe file (YAML); without one, the lab itself.")] = None,
    fast: Annotated[bool, typer.Option("--fast", help="Do not plan the arm's paths.")] = False,
    strict: Annotated[bool, typer.Option("--strict", help="Count warnings as errors.")] = False,
    lab: LabOption = None,
    as_json: JsonFlag = False,
) -> None:
    """Check a recipe, its tables, its workflows and the lab, without running anything."""
    from scuhand_bt.api import open_lab

    opened = open_lab(lab, recipe=recipe)
    found = opened.check(recipe, fast=fast)
    is_bad = bool(found.errors) or (strict and bool(found.problems))
    notes = notes_of(found.plan, opened, quiet=as_json) if found.plan is not None else []
    samples = len(found.plan.recipe.samples) if found.plan is not None else 0
    if as_json:
        problems = [values_of(problem) for problem in found.problems]
        print_json({"ok": not is_bad, "samples": samples, "problems": problems, "notes": notes})
    else:
        told, rest = first_of(found.problems)
        for problem in told:
            out.print(Text(line_of(problem)), soft_wrap=True)
        if rest:
            out.print(Text(rest), soft_wrap=True)
        _sum_up(
            found.problems,
            len(found.errors),
            f"{recipe}: {counted(samples, 'sample')}" if recipe else f"{found.lab.folder}",
        )
    if is_bad:
        raise typer.Exit(ExitCode.BAD_INPUT)


def line_of(problem: "Problem") -> str:
    """A finding on one line, with its place, its kind and its code."""
    kind = "warning: " if problem.is_warning else ""
    return f"{problem.mark}: {kind}{problem.message} [{problem.code}]"


def _sum_up(problems: "tuple[Problem, ...]", errors: int, what: str) -> None:
    warnings = len(problems) - errors
    also = counted(warnings, "warning") if warnings else ""
    if not errors:
        out.print(Text(f"{what}, no problem found{'; ' + also if also else ''}."), soft_wrap=True)
    elif errors > 1 or also:
        out.print(f"{counted(errors, 'problem')}{' and ' + also if also else ''}; nothing was moved.")


def values_of(problem: "Problem") -> dict[str, object]:
    """A finding, as JSON has it."""
    mark = problem.mark
    return {
        "file": mark.file,
        "line": mark.line,
        "column": mark.column,
        "code": problem.code,
        "severity": "warning" if problem.is_warning else "error",
        "message": problem.message,
    }
