"""Between two actions the devices are at rest, whatever a skill leaves; or the run stops with the skill's name."""

from pathlib import Path
from typing import ClassVar

import pytest
from conftest import Bench, FakeCell, FakeDevice, wait_until
from running import dry_run, make_lab

from scuhand_bt.clock import Steps
from scuhand_bt.journal.reader import read
from scuhand_bt.skill import Skill, SkillFailed
from scuhand_bt.tree.leaf import REST_S, SkillBug

CARELESS = '''
"""A skill that leaves its devices at work."""
from scuhand_bt.skill import Cell, Skill, SkillFailed, Steps, pause

class Careless(Skill[None]):
    """Leave something on."""
    devices = ("hand", "arm")
    def run(self, cell: Cell) -> Steps[None]:
        yield from pause(cell, 0.5)
        %s
'''
TREE = "workflow: w\ninputs: {source: Source}\ntree: {sequence: [{careless: }, {park: }]}\n"
RECIPE = "recipe: r\nworkflow: w\nsamples: [{id: a, source: beads}]\n"


@pytest.mark.parametrize(
    "leaves",
    [
        "cell.hand.set_opening(2.0)",
        "cell.hand.set_vibration(1.0)",
        "cell.hand.start_morph(60.0, 8.0)",
        'cell.hand.set_opening(2.0); raise SkillFailed("hand.no_flow", "none comes")',
    ],
)
def test_a_skill_that_leaves_a_device_at_work_ends_the_run_by_its_name_before_anything_else_moves(
    tmp_path: Path, leaves: str
) -> None:
    lab = make_lab(tmp_path / "lab", skills__careless=CARELESS % leaves, trees__w=TREE)
    ran = dry_run(tmp_path, RECIPE, lab=lab)
    assert ran.result.exit_code == 3
    assert "the skill careless" in ran.result.reason
    assert "hand" in ran.result.reason
    assert [(row["skill"], row["outcome"]) for row in read(ran.journal, "action")] == [("careless", "broken")]
    assert ran.session.cell.device("hand").is_stopped
    assert ran.session.cell.clock.now_s < 0.5 + REST_S + 5.0


@pytest.mark.parametrize("leaves", ["cell.hand.set_opening(2.0); cell.hand.set_opening(0.0)", "return"])
def test_a_skill_may_end_while_its_valve_still_closes_and_the_next_action_waits_for_it(
    tmp_path: Path, leaves: str
) -> None:
    lab = make_lab(tmp_path / "lab", skills__careless=CARELESS % leaves, trees__w=TREE)
    ran = dry_run(tmp_path, RECIPE, lab=lab)
    acted = [(row["skill"], row["outcome"]) for row in read(ran.journal, "action")]
    assert acted[:2] == [("careless", "done"), ("park", "done")]
    assert "broke" not in ran.result.reason


# --- when exactly, on devices that only say whether they have stopped


class Left(Skill[None]):
    """End while the hand still moves."""

    devices: ClassVar[tuple[str, ...]] = ("hand",)

    def run(self, cell: FakeCell) -> Steps[None]:  # type: ignore[override]
        yield from wait_until(cell, 1.0)
        cell.device("hand").is_stopped = False
        cell.note("left")


class Next(Skill[None]):
    """Note when it begins."""

    def run(self, cell: FakeCell) -> Steps[None]:  # type: ignore[override]
        cell.note("next")
        return
        yield


SEQUENCE = "sequence: [{left: }, {next: }]"
SKILLS = {"left": Left, "next": Next}


class Stops(FakeDevice):
    """Stops when it is told to."""

    def stop(self) -> None:
        self.is_stopped = True


def come_to_rest(hand: FakeDevice) -> None:
    hand.is_stopped = True
    hand.news.fire()


def test_the_next_action_begins_when_the_device_is_at_rest(bench: Bench) -> None:
    bench.agenda.at(1.0 + 0.9 * REST_S, lambda: come_to_rest(bench.cell.devices["hand"]))
    bench.run(SEQUENCE, SKILLS)
    assert bench.log == [(1.0, "left"), (1.0 + 0.9 * REST_S, "next")]
    assert bench.actions() == [("left", "done"), ("next", "done")]


def test_a_device_that_is_at_work_for_longer_is_stopped_and_the_skill_is_named(bench: Bench) -> None:
    bench.cell.devices = {**bench.cell.devices, "hand": Stops()}
    with pytest.raises(SkillBug, match=r"the skill left .* hand"):
        bench.run(SEQUENCE, SKILLS)
    assert bench.cell.devices["hand"].is_stopped
    assert bench.cell.clock.now_s == pytest.approx(1.0 + REST_S)
    assert bench.actions() == [("left", "broken")]


def test_a_device_that_has_failed_is_not_the_skills_doing(bench: Bench) -> None:
    bench.cell.devices["hand"].fault = SkillFailed("device.lost", "unplugged")
    bench.agenda.at(5.0, lambda: come_to_rest(bench.cell.devices["hand"]))
    bench.run(SEQUENCE, SKILLS)
    assert bench.actions()[0] == ("left", "done")
