"""What README and docs say is so: examples run or are read, names and links exist, the picture is of today."""

import ast
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from conftest import REPOSITORY, LabFolder

from scuhand_bt import cli
from scuhand_bt.cli.check import line_of
from scuhand_bt.findings import page as page_of_findings
from scuhand_bt.kit.case_files import read_test_file
from scuhand_bt.lab import read_lab
from scuhand_bt.problems import Problems
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.checking import check
from scuhand_bt.sim.fault_rules import parse_faults
from scuhand_bt.study.vary import read_vary
from scuhand_bt.tree.check import check_workflows

PAGES = [*sorted(REPOSITORY.glob("*.md")), *sorted(REPOSITORY.glob("docs/**/*.md"))]
ARCHITECTURE = (REPOSITORY / "docs" / "architecture.md").read_text(encoding="utf-8")
WALKED = sorted(set(re.findall(r"`([\w/.]+\.\w+):([\w.]+)`", ARCHITECTURE)))
COMMANDS: Any = typer.main.get_command(cli.app)


def blocks(language: str) -> list[Any]:
    """The code blocks of a language on all pages, each under its page and number."""
    found = []
    for page in PAGES:
        matches = re.findall(rf"^```{language}\n(.*?)^```", page.read_text(encoding="utf-8"), re.M | re.S)
        found += [pytest.param(text, id=f"{page.name}-{number}") for number, text in enumerate(matches, 1)]
    return found


def texts(language: str) -> list[str]:
    return [block.values[0] for block in blocks(language)]


# --- the architecture


@pytest.mark.parametrize(("file", "name"), WALKED, ids=[f"{file}:{name}" for file, name in WALKED])
def test_every_step_of_a_walk_exists(file: str, name: str) -> None:
    path = next((path for path in (REPOSITORY / "scuhand_bt" / file, REPOSITORY / file) if path.is_file()), None)
    assert path is not None, f"{file} is gone"
    inside: Any = ast.parse(path.read_text(encoding="utf-8"))
    for part in name.split("."):
        inside = next((node for node in inside.body if part in _names(node)), None)
        assert inside is not None, f"{file} has no {name}"


def _names(node: ast.stmt) -> list[str]:
    if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
        return [node.name]
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    return [target.id for target in targets if isinstance(target, ast.Name)]


def test_the_walks_are_there() -> None:
    assert len(WALKED) > 80


def test_every_file_that_the_architecture_names_exists() -> None:
    named = set(re.findall(r"`((?:[\w.]+/)+(?:[\w.]+\.(?:py|cpp|md|yaml))?)`", ARCHITECTURE))
    assert len(named) > 30
    missing = [n for n in sorted(named) if not any((REPOSITORY / home / n).exists() for home in ("", "scuhand_bt"))]
    assert [name for name in missing if "NAME" not in name] == []


def test_the_table_of_rooms_is_that_of_the_contract() -> None:
    contracts = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    layers = contracts["contracts"][0]["layers"]
    said = re.findall(r"^\| (\d+) \| `(\w+)` \|", ARCHITECTURE, re.M)
    for number, layer in enumerate(reversed(layers), 1):
        assert {room for at, room in said if at == str(number)} == set(re.findall(r"\w+", layer))
    assert len({at for at, _ in said}) == len(layers)


@pytest.mark.slow
def test_the_picture_of_the_rooms_is_of_today(tmp_path: Path) -> None:
    drawn = tmp_path / "rooms.svg"
    subprocess.run([sys.executable, REPOSITORY / "docs" / "draw_rooms.py", "-o", drawn], check=True)
    assert drawn.read_text() == (REPOSITORY / "docs" / "rooms.svg").read_text(), "run `python docs/draw_rooms.py`"


# --- examples


