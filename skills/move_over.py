"""The cone's apex over a container's mouth."""

from scuhand_bt.devices.places import over_balance
from scuhand_bt.skill import Cell, Container, Skill, SkillFailed, Steps


class MoveOver(Skill[None]):
    """Carry the cone over the container on the pan, axis upright, apex at the dispensing height."""

    devices = ("arm",)
    typical_s = 4.0
    interrupted = "repeat"

    container: Container

    def run(self, cell: Cell) -> Steps[None]:
        pan = cell.believed.pan
        if pan is None or pan.id != self.container.id:
            there = f"'{pan.id}'" if pan is not None else "nothing"
            raise SkillFailed("container.missing", f"'{self.container.id}' is not on the pan; there is {there}")
        place, _ = over_balance(cell.spec, self.container)
        yield from cell.move_to(place)
