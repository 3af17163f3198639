"""All twins and all drivers together, over one simulated world in real time."""

import numpy as np
import pytest
from wire_helpers import carry_out, wait_for

from scuhand_bt.devices.connect import connect_cell_devices
from scuhand_bt.lab import load_lab, starter_lab
from scuhand_bt.motion import ApexPose, Mount, solutions
from scuhand_bt.run.clock import WallClock
from scuhand_bt.sim.wire.bench import WireBench
from scuhand_bt.specs import Container, Source

pytestmark = pytest.mark.real_time


def test_powder_dosed_through_the_wires_lands_in_the_container_and_is_weighed_there() -> None:
    lab = load_lab(starter_lab())
    sources = {
        "beads": Source(
            name="beads",
            station="mortar_bay",
            mortar=lab.library.mortars["agate_mortar"],
            powder=lab.library.powders["glass_beads"],
            amount_mg=6000.0,
        )
    }
    x_mm, y_mm, z_mm = lab.cell.station_of_kind("balance").position_mm
    over_the_pan = ApexPose(np.array([x_mm, y_mm, z_mm + 80.0]) / 1000.0)
    joints = solutions(over_the_pan, Mount.of(lab.cell.hand))[0]
    kind = lab.library.containers["xrd_holder"]
    clock = WallClock()
    with WireBench(lab.cell, sources, lab.folder / "robot" / "firmware", joints, clock, seed=3) as bench:
        devices = connect_cell_devices(bench.spec, clock)
        devices.hand.rim_is(90.0)
        try:
            assert np.allclose(devices.arm.positions, joints, atol=0.002)
            bench.world.place(Container(**kind.model_dump(), id="xrd-01"))
            bench.world.load_cone("beads", 3000.0)
            wait_for(lambda: devices.balance.latest is not None and devices.balance.latest.value_mg > 5000.0)
            before = carry_out(devices.balance.stable_mean(), clock)
            carry_out(devices.hand.pulse(1.5, 0.1), clock)
            after = carry_out(devices.balance.stable_mean(), clock)
            dosed_mg = bench.world.true_mass("xrd-01")
            assert dosed_mg > 10.0
            assert after.value_mg - before.value_mg == pytest.approx(dosed_mg, abs=1.0)
            assert bench.world.ledger.total_mg == pytest.approx(6000.0)
            closed_mm = devices.hand.cone_diameter_mm - 2.0
            carry_out(devices.hand.morph(closed_mm), clock)
            assert devices.hand.cone_diameter_mm == pytest.approx(closed_mm, abs=0.05)
        finally:
            devices.close()


def test_a_balances_twin_tells_readings_as_often_as_the_cell_says_that_it_does() -> None:
    """Told oftener, each of them several times, they were a display that stands still, and then jumps."""
    lab = load_lab(starter_lab())
    balance = lab.cell.balance.model_copy(update={"driver": "and", "period_s": 0.5})
    spec = lab.cell.model_copy(update={"balance": balance})
    x_mm, y_mm, z_mm = spec.station_of_kind("balance").position_mm
    above = ApexPose(np.array([x_mm, y_mm, z_mm + 80.0]) / 1000.0)
    joints = solutions(above, Mount.of(spec.hand))[0]
    clock = WallClock()
    with WireBench(spec, {}, lab.folder / "robot" / "firmware", joints, clock) as bench:
        devices = connect_cell_devices(bench.spec, clock)
        try:
            times_s = [carry_out(devices.balance.next_reading(), clock).time_s for _ in range(5)]
        finally:
            devices.close()
    assert times_s[-1] - times_s[0] > 1.5