def file_of(cls: str) -> str:
    """The file of a skill's class, without its ending: `read_pan` of `ReadPan`."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", cls).lower()


@pytest.mark.parametrize("text", blocks("yaml"))
def test_every_yaml_example_is_accepted(text: str, lab_folder: LabFolder) -> None:
    lab_folder.write("recipes/holders.csv", texts("csv")[0])
    kind = text.split(":", 1)[0]
    for skill in (text for text in texts("python") if "(Skill" in text and "cell.device(" not in text):
        (cls,) = re.findall(r"^class (\w+)", skill, re.M)
        lab_folder.write(f"skills/{file_of(cls)}.py", skill)
    if kind == "recipe":
        recipe = load_recipe(lab_folder.write("recipes/example.yaml", text), lab_folder.load())
        assert recipe.samples
    elif kind == "workflow":
        name = text.split()[1]
        lab_folder.write(f"trees/{name}.yaml", text)
        problems = Problems()
        check_workflows(lab_folder.load().library, [name], problems)
        problems.raise_any()
    elif kind == "test":
        for name, tree in (w.split("\n", 1) for w in texts("yaml") if w.startswith("workflow: tap_and_weigh")):
            lab_folder.write(f"trees/{name.split()[1]}.yaml", f"{name}\n{tree}")
        assert read_test_file(lab_folder.write("trees/example.test.yaml", text), lab_folder.load()).cases
    elif kind == "faults":
        assert parse_faults(text, "faults.yaml").rules
    elif kind == "balance":
        cell = (lab_folder.folder / "robot" / "cell.yaml").read_text(encoding="utf-8")
        lab_folder.write("robot/cell.yaml", re.sub(r"^balance: .*$", text, cell, flags=re.M))
        assert lab_folder.load().cell.balance.limits.usp_41
    elif kind == "hand":
        cell = (lab_folder.folder / "robot" / "cell.yaml").read_text(encoding="utf-8")
        lab_folder.write("robot/cell.yaml", re.sub(r"^hand: .*$", text, cell, flags=re.M))
        assert [point.count for point in lab_folder.load().cell.hand.options.valve_map] == [2048, 2120, 2330]
    elif kind == "arm":
        cell = (lab_folder.folder / "robot" / "cell.yaml").read_text(encoding="utf-8")
        lab_folder.write("robot/cell.yaml", re.sub(r"^arm: .*\nhand: .*$", text.strip(), cell, flags=re.M))
        assert lab_folder.load().cell.arm.driver == "ros2"
    elif kind in ("changer", "devices"):
        cell = (lab_folder.folder / "robot" / "cell.yaml").read_text(encoding="utf-8")
        lab_folder.write("robot/cell.yaml", re.sub(r"^changer: .*$", text, cell, flags=re.M))
        assert [problem for problem in lab_folder.problems() if problem.startswith("robot/")] == []
    elif kind == "frames":
        cell = (lab_folder.folder / "robot" / "cell.yaml").read_text(encoding="utf-8")
        frames = text.split("stations:")[0] + "  table: {}\nstations:"
        lab_folder.write("robot/cell.yaml", re.sub(r"^frames:.*^stations:", frames, cell, flags=re.M | re.S))
        x_mm, y_mm, z_mm = lab_folder.load().cell.stations["balance"].position_mm
        assert (x_mm, y_mm, z_mm) == pytest.approx((339.1, -8.0, 60.4))
    elif kind == "mortars":
        kinds = (lab_folder.folder / "robot" / "containers.yaml").read_text(encoding="utf-8")
        lab_folder.write("robot/containers.yaml", kinds + text.split("\n", 1)[1])
        assert lab_folder.load().library.mortars["jar_95"].corner_mm == 5.0
    elif kind == "design":
        vary = lab_folder.write("vary.yaml", text)
        crucibles = (REPOSITORY / "recipes" / "crucibles.yaml").read_text(encoding="utf-8")
        recipe = lab_folder.write("crucibles.yaml", f"{crucibles}\ncontroller: adaptive\n")
        assert read_vary(vary, recipe, lab_folder.folder).changes()
    else:
        assert kind == "notify", "an example of a new kind: say here how it is read"
        cell = (lab_folder.folder / "robot" / "cell.yaml").read_text(encoding="utf-8")
        for line in text.splitlines():
            lab_folder.write("robot/cell.yaml", f"{cell}\n{line}\n")
            assert lab_folder.load().cell.notify is not None


def test_the_mistakes_that_recipes_md_shows_are_told_in_those_words(lab_folder: LabFolder) -> None:
    page = (REPOSITORY / "docs" / "recipes.md").read_text(encoding="utf-8")
    shown = page.split("$ scuhand-bt check my.yaml\n")[1].split("```")[0].splitlines()
    recipe = texts("yaml")[0].replace("titanium_dioxide,", "titanium_dioxid,").replace("mass: 50 mg", "mass: 50 s")
    rows = "".join(f"xrd-{7 if number == 12 else number - 1:02d},xrd_holder,30\n" for number in range(2, 13))
    lab_folder.write("recipes/holders.csv", "id,container,mass [mg]\n" + rows.replace("xrd-01", "xrd-99"))
    path = lab_folder.write("recipes/my.yaml", recipe)
    found = check(read_lab(lab_folder.folder), path, fast=True).problems
    told = [line_of(problem).removeprefix(f"{path.parent}/") for problem in found]
    told.append(f"{len(told)} problems; nothing was moved.")
    for line, expected in zip(told, shown, strict=True):
        assert re.fullmatch(re.escape(expected).replace("…", ".*"), line)


CONSTANTS = (REPOSITORY / "docs" / "dosing-constants.md").read_text(encoding="utf-8")
STATE = {"READING", "RATE", "MASS", "K", "G"}
"""Numbers of rows, not figures."""
LAW = (
    *("adaptive", "opening", "knowledge", "constraint", "estimation", "identification"),
    *("unseen", "noise", "valve", "pulses", "shaking"),
)


@pytest.mark.parametrize("module", LAW)
def test_every_constant_of_the_law_is_in_its_table(module: str) -> None:
    table = CONSTANTS.partition("<!-- noise -->")[0]
    tree = ast.parse((REPOSITORY / "scuhand_bt" / "dosing" / f"{module}.py").read_text(encoding="utf-8"))
    targets = [node.targets[0] for node in tree.body if isinstance(node, ast.Assign)]
    names = {name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)}
    constants = {name for name in names - STATE if name.isupper()}
    assert constants
    assert {name for name in constants if f"`{name}`" not in table} == set()


ARITHMETIC = {0.0, 0.5, 1.0, 2.0, 12.0}
"""Of which 12 is a rounding's: its variance is a twelfth of the digit squared."""
ROUNDING = 1e-3


