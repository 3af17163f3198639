"""Schemas for editors: they fit the shipped files, catch mistakes of form, and the checked-in ones are of today."""

import json
import re
import shutil
from functools import cache
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml
from conftest import REPOSITORY, Call, LabFolder

from scuhand_bt.kit.schemas import FILES_OF, KINDS_OF_FILES, schema, written
from scuhand_bt.lab import Lab

SHIPPED = [
    (kind, path)
    for kind, pattern in FILES_OF.items()
    for path in sorted(REPOSITORY.glob(pattern))
    if (kind == "test") == (".test." in path.name)
]
HEADER = "# yaml-language-server: $schema=../schemas/{}.schema.json\n"


def as_an_editor_reads(text: str) -> Any:
    """YAML 1.2, as the language server has it: `yes` and `on` are texts."""

    def value(node: yaml.Node) -> Any:
        if isinstance(node, yaml.MappingNode):
            return {str(key.value): value(one) for key, one in node.value}
        if isinstance(node, yaml.SequenceNode):
            return [value(one) for one in node.value]
        text = str(node.value)
        if node.style is not None:  # type: ignore[attr-defined]
            return text
        if text in ("", "~", "null"):
            return None
        if text in ("true", "false"):
            return text == "true"
        if re.fullmatch(r"[-+]?[0-9]+", text):
            return int(text)
        return float(text) if re.fullmatch(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?", text) else text

    return value(yaml.compose(text, Loader=yaml.SafeLoader))


@cache
def validator(written_schema: str) -> jsonschema.Draft202012Validator:
    """Of a schema that is one, which takes half a second to know."""
    made = json.loads(written_schema)
    jsonschema.Draft202012Validator.check_schema(made)
    return jsonschema.Draft202012Validator(made)


def mistakes(kind: str, text: str, lab: Lab) -> list[str]:
    found = validator(written(kind, lab)).iter_errors(as_an_editor_reads(text))
    return [".".join(map(str, error.absolute_path)) + ": " + error.message for error in found]


@pytest.mark.parametrize(("kind", "path"), SHIPPED, ids=[path.name for _, path in SHIPPED])
def test_every_shipped_file_names_its_schema_and_fits_it(starter: Lab, kind: str, path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert text.startswith(HEADER.format(kind))
    assert mistakes(kind, text, starter) == []


@pytest.mark.parametrize("kind", KINDS_OF_FILES)
def test_the_schema_that_is_checked_in_is_of_today(starter: Lab, kind: str) -> None:
    path = REPOSITORY / "schemas" / f"{kind}.schema.json"
    assert path.read_text(encoding="utf-8") == written(kind, starter), "run `scuhand-bt schema --write`"


@pytest.mark.parametrize(
    ("kind", "name", "old", "new"),
    [
        ("recipe", "recipes/xrd_holders.yaml", "container: xrd_holder", "container: xrd_holdr"),
        ("recipe", "recipes/xrd_holders.yaml", "workflow: fill_xrd_holder", "workflow: fill_xrd"),
        ("recipe", "recipes/xrd_holders.yaml", "mass: 20 mg", "mass: 20"),
        ("recipe", "recipes/xrd_holders.yaml", "mass: 20 mg", "mas: 20 mg"),
        ("recipe", "recipes/xrd_holders.yaml", "dose.overshoot: flag", "dose.overshoot: ignore"),
        ("recipe", "recipes/xrd_holders.yaml", "otherwise: stop", "dose.overshot: stop"),
        ("test", "trees/fill_or_redo.test.yaml", "fails: dose.overshoot", "fails: dose.overshot"),
        ("test", "trees/fill_or_redo.test.yaml", "discard_container: 1", "discard_containr: 1"),
        ("test", "trees/fill_or_redo.test.yaml", "mass: 50 mg", "mass: 50"),
        ("test", "trees/fill_or_redo.test.yaml", "verdict: in tolerance", "verdct: in tolerance"),
        ("workflow", "trees/mix_at_ratio.yaml", "record: {ratio:", "record: {}  # {ratio:"),
        ("workflow", "trees/aliquots.yaml", "items: {container: $containers}", "items: {container: all}"),
        ("workflow", "trees/aliquots.yaml", "containers: [Container]", "containers: [Containr]"),
        ("workflow", "trees/prime_and_fill.yaml", "when: $prime > 0 mg", "wen: $prime > 0 mg"),
        ("workflow", "trees/fill.yaml", "dispense: {mass", "dispense: {mas"),
        ("workflow", "trees/fill.yaml", "attempts: 24", "atempts: 8"),
        ("workflow", "trees/fill.yaml", "scoop: {source: $source, wanted: $mass, may_scoop_again: true}", "scoop:"),
        ("workflow", "trees/fill.yaml", "source: Source", "source: Sorce"),
        ("workflow", "trees/fill.yaml", "device.lost]", "device.lst]"),
        ("workflow", "trees/fill.yaml", "{source: $source, wanted: $mass,", "{source: mortar, wanted: $mass,"),
        ("workflow", "trees/fill.yaml", "move_over:", "moveover:"),
        ("cell", "robot/cell.yaml", "kind: waste", "kind: bin"),
        ("cell", "robot/cell.yaml", "period: 100 ms", "period: 100"),
        ("cell", "robot/cell.yaml", "slots: 24", "slots: many"),
        ("powders", "robot/powders.yaml", "repose: 25 deg", "repos: 25 deg"),
        ("powders", "robot/powders.yaml", "bulk_density: 1.5 g/cm^3", "bulk_density: 1.5"),
        ("containers", "robot/containers.yaml", "mouth: 20 mm", "mouht: 20 mm"),
        ("containers", "robot/containers.yaml", "mortars:", "mortar:"),
    ],
)
def test_a_mistake_of_form_is_marked_while_it_is_written(
    starter: Lab, kind: str, name: str, old: str, new: str
) -> None:
    text = (REPOSITORY / name).read_text(encoding="utf-8")
    assert old in text
    assert mistakes(kind, text.replace(old, new), starter) != []


def test_a_fault_file_is_known_by_its_faults(starter: Lab) -> None:
    assert mistakes("faults", "faults: [{fault: balance.silent, at_pulse: 3, for: 5 s}]", starter) == []
    assert mistakes("faults", "faults: [{fault: balance.silnt}]", starter) != []


def test_a_labs_own_skill_and_workflow_are_in_its_schemas(command: Call, lab_folder: LabFolder) -> None:
    text = "from scuhand_bt.skill import Cell, Seconds, Skill, Steps\n\n\nclass Sieve(Skill[None]):\n"
    text += '    """Sieve."""\n\n    duration_s: Seconds\n\n'
    text += "    def run(self, cell: Cell) -> Steps[None]:\n        yield from ()\n"
    lab_folder.write("skills/sieve.py", text)
    lab_folder.write("trees/sift.yaml", "workflow: sift\ninputs: {strength: Ratio}\ntree: {sieve: {duration: 1 min}}\n")
    lab = lab_folder.load()
    assert mistakes("workflow", "workflow: x\ntree: {sieve: {duration: 5 s}}", lab) == []
    assert mistakes("workflow", "workflow: x\ntree: {sieve: {}}", lab) != []
    assert mistakes("recipe", "workflow: sift\nsamples: [{id: a, strength: 5 %}]", lab) == []
    shown = json.loads(command("schema", "workflow", "--lab", lab_folder.folder).stdout)
    assert shown["$defs"]["node"]["properties"]["sieve"]["description"] == "Sieve."
    assert command("schema", "--write", "--lab", lab_folder.folder).returncode == 0
    assert json.loads((lab_folder.folder / "schemas" / "workflow.schema.json").read_text(encoding="utf-8")) == shown


def test_every_field_of_a_powder_is_explained_with_its_unit(starter: Lab) -> None:
    powder = schema("powders", starter)["additionalProperties"]["properties"]
    assert powder["load_limit"]["description"].startswith("The most the cone is ever loaded with")
    assert "a mass, in mg" in powder["load_limit"]["description"]
    assert powder["bulk_density"]["examples"] == ["1.5 g/cm^3"]


def test_a_kind_that_is_none_is_refused_with_those_there_are(command: Call) -> None:
    ended = command("schema", "recip")
    assert ended.returncode == 2
    assert "did you mean 'recipe'?" in ended.stderr.replace("\n", " ")


def test_a_new_lab_has_its_schemas_and_the_settings_of_an_editor(command: Call, tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    assert command("init", folder).returncode == 0
    settings = json.loads((folder / ".vscode" / "settings.json").read_text(encoding="utf-8"))
    for name, (pattern, *_) in settings["yaml.schemas"].items():
        assert (folder / name).is_file()
        assert list(folder.glob(pattern))
    shutil.rmtree(folder)
