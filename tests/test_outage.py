"""A power cut changes what it can, and a resumed run says no 'in tolerance' that the container does not hold."""

import csv
import functools
import io
import random
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from daily import first_daily

from harness.kill import Batch, Kill, journals, run_child
from harness.power_cut import Tally, cut_until_done, make_power_batch
from scuhand_bt.journal.history import read_history
from scuhand_bt.journal.reader import open_contents, read
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.problems import SourceError
from scuhand_bt.report.weighing_record import weighing_csv
from scuhand_bt.run.options import Options
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import Rehearsal
from scuhand_bt.sim.arm import SimulatedArm
from scuhand_bt.sim.fault_rules import parse_faults
from scuhand_bt.sim.outage import SAG_RAD

HEAD = """
recipe: cut
workflow: fill_xrd_holder
sources: {beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 20 g}}
defaults: {source: beads, container: xrd_holder, tolerance: 2 mg}
"""
ONE = HEAD + "samples: [{id: a, mass: 80 mg}]\n"
TWO = HEAD + "samples: [{id: a, mass: 80 mg}, {id: b, mass: 40 mg}]\n"
THREE = HEAD + "samples: [{id: a, mass: 80 mg}, {id: b, mass: 40 mg}, {id: c, mass: 20 mg}]\n"
REDO = "on_failure: {container.changed: redo, otherwise: stop}\n"


@functools.cache
def planner() -> list[MotionPlanner]:
    """One for all runs of these places, once it is made."""
    return []


class CutRun:
    """A dry run whose power is cut, each time with the same consequence."""

    def __init__(self, folder: Path, only: str, text: str = ONE, **options: Any) -> None:
        known = planner()
        made = make_power_batch(folder, 3, known[0] if known else None, only, text)
        known[:] = [made.motion]
        self.batch: Batch = replace(made, **options)

    @property
    def journal(self) -> Path | None:
        return next(journals(self.batch.folder), None)

    def cut(self, within: str, at_tick: int = 25, *, is_open: bool = False) -> None:
        """Run, or go on, and lose the power at this tick of a skill, of those with an open valve if it `is_open`."""
        assert run_child(self.batch, self.journal, Kill(at_tick=at_tick, within=within, is_open=is_open)) is None

    def resume(self) -> int:
        """The run's exit code."""
        code = run_child(self.batch, self.journal, Kill())
        assert code is not None
        return code

    def told(self, kind: str) -> list[dict[str, Any]]:
        assert self.journal is not None
        return [event["payload"] for event in read(self.journal, "event") if event["kind"] == kind]

    def sample(self, name: str = "a") -> dict[str, Any]:
        return [one for one in self.told("sample") if one["id"] == name][-1]


def good(sample: dict[str, Any]) -> bool:
    return (sample["verdict"], sample.get("code")) == ("in tolerance", None)


@pytest.mark.parametrize("only", ["outage.zero_at_power_on", "outage.zero_moved"])
@pytest.mark.parametrize("ticks", first_daily([25], [70], [40, 20]))
def test_a_dose_whose_balance_lost_its_zero_is_told_by_the_bare_pan(
    tmp_path: Path, only: str, ticks: Sequence[int]
) -> None:
    run = CutRun(tmp_path, only)
    for at_tick in ticks:
        run.cut("dispense", at_tick)
    assert run.resume() == 0
    assert good(run.sample())
    assert run.sample()["dispensed_mg"] == pytest.approx(run.sample()["true_mg"], abs=0.5)
    found = run.told("container_reweighed")
    assert [one["counts"] for one in found] == [True] * len(ticks)
    assert run.told("reweighed") == [], "it was weighed already"


def test_what_was_weighed_after_the_outage_is_in_the_weighing_record(tmp_path: Path) -> None:
    run = CutRun(tmp_path, "outage.zero_at_power_on")
    run.cut("dispense", 70)
    run.resume()
    assert run.journal is not None
    with open_contents(run.journal) as contents:
        rows = list(csv.DictReader(io.StringIO(weighing_csv(contents))))
    (row,) = [row for row in rows if row["weighing"] == "after an outage"]
    (found,) = run.told("container_reweighed")
    assert row["container"] == "a"
    assert float(row["net_mg"]) == pytest.approx(found["held_mg"], abs=1e-3)
    assert row["tare_lines"]
    assert row["gross_lines"]


@pytest.mark.slow
def test_a_batch_whose_power_is_cut_again_and_again_calls_nothing_good_that_is_not(tmp_path: Path) -> None:
    tally = Tally()
    cut_until_done(make_power_batch(tmp_path, 1), random.Random(2), 6, tally)
    assert tally.problems == []
    assert (tally.batches, tally.doses) == (1, 4)
    assert tally.good >= 2
    assert tally.came.total() > 0


