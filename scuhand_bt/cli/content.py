"""Commands about a lab's content: its skills, its workflows, and a new lab."""

import json
import shutil
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table
from rich.text import Text

from scuhand_bt.cli.shared import LabOption, NameArgument, app, out, the_lab, unknown


@app.command()
def skills(name: NameArgument = None, lab: LabOption = None) -> None:
    """List the lab's skills, or show one with its parameters."""
    from scuhand_bt.api.content import parameters, result_type

    loaded = the_lab(lab)
    library = loaded.library
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
    out.print(f"commands: {', '.join(skill.devices) or 'nothing'}; gives: {result_type(skill)}")
    table = Table("parameter", "type", "default", show_edge=False)
    for one in parameters(loaded, name):
        table.add_row(one.name, one.type, "required" if one.default is None else one.default)
    out.print(table)


@app.command()
def trees(
    name: NameArgument = None,
    bt_xml: Annotated[
        bool, typer.Option("--bt-xml", help="Write it as BehaviorTree.CPP 4 and Groot2 read it.")
    ] = False,
    svg: Annotated[bool, typer.Option("--svg", help="Draw it as a picture (SVG).")] = False,
    from_xml: Annotated[
        Path | None, typer.Option("--from-xml", help="Show the workflows of such an XML file as this lab writes them.")
    ] = None,
    lab: LabOption = None,
) -> None:
    """List the lab's workflows, or show one; all of them are checked."""
    from scuhand_bt.api.content import checked_lab, drawn, imported, to_xml

    if from_xml is not None:
        for its_name, text in imported(from_xml).items():
            out.file.write(f"# trees/{its_name}.yaml\n{text}")
        return
    loaded = checked_lab(lab)
    if name is not None:
        if name not in loaded.library.workflows:
            raise unknown("workflow", name, loaded.library.workflows)
        workflow = loaded.library.workflows[name]
        if bt_xml or svg:
            out.file.write(to_xml(loaded.library, name) if bt_xml else drawn(workflow))
            return
        out.print(Text((loaded.folder / "trees" / f"{name}.yaml").read_text(encoding="utf-8").rstrip()), soft_wrap=True)
        return
    table = Table("workflow", "inputs", "what it is for", show_edge=False)
    for key, workflow in loaded.library.workflows.items():
        inputs = ", ".join(f"{declared.name}: {declared.type.name}" for declared in workflow.inputs.values())
        table.add_row(key, inputs, workflow.summary)
    out.print(table)


@app.command()
def init(folder: Annotated[Path, typer.Argument(help="The new lab's folder.", show_default=False)]) -> None:
    """Make a lab of your own: a copy of the starter lab's robot, skills, trees and recipes, with what editors need."""
    from scuhand_bt.api.content import starter_lab
    from scuhand_bt.kit import vscode_settings, write_schemas

    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise typer.BadParameter(f"'{folder}' exists and is not empty")
    for part in ("robot", "skills", "trees", "recipes"):
        ignore = shutil.ignore_patterns("__pycache__", ".scuhand")
        try:
            shutil.copytree(starter_lab() / part, folder / part, ignore=ignore)
        except OSError as error:
            raise typer.BadParameter(f"'{folder}' cannot be written: {error}") from None
    write_schemas(the_lab(folder))
    (folder / ".vscode").mkdir()
    (folder / ".vscode" / "settings.json").write_text(json.dumps(vscode_settings(), indent=2) + "\n", encoding="utf-8")
    out.print(Text(f"A lab in {folder}. Try: scuhand-bt run {folder / 'recipes' / 'xrd_holders.yaml'} --dry-run"))
