"""Active faults: the rules of a fault file, applied as the simulated world advances.

The simulated devices and the world ask which faults are active (`active`), and report every opportunity for a fault to
begin. Rules apply in the order of their file; of two that exclude each other, the earlier wins.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf
from typing import Any, ClassVar

from numpy.random import Generator

from scuhand_bt.sim.fault_rules import Opportunity, Rule
from scuhand_bt.sim.randomness import substream

JUMP_MG = 5.0
"""Standard deviation of a draught's push on the pan."""
FLIPPED = 5
"""With the fault `balance.bit_flips`, one of so many lines of the balance has a flipped bit."""
JUMPS = 0.5
"""Probability that the push changes at the next reading."""


@dataclass(slots=True)
class _Course:
    """The progress of one rule."""

    openings: int = 0
    alarm_s: float = inf
    """When it begins, for a rule with a time."""
    is_due: bool = False
    """A momentary fault whose time has come waits for its next opportunity."""
    until_s: float = -inf
    came_s: list[float] = field(default_factory=list)
    rng: Generator | None = None


class Faults:
    """The faults of one simulated cell."""

    STATE: ClassVar[tuple[str, ...]] = ("active", "_sample", "_courses", "_next_s", "_air_rng", "_push_mg")

    def __init__(self, rules: Sequence[Rule] = (), seed: int = 0) -> None:
        self.rules = tuple(rules)
        self.active: dict[str, float] = {}
        """The lasting faults that are active now, and since when [s]."""
        self._seed = seed
        self._sample = ""
        self._next_s = inf
        self._push_mg = 0.0
        self._courses = [_Course() for _ in self.rules]
        self.begin_sample("", 0, 0.0)
        for rule, course in zip(self.rules, self._courses, strict=True):
            if rule.at_s is not None and rule.sample is None:
                course.alarm_s = rule.at_s
        self._note_next()

    def begin_sample(self, sample: str, attempt: int, now_s: float) -> None:
        """Draw from the streams of this sample and attempt from now on."""
        self._sample = sample
        self._air_rng = substream(self._seed, sample, attempt, "draught")
        for number, (rule, course) in enumerate(zip(self.rules, self._courses, strict=True), start=1):
            if rule.probability is not None:
                course.rng = substream(self._seed, sample, attempt, f"fault {number}")
            if rule.sample is not None:
                course.openings, course.is_due = 0, False
                is_here = rule.sample == sample and rule.at_s is not None
                course.alarm_s = now_s + (rule.at_s or 0.0) if is_here else inf
        self._note_next()

    def advance(self, now_s: float) -> None:
        """Begin the faults that are due, and end those that are over."""
        if now_s < self._next_s:
            return
        for rule, course in zip(self.rules, self._courses, strict=True):
            if course.alarm_s <= now_s:
                course.alarm_s = inf
                self._come(rule, course, now_s)
        self._look(now_s)

    def opening(self, now_s: float) -> None:
        """The valve begins to open."""
        if not self.rules:
            return
        for rule, course in zip(self.rules, self._courses, strict=True):
            if self._is_possible(rule, course):
                course.openings += 1
                if course.openings == rule.at_pulse:
                    self._come(rule, course, now_s)
        self.chance("opening", now_s)

    def chance(self, opportunity: Opportunity, now_s: float) -> None:
        """An opportunity for lasting faults to begin."""
        if not self.rules:
            return
        for rule, course in zip(self.rules, self._courses, strict=True):
            kind = rule.kind
            if kind.opportunity == opportunity and not kind.is_momentary and self._strikes(rule, course):
                self._come(rule, course, now_s)
        self._look(now_s)

    def comes(self, fault: str, now_s: float) -> bool:
        """Whether this momentary fault comes now; called at an opportunity for it."""
        found = False
        for rule, course in zip(self.rules, self._courses, strict=True):
            if rule.fault == fault and (self._strikes(rule, course) or course.is_due) and not found:
                course.is_due, found = False, True
                course.came_s.append(now_s)
        return found

    def end(self, fault: str, now_s: float) -> None:
        """End a lasting fault before its time."""
        for rule, course in zip(self.rules, self._courses, strict=True):
            if rule.fault == fault:
                course.until_s = -inf
        self._look(now_s)

    def push_mg(self) -> float:
        """What a draught adds to the next reading."""
        if self._air_rng.random() < JUMPS:
            self._push_mg = JUMP_MG * self._air_rng.standard_normal()
        return self._push_mg

    def account(self) -> list[dict[str, Any]]:
        """Each rule's fault, and when it began [s]; for the journal."""
        marked = zip(self.rules, self._courses, strict=True)
        return [{"fault": rule.fault, "came_s": [round(s, 3) for s in course.came_s]} for rule, course in marked]

    def _is_possible(self, rule: Rule, course: _Course) -> bool:
        return rule.sample in (None, self._sample) and len(course.came_s) < rule.at_most

    def _strikes(self, rule: Rule, course: _Course) -> bool:
        """Whether a rule without a time takes this opportunity."""
        if rule.at_s is not None or rule.at_pulse is not None or not self._is_possible(rule, course):
            return False
        return rule.probability is None or (course.rng is not None and course.rng.random() < rule.probability)

    def _come(self, rule: Rule, course: _Course, now_s: float) -> None:
        if rule.kind.is_momentary:
            course.is_due = True
            return
        for earlier, other in zip(self.rules, self._courses, strict=True):
            if other is course:
                break
            if other.until_s > now_s and earlier.kind.place == rule.kind.place:
                return
        course.until_s = now_s + rule.duration_s
        course.came_s.append(now_s)

    def _look(self, now_s: float) -> None:
        """Update `active`."""
        self.active, places = {}, set()
        for rule, course in zip(self.rules, self._courses, strict=True):
            if course.until_s <= now_s:
                course.until_s = -inf
            elif rule.kind.place not in places:
                places.add(rule.kind.place)
                self.active[rule.fault] = course.came_s[-1]
        self._note_next()

    def _note_next(self) -> None:
        times = [course.alarm_s for course in self._courses]
        times += [course.until_s for course in self._courses if course.until_s > -inf]
        self._next_s = min(times, default=inf)
