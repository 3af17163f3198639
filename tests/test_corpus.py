"""Planted mistakes, each found in its place with its remedy and nothing beside it; and labs with none."""

import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml
from conftest import REPOSITORY

from scuhand_bt.findings import FINDINGS
from scuhand_bt.lab import read_lab
from scuhand_bt.run.checking import check

CORPUS = Path(__file__).parent / "corpus"


def cases(name: str) -> list[dict[str, Any]]:
    """A file of the corpus; by libyaml, as every process of tests reads all of them."""
    read: list[dict[str, Any]] = yaml.load((CORPUS / f"{name}.yaml").read_text(encoding="utf-8"), yaml.CSafeLoader)
    return read


MISTAKES, SKILLS, CONTROLS = (cases(name) for name in ("mistakes", "skills", "controls"))
NAMES = {"recipe": "recipes/one.yaml", "tree": "trees/mine.yaml"}
TREE = """\
workflow: mine
summary: Fill a container, and put back what is left.
inputs: {from: Source, into: Container, mass: Mass, tolerance: {type: Mass, default: 2 mg}}
result: $dose
tree:
  sequence:
    - place_container: {container: $into}
    - tare:
    - timeout:
        duration: 30 min
        child:
          fill: {source: $from, container: $into, mass: $mass, tolerance: $tolerance, as: dose}
    - retry:
        attempts: 2
        on: [arm.no_path]
        child:
          return_leftover: {source: $from}
    - park:
"""
RECIPE = """\
recipe: one
workflow: mine
order: by_powder
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 5 g}
defaults: {from: beads, tolerance: 2 mg}
samples:
  - {id: a, into: xrd_holder, mass: 50 mg}
  - {table: more.csv}
on_failure: {dose.overshoot: flag, otherwise: stop}
"""
SKILL = """\
from scuhand_bt.skill import Cell, Code, Ratio, Seconds, Skill, SkillFailed, Steps, pause

__all__ = ["Code", "Ratio", "Seconds", "SkillFailed", "pause"]


class Sieve(Skill[None]):
    \"\"\"Sieve.\"\"\"
    devices = ("hand",)
"""


class CorpusLab:
    """A lab that is put together once, and changed for each mistake."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        for part in ("robot", "skills", "trees"):
            shutil.copytree(REPOSITORY / part, folder / part, ignore=shutil.ignore_patterns("__pycache__", "firmware"))
        (folder / "recipes").mkdir()
        self.put({"trees/mine.yaml": TREE, "recipes/one.yaml": RECIPE, "recipes/more.csv": MORE})

    def put(self, files: dict[str, str]) -> dict[str, str | None]:
        """Write files; returns what was in them before."""
        before: dict[str, str | None] = {}
        for name, text in files.items():
            path = self.folder / name
            before[name] = path.read_text(encoding="utf-8") if path.exists() else None
            path.write_text(text, encoding="utf-8")
        return before

    def take_back(self, before: dict[str, str | None]) -> None:
        for name, text in before.items():
            if text is None:
                (self.folder / name).unlink()
            else:
                (self.folder / name).write_text(text, encoding="utf-8")

    def found(self, files: dict[str, str]) -> list[tuple[str, str, str]]:
        """Code, place and text of all that is found with these files changed."""
        before = self.put(files)
        try:
            problems = check(read_lab(self.folder), self.folder / "recipes" / "one.yaml", fast=True).problems
        finally:
            self.take_back(before)
        return [
            (problem.code, str(problem.mark).removeprefix(f"{self.folder}/"), problem.message) for problem in problems
        ]


MORE = "id,into,mass [mg]\nb,xrd_holder,60\n"


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> CorpusLab:
    return CorpusLab(tmp_path_factory.mktemp("corpus") / "lab")


def file_of(case: dict[str, Any]) -> str:
    name = str(case["in"])
    return f"robot/{name.split(':')[1]}.yaml" if name.startswith("lab:") else NAMES.get(name, name)


def changed(lab: CorpusLab, case: dict[str, Any]) -> dict[str, str]:
    name, files = file_of(case), dict(case.get("with", {}))
    if "old" in case:
        text = files.get(name) or (lab.folder / name).read_text(encoding="utf-8")
        assert case["old"] in text, "the corpus is stale"
        files[name] = text.replace(case["old"], case["new"])
    elif case.get("text"):
        files[name] = case["text"]
    return files


@pytest.mark.parametrize("case", MISTAKES, ids=lambda case: case["is"])
def test_a_planted_mistake_is_found_in_its_place_and_nothing_beside_it(lab: CorpusLab, case: dict[str, Any]) -> None:
    files = changed(lab, case)
    place = f"{case.get('file') or file_of(case)}:{case['at']}"
    found = lab.found(files)
    said = [message for code, where, message in found if (code, where) == (case["code"], place)]
    assert said, found
    assert case["says"] in said[0]
    assert sorted(code for code, *_ in found) == sorted([case["code"], *case.get("also", ())]), found


@pytest.mark.parametrize("number", range(len(SKILLS)), ids=[case["is"] for case in SKILLS])
def test_a_planted_mistake_in_a_skill_is_found_before_it_runs(lab: CorpusLab, number: int) -> None:
    case, name = SKILLS[number], f"skills/sieve_{number}.py"  # a module is imported once
    ((code, where, message),) = lab.found({name: case.get("head", "") + SKILL + case["text"]})
    assert (code, where) == (case["code"], f"{name}:{case['at']}"), message
    assert case["says"] in message


def test_a_mistake_in_a_file_that_skills_share_is_found_for_those_that_use_it(lab: CorpusLab) -> None:
    shared = SKILL.split("\n\n\nclass")[0] + "\n\n\ndef knock(cell: Cell) -> Steps[None]:\n    yield 1.0\n"
    uses = SKILL.replace("\n\n__all__", "\n\nfrom ._knock import knock\n\n__all__")
    uses += "\n    def run(self, cell: Cell) -> Steps[None]:\n        yield from knock(cell)\n"
    ((code, where, _),) = lab.found({"skills/_knock.py": shared, "skills/knocks.py": uses})
    assert (code, where) == ("skill-yield", "skills/_knock.py:7:5")


@pytest.mark.parametrize("number", range(len(CONTROLS)), ids=[case["is"] for case in CONTROLS])
def test_where_nothing_is_wrong_nothing_is_found(lab: CorpusLab, number: int) -> None:
    case = CONTROLS[number]
    files = changed(lab, case) if "in" in case else {}
    if "skill" in case:
        files[f"skills/clean_{number}.py"] = SKILL + case["skill"]
    assert lab.found(files) == []


def test_the_corpus_is_large_and_every_code_of_it_has_its_section() -> None:
    planted = [case["code"] for case in (*MISTAKES, *SKILLS)]
    assert len(planted) >= 120
    assert len(CONTROLS) >= 20
    assert set(planted) <= set(FINDINGS)
    assert len({code for code in planted if FINDINGS[code].is_warning}) >= 12
