"""Labs in which something is in the arm's way, and what a check finds of it."""

from collections.abc import Callable
from typing import Any

import pytest
from conftest import LabFolder

from scuhand_bt.bench_spec import Point
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.lab import read_lab
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.problems import Problem
from scuhand_bt.run import ways
from scuhand_bt.run.checking import check
from scuhand_bt.specs import Source


def stands(lab: LabFolder, what: str) -> None:
    cell = lab.folder / "robot" / "cell.yaml"
    lab.write("robot/cell.yaml", cell.read_text(encoding="utf-8") + what)


def found(lab: LabFolder, code: str) -> list[Problem]:
    problems = check(read_lab(lab.folder), lab.folder / "recipes" / "one.yaml").problems
    return [problem for problem in problems if problem.code == code]


def blocked(lab: LabFolder) -> list[str]:
    return [problem.message for problem in found(lab, "no-path")]


def line_with(lab: LabFolder, text: str) -> int:
    lines = (lab.folder / "robot" / "cell.yaml").read_text(encoding="utf-8").splitlines()
    return next(number for number, line in enumerate(lines, 1) if text in line)


def strokes_where(monkeypatch: pytest.MonkeyPatch, possible: Callable[[str, dict[str, Point]], bool]) -> None:
    """Strokes are possible where that says so, by the station's name and where all stations are; other ways all are."""

    def swing_and_out(motion: Any, cell: CellSpec, source: Source, *_: Any, is_brief: bool) -> float:
        if not possible(source.station, {name: one.position_mm for name, one in cell.stations.items()}):
            raise SkillFailed(Code.ARM_NO_PATH, "none")
        return 4.0

    monkeypatch.setattr(ways, "swing_and_out", swing_and_out)
    monkeypatch.setattr(MotionPlanner, "prepare", lambda *_: None)
