"""Tare by software: weigh the container before its first powder."""

from scuhand_bt.cell.pan_cleared import weigh_broken_off
from scuhand_bt.cell.weighing import require_unchanged, weigh_until_still, weighing_of
from scuhand_bt.skill import Cell, Code, Milligrams, Skill, SkillFailed, Steps, Tared

STILL_DIGITS = 2.0
"""A container at rest changes by no more than this many digits from one weighing to the next."""
AT_ONCE_READINGS = 2.0
"""A weighing younger than this many balance periods is used again."""


class Tare(Skill[Milligrams]):
    """Weigh the container on the pan before its first powder; no tare command is sent to the balance.

    Directly after `place_container` it uses that skill's weighing; the dose weighs once more. What a container already
    holds, also of a dose that broke off, stays with its doses.
    """

    raises = (Code.CONTAINER_MISSING,)
    devices = ("balance",)
    typical_s = 1.0
    interrupted = "repeat"

    def run(self, cell: Cell) -> Steps[Milligrams]:
        require_unchanged(cell)
        if cell.believed.weighed_container is None or cell.believed.bracket is None:
            raise SkillFailed(Code.CONTAINER_MISSING, "no container was placed: put `place_container` before `tare`")
        yield from weigh_broken_off(cell)
        require_unchanged(cell)
        bracket = cell.believed.bracket
        assert bracket is not None
        mean, since_s = cell.weighed, cell.clock.now_s - bracket.last.time_s
        is_at_once = since_s < AT_ONCE_READINGS * cell.spec.balance.period_s
        if not is_at_once or mean is None or weighing_of(mean) != bracket.last:
            allowed_mg = STILL_DIGITS * cell.spec.balance.readability_mg
            _, mean = yield from weigh_until_still(cell, bracket.last, allowed_mg)
        cell.believed.tared(weighing_of(mean))
        cell.record.event(Tared(**dict(mean.written()), balance=cell.balance.identity))
        return mean.value_mg
