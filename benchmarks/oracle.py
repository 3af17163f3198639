"""The floor: a controller that sees the true mass, landed and in flight, at every instant.

It has the same hand and the same stopping rules as `adaptive`: it closes once what will have left lies within
the tolerance, and ends on a stable mean of the balance. What it cannot know is what the valve and the
powder will do next; its error is what no measurement can avoid.
"""

import math

from scuhand_bt.cell.cell import Cell
from scuhand_bt.cell.dose_loop import DoseRun
from scuhand_bt.cell.weighing import weighing_of
from scuhand_bt.clock import Steps, Wake
from scuhand_bt.dosing import DoseRequest, Finish
from scuhand_bt.dosing.pulses import within
from scuhand_bt.dosing.valve import FlowShape
from scuhand_bt.sim.mass_ledger import FLIGHT
from scuhand_bt.sim.world import World

LOOK_S = 0.02
WATCH_LAGS, SLACK_S = 2.0, 0.15
AHEAD_S = 0.35
"""Time constant of its approach: what is left divided by this is its flow."""
GUARD_MG = 0.3
REMEMBERED_LUMPS = 5.0
"""Lumps are judged by the mass that last fell: so many of them."""
RESERVED = 3.0
DOUBT = 3.0
QUIET_S = 0.8
LEAST_SHARE = 0.3
"""The flow's coefficient is never taken to be below this share of what is believed of the powder."""
LEAST_SURGE_MG = 0.03


class Oracle:
    """Picks the opening from the true remaining mass and the true flow of the last moments."""

    def __init__(self, request: DoseRequest) -> None:
        self.request = request
        self.shape = FlowShape(request.powder.threshold_mm, request.powder.exponent)
        self.coefficient = request.powder.coefficient
        self.surge_mg = DOUBT * request.powder.surge_mg
        self._mean = REMEMBERED_LUMPS * self.surge_mg
        self._odd = 2.0 * self.surge_mg * self._mean
        self._fell, self._passed = self._mean, self._mean / self.coefficient

    def aim_mg(self) -> float:
        """Where it closes: inside the tolerance from below, where a lump has the most room."""
        return self.request.target_mg - self.request.tolerance_mg + GUARD_MG

    def opening_mm(self, remaining_mg: float, slowest: float) -> float:
        """As wide as the standard deviations of surges allow, `AHEAD_S` ahead."""
        surge_mg = self.surge_mg
        flow = max(within(remaining_mg - RESERVED * surge_mg, surge_mg) / AHEAD_S, slowest)
        opening_mm = self.shape.opening_mm(flow / self.coefficient)
        return min(max(opening_mm, self.shape.threshold_mm + 0.05), self.request.max_opening_mm)

    def learn(self, gained_mg: float, phi_s: float) -> None:
        """The flow's coefficient, lumps included; lumps of mean mass m make the variance 2 m times the mean.

        It forgets as powder passes, not as time does: a slow flow without a lump says nothing.
        """
        expected_mg = self.coefficient * phi_s
        kept = math.exp(-expected_mg / (REMEMBERED_LUMPS * self.surge_mg))
        self._odd = kept * self._odd + (gained_mg - expected_mg) ** 2
        self._mean = kept * self._mean + expected_mg
        self.surge_mg = max(self._odd / self._mean / 2.0, LEAST_SURGE_MG)
        self._fell = kept * self._fell + gained_mg
        self._passed = kept * self._passed + phi_s
        self.coefficient = max(self._fell / self._passed, LEAST_SHARE * self.request.powder.coefficient)

    def tail_mg(self, opening_mm: float) -> float:
        request = self.request
        return self.coefficient * self.shape.closing(
            opening_mm, request.valve_dead_time_s, request.valve_speed_mm_per_s
        )


def run_oracle(oracle: Oracle, cell: Cell, world: World, container: str) -> Steps[DoseRun]:
    """Run it to its end."""
    request, hand, clock = oracle.request, cell.hand, cell.clock
    begin_s = clock.now_s
    vibration = request.powder.vibration
    openings = 0
    reason = "step_limit"

    def left_mg() -> float:
        return world.true_mass(container) + world.ledger.masses_mg[FLIGHT]

    while openings < 25:
        openings += 1
        quiet_s, shaking = 0.0, vibration
        before_mg, opening_mm, slowest = left_mg(), 0.0, min(3.0, max(0.3 / oracle.surge_mg, 0.25))
        while left_mg() + oracle.tail_mg(hand.opening_mm) < oracle.aim_mg():
            opening_mm = oracle.opening_mm(oracle.aim_mg() - left_mg(), slowest)
            hand.set_vibration(shaking)
            hand.set_opening(opening_mm)
            end_s = clock.now_s + LOOK_S
            phi = oracle.shape.value(hand.opening_mm)
            while clock.now_s < end_s - 1e-9:
                yield Wake(end_s)
            now_mg = left_mg()
            gained_mg, before_mg = now_mg - before_mg, now_mg
            phi = (phi + oracle.shape.value(hand.opening_mm)) / 2.0
            oracle.learn(gained_mg, phi * LOOK_S)
            if gained_mg > 0.0:
                quiet_s = 0.0
            elif phi > 0.0:
                quiet_s += LOOK_S
                if quiet_s > QUIET_S:
                    shaking = 1.0
                if quiet_s > 2.0 * QUIET_S:
                    slowest = min(slowest * 1.02, 50.0)
                if quiet_s > 30.0:
                    break
        shut_s = request.valve_dead_time_s + hand.opening_mm / request.valve_speed_mm_per_s
        hand.stop()
        end_s = clock.now_s + shut_s + SLACK_S + WATCH_LAGS * cell.spec.balance.simulation.lag_s
        while clock.now_s < end_s:
            yield Wake(end_s)
        mean = yield from cell.balance.stable_mean()
        error_mg = world.true_mass(container) - request.target_mg
        if quiet_s > 30.0:
            reason = "no_flow"
            break
        if error_mg >= -request.tolerance_mg + 0.02:
            reason = "reached" if error_mg <= request.tolerance_mg else "overshoot"
            break
    true_mg = world.true_mass(container)
    finish = Finish(reason, true_mg, math.sqrt(2.0) * mean.uncertainty_mg)  # type: ignore[arg-type]
    return DoseRun(finish, weighing_of(mean), openings, 0.0, clock.now_s - begin_s)
