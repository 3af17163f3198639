"""Commands about a lab's content: its skills, its workflows, and a new lab."""

import shutil
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table
from rich.text import Text

from scuhand_bt.cli.shared import LabOption, NameArgument, app, out, the_lab, unknown
from scuhand_bt.quantity import Unit


@app.command()
def skills(name: NameArgument = None, lab: LabOption = None) -> None:
    """List the lab's skills, or show one with its parameters."""
    from scuhand_bt.tree.wires import of_field

    library = the_lab(lab).library
    if name is None:
        table = Table("skill", "what it is for", show_edge=False)
        for key, skill in library.skills.items():
            table.add_row(key, skill.summary())
        out.print(table)
        return
    if name not in library.skills:
        raise unknown("skill", name, library.skills)
    skill = library.skills[name]
    out.print(f"{name}: {skill.summary()}")
    out.print(f"commands: {', '.join(skill.devices) or 'nothing'}; gives: {of_field(skill.result_type()).name}")
    table = Table("parameter", "type", "default", show_edge=False)
    for key, parameter in library.parameters(name).items():
        field = next(info for field_name, info in skill.model_fields.items() if (info.alias or field_name) == key)
        unit = next((f" {mark.unit}" for mark in field.metadata if isinstance(mark, Unit)), "")
        table.add_row(key, parameter.wire.name, "required" if parameter.required else f"{field.default}{unit}")
    out.print(table)


@app.command()
def trees(name: NameArgument = None, lab: LabOption = None) -> None:
    """List the lab's workflows, or show one; all of them are checked."""
    from scuhand_bt.problems import Problems
    from scuhand_bt.tree.check import check_workflows

    loaded = the_lab(lab)
    problems = Problems()
    check_workflows(loaded.library, loaded.library.workflows, problems)
    problems.raise_any()
    if name is not None:
        if name not in loaded.library.workflows:
            raise unknown("workflow", name, loaded.library.workflows)
        out.print(Text((loaded.folder / "trees" / f"{name}.yaml").read_text(encoding="utf-8").rstrip()))
        return
    table = Table("workflow", "inputs", "what it is for", show_edge=False)
    for key, workflow in loaded.library.workflows.items():
        inputs = ", ".join(f"{declared.name}: {declared.type.name}" for declared in workflow.inputs.values())
        table.add_row(key, inputs, workflow.summary)
    out.print(table)


@app.command()
def init(folder: Annotated[Path, typer.Argument(help="The new lab's folder.", show_default=False)]) -> None:
    """Make a lab of your own: a copy of the starter lab's robot, skills, trees and recipes."""
    from scuhand_bt.lab import starter_lab

    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise typer.BadParameter(f"'{folder}' exists and is not empty")
    for part in ("robot", "skills", "trees", "recipes"):
        ignore = shutil.ignore_patterns("__pycache__", ".scuhand")
        try:
            shutil.copytree(starter_lab() / part, folder / part, ignore=ignore)
        except OSError as error:
            raise typer.BadParameter(f"'{folder}' cannot be written: {error}") from None
    out.print(Text(f"A lab in {folder}. Try: scuhand-bt run {folder / 'recipes' / 'xrd_holders.yaml'} --dry-run"))