@pytest.mark.parametrize("module", LAW)
def test_no_figure_of_the_law_is_without_a_name(module: str) -> None:
    tree = ast.parse((REPOSITORY / "scuhand_bt" / "dosing" / f"{module}.py").read_text(encoding="utf-8"))
    bodies = [node for node in tree.body if isinstance(node, ast.ClassDef | ast.FunctionDef)]
    figures = [
        (node.lineno, node.value)
        for body in bodies
        for node in ast.walk(body)
        if isinstance(node, ast.Constant) and isinstance(node.value, float) and node.value > ROUNDING
    ]
    assert [(line, value) for line, value in figures if value not in ARITHMETIC] == []


def test_the_page_of_findings_is_of_today() -> None:
    assert (REPOSITORY / "docs" / "findings.md").read_text(encoding="utf-8") == page_of_findings(), (
        "run `python -m scuhand_bt.findings docs`"
    )


@pytest.mark.parametrize("text", blocks("python"))
def test_every_python_example_is_python(text: str) -> None:
    ast.parse(text)


@pytest.mark.parametrize("text", [block for block in blocks("python") if "(Skill" in block.values[0]])
def test_every_skill_example_is_loaded_and_called_as_the_page_says(text: str, lab_folder: LabFolder) -> None:
    name = file_of(re.findall(r"^class (\w+)\(Skill", text, re.M)[0])
    lab_folder.write(f"skills/{name}.py", text)
    lab_folder.replace(
        "robot/cell.yaml", "stations:", "devices: {codes: {kind: scanner, driver: keyboard_wedge}}\nstations:"
    )
    call = next(call for page in PAGES for call in re.findall(rf"`- ({name}: .*?)`", page.read_text(encoding="utf-8")))
    lab_folder.write("trees/example.yaml", f"workflow: example\ntree:\n  sequence:\n    - {call}\n")
    library = lab_folder.load().library
    problems = Problems()
    check_workflows(library, ["example"], problems)
    problems.raise_any()
    assert library.skills[name].summary()


