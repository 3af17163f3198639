"""The floor: the best dose of one who sees the truth.

It knows what has left the nozzle, the real opening, and the state of the powder: how strongly this load flows through
this opening now, what is on its way through the apex, whether it is primed or bridged. It knows the distribution of
what comes next (`oracle_model`) and not the draws. A flow f times as strong as the median one is taken for what comes
at the opening where that is f times as strong.

Nothing but the hand limits its opening. The motor runs while the valve is open, and stops at the command to shut; or it
does not run, where that is the better: crystals that are shaken come in avalanches. The dose is weighed before and
watched afterwards as any other: that takes the same time.
"""

import contextlib
import copy
import math
from typing import Any, Literal

import numpy as np

from benchmarks.oracle_model import LOOK_S, MIDDLE, SHUT, STEP_S, STILL_S, Model, apex_mg, flowing
from scuhand_bt.cell.cell import Cell
from scuhand_bt.cell.dose_loop import DoseRun
from scuhand_bt.cell.weighing import weigh_until_still, weighing_of
from scuhand_bt.clock import Steps, Wake
from scuhand_bt.dosing import DoseRequest, Finish
from scuhand_bt.dosing.bracket import watch_s
from scuhand_bt.sim.hand import FADE_MM
from scuhand_bt.sim.mass_ledger import CONE, FLIGHT
from scuhand_bt.sim.plant import PowderFlow
from scuhand_bt.sim.world import World

QUIET_S = 0.5
"""What has not come for so long is tried to be brought: by shutting the valve and opening it anew, or by shaking."""
LONGEST_S = 900.0

VIBRATIONS = (1.0, 0.0)
"""Of the motor, while the valve is open."""

MODELS: dict[str, list[Model]] = {}
"""By all that makes a plant's flow and its valve: the doses of one plant share them."""


def models_of(world: World, request: DoseRequest) -> list[Model]:
    """What is known of this world's powder and valve, shaken and not, where it flows so."""
    load, hand = world.load, world._hand.spec
    assert load.source is not None
    powder = load._sources[load.source].powder
    key = f"{vars(load._plant.flow(powder))} {hand!r} {request.tolerance_mg}"
    if key not in MODELS:
        MODELS[key] = []
        for vibration in VIBRATIONS:
            with contextlib.suppress(ValueError):
                MODELS[key].append(Model(lambda: load._plant.flow(powder), hand, request.tolerance_mg, vibration))
    return MODELS[key]


