"""Controller `direct_pid`: the paper's baseline, a PID loop from the error straight to the valve.

    u = Kp e + Ki s + Kd (e - e_before),   s' = kept s + e
    D = D_min + (D_max - D_min) sat(u),   t = t_min + (t_max - t_min) sat(u)

e error [mg], s its leaking sum, u the effort 0..1. One setting for all targets, as in the paper (Takahashi et
al., ICRA 2026, section V), which does not print its gains: these are fitted by hand to its three
columns. It crawls at 20 mg, where u hardly opens the valve beyond the onset of flow, and overshoots at 3 g,
where what the sum has gathered on the way holds the valve wide open through the target.
"""

from scuhand_bt.dosing.controller import Command, DoseRequest, Observation, Pulse, Weigh, stopped

KP_PER_MG = 3.9e-4
KI_PER_MG = 1.63e-4
KD_PER_MG = 7.3e-3
KEPT = 0.905
"""Share of the sum that is kept from one step to the next."""
NARROWEST_MM = 0.165
SHORTEST_DWELL_S = 0.10
LONGEST_DWELL_S = 0.53
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

    @property
    def estimate_mg(self) -> float:
        return self._net_mg

    def decide(self, seen: Observation | None) -> Command:
        request = self._request
        if seen is None:
            return Weigh()  # what is in the container already counts
        if self._steps == 0:
            self._start_mg = self._net_mg = seen.net_mg
        self._dry = self._dry + 1 if self._full and seen.net_mg - self._net_mg < 0.5 else 0
        self._net_mg = seen.net_mg
        error_mg = request.target_mg - seen.net_mg
        end = stopped(request, seen, self._steps, self._dry >= DRY_STEPS, seen.net_mg - self._start_mg)
        if end is not None:
            return end
        self._sum_mg = KEPT * self._sum_mg + error_mg
        change_mg = 0.0 if self._before_mg is None else error_mg - self._before_mg
        self._before_mg = error_mg
        effort = KP_PER_MG * error_mg + KI_PER_MG * self._sum_mg + KD_PER_MG * change_mg
        effort = min(max(effort, 0.0), 1.0)
        self._full = effort >= 1.0
        self._steps += 1
        vibration = 1.0 if request.powder.vibration else 0.0
        opening_mm = NARROWEST_MM + effort * (request.max_opening_mm - NARROWEST_MM)
        dwell_s = SHORTEST_DWELL_S + effort * (LONGEST_DWELL_S - SHORTEST_DWELL_S)
        return Pulse(opening_mm, dwell_s, vibration, request.wait_s)
