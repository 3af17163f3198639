"""The noise of a balance's readings: learnt as they come, apart for when the motor shakes."""

import math

NOISE_GAIN, OUTLIER = 0.05, 12.0
"""How fast the noise is learnt; a second difference of more standard deviations is no noise."""
SECOND = 6.0
"""Times a reading's variance is that of a second difference: 1 + 4 + 1."""
CHANGING = 5.0
"""Nor does a reading tell of it while more is on its way than so many standard deviations."""


class Noise:
    """Standard deviations of a reading [mg]."""

    def __init__(self, quiet_mg: float, shaken_mg: float, readability_mg: float) -> None:
        """What is believed while the motor is off, and while it runs; digits of `readability_mg` alone make some."""
        self._least_mg = readability_mg / math.sqrt(12.0)
        self._mg = {False: max(quiet_mg, self._least_mg), True: max(shaken_mg, self._least_mg)}
        self._recent_mg: list[float] = []
        self._was_shaking = False

    @property
    def quiet_mg(self) -> float:
        return self._mg[False]

    @property
    def shaken_mg(self) -> float:
        return self._mg[True]

    def learn(self, reading_mg: float, unseen_mg: float, *, shaking: bool) -> float:
        """What it is by now: from second differences, which a slowly changing mass leaves alone."""
        recent, before_mg = self._recent_mg, self._mg[shaking]
        if shaking != self._was_shaking:  # the motor starts and stops meanwhile
            self._was_shaking = shaking
            recent.clear()
            return before_mg
        recent.append(reading_mg)
        if len(recent) < 3:
            return before_mg
        second_mg = recent[-1] - 2.0 * recent[-2] + recent[-3]
        del recent[0]
        if unseen_mg <= CHANGING * before_mg and abs(second_mg) <= OUTLIER * before_mg:
            variance = (1.0 - NOISE_GAIN) * before_mg**2 + NOISE_GAIN * second_mg**2 / SECOND
            self._mg[shaking] = max(self._least_mg, math.sqrt(variance))
        return self._mg[shaking]
