"""Controller `direct_pid`: the paper's baseline, a PID loop from the error straight to the valve.

    u = Kp e + Ki sum(e) + Kd (e - e_before),   D = D_max sat(u),   t = t_max sat(u)

e error [mg], u in 0..1. One setting for all targets, tuned at 500 mg as the paper says: so it crawls at
20 mg, where u stays below the onset of flow until the sum has grown, and at 3 g the sum wound up
on the way holds the valve open through the target (Takahashi et al., ICRA 2026, section V).
"""

from scuhand_bt.dosing.controller import Command, DoseRequest, Finish, Observation, Pulse
from scuhand_bt.dosing.paper import WAIT_S

KP_PER_MG = 3.0e-4
KI_PER_MG = 2.0e-5
KD_PER_MG = 1.0e-4
LONGEST_DWELL_S = 2.0
SHORTEST_DWELL_S = 0.1
DRY_STEPS = 8
"""Full openings in a row without powder after which the cone is given up."""


class DirectPid:
    """PID on the weighing error, without a model of the powder."""

    name = "direct_pid"

    def __init__(self, request: DoseRequest) -> None:
        self._request = request
        self._sum_mg = 0.0
        self._before_mg: float | None = None
        self._start_mg = 0.0
        self._net_mg = 0.0
        self._steps = self._dry = 0
        self._full = False

    def decide(self, seen: Observation | None) -> Command:
        request = self._request
        if seen is not None:
            if self._steps == 0:
                self._start_mg = self._net_mg = seen.net_mg
            self._dry = self._dry + 1 if self._full and seen.net_mg - self._net_mg < 0.5 else 0
            self._net_mg = seen.net_mg
            error_mg = request.target_mg - seen.net_mg
            if abs(error_mg) < request.tolerance_mg:
                return Finish("reached", seen.net_mg, seen.uncertainty_mg)
            if error_mg < 0.0:
                return Finish("overshoot", seen.net_mg, seen.uncertainty_mg)
            if self._dry >= DRY_STEPS:
                return Finish(request.given_up(seen.net_mg - self._start_mg), seen.net_mg, seen.uncertainty_mg)
            if self._steps >= request.step_limit:
                return Finish("step_limit", seen.net_mg, seen.uncertainty_mg)
        error_mg = request.target_mg - self._net_mg
        self._sum_mg += error_mg
        change_mg = 0.0 if self._before_mg is None else error_mg - self._before_mg
        self._before_mg = error_mg
        effort = KP_PER_MG * error_mg + KI_PER_MG * self._sum_mg + KD_PER_MG * change_mg
        effort = min(max(effort, 0.0), 1.0)
        self._full = effort >= 1.0
        self._steps += 1
        vibration = 1.0 if request.powder.vibration else 0.0
        dwell_s = max(SHORTEST_DWELL_S, effort * LONGEST_DWELL_S)
        return Pulse(effort * request.max_opening_mm, dwell_s, vibration, WAIT_S)
