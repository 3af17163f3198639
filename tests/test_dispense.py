"""The skill `dispense`: what it makes of its weighings, and of a controller's last word."""

from dataclasses import replace

import pytest
from dispense_bench import BEADS, SALT, TARGET_MG, TOLERANCE_MG, Rig
from dose_bench import DISH, OVER_PAN, Bench

from scuhand_bt.dosing import Finish, Observation, Weigh, new_controller
from scuhand_bt.dosing.bracket import Drift, Gross, Net
from scuhand_bt.events.doses import Dose
from scuhand_bt.events.weighings import DoseWeighed
from scuhand_bt.failures import SkillFailed
from scuhand_bt.lab import Lab
from scuhand_bt.record import Record
from scuhand_bt.specs import Departure, PaperSpec

UNCERTAINTY_MG = 0.25
ALLOWED_MG = 1.5
"""The tolerance less twice the uncertainty."""


@pytest.fixture
def rig(starter: Lab, monkeypatch: pytest.MonkeyPatch) -> Rig:
    return Rig(starter, monkeypatch)


@pytest.mark.parametrize("of_recipe", [True, False])
@pytest.mark.parametrize(("name", "widest_mm"), [("paper", 1.0), ("adaptive", 2.1), ("direct_pid", 2.1)])
def test_only_the_paper_is_held_to_what_the_paper_was_set_to(
    rig: "Rig", name: str, widest_mm: float, of_recipe: bool
) -> None:
    set_to = PaperSpec(gain=0.4, max_opening_mm=1.0, wait_s=2.5, departures=(Departure.ORDER,))
    powder = BEADS.model_copy(update={"max_opening_mm": 2.1, "paper": set_to})
    rig.cell.sources["store"] = rig.cell.sources["store"].model_copy(update={"powder": powder})
    rig.cell.controller = "adaptive" if of_recipe else name
    skill = rig.skill("dispense", mass_mg=TARGET_MG, controller=name if of_recipe else "")
    request = skill.request(rig.cell)
    assert request.max_opening_mm == widest_mm
    assert (request.gain, request.wait_s, request.departures) == (0.4, 2.5, (Departure.ORDER,))


@pytest.mark.parametrize("uncertainty_mg", [0.0, 0.2])
@pytest.mark.parametrize(
    ("side", "beyond_mg", "verdict"),
    [(1, -0.01, "in tolerance"), (1, 0.01, "over"), (-1, -0.01, "in tolerance"), (-1, 0.01, "under")],
)
def test_in_tolerance_means_by_more_than_twice_the_uncertainty_of_its_weighings(
    starter: Lab, monkeypatch: pytest.MonkeyPatch, side: int, beyond_mg: float, verdict: str, uncertainty_mg: float
) -> None:
    probe = Rig(starter, monkeypatch)
    probe.balance.uncertainty_mg = uncertainty_mg
    u_mg = probe.dispense(TARGET_MG).uncertainty_mg
    assert u_mg > max(0.02, 2**0.5 * uncertainty_mg), "two weighings, and a zero that walks between them"
    rig = Rig(starter, monkeypatch)
    rig.balance.uncertainty_mg = uncertainty_mg
    assert rig.dispense(TARGET_MG + side * (TOLERANCE_MG - 2.0 * u_mg + beyond_mg)).verdict == verdict


@pytest.mark.parametrize(("error_mg", "verdict"), [(-0.001, "under"), (0.001, "over")])
def test_a_measurement_worse_than_the_tolerance_is_never_in_it(rig: Rig, error_mg: float, verdict: str) -> None:
    rig.balance.uncertainty_mg = 1.0
    assert rig.dispense(TARGET_MG + error_mg).verdict == verdict


