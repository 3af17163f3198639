"""The software tare: the stable gross before the first powder."""

from scuhand_bt.skill import Cell, Code, Milligrams, Skill, SkillFailed, Steps, Tared


class Tare(Skill[Milligrams]):
    """Weigh the container on the pan before its first powder; no tare command is sent to the balance."""

    raises = (Code.CONTAINER_MISSING,)
    devices = ("balance",)
    typical_s = 4.0
    interrupted = "repeat"

    def run(self, cell: Cell) -> Steps[Milligrams]:
        if cell.believed.weighed_container is None:
            raise SkillFailed(Code.CONTAINER_MISSING, "no container was placed; `place_container` comes before `tare`")
        mean = yield from cell.balance.stable_mean()
        cell.believed.tared(mean.value_mg, cell.clock.now_s)
        cell.record.event(Tared(**dict(mean.written()), balance=cell.balance.identity))
        return mean.value_mg
