"""A skill that was looked through and found sound is not looked through again, until what it stands on has changed."""

from pathlib import Path

import pytest
from conftest import LabFolder

from scuhand_bt.skill_files import load

STEPS = "from scuhand_bt.skill import Cell, Skill, Steps, pause\n\n\n"
WAITED = "def shake(cell: Cell) -> Steps[None]:\n    yield from pause(cell, 1.0)\n"
AT_ONCE = "def shake(cell: Cell) -> None:\n    return None\n"
OTHER = """

class Other(Skill[None]):
    \"\"\"Another skill.\"\"\"

    devices = ()

    def run(self, cell: Cell) -> Steps[None]:
        yield from pause(cell, 1.0)
"""


def skill(imports: str) -> str:
    return (
        f"from scuhand_bt.skill import Cell, Skill, Steps, pause\n\n{imports}\n\n\n"
        'class Sieve(Skill[None]):\n    """Sieve."""\n\n    devices = ("hand",)\n\n'
        "    def run(self, cell: Cell) -> Steps[None]:\n        shake(cell)\n        yield from pause(cell, 1.0)\n"
    )


@pytest.fixture
def looked_through(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The skills' names, each time that one is looked through."""
    names: list[str] = []
    look = load._looked_through

    def counted(skill, path: Path, *given):
        names.append(path.stem)
        return look(skill, path, *given)

    monkeypatch.setattr(load, "_looked_through", counted)
    monkeypatch.setattr(load, "_SOUND", {})
    return names


def test_the_same_skills_are_looked_through_once_wherever_they_are(
    lab_folder: LabFolder, looked_through: list[str]
) -> None:
    first = lab_folder.load()
    assert sorted(looked_through) == sorted(set(first.library.facts))
    looked_through.clear()
    again = LabFolder(lab_folder.folder.rename(lab_folder.folder.with_name("moved"))).load()
    assert looked_through == []
    assert again.library.facts == first.library.facts
    assert again.library.skills["scoop"] is not first.library.skills["scoop"]


def test_a_skill_that_was_changed_is_looked_through_and_no_other(
    lab_folder: LabFolder, looked_through: list[str]
) -> None:
    lab_folder.load()
    looked_through.clear()
    lab_folder.replace("skills/park.py", "\n\n\nclass ", "\n\n\n# Another day.\nclass ")
    lab_folder.load()
    assert looked_through == ["park"]


@pytest.mark.parametrize(
    ("by", "files", "other"),
    [
        ("_sieving", {}, ""),
        ("sieving", {}, OTHER),
        ("_both", {"skills/_both.py": "from .sieving import shake\n\n__all__ = ['shake']\n"}, OTHER),
    ],
)
def test_what_a_skill_takes_from_its_lab_is_part_of_it(
    lab_folder: LabFolder, by: str, files: dict[str, str], other: str
) -> None:
    """From a file that skills share, from another skill's, and from that by one that they share."""
    for name, text in {"skills/sieve.py": skill(f"from .{by} import shake"), **files}.items():
        lab_folder.write(name, text)
    theirs = "skills/sieving.py" if other else "skills/_sieving.py"
    lab_folder.write(theirs, STEPS + AT_ONCE + other)
    assert lab_folder.problems() == []
    lab_folder.write(theirs, STEPS + WAITED + other)
    (problem,) = lab_folder.problems()
    assert problem.startswith("skills/sieve.py:12:9: `shake(…)` does nothing unless it is waited for")


def test_what_is_wrong_is_said_each_time(lab_folder: LabFolder) -> None:
    lab_folder.write("skills/_sieving.py", STEPS + WAITED)
    lab_folder.write("skills/sieve.py", skill("from ._sieving import shake"))
    (problem,) = lab_folder.problems()
    assert lab_folder.problems() == [problem]


def test_a_device_that_is_taken_from_the_cell_is_missed_by_its_skills(lab_folder: LabFolder) -> None:
    cell = (lab_folder.folder / "robot" / "cell.yaml").read_text(encoding="utf-8")
    lab_folder.write("robot/cell.yaml", f"{cell}devices:\n  codes: {{kind: scanner, driver: keyboard_wedge}}\n")
    reads = skill("").replace('("hand",)', '("codes",)').replace("        shake(cell)\n", "")
    lab_folder.write("skills/sieve.py", reads)
    assert lab_folder.problems() == []
    lab_folder.write("robot/cell.yaml", cell)
    (problem,) = lab_folder.problems()
    assert "names an unknown device 'codes'" in problem
