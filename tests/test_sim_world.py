import math
from typing import Any

import numpy as np
import pytest
from dose_bench import DISH, Bench, Setting, shipped_powders
from hypothesis import example, given, settings
from hypothesis import strategies as st

from scuhand_bt.clock import Wake
from scuhand_bt.device_specs.balance import BalanceResponseSpec, BalanceSpec
from scuhand_bt.device_specs.hand import HandSpec, ValveErrorSpec
from scuhand_bt.devices.balances.frames import Weight
from scuhand_bt.devices.balances.mt_sics import DIALECT as MT_SICS
from scuhand_bt.devices.interfaces import Reading
from scuhand_bt.failures import SkillFailed
from scuhand_bt.sim.mass_ledger import CONE, WASTE
from scuhand_bt.sim.plant import Plant, PlantError, load_plant
from scuhand_bt.sim.powder import OurPowderFlow
from scuhand_bt.sim.randomness import substream
from scuhand_bt.specs import Powder

POWDERS = shipped_powders()
BEADS = POWDERS["glass_beads"]


def bench(powder: Powder = BEADS, seed: int = 1, **setting: Any) -> Bench:
    return Bench(powder, seed=seed, setting=Setting(**setting))


def let_pass(rig: Bench, duration_s: float) -> None:
    end_s = rig.clock.now_s + duration_s

    def waiting() -> Any:
        while rig.clock.now_s < end_s:
            yield Wake(end_s)

    rig.drive(waiting())


def everything_is_there(rig: Bench) -> None:
    assert rig.world.ledger.total_mg == pytest.approx(10_000.0, abs=1e-6)
    assert all(mass_mg >= 0.0 for mass_mg in rig.world.masses_mg.values())


@pytest.mark.parametrize("readability_mg", [0.01, 0.1, 0.5, 1.0])
def test_a_simulated_balance_gives_its_lines_to_whoever_listens(readability_mg: float) -> None:
    rig = bench(balance=BalanceSpec(readability_mg=readability_mg))
    let_pass(rig, 1.0)
    assert rig.cell.balance.latest is not None
    assert rig.cell.balance.latest.raw == b"", "nobody listened"
    heard: list[Reading] = []
    rig.cell.balance.on_reading = heard.append
    rig.drive(rig.cell.hand.pulse(1.0, 0.5))
    let_pass(rig, 2.0)
    assert len(heard) > 25
    for reading in heard:
        weight = MT_SICS.parse(reading.raw)
        assert isinstance(weight, Weight)
        assert weight.milligrams() == pytest.approx(reading.value_mg, abs=1e-9)
        assert (weight.unit, weight.stable) == (reading.unit, reading.stable)


@pytest.mark.parametrize("readability_mg", [0.01, 0.02, 0.1, 1.0])
def test_a_finer_simulated_balance_comes_to_rest_too(readability_mg: float) -> None:
    """With the noise of a 0.1 mg balance one of 0.01 mg never called itself stable: every dry run failed."""
    rig = bench(balance=BalanceSpec(readability_mg=readability_mg))
    for _ in range(10):
        mean = rig.drive(rig.cell.balance.stable_mean(10.0))
        assert mean.uncertainty_mg < readability_mg


def test_what_is_written_of_a_balance_is_simulated_however_fine_it_is() -> None:
    rig = bench(balance=BalanceSpec(readability_mg=0.01, simulation=BalanceResponseSpec(noise_mg=0.5, drift_mg=0.0)))
    let_pass(rig, 10.0)
    heard: list[Reading] = []
    rig.cell.balance.on_reading = heard.append
    let_pass(rig, 20.0)
    assert np.std([reading.value_mg for reading in heard]) == pytest.approx(0.5, rel=0.2)


actions = st.lists(
    st.tuples(
        st.sampled_from(["pulse", "open", "stop", "vibrate", "wait", "remove", "place", "swap"]),
        st.floats(min_value=0.0, max_value=2.4),
    ),
    max_size=12,
)


