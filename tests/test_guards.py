"""Guards: each trips in time, and none does while all is well."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from daily import first_daily
from dose_bench import DISH, PAN, Bench, Setting, shipped_powders
from running import dry_run, make_lab

from scuhand_bt.cell.weighing import weighing_of
from scuhand_bt.clock import Steps, Wake, pause
from scuhand_bt.device_specs.balance import BalanceResponseSpec, BalanceSpec
from scuhand_bt.devices.interfaces import Reading
from scuhand_bt.dosing.bracket import Gross
from scuhand_bt.failures import SkillFailed
from scuhand_bt.run.guards import BEYOND_TARGET_MG, RUNAWAY_S, Guards
from scuhand_bt.run.operator import ANSWER_S
from scuhand_bt.sim.arm import SimulatedArm
from scuhand_bt.sim.hand import SimulatedHand
from scuhand_bt.specs import BalanceBelief

POWDERS = shipped_powders()


class Guarded:
    """A bench whose cone is believed, and taken, to stand over the container on the pan."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, powder: str = "glass_beads", **setting: Any) -> None:
        self.apex_mm: tuple[float, float, float] = (PAN.position_mm[0], PAN.position_mm[1] + 5.0, 140.0)
        self.rig = Bench(POWDERS[powder], 20.0, setting=Setting(**setting))
        self.cell, self.clock = self.rig.cell, self.rig.clock
        monkeypatch.setattr(self.cell, "apex_mm", lambda: self.apex_mm)
        self.guards = Guards(self.cell)
        self.before = weighing_of(self.rig.drive(self.cell.balance.stable_mean()))
        believed = self.cell.believed
        believed.brought(DISH, from_changer=True)
        believed.placed(Gross(0.0, 0.0, 0.0), self.before)
        believed.tared(self.before)

    def dosing_towards(self, target_mg: float) -> None:
        self.cell.believed.dosing_towards(target_mg, self.rig.powder.name, self.before)

    def begin(self, fault: str) -> None:
        """Let a fault come now."""
        self.rig.world.faults.active[fault] = self.clock.now_s

    def watch(self, duration_s: float, steps: Steps[Any] | None = None) -> SkillFailed | None:
        """What a guard finds within this time, looked at as a run does, while `steps` are carried out."""
        end_s = self.clock.now_s + duration_s
        waiting = steps or iter(())
        wake = next(waiting, Wake())
        while self.clock.now_s < end_s:
            self.clock.wait([wake, Wake(end_s), *self.guards.wakes()])
            if (fault := self.guards.look()) is not None:
                return fault
            if wake.has_fired or self.clock.now_s >= wake.until_s:
                wake = next(waiting, Wake())
        return None

    def drop(self, mass_mg: float) -> None:
        """Let powder fall from the cone all at once, through a valve that is shut."""
        self.rig.world.load.drop(self.clock.now_s, mass_mg)


@pytest.fixture
def guarded(monkeypatch: pytest.MonkeyPatch) -> Guarded:
    return Guarded(monkeypatch)


@pytest.mark.parametrize(
    ("fault", "code"),
    [
        ("hand.emergency_stop", "device.emergency_stop"),
        ("hand.lost", "device.lost"),
        ("arm.lost", "device.lost"),
        ("arm.no_power", "arm.limp"),
        ("valve.no_power", "hand.valve_lost"),
        ("servo.overheat", "servo.overload"),
        ("servo.overload", "servo.overload"),
    ],
)
def test_a_device_that_tells_of_a_fault_trips_the_guard_at_the_next_look(
    guarded: Guarded, fault: str, code: str
) -> None:
    assert guarded.guards.look() is None
    guarded.begin(fault)
    tripped = guarded.guards.look()
    assert tripped is not None
    assert tripped.code == code


def test_a_silent_balance_trips_after_three_seconds(guarded: Guarded) -> None:
    guarded.begin("balance.silent")
    began_s = guarded.clock.now_s
    tripped = guarded.watch(10.0)
    assert tripped is not None
    assert str(tripped) == "device.lost: the balance has sent no reading for 3 s"
    assert 2.9 <= guarded.clock.now_s - began_s <= 3.2


def test_a_slow_balance_is_given_ten_of_its_periods(monkeypatch: pytest.MonkeyPatch) -> None:
    guarded = Guarded(monkeypatch, balance=BalanceSpec(period_s=1.0))
    guarded.begin("balance.silent")
    assert guarded.watch(8.9) is None
    tripped = guarded.watch(2.1)
    assert tripped is not None
    assert tripped.code == "device.lost"


BALANCES = {
    "the lab's": BalanceSpec(),
    "a coarse one": BalanceSpec(readability_mg=1.0),
    "a noisy one": BalanceSpec(simulation=BalanceResponseSpec(noise_mg=0.3, drift_mg=1.0)),
    "a slow one": BalanceSpec(simulation=BalanceResponseSpec(lag_s=1.0)),
    "one with few readings": BalanceSpec(period_s=0.2),
}


