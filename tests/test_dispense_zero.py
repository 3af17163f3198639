"""The skill `dispense` and the balance's zero: steps, drift and creep are no powder."""

import math
from dataclasses import replace

import pytest
from dispense_bench import BEADS, TARGET_MG, TOLERANCE_MG, WEIGHING_S, Rig
from dose_bench import DISH

from scuhand_bt.cell.places import over_balance
from scuhand_bt.dosing import CONTROLLERS, Command, Finish, Observation, Stream, Weigh
from scuhand_bt.dosing.bracket import Gross
from scuhand_bt.dosing.characteristic import Step
from scuhand_bt.events.doses import Dose, Pulsed
from scuhand_bt.events.weighings import DoseWeighed
from scuhand_bt.failures import SkillFailed
from scuhand_bt.lab import Lab

POURED = 70
"""Readings that what is poured takes."""
CAME_MG = 5 * TARGET_MG / POURED
"""What comes in five of them hides as much of a fall."""


class Pours:
    """A controller that lets everything fall while it streams, shaking so much, and then says that it is done."""

    name, estimate_mg = "pours", 0.0

    def __init__(self, rig: Rig, vibration: float) -> None:
        self._rig, self._streams, self._vibration = rig, 0, vibration

    def decide(self, seen: Observation | None) -> Command:
        if seen is not None and seen.stable:
            return Finish("reached", seen.net_mg, seen.uncertainty_mg)
        self._streams += 1
        if self._streams > POURED:
            return Weigh()
        self._rig.balance.load_mg += TARGET_MG / POURED
        return Stream(0.5, self._vibration)


@pytest.fixture
def rig(starter: Lab, monkeypatch: pytest.MonkeyPatch) -> Rig:
    return Rig(starter, monkeypatch)


@pytest.mark.parametrize(
    ("by_mg", "vibration", "remembered_mg"),
    [(-4.2, 0.0, 4.2 - CAME_MG), (-4.0, 0.0, 0.0), (6.0, 0.0, 0.0), (-20.0, 0.0, 20.0 - CAME_MG), (-20.0, 0.5, 0.0)],
)
def test_a_zero_that_falls_while_powder_comes_is_remembered_unless_it_is_shaken(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, by_mg: float, vibration: float, remembered_mg: float
) -> None:
    monkeypatch.setitem(CONTROLLERS, "pours", lambda request: Pours(rig, vibration))  # type: ignore[arg-type]
    begins_mg = rig.balance.load_mg
    rig.balance.zero_mg = lambda time_s: by_mg if rig.balance.load_mg > begins_mg + TARGET_MG / 2 else 0.0
    skill = rig.skill("dispense", mass_mg=TARGET_MG, tolerance_mg=30.0, controller="pours")
    rig.bench.drive(skill.run(rig.cell))
    assert rig.cell.believed.zero_stepped_mg == pytest.approx(remembered_mg)


@pytest.mark.parametrize(
    ("digit_mg", "why"),
    [
        (2.0, "are multiples of 2 mg apart, but robot/cell.yaml gives a readability of 0.1 mg"),
        (0.1, "the display stood still"),
    ],
)
def test_a_display_of_coarser_digits_stands_still_between_them_and_is_told_for_what_it_is(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, digit_mg: float, why: str
) -> None:
    """Set by hand to whole milligrams in the middle of a batch; or a display that holds what it shows."""
    monkeypatch.setitem(CONTROLLERS, "pours", lambda request: Pours(rig, 0.0))  # type: ignore[arg-type]
    begins_mg = rig.balance.load_mg

    def shown_mg(time_s: float) -> float:
        came_mg = rig.balance.load_mg - begins_mg
        held_mg = 0.0 if came_mg < TARGET_MG / 2 else came_mg
        return digit_mg * round(held_mg / digit_mg) - came_mg

    rig.balance.zero_mg = shown_mg
    skill = rig.skill("dispense", mass_mg=TARGET_MG, tolerance_mg=30.0, controller="pours")
    with pytest.raises(SkillFailed, match=rf"balance\.coarse: .*{why}"):
        rig.bench.drive(skill.run(rig.cell))


def test_a_zero_that_stepped_between_tare_and_dose_is_not_in_the_dose(rig: Rig) -> None:
    rig.balance.zero_mg = lambda time_s: 3.0
    dose = rig.dispense(TARGET_MG)
    assert dose.dispensed_mg == pytest.approx(TARGET_MG)
    assert dose.verdict == "in tolerance"
    assert rig.kept(DoseWeighed)[0].before.gross_mg == 25_003.0
    assert rig.cell.believed.zero_stepped_mg == pytest.approx(3.0), "and is remembered"


@pytest.mark.parametrize("number", [2, 3], ids=["the container's", "the one before the dose"])
def test_a_weighing_that_is_off_by_chance_makes_no_drift_over_a_long_dose(rig: Rig, number: int) -> None:
    rig.balance.uncertainty_mg = 0.035
    off_s = number * WEIGHING_S
    rig.balance.zero_mg = lambda time_s: 0.19 if abs(time_s - off_s) < 0.5 else 0.0
    if number == 2:
        rig.bench.drive(rig.skill("tare").run(rig.cell))
    dose = rig.dispense(TARGET_MG)
    assert rig.kept(DoseWeighed)[0].before.gross_mg == 25_000.0, "it was looked at anew"
    assert rig.kept(DoseWeighed)[0].drift_mg_per_s == 0.0
    assert dose.dispensed_mg == pytest.approx(TARGET_MG)