def test_too_much_for_the_tolerance_is_an_overshoot_and_the_dose_is_recorded_as_over(rig: Rig) -> None:
    with pytest.raises(SkillFailed, match=r"dose\.overshoot: 52\.0 mg of 50 mg: 2\.0 mg too much"):
        rig.dispense(TARGET_MG + TOLERANCE_MG + 0.001)
    assert [event.verdict for event in rig.kept(Dose)] == ["over"]


def test_a_dose_at_its_tolerance_is_no_overshoot_and_not_surely_in_it(rig: Rig) -> None:
    assert rig.dispense(TARGET_MG + TOLERANCE_MG).verdict == "over"


def test_a_dose_that_its_controller_took_for_done_and_that_weighs_less_is_gone_on_with(rig: Rig) -> None:
    """A draught weighs on the pan just while the controller looks."""
    began_s = rig.clock.now_s
    rig.balance.zero_mg = lambda time_s: 5.0 if time_s < began_s + 3.0 and rig.balance.load_mg > 25_001.0 else 0.0
    dose = rig.dispense(45.0, 5.1)
    assert [round(seen.net_mg, 1) for seen in rig.seen] == [50.0, 50.1], "the second counts what the first has brought"
    assert (round(dose.dispensed_mg, 3), dose.verdict, dose.pulses) == (50.1, "in tolerance", 2)
    assert [round(event.gained_mg, 3) for event in rig.kept(DoseWeighed)] == [45.0, 5.1]
    assert len(rig.kept(Dose)) == 1


def test_a_dose_that_nothing_is_added_to_is_under_after_its_rounds(rig: Rig) -> None:
    dose = rig.dispense(45.0)
    assert (round(dose.dispensed_mg, 3), dose.verdict, dose.pulses) == (45.0, "under", 4)


def test_a_dose_that_ended_for_another_reason_is_not_gone_on_with(rig: Rig) -> None:
    with pytest.raises(SkillFailed, match=r"hand\.no_flow"):
        rig.dispense(20.0, 30.0, reason="empty")
    assert rig.brings == [30.0]


def test_two_powder_lots_in_one_container_are_each_measured_by_their_own_weighings(rig: Rig) -> None:
    first = rig.dispense(TARGET_MG)
    rig.balance.zero_mg = lambda time_s: -4.0
    rig.cell.believed.emptied()
    rig.cell.believed.cone_holds(SALT, 3000.0)
    second = rig.dispense(TARGET_MG + 1.0)
    assert (first.lot, second.lot) == ("glass_beads", "monosodium_glutamate")
    assert (first.container, second.container) == (DISH.id, DISH.id)
    assert (first.dispensed_mg, second.dispensed_mg) == (pytest.approx(50.0), pytest.approx(51.0))
    bracket = rig.cell.believed.bracket
    assert bracket is not None
    assert {lot: net.mass_mg for lot, net in bracket.doses.items()} == {
        first.lot: first.dispensed_mg,
        second.lot: second.dispensed_mg,
    }


def test_a_dose_that_took_too_many_steps_is_not_reached(rig: Rig) -> None:
    with pytest.raises(SkillFailed, match=r"dose\.not_reached: 30\.0 mg of 50 mg after \d+ min, in 1 pulse$"):
        rig.dispense(30.0, reason="step_limit")


def test_the_valve_stays_shut_where_the_cone_is_not_over_the_containers_mouth(rig: Rig) -> None:
    """330 mm out, and the mouth is 55 mm wide; a real arm is a few aside of where it was sent."""
    rig.bench.cell.arm.hold([0.09, *OVER_PAN[1:]])  # type: ignore[attr-defined]
    said = r"arm\.not_over_pan: the cone's apex is 30 mm from the middle of the pan, but .* is only 55 mm wide"
    with pytest.raises(SkillFailed, match=said):
        rig.dispense(50.0)
    assert rig.brings == [50.0], "nothing was let out"
    assert rig.kept(Dose) == []
    rig.bench.cell.arm.hold([0.08, *OVER_PAN[1:]])  # type: ignore[attr-defined]
    assert rig.dispense(50.0).verdict == "in tolerance"


