"""The skill `dispense`: what it makes of its weighings, and of a controller's last word."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import pytest
from dose_bench import BAY, DISH, MORTAR, OVER_PAN, Bench, shipped_powders

from scuhand_bt.cell.places import over_balance
from scuhand_bt.clock import Clock, Signal, Steps, Wake
from scuhand_bt.device_specs.balance import BalanceSpec
from scuhand_bt.devices.interfaces import Reading, StableMean
from scuhand_bt.dosing import CONTROLLERS, Command, Finish, Observation, Pulse, Stream, Weigh, new_controller
from scuhand_bt.dosing.bracket import Drift, Gross, Net
from scuhand_bt.events.doses import Dose
from scuhand_bt.events.entry import Note, SkillEvent
from scuhand_bt.events.weighings import DoseWeighed
from scuhand_bt.failures import SkillFailed
from scuhand_bt.lab import Lab
from scuhand_bt.record import Record
from scuhand_bt.specs import Departure, PaperSpec, Source

POWDERS = shipped_powders()
BEADS = POWDERS["glass_beads"]
SALT = Source(name="salt", station=BAY.name, mortar=MORTAR, powder=POWDERS["monosodium_glutamate"], amount_mg=10_000.0)
TARGET_MG, TOLERANCE_MG, UNCERTAINTY_MG = 50.0, 2.0, 0.25
ALLOWED_MG = 1.5
"""The tolerance less twice the uncertainty."""
WEIGHING_S = 1.0
POURED = 70
"""Readings that what is poured takes."""
CAME_MG = 5 * TARGET_MG / POURED
"""What comes in five of them hides as much of a fall."""


@dataclass
class ScriptedBalance:
    """Tells a load, and a zero of our choosing, a second after it is asked."""

    clock: Clock
    spec: BalanceSpec
    load_mg: float = 25_000.0
    uncertainty_mg: float = 0.0
    zero_mg: Callable[[float], float] = lambda time_s: 0.0
    identity: str = "scripted"
    latest: Reading | None = None
    on_reading: Callable[[Reading], None] | None = None
    is_stopped: bool = True
    news: Signal = field(default_factory=Signal)

    def stop(self) -> None:
        """Nothing of it moves."""

    def next_reading(self, timeout_s: float = 5.0) -> Steps[Reading]:
        end_s = self.clock.now_s + 0.1
        while self.clock.now_s < end_s:
            yield Wake(end_s)
        self.latest = Reading(self.load_mg + self.zero_mg(end_s), False, end_s)
        return self.latest

    def stable_mean(self, timeout_s: float = 30.0) -> Steps[StableMean]:
        end_s = self.clock.now_s + WEIGHING_S
        while self.clock.now_s < end_s:
            yield Wake(end_s)
        value_mg = self.load_mg + self.zero_mg(end_s)
        self.latest = Reading(value_mg, True, end_s)
        return StableMean(value_mg, self.uncertainty_mg, end_s, [self.latest])


class Rig:
    """A bench whose balance is scripted, with a tared dish on its pan; its controllers do as they are told.

    `brings`: what each controller lets fall, one after the other, before it says `reason`; nothing when all are used.
    """

    def __init__(self, lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
        self.bench = Bench(BEADS, TARGET_MG)
        self.clock = self.bench.clock
        self.balance = ScriptedBalance(self.clock, BalanceSpec())
        self.written: list[SkillEvent | Note] = []
        sources = {**self.bench.cell.sources, SALT.name: SALT}
        record = Record(self.written.append)
        self.cell = replace(self.bench.cell, balance=self.balance, sources=sources, record=record)
        self.brings: list[float] = []
        self.reason: Any = "reached"
        self.seen: list[Observation] = []
        self._lab = lab
        monkeypatch.setitem(CONTROLLERS, "last_word", lambda request: LastWord(self))  # type: ignore[arg-type]
        believed = self.cell.believed
        believed.brought(DISH, from_changer=False)
        believed.placed(Gross(0.0, 0.0, 0.0), Gross(25_000.0, 0.0, 0.0))
        believed.source_holds("store", 7000.0)
        believed.cone_holds(self.cell.sources["store"], 3000.0)
        self.bench.drive(self.skill("tare").run(self.cell))

    def skill(self, name: str, **inputs: Any) -> Any:
        return self._lab.library.skills[name](**inputs)

    def dispense(self, *brings_mg: float, reason: str = "reached") -> Dose:
        """Dispense 50 ± 2 mg, while the controllers bring this."""
        self.brings, self.reason = list(brings_mg), reason
        skill = self.skill("dispense", mass_mg=TARGET_MG, tolerance_mg=TOLERANCE_MG, controller="last_word")
        dose: Dose = self.bench.drive(skill.run(self.cell))
        return dose

    def kept(self, kind: type[SkillEvent]) -> list[Any]:
        return [event for event in self.written if isinstance(event, kind)]


class LastWord:
    """A controller that opens the valve for a moment, vibrating, and then says what it is told to say."""

    name = "last_word"
    estimate_mg = 0.0

    def __init__(self, rig: Rig) -> None:
        self._rig = rig

    def decide(self, seen: Observation | None) -> Command:
        rig = self._rig
        if seen is None:
            rig.balance.load_mg += rig.brings.pop(0) if rig.brings else 0.0
            return Pulse(0.2, 0.5, 1.0)
        rig.seen.append(seen)
        return Finish(rig.reason, seen.net_mg, seen.uncertainty_mg)


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


@pytest.fixture
def rig(starter: Lab, monkeypatch: pytest.MonkeyPatch) -> Rig:
    return Rig(starter, monkeypatch)


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


def test_what_is_left_of_a_load_for_a_fresh_one_stays_in_the_cone_and_tells_nothing_of_scoops(rig: Rig) -> None:
    believed = rig.cell.believed
    with pytest.raises(SkillFailed, match=r"hand\.cone_empty: 20\.0 mg of 50 mg; the rest in the cone flows only"):
        rig.dispense(20.0, 30.0, reason="rest")
    assert (believed.cone_mg, believed.cone_source, believed.yields) == (2980.0, "store", {})
    with pytest.raises(SkillFailed, match=r"hand\.cone_empty: the rest in the cone flows only when it is shaken"):
        rig.skill("cone_holds", powder=BEADS, wanted_mg=TARGET_MG).check(rig.cell)
    believed.emptied()
    believed.cone_holds(rig.cell.sources["store"], 3000.0)
    rig.skill("cone_holds", powder=BEADS, wanted_mg=TARGET_MG).check(rig.cell)


@pytest.mark.parametrize(
    ("may_scoop_again", "in_mortar_mg", "told"), [(True, 1100.0, True), (True, 900.0, False), (False, 7000.0, False)]
)
def test_a_rest_is_left_only_where_there_is_more_to_scoop_and_something_scoops_it(
    rig: Rig, may_scoop_again: bool, in_mortar_mg: float, told: bool
) -> None:
    rig.cell.believed.source_holds("store", in_mortar_mg)
    skill = rig.skill("dispense", mass_mg=TARGET_MG, may_scoop_again=may_scoop_again)
    rig.dispense(20.0, 30.0)
    asked = skill.request(rig.cell)
    assert (asked.may_scoop_again, asked.came_mg, asked.cone_mg) == (told, 50.0, 2950.0)


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


def test_split_doses_of_one_lot_add_up_to_one_target(rig: Rig) -> None:
    rig.cell.believed.cone_holds(rig.cell.sources["store"], 30.0)
    with pytest.raises(SkillFailed, match=r"hand\.cone_empty: the cone ran empty at 20\.0 mg of 50 mg"):
        rig.dispense(20.0, reason="empty")
    rig.cell.believed.cone_holds(rig.cell.sources["store"], 3000.0)
    dose = rig.dispense(30.5)
    assert rig.seen[-1].net_mg == pytest.approx(50.5)
    assert (dose.dispensed_mg, dose.verdict) == (pytest.approx(50.5), "in tolerance")


@pytest.mark.parametrize("reason", ["empty", "no_flow"])
@pytest.mark.parametrize(
    ("held_mg", "code", "doubted"), [(779.9, "hand.cone_empty", False), (780.1, "hand.no_flow", True)]
)
def test_powder_that_does_not_come_is_an_empty_cone_or_none_by_what_the_cone_should_hold(
    rig: Rig, reason: str, held_mg: float, code: str, doubted: bool
) -> None:
    rig.cell.believed.cone_holds(rig.cell.sources["store"], held_mg)
    with pytest.raises(SkillFailed) as failed:
        rig.dispense(30.0, reason=reason)
    assert (failed.value.code, rig.cell.believed.is_load_doubted) == (code, doubted)


def test_a_dose_that_took_too_many_steps_is_not_reached(rig: Rig) -> None:
    with pytest.raises(SkillFailed, match=r"dose\.not_reached: 30\.0 mg of 50 mg after \d+ min, in 1 pulse$"):
        rig.dispense(30.0, reason="step_limit")


def test_what_a_balance_that_is_not_believed_shows_of_a_dose_is_said_though_it_is_none(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("scuhand_bt.cell.pan_cleared.is_frozen", lambda readings_mg, digit_mg: True)
    with pytest.raises(
        SkillFailed, match=r"balance\.coarse: .*\. The balance shows 50\.0 mg in the container; this does not count"
    ):
        rig.dispense(50.0)


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


def test_two_loads_that_brought_nothing_are_told_as_such(rig: Rig) -> None:
    for code in (
        r"hand\.no_flow: .* 0 mg of this load have come, and the cone should hold 3000 mg more",
        r"scoop\.nothing: 2 ",
    ):
        rig.cell.believed.emptied()
        rig.cell.believed.scooped(rig.cell.sources["store"], 3000.0)
        with pytest.raises(SkillFailed, match=code):
            rig.dispense(0.0, reason="no_flow")


def test_a_load_after_one_that_brought_nothing_is_not_shaken_for_as_long_while_another_may_follow(rig: Rig) -> None:
    skill, why = rig.skill("dispense", mass_mg=TARGET_MG), []
    for there_mg in (20_000.0, 20_000.0, 6_000.0):
        rig.cell.believed.emptied()
        rig.cell.believed.source_holds("store", there_mg)
        rig.cell.believed.scooped(rig.cell.sources["store"], 3000.0)
        why.append(skill.request(rig.cell).given_up(0.0))
        if len(why) == 1:
            rig.cell.believed.gave_out(is_short=True)
    assert why == ["no_flow", "empty", "no_flow"], "the first one, one with others to come, and the last one"


def test_a_zero_that_has_sunk_is_no_powder_that_went_back(rig: Rig) -> None:
    rig.cell.believed.scooped(rig.cell.sources["store"], 3000.0)
    with pytest.raises(SkillFailed, match=r" 0 mg of this load have come"):
        rig.dispense(-0.3, reason="no_flow")


def test_loads_that_do_not_give_what_little_a_dose_lacks_are_not_told_as_nothing(rig: Rig) -> None:
    for brings_mg in (45.0, 0.0, 0.0):
        rig.cell.believed.emptied()
        rig.cell.believed.scooped(rig.cell.sources["store"], 3000.0)
        with pytest.raises(SkillFailed, match=r"hand\.no_flow"):
            rig.dispense(brings_mg, reason="no_flow")
    assert rig.cell.believed.yields == {}


def test_loads_that_go_on_giving_nothing_of_what_little_a_dose_lacks_end_it_and_tell_nothing_of_its_source(
    rig: Rig,
) -> None:
    codes = []
    for brings_mg in (40.0, 0.0, 2.0, 0.0, 0.0, 0.0):
        rig.cell.believed.emptied()
        rig.cell.believed.source_holds("store", 7000.0)
        rig.cell.believed.scooped(rig.cell.sources["store"], 3000.0)
        with pytest.raises(SkillFailed) as failed:
            rig.dispense(brings_mg, reason="no_flow")
        codes.append(failed.value.code)
    assert codes == [*["hand.no_flow"] * 5, "dose.not_reached"]
    assert str(failed.value).endswith("4 loads in a row brought nothing of the last 8.0 mg (valve open, motor shaking)")
    assert rig.cell.believed.barren_sources == set()


def test_a_cone_that_ran_empty_holds_nothing_and_what_it_was_thought_to_hold_is_in_the_mortar(rig: Rig) -> None:
    rig.cell.believed.cone_holds(rig.cell.sources["store"], 700.0)
    with pytest.raises(SkillFailed, match=r"hand\.cone_empty"):
        rig.dispense(30.0, reason="empty")
    believed = rig.cell.believed
    assert (believed.cone_mg, believed.cone_source) == (0.0, None)
    assert believed.sources_mg["store"] == pytest.approx(7000.0 + 700.0 - 30.0)


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
