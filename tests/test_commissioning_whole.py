"""The whole commissioning on wire twins, from what the factory ships to the first dose, as a user goes through it."""

import os
import pty
import re
import select
import subprocess
import sys

import numpy as np
import pytest
from test_commissioning import Factory, factory

from scuhand_bt.cell.places import over_balance
from scuhand_bt.commissioning import held_arm
from scuhand_bt.commissioning.guide import carry_out
from scuhand_bt.commissioning.record import Record
from scuhand_bt.commissioning.steps import STEPS, next_step
from scuhand_bt.lab import starter_lab, state_folder
from scuhand_bt.motion.kinematics import Mount, apex
from scuhand_bt.run.hands import check_weight
from scuhand_bt.specs import Container

__all__ = ["factory"]
pytestmark = [pytest.mark.slow, pytest.mark.real_time]
SLOW = "50%"
QUESTION = re.compile(r"([^\r\n]*[.?]) \[([^\]\r\n]+)\]")
SILENT_S = 300.0
RUNS = {"balance": "start_of_day", "first_dose": "first_dose"}


class AtTheCell:
    """A person who runs a recipe at a terminal, and does at the cell what is asked."""

    def __init__(self, factory: Factory) -> None:
        self.factory = factory
        self.over_mm: list[float] = []
        """How far the real apex was from where it should be over the real container, whenever a dose was to begin."""
        self.said = ""

    def run(self, recipe: str) -> int:
        folder = self.factory.lab_folder
        path = starter_lab() / "recipes" / f"{recipe}.yaml"
        (folder / "recipes").mkdir(exist_ok=True)
        (folder / "recipes" / path.name).write_text(path.read_text(encoding="utf-8"), encoding="utf-8")
        ours, theirs = pty.openpty()
        command = [sys.executable, "-m", "scuhand_bt", "run", f"recipes/{recipe}.yaml", "--step", "--slow", SLOW]
        command += ["--verbose", "--operator", "Ada", "--lab", str(folder)]
        with subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=theirs, cwd=folder) as process:
            os.close(theirs)
            heard = ""
            try:
                while True:
                    assert select.select([ours], [], [], SILENT_S)[0], f"nothing was said any more:\n{self.said}"
                    data = os.read(ours, 65536).decode(errors="replace")
                    heard, self.said = heard + data, self.said + data
                    while asked := QUESTION.search(heard):
                        heard = heard[asked.end() :]
                        self._do(asked[1])
                        os.write(ours, f"{asked[2].split('/')[0]}\n".encode())
            except OSError:  # it has closed its terminal
                pass
            finally:
                os.close(ours)
                if process.poll() is None:
                    process.wait(30)
        return process.returncode

    def _do(self, question: str) -> None:
        world = self.factory.bench.world
        if asked := re.search(r"Put the (\w+) '(\w+)' on the pan", question):
            kind = self.factory.lab.library.containers[asked[1]]
            world.place(Container.model_validate({**kind.model_dump(), "id": asked[2]}))
        elif "Put the check weight" in question:
            world.place(check_weight(20_000.0))
        elif "off the pan" in question:
            world.remove()
        elif "lost its turns" in question:
            pytest.fail("the roller's count was kept by its step")
        elif "mount the sheet" in question:
            world.swap_sheet()
        elif "Next: scoop" in question:
            world.refill("beads", 10_000.0 - world.masses_mg["source:beads"])
        elif "Next: dispense" in question:
            truth = self.factory.truth
            wanted_mm = over_balance(truth.cell, truth.library.containers["alumina_crucible"])[1]
            there_m = apex(self.factory.bench.arm.joints, Mount.of(truth.cell.hand)).position_m
            self.over_mm.append(float(np.linalg.norm(1e3 * there_m - np.array(wanted_mm))))


def test_a_cell_is_commissioned_from_factory_state_to_its_first_dose(
    factory: Factory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(held_arm, "SLOW_RATIO", 1.0)
    person = AtTheCell(factory)
    for step in STEPS:
        if step.name in RUNS:
            assert person.run(RUNS[step.name]) == 0, person.said
        assert carry_out(step, factory.site()) is not None
    last = Record(state_folder(factory.lab)).last(simulated=True)
    assert next_step(last, factory.lab.cell) is None
    assert person.over_mm
    assert max(person.over_mm) < 1.0
    dosed_mg = factory.bench.world.masses_mg["container:first"]
    assert dosed_mg == pytest.approx(200.0, abs=5.5)
    truth, found = factory.truth.cell.hand, factory.lab.cell.hand
    assert found.roller_deg_per_mm == pytest.approx(truth.roller_deg_per_mm, rel=0.015)
    real, told = truth.options.valve_map, found.options.valve_map
    opens_mm = np.interp([p.count for p in told], [p.count for p in real], [p.opening_mm for p in real])
    assert opens_mm == pytest.approx([point.opening_mm for point in told], abs=0.15)