def test_without_a_tare_there_is_no_dose(rig: Rig) -> None:
    believed = rig.cell.believed
    believed.placed(Gross(0.0, 0.0, 0.0), Gross(25_000.0, 0.0, 0.0))
    believed.changing_container()
    with pytest.raises(SkillFailed, match=r"container\.missing: no container was weighed empty"):
        rig.dispense(TARGET_MG)


def test_a_dose_says_what_was_asked_what_is_there_and_what_it_took_in_all(rig: Rig) -> None:
    believed, began_s = rig.cell.believed, rig.clock.now_s - 20.0
    believed.dose_began(began_s)
    empty, filled = Gross(25_000.0, 0.0, rig.clock.now_s), Gross(25_020.0, 0.0, rig.clock.now_s)
    believed.dosing_towards(TARGET_MG, "glass_beads", empty)
    believed.dosed(Net(20.0, 0.3), Drift(0.0, 0.0), filled, pulses=3, vibration_s=1.5)
    rig.balance.load_mg += 20.0
    dose = rig.dispense(30.5)
    assert (dose.target_mg, dose.tolerance_mg, dose.dispensed_mg) == (50.0, 2.0, pytest.approx(50.5))
    assert 0.3 < dose.uncertainty_mg < 0.4
    assert (dose.container, dose.lot) == (DISH.id, "glass_beads")
    assert (dose.pulses, dose.controller) == (4, "last_word")
    assert dose.vibration_s == pytest.approx(1.5 + 0.7, abs=0.1)
    assert dose.duration_s == pytest.approx(rig.clock.now_s - began_s)
    assert dose.duration_s > 20.0


@pytest.mark.parametrize("streaming", [True, False])
@pytest.mark.parametrize(
    ("error_mg", "uncertainty_mg", "reason"),
    [
        (ALLOWED_MG, UNCERTAINTY_MG, "reached"),
        (-ALLOWED_MG, UNCERTAINTY_MG, "reached"),
        (ALLOWED_MG + 0.001, UNCERTAINTY_MG, "overshoot"),
        (-ALLOWED_MG - 0.001, UNCERTAINTY_MG, None),
        (0.001, 1.001, "overshoot"),
        (0.0, 1.001, "reached"),  # no more is to come, and no mass would be told in tolerance
        (-1.0, 1.001, None),
    ],
)
def test_adaptive_is_done_exactly_where_the_verdict_will_be_in_tolerance_or_where_none_can_be(
    streaming: bool, error_mg: float, uncertainty_mg: float, reason: str | None
) -> None:
    controller = new_controller("adaptive", replace(Bench(BEADS, TARGET_MG).request(), streaming=streaming))
    command, time_s = controller.decide(None), 0.0
    while not isinstance(command, Weigh):
        time_s += 0.1
        command = controller.decide(Observation(time_s, TARGET_MG + error_mg, uncertainty_mg, False))
    command = controller.decide(Observation(time_s, TARGET_MG + error_mg, uncertainty_mg, True))
    assert (command.reason if isinstance(command, Finish) else None) == reason


def test_into_a_container_that_was_given_up_nothing_is_dosed(rig: Rig) -> None:
    rig.cell.believed.container_given_up("it is another one")
    with pytest.raises(SkillFailed, match=r"container\.changed: it is another one"):
        rig.dispense(TARGET_MG)
    assert rig.seen == []


def test_the_valve_opens_once_the_empty_containers_weighing_is_on_disk(rig: Rig) -> None:
    on_disk: list[tuple[str, float, bool]] = []

    def waits() -> None:
        on_disk.append((type(rig.written[-1]).__name__, rig.balance.load_mg, rig.cell.hand.is_stopped))

    rig.cell.record = Record(rig.written.append, waits)
    empty_mg = rig.balance.load_mg
    rig.dispense(TARGET_MG)
    assert on_disk == [("DoseBegun", empty_mg, True)]