@example([("open", 2.2e-311)], "glass_beads", 0)
@settings(max_examples=40, deadline=None)
@given(actions, st.sampled_from(sorted(POWDERS)), st.integers(0, 2**31))
def test_mass_is_conserved_whatever_is_done(todo: list[tuple[str, float]], powder: str, seed: int) -> None:
    rig = bench(POWDERS[powder], seed)
    for action, value in todo:
        if action == "pulse":
            rig.drive(rig.cell.hand.pulse(value, value / 4.0, min(1.0, value)))
        elif action == "open":
            rig.cell.hand.set_opening(value)
        elif action == "stop":
            rig.cell.hand.stop()
        elif action == "vibrate":
            rig.cell.hand.set_vibration(min(1.0, value))
        elif action == "remove" and rig.world.pan.container_id is not None:
            rig.world.remove()
        elif action == "place" and rig.world.pan.container_id is None:
            rig.world.place(DISH)
        elif action == "swap":
            rig.world.swap_sheet()
        let_pass(rig, value / 3.0)
        everything_is_there(rig)


def test_moving_more_than_there_is_or_nan_is_refused() -> None:
    world = bench().world
    for mass_mg in (1e9, -1.0, math.nan):
        with pytest.raises(ValueError, match="cannot move"):
            world.ledger.transfer(CONE, WASTE, mass_mg)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_dose_and_another_gives_another() -> None:
    first, again, other = (bench(seed=seed).dose("adaptive") for seed in (5, 5, 6))
    assert first == again
    assert first != other


def test_streams_are_keyed_by_every_name() -> None:
    draws = {substream(1, *names).random() for names in [("a", 0, "flow"), ("a", 1, "flow"), ("a", 0, "hand"), ("b",)]}
    assert len(draws) == 4


def test_powder_lands_a_fall_after_it_left_and_the_balance_follows() -> None:
    rig = bench()
    empty_mg = rig.drive(rig.cell.balance.stable_mean()).value_mg
    rig.drive(rig.cell.hand.pulse(1.0, 0.5))
    assert rig.world.masses_mg["flight"] > 0.0
    let_pass(rig, 0.3)
    assert rig.world.masses_mg["flight"] == 0.0
    let_pass(rig, 3.0)
    mean = rig.drive(rig.cell.balance.stable_mean())
    assert mean.value_mg - empty_mg == pytest.approx(rig.world.true_mass("dish"), abs=0.5)


def test_without_a_container_powder_lies_on_the_pan_beside_no_mouth() -> None:
    rig = bench()
    rig.world.remove()
    rig.drive(rig.cell.hand.pulse(1.0, 0.5))
    let_pass(rig, 1.0)
    assert rig.world.masses_mg["pan"] > 5.0
    assert rig.world.true_mass("dish") == 0.0


def test_a_full_container_overflows_onto_the_pan() -> None:
    rig = bench()
    rig.world.remove()
    rig.world.place(DISH.model_copy(update={"id": "thimble", "capacity_mm3": 10.0}))
    rig.drive(rig.cell.hand.pulse(2.0, 1.0))
    let_pass(rig, 1.0)
    assert rig.world.true_mass("thimble") == pytest.approx(10.0 * BEADS.bulk_density_mg_per_mm3)
    assert rig.world.masses_mg["pan"] > 0.0


def test_the_valve_is_shut_when_it_is_shut_and_off_by_its_error_when_open() -> None:
    rig = bench(hand=HandSpec(simulation=ValveErrorSpec(opening_mm=0.0, sample_mm=0.0, stick_probability=0.0)))
    rig.cell.hand.set_opening(0.5)
    let_pass(rig, 0.5)
    assert rig.cell.hand.opening_mm == pytest.approx(0.5)
    rig.cell.hand.stop()
    let_pass(rig, 0.5)
    assert rig.cell.hand.is_stopped
    assert rig.cell.hand.opening_mm == 0.0