def test_what_the_outage_adds_to_the_uncertainty_is_in_the_dose(tmp_path: Path) -> None:
    whole, cut = CutRun(tmp_path / "whole", "outage.zero_moved"), CutRun(tmp_path / "cut", "outage.zero_moved")
    whole.resume()
    cut.cut("dispense", 70)
    cut.resume()
    (found,) = cut.told("container_reweighed")
    assert cut.sample()["uncertainty_mg"] > found["uncertainty_mg"] > whole.sample()["uncertainty_mg"]


@pytest.mark.parametrize("within", first_daily("park", "place_container"))
def test_a_zero_that_moved_while_a_filled_container_stood_there_leaves_its_dose_confirmed(
    tmp_path: Path, within: str
) -> None:
    run = CutRun(tmp_path, "outage.zero_at_power_on", TWO)
    run.cut("dispense", 70)
    run.cut(within, 3)
    assert run.resume() == 0
    for name in ("a", "b"):
        assert good(run.sample(name))
        assert [dose["bracket"] for dose in run.sample(name)["doses"]] == ["closed"]


@pytest.mark.parametrize("at_event", first_daily("answered", "asked", "container_reweighed"))
def test_a_cut_while_it_is_settled_what_the_last_one_did_changes_nothing(tmp_path: Path, at_event: str) -> None:
    run = CutRun(tmp_path, "outage.zero_at_power_on")
    run.cut("dispense", 60)
    assert run.journal is not None
    stood = read_history(run.journal).state["joints_rad"]
    assert run_child(run.batch, run.journal, Kill(at_event=at_event)) is None
    assert read_history(run.journal).state["joints_rad"] == stood, "where the arm is to go back to"
    assert run.resume() == 0
    assert good(run.sample())
    assert [one["bracket"] for one in run.sample()["doses"]] == ["closed"]
    assert run.told("matter")[-1]["spilled"] == 0.0, "the arm was over the container again"


@pytest.mark.parametrize("only", first_daily("outage.container_exchanged", "outage.container_taken"))
def test_a_container_that_a_hand_took_or_exchanged_counts_no_more_and_its_sample_is_done_in_another(
    tmp_path: Path, only: str
) -> None:
    run = CutRun(tmp_path, only, ONE + REDO)
    run.cut("dispense")
    assert run.resume() == 0
    assert [(one["attempt"], one.get("code")) for one in run.told("sample")][:2] == [
        (1, "container.changed"),
        (2, None),
    ]
    assert good(run.sample())
    assert [dose["container"] for dose in run.sample()["doses"]] == ["a#2"]
    assert run.sample()["true_mg"] == pytest.approx(80.0, abs=2.0)


def test_a_container_exchanged_before_its_first_powder_counts_no_more(tmp_path: Path) -> None:
    run = CutRun(tmp_path, "outage.container_exchanged", ONE + REDO)
    run.cut("move_over", 2)
    assert run.resume() == 0
    (found,) = run.told("container_reweighed")
    assert not found["counts"]
    assert run.told("sample")[0]["code"] == "container.changed"
    assert good(run.sample())


def test_unattended_a_container_that_cannot_weigh_so_ends_the_run_safe_with_a_code_of_its_own(tmp_path: Path) -> None:
    run = CutRun(tmp_path, "outage.container_taken", unattended=True)
    run.cut("dispense")
    assert run.resume() == 3
    assert run.sample()["code"] == "container.changed"
    assert "'a' weighs as if it held -9" in run.sample()["detail"]
    assert run.told("asked") == []
    (found,) = run.told("container_reweighed")
    assert not found["counts"]


def test_unattended_what_physics_allows_counts_and_nobody_is_asked(tmp_path: Path) -> None:
    run = CutRun(tmp_path, "outage.zero_at_power_on", unattended=True)
    run.cut("dispense", 70)
    assert run.resume() == 0
    assert good(run.sample())
    assert run.told("asked") == []


def test_where_a_dose_was_under_way_a_person_says_whether_it_is_the_same_container(tmp_path: Path) -> None:
    run = CutRun(tmp_path, "outage.zero_moved")
    run.cut("dispense")
    run.resume()
    (asked,) = run.told("asked")
    assert "Is it another container, or the same one? The same one counts with what it weighs now." in asked["question"]
    assert asked["choices"] == ["same", "another", "stop"]


def test_all_that_ran_out_of_a_valve_without_power_is_in_the_dose(tmp_path: Path) -> None:
    run = CutRun(tmp_path, "outage.valve_open")
    run.cut("dispense", 34, is_open=True)  # the world that is left may be a second older: there, too, powder came
    assert run.resume() == 1
    assert run.sample()["code"] == "dose.overshoot"
    assert run.sample()["dispensed_mg"] == pytest.approx(run.sample()["true_mg"], abs=0.5)