def test_a_drift_that_shows_before_the_dose_is_looked_at_anew_and_taken_out(rig: Rig) -> None:
    rig.balance.uncertainty_mg = 0.03
    rig.balance.zero_mg = lambda time_s: 0.08 * min(time_s, 7.0)
    rig.dispense(TARGET_MG)
    assert rig.kept(DoseWeighed)[0].before.gross_mg == pytest.approx(25_000.56), "7 s after the dish was put down"
    assert rig.kept(DoseWeighed)[0].drift_mg_per_s == pytest.approx(0.08, abs=0.002)


@pytest.mark.parametrize(("by_mg", "remembered_mg"), [(-1.0, 1.0), (1.0, 0.0), (0.0, 0.0)])
def test_after_a_dose_what_is_lost_is_the_zeros_and_what_comes_may_be_powder(
    rig: Rig, by_mg: float, remembered_mg: float
) -> None:
    rig.balance.zero_mg = lambda time_s: by_mg if rig.seen and time_s > rig.seen[-1].time_s else 0.0
    rig.dispense(TARGET_MG)
    assert rig.cell.believed.zero_stepped_mg == pytest.approx(remembered_mg)


@pytest.mark.parametrize("fallen_mg", [0.0, 3.0])
def test_the_last_swings_of_a_filter_after_a_dose_are_no_step_of_the_zero_and_a_step_after_them_is(
    rig: Rig, fallen_mg: float
) -> None:
    """It steps once the dose was weighed for the second time, at rest; what the swing showed before is not believed."""
    times_s = [0.1 * number for number in range(1, 1000)]
    rig.cell.came = Step(25_000.0, tuple(times_s), tuple(-math.exp(-time_s / 3.0) for time_s in times_s))
    before_mg, opened_s = rig.balance.load_mg, rig.clock.now_s

    def zero_mg(time_s: float) -> float:
        if rig.balance.load_mg == before_mg:
            return 0.0
        is_at_rest = len(rig.kept(Pulsed)) > 1
        return TARGET_MG * math.exp((opened_s - time_s) / 3.0) - fallen_mg * is_at_rest

    rig.balance.zero_mg = zero_mg
    dose = rig.dispense(TARGET_MG)
    assert rig.cell.believed.zero_stepped_mg == pytest.approx(fallen_mg, abs=0.1)
    assert dose.dispensed_mg == pytest.approx(TARGET_MG - fallen_mg, abs=0.1)


def test_a_step_while_a_filters_last_swings_are_waited_for_is_remembered(rig: Rig) -> None:
    """Else the dose went on, to 3 mg too much, and was reported good where the zero came back with the next lift."""
    times_s = [0.1 * number for number in range(1, 1000)]
    rig.cell.came = Step(25_000.0, tuple(times_s), tuple(-math.exp(-time_s / 0.4) for time_s in times_s))
    rig.balance.zero_mg = lambda time_s: -100.0 * (len(rig.kept(Pulsed)) > 0)
    rig.dispense(TARGET_MG, reason="cone_empty")
    assert rig.cell.believed.zero_stepped_mg == pytest.approx(100.0, abs=0.1)


def test_a_pan_that_creeps_is_not_dosed_on(rig: Rig) -> None:
    rig.balance.zero_mg = lambda time_s: 0.5 * time_s
    with pytest.raises(SkillFailed, match=r"balance\.drifting: after 60 s the reading still changes by \+0\.50 mg/s"):
        rig.dispense(TARGET_MG)
    assert rig.brings == [TARGET_MG], "the valve stayed shut"


def test_a_pan_that_creeps_after_the_dose_says_so_and_the_dose_stays_unweighed(rig: Rig) -> None:
    rig.balance.zero_mg = lambda time_s: 0.5 * time_s if rig.balance.load_mg > 25_001.0 else 0.0
    with pytest.raises(SkillFailed, match=r"balance\.drifting"):
        rig.dispense(TARGET_MG)
    assert rig.cell.believed.dosing.is_unweighed
    assert rig.kept(Dose) == []


def test_what_a_balance_that_is_not_believed_shows_of_a_dose_is_said_though_it_is_none(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("scuhand_bt.cell.pan_cleared.is_frozen", lambda readings_mg, digit_mg: True)
    with pytest.raises(
        SkillFailed, match=r"balance\.coarse: .*\. The balance shows 50\.0 mg in the container; this does not count"
    ):
        rig.dispense(50.0)


@pytest.mark.parametrize("skill", ["tare", "dispense"])
def test_a_container_that_weighs_less_after_a_dose_broke_off_is_another_one(rig: Rig, skill: str) -> None:
    """30 mg less were taken for a dose of -30 mg, and 80 mg were dosed into it for 50."""
    believed = rig.cell.believed
    place, _ = over_balance(rig.cell.spec, DISH)
    rig.cell = replace(rig.cell, places_mm={place: rig.cell.apex_mm()})
    inputs = {"mass_mg": TARGET_MG, "tolerance_mg": TOLERANCE_MG} if skill == "dispense" else {}
    believed.dosing_towards(TARGET_MG, BEADS.name, Gross(25_000.0, 0.0, rig.clock.now_s))
    believed.dosing_ended(5.0, 25_005.0)
    rig.balance.load_mg -= 30.0
    for _ in range(2):  # trying again does not make it the same
        with pytest.raises(SkillFailed, match=r"has gained -30\.0 mg") as failed:
            rig.bench.drive(rig.skill(skill, **inputs).run(rig.cell))
        assert failed.value.code == "container.changed"
    if skill == "dispense":
        assert believed.bracket is not None, "a resumed run may find that it was the balance"
        return
    with pytest.raises(
        SkillFailed,
        match=r"was on the pan before: 'dish' has gained -30\.0 mg since it was last weighed; possible gains are",
    ):
        rig.bench.drive(rig.skill("place_container", container=DISH).run(rig.cell))
    assert [closed.closes for closed in believed.closed] == [False]
