"""Bring the cone's apex over a container's mouth."""

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field

from scuhand_bt.cell.places import over_balance
from scuhand_bt.cell.weighing import require_unchanged
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.skill import Cell, Code, Container, Forecast, Millimetres, Skill, SkillFailed, Steps

from ._opening import open_to_let_out

LOWERING_MM_PER_S = 60.0


class MoveOver(Skill[None]):
    """Carry the cone over the container on the pan, axis upright, apex at the dispensing height.

    The last `from_above` of the way is straight down, so that powder that trickles from the valve falls into a narrow
    mouth.
    """

    raises = (Code.CONTAINER_MISSING,)
    devices = ("arm", "hand")
    zones = ("pan",)
    typical_s = 1.5
    interrupted = "repeat"

    container: Container
    from_above_mm: Annotated[Millimetres, Field(ge=0, le=100)] = 0.0

    @classmethod
    def forecast(cls, inputs: Mapping[str, Any], cell: CellSpec) -> Forecast:
        container, from_above_mm = inputs.get("container"), inputs.get("from_above", 0.0)
        if container is None or not from_above_mm:
            return Forecast(cls.typical_s)
        return Forecast(cls.typical_s, descent=(over_balance(cell, container)[0], from_above_mm))

    def run(self, cell: Cell) -> Steps[None]:
        require_unchanged(cell)
        pan = cell.believed.weighed_container
        if pan is None or pan.id != self.container.id:
            there = f"'{pan.id}'" if pan is not None else "nothing"
            raise SkillFailed(Code.CONTAINER_MISSING, f"'{self.container.id}' is not on the pan; there is {there}")
        yield from open_to_let_out(cell)
        place, _ = over_balance(cell.spec, self.container)
        if self.from_above_mm > 0:
            yield from cell.lower_to(place, self.from_above_mm, LOWERING_MM_PER_S)
        else:
            yield from cell.move_to(place)
