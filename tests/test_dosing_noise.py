"""How much readings scatter: learnt apart for when the hand's motor shakes, and kept from dose to dose."""

import math

import numpy as np
import pytest
from dose_bench import UNSEEN, Bench, dose_request, shipped_powders

from scuhand_bt.dosing.knowledge import Knowledge
from scuhand_bt.dosing.noise import Noise

QUIET_MG, SHAKEN_MG = 0.08, 0.48


def test_short_times_of_shaking_tell_how_much_readings_scatter_in_them_and_the_quiet_between_how_much_else() -> None:
    rng, noise = np.random.default_rng(1), Noise(0.1, 0.3, readability_mg=0.1)
    variances: dict[bool, list[float]] = {True: [], False: []}
    for number in range(400):
        shaking = number % 2 == 0
        for _ in range(9):
            reading_mg = float(rng.standard_normal()) * (SHAKEN_MG if shaking else QUIET_MG)
            variances[shaking].append(noise.learn(reading_mg, 0.0, shaking=shaking) ** 2)
    assert math.sqrt(np.mean(variances[True])) == pytest.approx(SHAKEN_MG, rel=0.05)
    assert math.sqrt(np.mean(variances[False])) == pytest.approx(QUIET_MG, rel=0.05)
    assert (noise.shaken_mg, noise.quiet_mg) == (math.sqrt(variances[True][-1]), math.sqrt(variances[False][-1]))


def test_what_doses_have_seen_of_the_noise_is_what_the_next_one_begins_with() -> None:
    powder = shipped_powders()["titanium_dioxide"]
    belief, balance = powder.belief, UNSEEN
    for dose in range(3):
        bench = Bench(powder, 50.0, seed=5, dose=dose)
        belief, balance = bench.dose("adaptive", belief, balance).learnt(belief, balance)
    vibration_mg = bench.cell.spec.balance.simulation.vibration_noise_mg
    assert balance.shaken_noise_mg == pytest.approx(QUIET_MG + vibration_mg, rel=0.25)
    assert balance.noise_mg == pytest.approx(QUIET_MG, rel=0.5)
    known = Knowledge(dose_request(balance=balance))
    assert (known.noise.shaken_mg, known.noise.quiet_mg) == (balance.shaken_noise_mg, balance.noise_mg)
