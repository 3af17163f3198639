"""Weigh the container on the pan."""

from scuhand_bt.cell.weighing import require_unchanged, weigh_until_still, weighing_of
from scuhand_bt.dosing.bracket import dose_between, total
from scuhand_bt.skill import Cell, Code, Skill, SkillFailed, Steps, Weighed

STILL_DIGITS = 2.0
"""Two weighings in a row agree if they differ by no more than this many digits."""


class Weigh(Skill[Weighed]):
    """Weigh the container on the pan; returns its gross, and the net that it has gained since it was weighed empty."""

    raises = (Code.CONTAINER_MISSING,)
    devices = ("balance",)
    typical_s = 1.0
    interrupted = "repeat"

    def run(self, cell: Cell) -> Steps[Weighed]:
        require_unchanged(cell)
        bracket, digit_mg = cell.believed.bracket, cell.spec.balance.readability_mg
        if cell.believed.weighed_container is None or bracket is None:
            raise SkillFailed(Code.CONTAINER_MISSING, "no container was placed: put `place_container` before `weigh`")
        earlier, mean = yield from weigh_until_still(cell, bracket.last, STILL_DIGITS * digit_mg, may_gain=True)
        now = weighing_of(mean)
        gained, _ = dose_between(((bracket.loaded, bracket.loaded), (earlier, now)), digit_mg)
        net = total([*bracket.carried.values(), gained])
        weighed = Weighed(
            **dict(mean.written()),
            container=bracket.container,
            net_mg=net.mass_mg,
            net_uncertainty_mg=net.uncertainty_mg,
        )
        cell.record.event(weighed)
        return weighed
