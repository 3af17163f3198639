"""Shake the cone."""

from typing import Annotated

from pydantic import Field

from scuhand_bt.skill import Cell, Ratio, Seconds, Skill, Steps, pause


class Shake(Skill[None]):
    """Vibrate the closed cone for a while, to bring powder down its wall or break a bridge.

    It waits for the end of any weighing or change of a container.
    """

    devices = ("hand",)
    typical_s = 3.0
    interrupted = "repeat"

    duration_s: Annotated[Seconds, Field(gt=0)] = 2.0
    level_ratio: Annotated[Ratio, Field(ge=0, le=1)] = 1.0

    def run(self, cell: Cell) -> Steps[None]:
        yield from cell.right_of_way.go(shaking=True)
        cell.hand.set_vibration(self.level_ratio)
        try:
            yield from pause(cell, self.duration_s)
        finally:
            cell.hand.set_vibration(0.0)
