"""The noise of a balance's readings, learnt as they come; apart for when the motor shakes."""

import math

NOISE_GAIN, OUTLIER = 0.05, 12.0
"""Gain at which the noise is learnt; a second difference of more standard deviations is not noise."""
SECOND = 6.0
"""Variance of a second difference, in variances of a reading: 1 + 4 + 1."""
CHANGING = 5.0
"""With more than this unseen, in standard deviations, a reading tells nothing about noise."""


class Noise:
    """Standard deviations of a reading [mg]."""

    def __init__(self, quiet_mg: float, shaken_mg: float, readability_mg: float) -> None:
        """Start from what is believed with the motor off and running; the digit alone makes some noise."""
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
        """The noise by now [mg], from second differences: a slow change of the mass does not affect them."""
        recent, before_mg = self._recent_mg, self._mg[shaking]
        if shaking != self._was_shaking:  # the motor starts or stops in between
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
