"""Our powder: what leaves the apex in a time step, as one object per cone load.

    Q = C' (D - kd)^2.5 * load * packing * (1 + noise) * head * mobility

Beverloo's law (Beverloo, Leniger & van de Velde, Chem. Eng. Sci. 15, 1961) with C' [mg s^-1 mm^-2.5] and dead diameter
kd [mm] of the powder; D [mm] is the real opening. Around it:

* load, packing: log-normal factors, drawn per cone load and per opening of the valve;
* noise: an Ornstein-Uhlenbeck fluctuation with a correlation time of 0.25 s;
* head: the flow does not depend on the head (Janssen) until the last `HEAD_MG` above the heel. The heel is the share
  of the load that stays on a wall of only 26 deg; vibration brings it down;
* mobility: gravity's share of the flow; vibration adds the rest;
* arches: the mean mass between two arches grows as exp((D/Da)^3) (Thomas & Durian, Phys. Rev. Lett. 114, 178001,
  2015). Vibration breaks them (Janda et al., EPL 87, 2009), and so does the next opening of the valve;
* surges: part of a cohesive powder comes in lumps, a Poisson process with exponential masses. Their mean is fixed or
  grows with the gap; with `equal_lumps` every lump has the mean mass;
* avalanches: crystals shaken through a narrow gap jam and give way again; an exponential mass comes down between two
  jams (Zuriguel et al., Phys. Rev. E 71, 051303, 2005; Mankoc et al., Phys. Rev. E 80, 011309, 2009). Their mean flow
  is that of the law. Under vibration they replace the surges; without it there are none;
* the slot: the space between the two sheets fills as the valve opens and is squeezed out as it closes.
"""

import math

from numpy.random import Generator

from scuhand_bt.specs import Powder

NOISE_TIME_S = 0.25
HEAD_MG = 150.0
ARCH_MASS_MG = 2.0
"""Mean mass between arches as D goes to 0."""
ARCH_BREAKS_PER_S = 6.0
"""How often vibration at full level breaks an arch."""


class OurPowderFlow:
    """Powder leaving the apex; one object per cone load. With `equal_lumps` each lump of a surge has their mean
    mass.
    """

    def __init__(self, powder: Powder, *, equal_lumps: bool = False) -> None:
        self._spec = powder.simulation
        self._equal_lumps = equal_lumps
        self._load = 0.0  # not drawn yet
        self._heel_mg = 0.0
        self._packing = 1.0
        self._noise = 0.0
        self._is_open = False
        self._arched = False
        self._slot_mg = 0.0

    def step(self, dt_s: float, opening_mm: float, vibration: float, in_cone_mg: float, rng: Generator) -> float:
        """The mass [mg] that leaves in `dt_s`."""
        spec = self._spec
        if self._load == 0.0:
            self._load = math.exp(spec.load_variation * rng.standard_normal())
            self._heel_mg = spec.heel * in_cone_mg
        if opening_mm <= 0.0:
            squeezed_mg, self._slot_mg = min(self._slot_mg, in_cone_mg), 0.0
            self._is_open = self._arched = False
            return squeezed_mg
        if not self._is_open:
            self._is_open = True
            self._packing = math.exp(spec.packing_variation * rng.standard_normal())
        entering_mg = self._entering_mg(dt_s, opening_mm, vibration, in_cone_mg, rng)
        self._slot_mg += min(entering_mg, max(0.0, in_cone_mg - self._slot_mg))
        leaving_mg = min(max(0.0, self._slot_mg - spec.slot_mg_per_mm * opening_mm), in_cone_mg)
        self._slot_mg -= leaving_mg
        return leaving_mg

    def _entering_mg(
        self, dt_s: float, opening_mm: float, vibration: float, in_cone_mg: float, rng: Generator
    ) -> float:
        """The mass that enters the slot between the sheets from above."""
        spec = self._spec
        gap_mm = opening_mm - spec.dead_diameter_mm
        if gap_mm <= 0.0:
            return 0.0
        if self._arched:
            if vibration <= 0.0 or rng.random() >= ARCH_BREAKS_PER_S * vibration * dt_s:
                return 0.0
            self._arched = False
        head = min(1.0, max(0.0, in_cone_mg - self._heel_mg * (1.0 - vibration)) / HEAD_MG)
        mobility = spec.gravity + (1.0 - spec.gravity) * vibration
        keep = math.exp(-dt_s / NOISE_TIME_S)
        self._noise = keep * self._noise + math.sqrt(1.0 - keep * keep) * spec.rate_variation * rng.standard_normal()
        flow = spec.flow_coefficient * gap_mm * gap_mm * math.sqrt(gap_mm)
        flow *= self._load * self._packing * max(0.0, 1.0 + self._noise) * head * mobility
        entering_mg = flow * dt_s
        if spec.arch_diameter_mm > 0.0:
            between_mg = ARCH_MASS_MG * math.exp(min(50.0, (opening_mm / spec.arch_diameter_mm) ** 3))
            self._arched = rng.random() < entering_mg / between_mg
        if spec.avalanche_mg > 0.0 and vibration > 0.0:
            entering_mg = _in_lumps(entering_mg, spec.avalanche_mg, rng)
        elif spec.surge_share > 0.0 and entering_mg > 0.0:
            lumpy_mg = spec.surge_share * entering_mg
            entering_mg -= lumpy_mg
            lump_mg = spec.surge_mg * opening_mm**spec.surge_exponent
            entering_mg += _in_lumps(lumpy_mg, lump_mg, rng, equal=self._equal_lumps)
        return entering_mg


def _in_lumps(mass_mg: float, lump_mg: float, rng: Generator, *, equal: bool = False) -> float:
    """The mass that comes in this step if a mean flow of `mass_mg` comes in lumps, of exponential or equal mass."""
    if mass_mg <= 0.0:
        return 0.0
    lump_mg = max(lump_mg, mass_mg)
    if rng.random() >= mass_mg / lump_mg:
        return 0.0
    return lump_mg if equal else lump_mg * rng.standard_exponential()
