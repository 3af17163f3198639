"""Commands about a lab's content: its skills, its workflows, and a new lab."""

import json
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
def trees(
    name: NameArgument = None,
    bt_xml: Annotated[bool, typer.Option("--bt-xml", help="As BehaviorTree.CPP 4 and Groot2 read it.")] = False,
    svg: Annotated[bool, typer.Option("--svg", help="As a picture.")] = False,
    from_xml: Annotated[
        Path | None, typer.Option("--from-xml", help="Show the workflows of such an XML file as this lab writes them.")
    ] = None,
    lab: LabOption = None,
) -> None:
    """List the lab's workflows, or show one; all of them are checked."""
    if from_xml is not None:
        _show_imported(from_xml)
        return
    from scuhand_bt.lab import find_lab, load_lab
    from scuhand_bt.problems import Problems
    from scuhand_bt.tree.btxml import to_xml
    from scuhand_bt.tree.check import check_workflows
    from scuhand_bt.tree.drawing import drawn

    loaded = load_lab(find_lab(None, lab))
    problems = Problems(list(loaded.problems))
    check_workflows(loaded.library, loaded.library.workflows, problems)
    problems.raise_any()
    if name is not None:
        if name not in loaded.library.workflows:
            raise unknown("workflow", name, loaded.library.workflows)
        workflow = loaded.library.workflows[name]
        if bt_xml or svg:
            out.file.write(to_xml(loaded.library, name) if bt_xml else drawn(workflow))
            return
        out.print(Text((loaded.folder / "trees" / f"{name}.yaml").read_text(encoding="utf-8").rstrip()))
        return
    table = Table("workflow", "inputs", "what it is for", show_edge=False)
    for key, workflow in loaded.library.workflows.items():
        inputs = ", ".join(f"{declared.name}: {declared.type.name}" for declared in workflow.inputs.values())
        table.add_row(key, inputs, workflow.summary)
    out.print(table)


def _show_imported(path: Path) -> None:
    from scuhand_bt.tree.btxml import from_xml
    from scuhand_bt.yaml_source import read_text

    for name, text in from_xml(read_text(path, "a file of BehaviorTree.CPP"), str(path)).items():
        out.file.write(f"# trees/{name}.yaml\n{text}")


@app.command()
def init(folder: Annotated[Path, typer.Argument(help="The new lab's folder.", show_default=False)]) -> None:
    """Make a lab of your own: a copy of the starter lab's robot, skills, trees and recipes, with what editors need."""
    from scuhand_bt.kit.schemas import vscode_settings, write_schemas
    from scuhand_bt.lab import load_lab, starter_lab

    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise typer.BadParameter(f"'{folder}' exists and is not empty")
    for part in ("robot", "skills", "trees", "recipes"):
        ignore = shutil.ignore_patterns("__pycache__", ".scuhand")
        try:
            shutil.copytree(starter_lab() / part, folder / part, ignore=ignore)
        except OSError as error:
            raise typer.BadParameter(f"'{folder}' cannot be written: {error}") from None
    write_schemas(load_lab(folder))
    (folder / ".vscode").mkdir()
    (folder / ".vscode" / "settings.json").write_text(json.dumps(vscode_settings(), indent=2) + "\n", encoding="utf-8")
    out.print(Text(f"A lab in {folder}. Try: scuhand-bt run {folder / 'recipes' / 'xrd_holders.yaml'} --dry-run"))
