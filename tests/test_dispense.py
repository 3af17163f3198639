"""The skill `dispense`: what it makes of a controller's last word."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from dose_bench import DISH, Bench, shipped_powders

from scuhand_bt.dosing import CONTROLLERS, Command, DoseRequest, Finish, Observation, Pulse, Weigh, new_controller
from scuhand_bt.events import Dose, Note, SkillEvent
from scuhand_bt.failures import SkillFailed
from scuhand_bt.lab import Lab
from scuhand_bt.record import Record

BEADS = shipped_powders()["glass_beads"]
TARGET_MG, TOLERANCE_MG, UNCERTAINTY_MG = 50.0, 2.0, 0.25
ALLOWED_MG = 1.5
"""The tolerance less twice the uncertainty."""


class LastWord:
    """A controller that opens the valve for a moment, vibrating, and then says what it is told to say."""

    name = "last_word"
    estimate_mg = 0.0

    def __init__(self, finish: Finish) -> None:
        self._finish = finish

    def decide(self, seen: Observation | None) -> Command:
        return Pulse(0.2, 0.5, 1.0) if seen is None else self._finish


Dispense = Callable[..., Dose]


@pytest.fixture
def rig() -> Bench:
    rig = Bench(BEADS, TARGET_MG)
    gross_mg = rig.drive(rig.cell.balance.stable_mean()).value_mg
    believed = rig.cell.believed
    believed.brought(DISH, from_changer=False)
    believed.placed(gross_mg)
    believed.tared(gross_mg, rig.clock.now_s)
    believed.source_holds("store", 7000.0)
    believed.cone_holds(rig.cell.sources["store"], 3000.0)
    return rig


@pytest.fixture
def dispense(rig: Bench, starter: Lab, monkeypatch: pytest.MonkeyPatch) -> Dispense:
    """Dispenses 50 ± 2 mg, with a controller that ends so far from the target."""

    def run(error_mg: float, reason: Any = "reached", uncertainty_mg: float = UNCERTAINTY_MG) -> Dose:
        def make(request: DoseRequest) -> LastWord:
            return LastWord(Finish(reason, TARGET_MG + error_mg, uncertainty_mg))

        monkeypatch.setitem(CONTROLLERS, "last_word", make)  # type: ignore[arg-type]
        skill = starter.library.skills["dispense"](mass_mg=TARGET_MG, tolerance_mg=TOLERANCE_MG, controller="last_word")
        dose: Dose = rig.drive(skill.run(rig.cell))
        return dose

    return run


@pytest.mark.parametrize(
    ("error_mg", "verdict"),
    [
        (0.0, "in tolerance"),
        (ALLOWED_MG, "in tolerance"),
        (ALLOWED_MG + 0.001, "over"),
        (-ALLOWED_MG, "in tolerance"),
        (-ALLOWED_MG - 0.001, "under"),
        (TOLERANCE_MG, "over"),
        (-TOLERANCE_MG, "under"),
        (-40.0, "under"),
    ],
)
def test_in_tolerance_means_by_more_than_twice_the_uncertainty(
    dispense: Dispense, error_mg: float, verdict: str
) -> None:
    assert dispense(error_mg).verdict == verdict


def test_a_measurement_without_doubt_may_use_the_whole_tolerance(dispense: Dispense) -> None:
    assert dispense(TOLERANCE_MG, uncertainty_mg=0.0).verdict == "in tolerance"


@pytest.mark.parametrize(("error_mg", "verdict"), [(-0.001, "under"), (0.0, "under"), (0.001, "over")])
def test_a_measurement_worse_than_the_tolerance_is_never_in_it(
    dispense: Dispense, error_mg: float, verdict: str
) -> None:
    assert dispense(error_mg, uncertainty_mg=1.001).verdict == verdict


def test_too_much_for_the_tolerance_is_an_overshoot_and_the_dose_is_recorded_as_over(
    dispense: Dispense, rig: Bench
) -> None:
    written: list[SkillEvent | Note] = []
    rig.cell = replace(rig.cell, record=Record(written.append))
    with pytest.raises(SkillFailed, match=r"dose\.overshoot: 52\.0 mg of 50 mg: 2\.0 mg too much"):
        dispense(TOLERANCE_MG + 0.001)
    assert [event.verdict for event in written if isinstance(event, Dose)] == ["over"]


@pytest.mark.parametrize(
    ("reason", "code"),
    [("empty", "hand.cone_empty"), ("no_flow", "hand.no_flow"), ("step_limit", "dose.not_reached")],
)
def test_a_controller_that_gave_up_fails_the_skill_by_its_reason(dispense: Dispense, reason: str, code: str) -> None:
    with pytest.raises(SkillFailed) as failed:
        dispense(-20.0, reason)
    assert failed.value.code == code


def test_a_cone_that_ran_empty_holds_nothing_and_what_it_was_thought_to_hold_is_in_the_mortar(
    dispense: Dispense, rig: Bench
) -> None:
    with pytest.raises(SkillFailed, match=r"hand\.cone_empty"):
        dispense(-20.0, "empty")
    believed = rig.cell.believed
    assert (believed.cone_mg, believed.cone_source) == (0.0, None)
    assert believed.sources_mg["store"] == pytest.approx(10_000.0, abs=1.0)


def test_a_dose_says_what_was_asked_what_is_there_and_what_it_took_in_all(dispense: Dispense, rig: Bench) -> None:
    believed, began_s = rig.cell.believed, rig.clock.now_s - 20.0
    believed.dose_began(began_s)
    believed.dosed(believed.pan_gross_mg or 0.0, pulses=3, vibration_s=1.5)
    dose = dispense(0.5)
    assert (dose.target_mg, dose.tolerance_mg, dose.dispensed_mg, dose.uncertainty_mg) == (50.0, 2.0, 50.5, 0.25)
    assert (dose.pulses, dose.controller) == (4, "last_word")
    assert dose.vibration_s == pytest.approx(1.5 + 0.7, abs=0.1)
    assert dose.duration_s == pytest.approx(rig.clock.now_s - began_s)
    assert dose.duration_s > 20.0


# --- the controllers' own knowledge of it


@pytest.mark.parametrize("streaming", [True, False])
@pytest.mark.parametrize(
    ("error_mg", "uncertainty_mg", "reason"),
    [
        (ALLOWED_MG, UNCERTAINTY_MG, "reached"),
        (-ALLOWED_MG, UNCERTAINTY_MG, "reached"),
        (ALLOWED_MG + 0.001, UNCERTAINTY_MG, "overshoot"),
        (-ALLOWED_MG - 0.001, UNCERTAINTY_MG, None),
        (0.001, 1.001, "overshoot"),
        (0.0, 1.001, None),
    ],
)
def test_adaptive_is_done_exactly_where_the_verdict_will_be_in_tolerance(
    rig: Bench, streaming: bool, error_mg: float, uncertainty_mg: float, reason: str | None
) -> None:
    controller = new_controller("adaptive", replace(rig.request(), streaming=streaming))
    command, time_s = controller.decide(None), 0.0
    while not isinstance(command, Weigh):
        time_s += 0.1
        command = controller.decide(Observation(time_s, TARGET_MG + error_mg, uncertainty_mg, False))
    command = controller.decide(Observation(time_s, TARGET_MG + error_mg, uncertainty_mg, True))
    assert (command.reason if isinstance(command, Finish) else None) == reason
