"""Controller `paper`: Algorithm 1 of the SCU-Hand-SV paper (Takahashi et al., ICRA 2026).

    e = W_goal - W;  use_vibration = false
    while |e| >= 2:
        fit C' on stored (D, t, dW >= 0.5 mg)
        (D, t) = argmin |W(D, t; C') - Kp e|
        if W(D_max, t_max; C') < Kp e:  use_vibration = true, and W is switched to vibration
        pulse;  weigh

Nothing in the listing sets `use_vibration` back: once shaken, a dose is shaken to its end. What the listing leaves
open is settled like this:

* *The first C'.* It has none to start with. It is started `CAUTION` spreads of the powder's first guess too large,
  so that the first pulses are small.
* *Vibration mode.* W is 'switched internally': each mode has a C' of its own, fitted to its own pulses.
* *The branch of the argmin.* The minimum is a curve in (D, t). The shortest dwell is taken first and
  the opening solved for; only when the widest opening does not suffice does the dwell grow.

Where the listing is left, the departure has a name (`scuhand_bt.specs.Departure`) and can be taken back, for a powder
(`paper: {departures: [...]}` in `robot/powders.yaml`):

* `guard`: the strict |e| < tolerance is held against the first settled reading, less the guard band that the verdict
  keeps (`verdict`). As printed there is none.
* `overshoot`: `while |e| >= 2` never ends once e <= -2, as powder cannot be taken back. The dose ends.
* `giving-up`: full openings under vibration that bring nothing end the dose, as `empty` or `no_flow`.
* `shaken-start`: a dose of a powder that flows only when shaken begins with `use_vibration` true. As printed it begins
  with false, and is not shaken before a pulse as large as is wanted is larger than the widest one should bring.
* `order`: vibration is decided on before the argmin, so that the first shaken pulse is sized by the shaken C'.
  As printed that pulse is the argmin of the other mode.
* `first-guess`: it stays in the fit as one more pulse like the first, so that one odd pulse cannot collapse C'.
* `thaw`: a pulse below 0.5 mg is never stored, so a C' that is far too high never falls, and every pulse may bring
  nothing. From the fifth pulse in a row on that brings less than half of what was expected and is not stored, C' is
  lowered by a third each time; to no less than a third of the last fit, though: a clog that breaks must not find the
  valve wide open.
"""

from dataclasses import dataclass, field

from scuhand_bt.dosing.controller import Command, DoseRequest, Observation, Pulse, Weigh, stopped
from scuhand_bt.dosing.flow import EXPONENT, PulseModel, basis, fit_coefficient
from scuhand_bt.specs import Departure

STORED_MG = 0.5
"""A pulse that brought less is not stored for the fit (Algorithm 1)."""
SHORTEST_DWELL_S = 0.1
LONGEST_DWELL_S = 2.0
"""t_pose = 200 in the listing; the times per step of Table II say that its unit is 10 ms."""
CAUTION = 2.5
BARREN_PULSES = 5
LOWERED = 2.0 / 3.0
LEAST_SHARE = 1.0 / 3.0
DRY_PULSES = 5


@dataclass
class _Mode:
    """One flow mode's stored pulses and the C' fitted to them."""

    coefficient: float
    fitted: float = 0.0
    """The last fit."""
    bases: list[float] = field(default_factory=list)
    masses_mg: list[float] = field(default_factory=list)

    def store(self, pulse_basis: float, mass_mg: float) -> None:
        self.bases.append(pulse_basis)
        self.masses_mg.append(mass_mg)
        self.coefficient = self.fitted = fit_coefficient(self.bases, self.masses_mg)

    def lower(self) -> None:
        self.coefficient = max(LOWERED * self.coefficient, LEAST_SHARE * self.fitted)


class Paper:
    """Algorithm 1, pulse by pulse."""

    name = "paper"

    def __init__(self, request: DoseRequest) -> None:
        self._request = request
        start = (1.0 + CAUTION * request.powder.spread) * request.powder.coefficient
        self._gravity, self._shaken = _Mode(start), _Mode(start)
        self._use_vibration = Departure.SHAKEN_START in request.departures and request.powder.vibration > 0.0
        self._pulse: Pulse | None = None
        self._net_mg = 0.0
        self._start_mg = 0.0
        self._pulses = self._barren = self._dry = 0

    @property
    def estimate_mg(self) -> float:
        return self._net_mg

    def decide(self, seen: Observation | None) -> Command:
        request = self._request
        if seen is None:
            return Weigh()  # what is in the container already counts
        if self._pulse is None:
            self._start_mg = seen.net_mg
        else:
            self._learn(self._pulse, seen.net_mg - self._net_mg)
        self._net_mg = seen.net_mg
        end = stopped(request, seen, self._pulses, self._dry >= DRY_PULSES, seen.net_mg - self._start_mg)
        if end is not None:
            return end
        self._pulse = self._aim(request.gain * (request.target_mg - self._net_mg))
        self._pulses += 1
        return self._pulse

    @property
    def _mode(self) -> _Mode:
        return self._shaken if self._use_vibration else self._gravity

    def _learn(self, pulse: Pulse, gained_mg: float) -> None:
        mode, departures = self._mode, self._request.departures
        pulse_basis = basis(pulse.opening_mm, pulse.dwell_s, self._request.valve_speed_mm_per_s)
        barren = gained_mg < 0.5 * mode.coefficient * pulse_basis
        self._barren = self._barren + 1 if barren else 0
        if gained_mg >= STORED_MG:
            if not mode.bases and Departure.FIRST_GUESS in departures:
                mode.store(pulse_basis, mode.coefficient * pulse_basis)
            mode.store(pulse_basis, gained_mg)
        elif self._barren >= BARREN_PULSES and Departure.THAW in departures:
            mode.lower()
        full = pulse.opening_mm >= self._request.max_opening_mm and pulse.dwell_s >= LONGEST_DWELL_S
        self._dry = self._dry + 1 if full and gained_mg < STORED_MG else 0

    def _aim(self, aim_mg: float) -> Pulse:
        request = self._request
        sized_by = self._mode
        widest = PulseModel(sized_by.coefficient, request.valve_speed_mm_per_s)
        if widest.mass_mg(request.max_opening_mm, LONGEST_DWELL_S) < aim_mg:
            self._use_vibration = True
        if Departure.ORDER in request.departures:
            sized_by = self._mode
        wanted = aim_mg / sized_by.coefficient
        opening_mm, dwell_s = solve_pulse(wanted, request.max_opening_mm, request.valve_speed_mm_per_s)
        return Pulse(opening_mm, dwell_s, 1.0 if self._use_vibration else 0.0, request.wait_s)


def solve_pulse(wanted_basis: float, max_opening_mm: float, speed_mm_per_s: float) -> tuple[float, float]:
    """(D [mm], t [s]) whose basis D^2.5 (D/speed + t) is nearest to the wanted one, shortest dwell first."""
    if basis(max_opening_mm, SHORTEST_DWELL_S, speed_mm_per_s) <= wanted_basis:
        dwell_s = wanted_basis / max_opening_mm**EXPONENT - max_opening_mm / speed_mm_per_s
        return max_opening_mm, min(dwell_s, LONGEST_DWELL_S)
    low_mm, high_mm = 0.0, max_opening_mm
    while high_mm - low_mm > 1e-4:
        middle_mm = (low_mm + high_mm) / 2.0
        if basis(middle_mm, SHORTEST_DWELL_S, speed_mm_per_s) < wanted_basis:
            low_mm = middle_mm
        else:
            high_mm = middle_mm
    return high_mm, SHORTEST_DWELL_S