# --- commands


def said_commands() -> Iterator[Any]:
    """Every `scuhand-bt …` of the pages: lines of shell blocks, of shown terminals, and within sentences."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        lines = re.findall(r"`scuhand-bt ([^`]*)`", text)
        for block in re.findall(r"^```(?:sh|text)\n(.*?)^```", text, re.M | re.S):
            lines += re.findall(r"^(?:\$ )?(?:.*/)?scuhand-bt (.*)$", block, re.M)
        for line in dict.fromkeys(lines):
            words = shlex.split(line.replace("[", "").replace("]", ""), comments=True)
            yield pytest.param(words, id=f"{page.name}: {' '.join(words)}")


@pytest.mark.parametrize("words", list(said_commands()))
def test_every_command_that_is_said_exists_with_its_options(words: list[str]) -> None:
    command = COMMANDS
    while words and words[0] in getattr(command, "commands", {}):
        command, words = command.commands[words[0]], words[1:]
    assert command is not COMMANDS, "no such command"
    assert not hasattr(command, "commands") or not words or words[0].startswith("-"), "no such command of this group"
    if words:  # else it is only spoken of
        placeholder = {"N": "1", "…": "x"}
        command.make_context(command.name, [placeholder.get(word, word) for word in words])
        for word in words:
            assert not word.startswith("recipes/") or (REPOSITORY / word).is_file()


def test_every_option_that_is_said_is_one_of_some_command() -> None:
    def options(command: Any) -> set[str]:
        inner = getattr(command, "commands", {}).values()
        return {option for p in command.params for option in p.opts}.union(*map(options, inner))

    known = options(COMMANDS) | {"--help"}
    for page in [REPOSITORY / "README.md", *sorted(REPOSITORY.glob("docs/*.md"))]:
        said = set(re.findall(r"`(--[a-z-]+)", page.read_text(encoding="utf-8")))
        assert said <= known, page.name


def test_every_option_of_a_command_is_told_on_the_page_of_commands() -> None:
    page = (REPOSITORY / "docs" / "commands.md").read_text(encoding="utf-8")

    def untold(command: Any) -> set[str]:
        options = [p for p in command.params if p.param_type_name == "option" and not p.hidden and p.name != "help"]
        missing = {p.opts[0] for p in options if not any(re.search(rf"{re.escape(o)}(?![\w-])", page) for o in p.opts)}
        return missing.union(*map(untold, getattr(command, "commands", {}).values()))

    assert untold(COMMANDS) == set()


def _anchors(text: str) -> set[str]:
    """What a page's headings are called in links, as GitHub has it."""
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_and_module_that_a_page_names_exists(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for target, part in re.findall(r"\]\(([^)#\s]*)(?:#([^)]*))?\)", text):
        if not target.startswith("http"):
            there = page.parent / target if target else page
            assert there.exists(), target
            assert not part or part in _anchors(there.read_text(encoding="utf-8")), f"{target}#{part}"
    for module in re.findall(r"python -m (benchmarks[\w.]*)", text):
        named = REPOSITORY.joinpath(*module.split("."))
        assert named.with_suffix(".py").is_file() or (named / "__main__.py").is_file(), module
    for script in re.findall(r"python (docs/\w+\.py)", text):
        assert (REPOSITORY / script).is_file(), script


def test_ci_finds_the_two_commands_of_the_readme_and_each_makes_its_own_environment() -> None:
    readme = (REPOSITORY / "README.md").read_text(encoding="utf-8").splitlines()
    wanted = re.findall(r"readme_command '(.+?)'", (REPOSITORY / ".ci" / "run").read_text(encoding="utf-8"))
    assert len(wanted) == 2
    for end in wanted:
        command = next(line for line in readme if line.endswith(end))
        assert command.startswith("python3 -m venv .venv && .venv/bin/pip install --quiet ")
