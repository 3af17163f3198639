"""How much of a run's time tells nothing of what is still to come: it was paused, or a person long kept it waiting."""

from dataclasses import dataclass

PERSON_S = 120.0
"""So much of a question counts: the longest that a skill of the starter lab forecasts for a person. Who takes longer
has not been there, as overnight."""


@dataclass
class Standing:
    """Told of pauses and questions, each with the run's time, in their order."""

    stood_s: float = 0.0
    """Until now, but for what goes on."""
    _paused_s: float | None = None
    _asked_s: float | None = None
    _stood_before_s: float = 0.0

    def paused(self, time_s: float) -> None:
        """A person wished that it stands still."""
        if self._paused_s is None:
            self._paused_s = time_s

    def continued(self, time_s: float) -> None:
        """It goes on; whether it stood still or not."""
        if self._paused_s is not None:
            self.stood_s += time_s - self._paused_s
        self._paused_s = None

    def asked(self, time_s: float) -> None:
        """A question waits; for as long as it does told as often as one likes."""
        if self._asked_s is None:
            self._asked_s, self._stood_before_s = time_s, self.stood_s

    def answered(self, time_s: float) -> None:
        """None waits any more; whether one did or not."""
        paused_s = time_s - self._paused_s if self._paused_s is not None else 0.0
        self.stood_s = self.until(time_s) - paused_s
        self._asked_s = None

    def until(self, time_s: float) -> float:
        """What it comes to at this time, with what goes on."""
        stood_s = self.stood_s + (time_s - self._paused_s if self._paused_s is not None else 0.0)
        if self._asked_s is None:
            return stood_s
        # A pause within the time of a question counts once.
        return stood_s + max(0.0, time_s - self._asked_s - PERSON_S - (stood_s - self._stood_before_s))
