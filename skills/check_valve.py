"""Check that the valve shuts."""

from typing import Annotated, ClassVar

from pydantic import Field

from scuhand_bt.devices.hand_protocol import LONGEST_DWELL_S
from scuhand_bt.skill import Cell, Failure, Millimetres, Seconds, Skill, SkillFailed, Steps, ValveChecked


class CheckValve(Skill[Millimetres]):
    """Open the valve over the waste bin, vibrating, and check that it shuts to zero; returns where it then stands."""

    devices = ("arm", "hand")
    failures: ClassVar = {
        "hand.valve_zero": Failure(
            "The shut valve does not stand at zero.",
            "Look for powder in the valve. If there is none, calibrate `valve_map` of the hand in robot/cell.yaml.",
        )
    }
    raises = ("hand.valve_zero",)
    typical_s = 3.0
    interrupted = "repeat"

    opening_mm: Millimetres = 1.0
    dwell_s: Annotated[Seconds, Field(ge=0, le=LONGEST_DWELL_S)] = 1.0
    limit_mm: Millimetres = 0.05

    def run(self, cell: Cell) -> Steps[Millimetres]:
        yield from cell.move_to(cell.spec.station_of_kind("waste").name)
        yield from cell.right_of_way.go(shaking=True)
        yield from cell.hand.pulse(self.opening_mm, self.dwell_s, vibration=1.0)
        zero_mm = cell.hand.opening_mm
        cell.record.event(ValveChecked(opening_mm=zero_mm))
        if abs(zero_mm) > self.limit_mm:
            raise SkillFailed("hand.valve_zero", f"the shut valve stands at {zero_mm:.3f} mm")
        return zero_mm
