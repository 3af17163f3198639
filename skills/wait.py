"""Pause."""

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field

from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.skill import Cell, Forecast, Seconds, Skill, Steps, pause


class Wait(Skill[None]):
    """Let time pass."""

    interrupted = "repeat"

    duration_s: Annotated[Seconds, Field(ge=0)]

    @classmethod
    def forecast(cls, inputs: Mapping[str, Any], cell: CellSpec) -> Forecast:
        return Forecast(inputs.get("duration", cls.typical_s))

    def run(self, cell: Cell) -> Steps[None]:
        yield from pause(cell, self.duration_s)