@pytest.mark.parametrize("balance", BALANCES)
def test_a_leak_over_the_pan_is_found_within_four_seconds(monkeypatch: pytest.MonkeyPatch, balance: str) -> None:
    guarded = Guarded(monkeypatch, balance=BALANCES[balance])
    assert guarded.watch(5.0) is None
    guarded.begin("cone.leak")
    began_s = guarded.clock.now_s
    tripped = guarded.watch(10.0)
    assert tripped is not None
    assert tripped.code == "hand.leak"
    assert guarded.clock.now_s - began_s <= 4.0


def test_a_leak_is_found_also_between_the_pulses_of_a_dose(guarded: Guarded) -> None:
    guarded.dosing_towards(20.0)
    guarded.begin("cone.leak")
    assert guarded.watch(1.2, guarded.cell.hand.pulse(0.5, 0.2)) is None
    tripped = guarded.watch(8.0)
    assert tripped is not None
    assert tripped.code == "hand.leak"


def test_what_falls_through_a_valve_that_was_open_between_two_readings_is_no_leak(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    guarded = Guarded(monkeypatch, balance=BalanceSpec(period_s=1.0))
    guarded.dosing_towards(300.0)

    def dosing() -> Steps[None]:
        for _ in range(40):
            yield from guarded.cell.balance.next_reading()
            guarded.cell.hand.set_opening(0.6)
            yield from pause(guarded.clock, 0.2)
            guarded.cell.hand.set_opening(0.0)

    assert guarded.watch(40.0, dosing()) is None
    assert guarded.rig.world.true_mass(DISH.id) > 40.0


def test_what_falls_onto_the_pan_from_elsewhere_is_no_leak_of_the_cone(guarded: Guarded) -> None:
    guarded.apex_mm = (PAN.position_mm[0], PAN.position_mm[1] + 100.0, 140.0)
    guarded.begin("cone.leak")
    assert guarded.watch(20.0) is None


def test_while_containers_are_changed_nothing_is_a_leak(guarded: Guarded) -> None:
    guarded.cell.believed.changing_container()
    guarded.begin("cone.leak")
    assert guarded.watch(20.0) is None


def _single_drops(guarded: Guarded) -> Iterator[Wake]:
    """Knocks and lumps, once the balance's lag is known."""
    guarded.cell.balance_belief = BalanceBelief(lag_s=guarded.cell.spec.balance.simulation.lag_s)
    for mass_mg in (3.0, 400.0, 20.0, 1000.0):
        guarded.drop(mass_mg)
        yield Wake(guarded.clock.now_s + 3.7)


def _pulses(guarded: Guarded) -> Steps[None]:
    for opening_mm in (0.4, 0.8, 1.6):
        yield from guarded.cell.hand.pulse(opening_mm, 0.5)
        yield Wake(guarded.clock.now_s + 8.0)


def _a_container_comes(guarded: Guarded) -> Iterator[Wake]:
    believed = guarded.cell.believed
    believed.changing_container()
    guarded.rig.world.remove()
    yield Wake(guarded.clock.now_s + 2.0)
    guarded.rig.world.place(DISH)
    believed.placed(
        Gross(0.0, 0.0, 0.0), Gross(25_000.0, 0.0, guarded.clock.now_s)
    )  # sooner than any skill would say so
    yield Wake()


@pytest.mark.parametrize("balance", BALANCES)
@pytest.mark.parametrize("happens", [_single_drops, _pulses, _a_container_comes])
def test_what_settles_is_no_leak(monkeypatch: pytest.MonkeyPatch, balance: str, happens: Any) -> None:
    guarded = Guarded(monkeypatch, balance=BALANCES[balance])
    assert guarded.watch(40.0, happens(guarded)) is None


@pytest.mark.parametrize("lag_s", [1.0, 1.3, 1.6, 2.0])
@pytest.mark.parametrize("open_s", [0.5, 2.0, 5.0])
def test_a_balance_that_was_set_slower_in_a_dose_is_no_leak(
    monkeypatch: pytest.MonkeyPatch, lag_s: float, open_s: float
) -> None:
    guarded = Guarded(monkeypatch, balance=BalanceSpec(simulation=BalanceResponseSpec(lag_s=lag_s)))
    guarded.cell.balance_belief = BalanceBelief(lag_s=0.3, fits=1)
    assert guarded.watch(20.0, guarded.cell.hand.pulse(0.8, open_s)) is None


@pytest.mark.parametrize("fault", ["balance.draught", "balance.drifting", "balance.unstable"])
def test_a_restless_balance_is_no_leak(guarded: Guarded, fault: str) -> None:
    guarded.begin(fault)
    guarded.cell.hand.set_vibration(1.0)
    assert guarded.watch(300.0) is None


def test_a_dose_that_runs_away_trips_when_the_valve_has_had_time_to_shut(guarded: Guarded) -> None:
    cell, heard = guarded.cell, list[Reading]()
    cell.balance.on_reading = heard.append
    guarded.dosing_towards(20.0)
    cell.hand.set_opening(1.5)
    tripped = guarded.watch(20.0)
    assert tripped is not None
    assert tripped.code == "dose.runaway"
    limit_mg = (cell.believed.pan_empty_mg or 0.0) + 20.0 + BEYOND_TARGET_MG
    beyond = next(reading for reading in heard if reading.value_mg > limit_mg)
    assert guarded.clock.now_s == pytest.approx(beyond.time_s + RUNAWAY_S, abs=0.11)


def test_a_valve_that_shuts_behind_an_avalanche_is_no_runaway(guarded: Guarded) -> None:
    guarded.dosing_towards(20.0)
    guarded.drop(500.0)
    assert guarded.watch(10.0, guarded.cell.hand.pulse(1.5, 1.0)) is None


def test_too_much_behind_a_shut_valve_is_for_the_dose_to_judge(guarded: Guarded) -> None:
    guarded.dosing_towards(20.0)
    guarded.drop(500.0)
    assert guarded.watch(10.0) is None


def test_emptying_the_cone_is_no_dose(guarded: Guarded) -> None:
    assert guarded.watch(20.0, guarded.cell.hand.pulse(2.0, 10.0, vibration=1.0)) is None


RECIPE = """
recipe: lumpy
workflow: scoop_and_dispense
defaults: {container: xrd_holder, tolerance: 3 mg}
samples: [{id: a, source: titania, mass: 40 mg}, {id: b, source: beads, mass: 100 mg}]
sources:
  titania: {station: mortar_bay, container: agate_mortar, powder: titanium_dioxide, amount: 10 g}
  beads: {station: mortar_bay_2, container: small_agate_mortar, powder: glass_beads, amount: 8 g}
on_failure: {otherwise: flag}
"""


@pytest.mark.parametrize("controller", first_daily("adaptive", "paper", "direct_pid"))
def test_a_whole_run_trips_nothing(tmp_path: Path, controller: str) -> None:
    ran = dry_run(tmp_path, RECIPE, controller=controller)
    assert ran.result.exit_code != 3, ran.result.reason


def test_a_leak_in_a_run_ends_it_with_the_valve_shut(tmp_path: Path) -> None:
    ran = dry_run(tmp_path, RECIPE, faults="faults: [{fault: cone.leak, at_pulse: 1}]", controller="adaptive")
    assert ran.result.exit_code == 3
    assert "hand.leak" in ran.result.reason
    assert ran.session.cell.hand.is_stopped
    assert ran.session.cell.arm.is_stopped


WAITING = """
workflow: waiting
inputs: {source: Source, container: Container}
tree:
  sequence:
    - place_container: {container: $container}
    - tare:
    - scoop: {source: $source}
    - move_over: {container: $container}
    - timeout: {duration: 1 s, child: {wait: {duration: 60 s}}}
"""
ASKING = """
recipe: asking
workflow: waiting
samples: [{id: a, source: beads, container: xrd_holder}]
on_failure: {otherwise: ask}
"""


@pytest.mark.slow
@pytest.mark.parametrize(("fault", "code"), [("cone.leak", "hand.leak"), ("balance.silent", "device.lost")])
def test_guards_go_on_while_a_person_is_asked_what_to_do(tmp_path: Path, fault: str, code: str) -> None:
    """The sample fails over the pan; that goes wrong while the person thinks, for a minute."""
    lab = make_lab(tmp_path / "lab", trees__waiting=WAITING)
    well = dry_run(tmp_path, ASKING, lab=lab)
    assert well.result.exit_code == 1, "the person answers: flag it"
    failed_s = well.sample("a").duration_s - ANSWER_S
    ran = dry_run(tmp_path, ASKING, lab=lab, faults=f"faults: [{{fault: {fault}, at: {failed_s + 5.0:.0f} s}}]")
    assert ran.result.exit_code == 3
    assert code in ran.result.reason
    assert failed_s + 5.0 < ran.session.cell.clock.now_s < failed_s + 20.0


def test_a_device_that_cannot_be_stopped_does_not_keep_the_others_from_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def breaks(arm: SimulatedArm) -> None:
        raise RuntimeError("no such joint")

    told: list[SimulatedHand] = []
    monkeypatch.setattr(SimulatedArm, "stop", breaks)
    monkeypatch.setattr(SimulatedHand, "stop", lambda hand: told.append(hand))
    lab = make_lab(tmp_path / "lab", trees__waiting=WAITING)
    ran = dry_run(tmp_path, ASKING.replace("ask}", "flag}"), lab=lab)
    assert told
    assert all(hand is ran.session.cell.hand for hand in told)
    assert ran.result.exit_code == 3
    assert "a device did not stop" in ran.result.reason
