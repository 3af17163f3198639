"""A run that is paused, or stopped and resumed, while a container changes beside a scoop."""

from pathlib import Path
from typing import Any

import pytest
from daily import first_daily
from py_trees.common import Status
from running import Watching, make_lab, shared_planner

from scuhand_bt.cell.places import CLEAR_MM
from scuhand_bt.events.entry import Event, Note
from scuhand_bt.journal.reader import read
from scuhand_bt.journal.run_events import Paused
from scuhand_bt.lab import load_lab
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.options import Options
from scuhand_bt.run.resume import checked_history, resumable
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun
from scuhand_bt.sim.fault_rules import parse_faults

RECIPE = """
recipe: one
workflow: fill_crucible
sources: {beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 20 g}}
samples:
  - {id: a, source: beads, container: alumina_crucible, mass: 500 mg, tolerance: 10 mg}
"""
SWINGS_S, IN_THE_MORTAR_S, SETTLES_S = 1.0, 5.5, 7.5
"""When the wheel swings and the arm goes to the mortar; when the lip is on its wall; when the pan comes to rest."""


LEAVING = """
workflow: fill_crucible
inputs: {source: Source, container: Container, mass: Mass, tolerance: {type: Mass, default: 2 mg}}
result: $dose
tree:
  sequence:
    - place_and_scoop: {source: $source, container: $container, mass: $mass}
    - fill: {source: $source, container: $container, mass: $mass, tolerance: $tolerance, as: dose}
    - parallel:
        - remove_container:
        - sequence: [{park: }, {return_leftover: {source: $source}}]
"""
DOSING_BESIDE = """
workflow: fill_crucible
inputs: {source: Source, container: Container, mass: Mass, tolerance: {type: Mass, default: 2 mg}}
result: $dose
tree:
  sequence:
    - place_and_scoop: {source: $source, container: $container, mass: $mass}
    - move_over: {container: $container}
    - parallel:
        - wait: {duration: 60 s}
        - dispense: {mass: $mass, tolerance: $tolerance, as: dose}
    - return_leftover: {source: $source}
    - park:
"""
DOSING_S = 26.0
"""When it doses."""
OVER_THE_PAN_MM, ASIDE_OF_IT_MM = 10.0, CLEAR_MM + 5.0
"""How far the apex has come from the pan's middle, the cone in the zone still."""


class Wishing(Watching):
    """Wishes something at a time of the run, once."""

    def __init__(self, wish: str, at_s: float) -> None:
        super().__init__()
        self.wish, self.at_s = wish, at_s

    def ticked(self, root: Any) -> None:
        assert self.session is not None
        if self.wish and self.session.cell.clock.now_s >= self.at_s:
            self.session.control.wish(self.wish)  # type: ignore[arg-type]
            self.wish = ""


class InTheZone(Wishing):
    """Wishes it as the arm leaves the pan, so far from its middle."""

    def __init__(self, wish: str, aside_mm: float) -> None:
        super().__init__(wish, 0.0)
        self.aside_mm = aside_mm

    def ticked(self, root: Any) -> None:
        assert self.session is not None
        cell = self.session.cell
        is_parking = any(node.name == "park" and node.status is Status.RUNNING for node in root.iterate())
        if is_parking and cell.aside_of_pan_mm() > self.aside_mm and "pan" in cell.zones_entered():
            super().ticked(root)


class Desk:
    """A lab with one recipe, run and resumed."""

    def __init__(self, folder: Path, **files: str) -> None:
        self.lab = load_lab(make_lab(folder / "lab", **files))
        recipe = self.lab.folder / "recipes" / "one.yaml"
        recipe.parent.mkdir()
        recipe.write_text(RECIPE, encoding="utf-8")
        self.plan = make_plan(load_recipe(recipe, self.lab), self.lab)
        self.runs = folder / "runs"

    @property
    def journal(self) -> Path:
        (journal,) = self.runs.glob("*.sqlite")
        return journal

    def go(self, wishing: Wishing, *, resumes: bool = False, faults: str = "") -> Any:
        found = None
        dry = DryRun(1, faults=parse_faults(faults, "faults") if faults else None)
        if resumes:
            found = resumable(self.journal, checked_history(self.journal), self.plan, self.lab, accept_changes=False)
        motion = shared_planner(self.plan, self.lab)
        session = Session(self.plan, self.lab, Options(dry, None, self.runs), motion, resumes=found)
        wishing.session = session
        heard = session.journal.heard

        def hear(event: Event | Note) -> None:
            heard(event)
            if isinstance(event, Paused):
                session.control.wish("continue")

        session.journal.heard = hear
        try:
            return session.run(wishing)
        finally:
            session.close()


