"""A shake of the cone."""

from scuhand_bt.skill import Cell, Ratio, Seconds, Skill, Steps, pause


class Shake(Skill[None]):
    """Vibrate the closed cone for a while, to bring powder down its wall or break a bridge."""

    devices = ("hand",)
    typical_s = 3.0

    duration_s: Seconds = 2.0
    level_ratio: Ratio = 1.0

    def run(self, cell: Cell) -> Steps[None]:
        cell.hand.set_vibration(self.level_ratio)
        try:
            yield from pause(cell, self.duration_s)
        finally:
            cell.hand.set_vibration(0.0)