class Oracle:
    """One dose's eyes and hands."""

    def __init__(self, request: DoseRequest, cell: Cell, world: World, container: str) -> None:
        self.request, self.openings = request, 0
        self._world, self._container, self._clock = world, container, cell.clock
        self._hand = world._hand
        self._models = models_of(world, request)
        self._model = self._models[0]
        self._strength = 1.0

    @property
    def missing_mg(self) -> float:
        """What has yet to leave the apex."""
        left_mg = self._world.true_mass(self._container) + self._world.ledger.masses_mg[FLIGHT]
        return self.request.target_mg - left_mg

    def dose(self) -> Steps[str]:
        """Until it is best to end; why it ended."""
        end_s = self._clock.now_s + LONGEST_S
        while self._clock.now_s < end_s:
            self._model = max(self._models, key=lambda model: model.worth(self.missing_mg))
            _, to = self._look()
            if to == SHUT:
                return "reached" if abs(self.missing_mg) <= self.request.tolerance_mg else "overshoot"
            self.openings += 1
            yield from self._go_to(to)
            yield from self._steer(end_s)
            self._hand.stop()
            yield from self._wait(self._way_s(0.0) + STILL_S)
        return "step_limit"

    def _steer(self, end_s: float) -> Steps[None]:
        """One opening of the valve, until it is to be shut."""
        quiet_s, before_mg = 0.0, self.missing_mg
        while self._world.ledger.masses_mg[CONE] > 0.0 and self._clock.now_s < end_s:
            index, to = self._look()
            freed_by = self._freed_by() if quiet_s > QUIET_S else None
            if to == SHUT or freed_by == "shutting":
                return
            self._hand.set_vibration(VIBRATIONS[0] if freed_by == "shaking" else self._model.vibration)
            if to == index:
                yield from self._wait(LOOK_S)
            else:
                yield from self._go_to(to)
            quiet_s = 0.0 if self.missing_mg < before_mg else quiet_s + LOOK_S
            before_mg = self.missing_mg

    def _look(self) -> tuple[int, int]:
        """Which of the model's openings the real one is, by how strongly the powder flows or will flow; what is best.

        What leaves the cone in closing is not quite the same there and here: what is more counts as if it had left.
        """
        gap_mm, in_cone_mg, model = self._hand.gap_mm, self._world.ledger.masses_mg[CONE], self._model
        missing_mg = self.missing_mg - apex_mg(self._flow, in_cone_mg)
        known = model.rate(gap_mm)
        if known <= 0.0:
            return SHUT, model.action(missing_mg, SHUT)
        flow, now = flowing(self._flow, gap_mm, model.vibration, in_cone_mg)
        self._strength = now / known if now > 0.0 else self._strength
        index = int(np.argmin(np.abs(model.log_rates - math.log(known * self._strength))))
        more_mg = model.closing_mg(flow, gap_mm, in_cone_mg) - model.closings_mg[index] if now > 0.0 else 0.0
        return index, model.action(missing_mg - more_mg, index)

    def _go_to(self, index: int) -> Steps[None]:
        """The opening that lets as much through as the median flow does at this one."""
        hand = self._hand
        real_mm = self._model.opening_mm(math.exp(self._model.log_rates[index]) / self._strength)
        error_mm = hand._error_mm if hand.opening_mm > 0.0 else hand._sample_error_mm
        servo_mm = real_mm - error_mm
        servo_mm = servo_mm if servo_mm >= FADE_MM else real_mm / max(0.2, 1.0 + error_mm / FADE_MM)
        servo_mm = min(max(servo_mm, 0.02), hand.spec.max_opening_mm)
        hand.set_vibration(self._model.vibration)
        hand.set_opening(servo_mm)
        yield from self._wait(self._way_s(servo_mm))

    def _freed_by(self) -> Literal["shutting", "shaking"] | None:
        """What frees powder that does not come now: the valve shut and opened anew, or shaking; None where it comes."""
        flow, gap_mm, in_cone_mg = copy.copy(self._flow), self._hand.gap_mm, self._world.ledger.masses_mg[CONE]

        def comes() -> bool:
            steps = (flow.step(STEP_S, gap_mm, self._model.vibration, in_cone_mg, MIDDLE) for _ in range(10))
            return sum(steps) > 0.0

        if comes():
            return None
        flow.step(STEP_S, 0.0, 0.0, in_cone_mg, MIDDLE)
        return "shutting" if comes() else "shaking"

    @property
    def _flow(self) -> PowderFlow:
        flow = self._world.load._flow
        assert flow is not None
        return flow

    def _way_s(self, opening_mm: float) -> float:
        spec = self._hand.spec
        return spec.valve_dead_time_s + abs(opening_mm - self._hand.opening_mm) / spec.valve_speed_mm_per_s

    def _wait(self, duration_s: float) -> Steps[None]:
        end_s = self._clock.now_s + duration_s
        while self._clock.now_s < end_s - 1e-9:
            yield Wake(end_s)


def run_oracle(dispense: Any, cell: Cell, world: World, container: str) -> Steps[DoseRun]:
    """A dose as `dispense` makes it, weighed before and watched afterwards like any other."""
    assert cell.believed.bracket is not None
    _, mean = yield from weigh_until_still(cell, cell.believed.bracket.last, dispense._allowed_mg)
    before, begin_s = weighing_of(mean), cell.clock.now_s
    oracle = Oracle(dispense.request(cell), cell, world, container)
    reason: Any = yield from oracle.dose()
    last = weighing_of((yield from cell.balance.stable_mean()))
    duration_s = cell.clock.now_s - begin_s
    _, mean = yield from weigh_until_still(cell, last, 0.0, watch_s(before, last, dispense.tolerance_mg))
    finish = Finish(reason, world.true_mass(container), math.sqrt(2.0) * mean.uncertainty_mg)
    return DoseRun(finish, weighing_of(mean), [], oracle.openings, 0.0, duration_s)