@pytest.fixture
def desk(tmp_path: Path) -> Desk:
    return Desk(tmp_path)


def outcomes(journal: Path, skill: str) -> list[str]:
    return [row["outcome"] for row in read(journal, "action") if row["skill"] == skill]


def require_one_sound_dose(desk: Desk, result: Any) -> None:
    """What was begun anew leaves one container, one load that is known, and no powder elsewhere."""
    (sample,) = result.samples
    assert (result.exit_code, sample.verdict) == (0, "in tolerance")
    assert sample.true_mg == pytest.approx(500.0, abs=10.0)
    matter = [event["payload"] for event in read(desk.journal, "event") if event["kind"] == "matter"][-1]
    assert matter["spilled"] == 0.0
    assert matter["source:beads"] == pytest.approx(20_000.0 - sample.true_mg, abs=30.0)
    placed = [event for event in read(desk.journal, "event") if event["kind"] == "container"]
    assert len(placed) == 1


@pytest.mark.parametrize("at_s", first_daily(IN_THE_MORTAR_S, SWINGS_S, SETTLES_S))
def test_both_are_halted_by_a_pause_settled_and_begun_again(desk: Desk, at_s: float) -> None:
    require_one_sound_dose(desk, desk.go(Wishing("pause_now", at_s)))
    kinds = [event["kind"] for event in read(desk.journal, "event")]
    assert kinds.index("paused") < kinds.index("continued")
    assert outcomes(desk.journal, "place_container") == ["interrupted", "done"]
    assert outcomes(desk.journal, "scoop") == ["interrupted", "done"]


def test_both_come_to_their_end_before_a_pause_that_halts_none(desk: Desk) -> None:
    require_one_sound_dose(desk, desk.go(Wishing("pause", IN_THE_MORTAR_S)))
    assert outcomes(desk.journal, "place_container") == ["done"]
    assert outcomes(desk.journal, "scoop") == ["done"]
    events = read(desk.journal, "event")
    paused_s = next(event["time_s"] for event in events if event["kind"] == "paused")
    ended_s = [row["ended_s"] for row in read(desk.journal, "action") if row["skill"] in ("place_container", "scoop")]
    assert max(ended_s) <= paused_s


@pytest.mark.slow
@pytest.mark.parametrize("at_s", first_daily(IN_THE_MORTAR_S, SWINGS_S))
def test_a_run_that_was_stopped_there_is_resumed_to_its_end(desk: Desk, at_s: float) -> None:
    assert desk.go(Wishing("stop_now", at_s)).exit_code == 130
    require_one_sound_dose(desk, desk.go(Wishing("", 0.0), resumes=True))


@pytest.mark.parametrize("wish", first_daily("pause_now", "stop_now"))
@pytest.mark.parametrize("aside_mm", [ASIDE_OF_IT_MM, OVER_THE_PAN_MM])
def test_what_the_arm_is_halted_in_on_its_way_out_of_is_not_swept_before_it_has_left_it(
    tmp_path: Path, wish: str, aside_mm: float
) -> None:
    """`remove_container`, the first to go on, had leased the arm to see where it is, and so its own zone was free."""
    desk = Desk(tmp_path, trees__fill_crucible=LEAVING)
    wishing = InTheZone(wish, aside_mm)
    result = desk.go(wishing)
    assert not wishing.wish, "it was wished"
    if wish == "stop_now":
        result = desk.go(Wishing("", 0.0), resumes=True)
    require_one_sound_dose(desk, result)
    assert outcomes(desk.journal, "park")[:2] == ["interrupted", "done"]
    assert "failed" not in outcomes(desk.journal, "remove_container")


def test_a_dose_beside_what_goes_on_first_brings_the_arm_back_that_has_sunk(tmp_path: Path) -> None:
    """It had not leased the arm with which it settles: its own zone was closed to that, and 2 min later it failed."""
    desk = Desk(tmp_path, trees__fill_crucible=DOSING_BESIDE)
    limp = "faults:\n  - {fault: outage.arm_limp}\n"
    desk.go(Wishing("stop_now", DOSING_S), faults=limp)
    assert outcomes(desk.journal, "dispense") == ["interrupted"]
    ended = desk.go(Wishing("", 0.0), resumes=True, faults=limp)
    assert [(sample.verdict, sample.code) for sample in ended.samples] == [("in tolerance", None)]