def test_a_roller_that_forgot_its_turns_is_not_believed(tmp_path: Path) -> None:
    run = CutRun(tmp_path, "outage.roller_lost")
    run.cut("scoop", 4)
    assert run.resume() == 0
    (asked,) = run.told("asked")
    assert asked["question"] == "The roller has lost count of its turns. How wide is the cone's rim?"
    assert asked["choices"][-2:] == ["none", "stop"]
    (answered,) = run.told("answered")
    assert answered["answer"] in asked["choices"][:-2], "a person sees it"


def test_unattended_a_roller_that_forgot_its_turns_ends_the_run_before_anything_moves(tmp_path: Path) -> None:
    run = CutRun(tmp_path, "outage.roller_lost", unattended=True)
    run.cut("scoop", 4)
    assert run.journal is not None
    before = len(read(run.journal, "action"))
    assert run.resume() == 3
    assert len(read(run.journal, "action")) == before
    assert run.told("ended")[-1]["reason"].startswith("operator.absent: ")


def test_what_was_done_before_a_start_that_came_to_nothing_stays_told(tmp_path: Path) -> None:
    run = CutRun(tmp_path, "outage.roller_lost", THREE, unattended=True)
    run.cut("dispense", 130)
    before = run.told("sample")
    assert [(one["id"], one["verdict"]) for one in before] == [("a", "in tolerance")] * len(before)
    assert run.resume() == 3
    told = {name: run.sample(name) for name in "abc"}
    assert [one["verdict"] for one in told.values()] == ["in tolerance", "interrupted", "not run"]
    assert good(told["a"]), "its container has gone, though nobody had told so yet"
    assert run.resume() == 3, "and so on"
    assert good(run.sample())


def test_a_limp_arm_and_a_changer_gone_home_are_no_harm(tmp_path: Path) -> None:
    for only, within in (("outage.arm_limp", "dispense"), ("outage.changer_lost", "place_container")):
        run = CutRun(tmp_path / only, only)
        run.cut(within, 10)
        assert run.resume() == 0
        assert good(run.sample())


@pytest.mark.parametrize(("within", "at_tick", "overlap_mm"), first_daily(("open_cone", 10, 21), ("scoop", 44, 23)))
def test_an_arm_that_sank_with_its_cone_in_a_mortar_goes_out_of_what_it_touches_by_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, within: str, at_tick: int, overlap_mm: int
) -> None:
    sink = SimulatedArm.sink
    monkeypatch.setattr(SimulatedArm, "sink", lambda arm, by_rad: sink(arm, SAG_RAD))
    run = CutRun(tmp_path, "outage.arm_limp")
    run.cut(within, at_tick)
    assert run.resume() == 0
    assert good(run.sample())
    (freed,) = run.told("arm_freed")
    assert f"overlap by {overlap_mm} mm" in freed["what"]


def test_an_arm_that_sank_into_the_container_does_not_go_back_into_it_once_that_is_weighed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The run ended with arm.no_path, as the container was in the way there."""
    sink = SimulatedArm.sink
    monkeypatch.setattr(SimulatedArm, "sink", lambda arm, by_rad: sink(arm, SAG_RAD))
    into = "workflow: fill_crucible, container: alumina_crucible"
    run = CutRun(tmp_path, "outage.arm_limp", ONE.replace("mass:", f"{into}, mass:"))
    run.cut("dispense", 60)
    assert run.resume() == 0
    assert good(run.sample())
    assert "alumina_crucible" in run.told("arm_freed")[0]["what"]


def test_a_rehearsal_refuses_outages_which_its_twins_do_not_have(tmp_path: Path) -> None:
    run = CutRun(tmp_path, "outage.zero_moved")
    options = Options(Rehearsal(faults=run.batch.faults), folder=tmp_path)
    with pytest.raises(
        SourceError, match=r"'outage\.zero_moved' has no effect here: twins that have ended are there again"
    ):
        Session(run.batch.plan, run.batch.lab, options, run.batch.motion)


def test_a_balance_that_was_off_within_a_dose_stops_it_and_the_resumed_run_weighs_about_the_bare_pan(
    tmp_path: Path,
) -> None:
    made = CutRun(tmp_path, "outage.zero_moved")
    off = parse_faults("faults: [{fault: balance.restarted, at_pulse: 1}]", "off")
    made.batch = replace(made.batch, faults=off)
    assert made.resume() == 3
    assert made.sample()["code"] == "container.moved"
    assert made.resume() == 0
    assert good(made.sample())
    assert made.sample()["dispensed_mg"] == pytest.approx(made.sample()["true_mg"], abs=0.5)


@pytest.mark.parametrize(("only", "counts_on"), [("outage.arm_limp", False), ("outage.zero_moved", True)])
def test_what_was_in_the_cone_of_an_arm_that_was_limp_is_not_counted_on(
    tmp_path: Path, only: str, counts_on: bool
) -> None:
    cut = CutRun(tmp_path, only)
    cut.cut("dispense", 60)
    assert cut.resume() == 0
    assert good(cut.sample())
    assert (cut.told("returned")[-1]["expected_mg"] > 0.0) == counts_on