def test_a_cohesive_powder_does_not_flow_without_vibration() -> None:
    rig = bench(POWDERS["titanium_dioxide"])
    rig.drive(rig.cell.hand.pulse(1.5, 1.0))
    let_pass(rig, 1.0)
    assert rig.world.true_mass("dish") < 1.0
    rig.drive(rig.cell.hand.pulse(1.5, 1.0, 1.0))
    let_pass(rig, 1.0)
    assert rig.world.true_mass("dish") > 5.0


def test_lumps_that_shrink_with_the_gap_are_smaller_at_small_openings() -> None:
    powder = POWDERS["titanium_dioxide_fine"]

    def largest_mg(opening_mm: float) -> float:
        flow, rng = OurPowderFlow(powder), np.random.default_rng(3)
        return max(flow.step(0.02, opening_mm, 1.0, 4000.0, rng) for _ in range(4000))

    assert largest_mg(0.5) < 0.2 * largest_mg(1.5)


def test_shaken_crystals_come_in_avalanches_and_no_more_of_them_for_that() -> None:
    even = POWDERS["monosodium_glutamate"].simulation.model_copy(
        update={"load_variation": 0.0, "packing_variation": 0.0, "arch_diameter_mm": 0.0, "surge_share": 0.0}
    )

    def flowing(avalanche_mg: float, vibration: float) -> np.ndarray:
        """What leaves in each of many steps at a narrow opening, once the slot is full."""
        figures = even.model_copy(update={"avalanche_mg": avalanche_mg})
        powder = POWDERS["monosodium_glutamate"].model_copy(update={"simulation": figures})
        flow, rng = OurPowderFlow(powder), np.random.default_rng(3)
        return np.array([flow.step(0.02, 0.4, vibration, 4000.0, rng) for _ in range(20_000)])[100:]

    shaken = flowing(1.5, 1.0)
    avalanches = shaken[shaken > 1e-9]
    assert avalanches.std() == pytest.approx(avalanches.mean(), rel=0.1), "exponential"
    assert avalanches.mean() == pytest.approx(1.5, rel=0.1)
    assert shaken.mean() == pytest.approx(flowing(0.0, 1.0).mean(), rel=0.1)
    assert flowing(1.5, 0.0) == pytest.approx(flowing(0.0, 0.0))


def test_an_overloaded_balance_says_so() -> None:
    rig = bench(balance=BalanceSpec(maximum_mg=20_000.0))
    with pytest.raises(SkillFailed, match=r"balance\.overload"):
        rig.drive(rig.cell.balance.stable_mean())


class Broken:
    """A plant whose powder is not a number."""

    def flow(self, powder: Powder) -> Any:
        return self

    def step(self, *_: object) -> float:
        return math.nan


class Idle:
    """A plant that offers nothing."""


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("nonsense", "write it as module:Class"),
        ("no_such_module_x:Plant", "cannot be imported"),
        ("scuhand_bt.sim.powder:Missing", "has no class 'Missing'"),
        (f"{__name__}:Idle", "offers none of"),
    ],
)
def test_a_plant_that_cannot_be_used_is_refused_by_name(name: str, says: str) -> None:
    with pytest.raises(PlantError, match=says):
        load_plant(name)


def test_a_plant_of_nan_is_refused_before_anything_moves() -> None:
    with pytest.raises(PlantError, match=r"test plant: flow let nan mg"):
        Plant(Broken(), "test plant").probe(BEADS, BalanceSpec())
    with pytest.raises(PlantError, match="flow let nan mg"):
        bench(plant=f"{__name__}:Broken")


class BreaksLater:
    """A plant whose balance and powder are sound while they are tried."""

    class Of:
        steps = 0

        def step(self, *_: object) -> Any:
            self.steps += 1
            return 0.0 if self.steps < 10 else None

    def balance(self, spec: BalanceSpec) -> Of:
        return self.Of()


def test_a_plant_that_breaks_in_a_run_is_told_by_its_name() -> None:
    rig = bench(plant=f"{__name__}:BreaksLater")
    with pytest.raises(PlantError, match="BreaksLater: TypeError in balance"):
        rig.drive(rig.cell.balance.stable_mean())
