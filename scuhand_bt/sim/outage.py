"""What a power cut does to a simulated cell: to its devices and its powder, and what people do to it meanwhile.

The faults (`outage.…`, docs/faults.md) decide which of these come; the outage's own random draws decide how much.
"""

import numpy as np

from scuhand_bt.sim.arm import SimulatedArm
from scuhand_bt.sim.balance import SimulatedBalance
from scuhand_bt.sim.cone_load import ConeLoad
from scuhand_bt.sim.fault_rules import OUTAGES
from scuhand_bt.sim.faults import Faults
from scuhand_bt.sim.hand import SimulatedHand
from scuhand_bt.sim.pan import Pan

ZERO_MOVES_MG = (-15.0, -3.0, -1.0, 1.0, 2.5, 15.0)
"""Shifts of a balance's zero over some hours: warm-up, levelling, an imperfect re-zero."""
SPAN_MOVES = 1e-5
"""Standard deviation of the relative change of the span: another temperature, an adjustment at power-on."""
SAG_RAD = 0.15
"""How far a limp joint sinks at most; then the arm rests on something."""
LEAST_FALL_MG = 1.0


class PowerCut:
    """One outage of one world: call `begin` at its start, `go_on` in its middle, `end` when the power is back."""

    def __init__(self, faults: Faults, now_s: float, rng: np.random.Generator) -> None:
        self._comes = {name for name in OUTAGES if faults.comes(name, now_s)}
        self._rng = rng

    def begin(self, now_s: float, arm: SimulatedArm, hand: SimulatedHand, pan: Pan) -> None:
        """The devices go off. A hand without power leaves its valve as it is; else its dead-man shuts it."""
        if "outage.valve_open" in self._comes:
            hand.freeze()
        else:
            hand.shut(now_s)
        if "outage.roller_lost" in self._comes:
            hand.knows_its_roller = False
        if "outage.arm_limp" in self._comes:
            arm.sink(self._rng.uniform(0.0, SAG_RAD))
        if "outage.changer_lost" in self._comes:
            pan.end_swing()

    def go_on(self, now_s: float, hand: SimulatedHand, load: ConeLoad, in_cone_mg: float) -> None:
        """The bench is knocked, and the hand is on again."""
        if "outage.valve_open" in self._comes:
            hand.shut(now_s)
        if "outage.powder_fell" in self._comes and in_cone_mg > LEAST_FALL_MG:
            load.drop(now_s, float(np.exp(self._rng.uniform(np.log(LEAST_FALL_MG), np.log(in_cone_mg)))))

    def end(self, balance: SimulatedBalance, pan: Pan) -> None:
        """Somebody has handled the container, and the balance is on again."""
        if "outage.container_taken" in self._comes:
            pan.carry_off()
        if "outage.container_exchanged" in self._comes:
            pan.exchange(self._rng)
        if "outage.span_moved" in self._comes:
            balance.change_span(SPAN_MOVES * float(self._rng.standard_normal()))
        if "outage.zero_at_power_on" in self._comes:
            balance.take_zero(pan.gross_mg(0.0))
        if "outage.zero_moved" in self._comes:
            balance.move_zero(float(self._rng.choice(ZERO_MOVES_MG)))
