"""A watcher that is asked, and tells in one line the boxes that it sees something in."""

import re

from scuhand_bt.devices.boxes import Seen
from scuhand_bt.devices.line_device import LineWatcher
from scuhand_bt.devices.serial_link import Framing
from scuhand_bt.sim.wire.line_twin import LineTwin

_BOX = rb" -?\d+ -?\d+ -?\d+ \d+ \d+ \d+"
_LINE = re.compile(rb"SEES((?:" + _BOX + rb")*);\r\n")


class Template(LineWatcher):
    """Asks five times a second. A box is its centre and its size, in mm, in the device's own frame."""

    twin = f"{__name__}:TemplateTwin"
    framing = Framing(115200, "8N1")
    question = b"LOOK\r\n"
    period_s = 0.2

    def parse(self, line: bytes) -> tuple[tuple[float, float, float], ...] | None:
        match = _LINE.fullmatch(line)
        if match is None:
            return None
        numbers = [float(number) for number in match[1].split()]
        boxes = [numbers[k : k + 6] for k in range(0, len(numbers), 6)]
        # From here on in the base frame: where the device stands and how it is turned goes in here.
        seen = [Seen(at_mm=(x, y, z), box_mm=(a, b, c)) for x, y, z, a, b, c in boxes]
        return tuple((float(x), float(y), float(z)) for box in seen for x, y, z in box.points_m)


class TemplateTwin(LineTwin):
    """Tells what is in its scene; never make it by the driver's own expressions."""

    def answer(self, command: bytes, now_s: float) -> bytes:
        if command.strip() != b"LOOK":
            return b""
        numbers = (round(number) for box in self.scene.seen for number in (*box.at_mm, *box.box_mm))
        return b"SEES" + "".join(f" {number}" for number in numbers).encode() + b";\r\n"


DRIVER = Template
