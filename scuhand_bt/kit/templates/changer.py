"""A changer of containers with numbered slots, which is told a slot and says when it is there."""

import re

from scuhand_bt.clock import Signal, Steps, Wake
from scuhand_bt.devices.interfaces import Site
from scuhand_bt.devices.line_device import LineDevice
from scuhand_bt.devices.serial_link import Framing
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.sim.wire.line_twin import LineTwin
from scuhand_bt.specs import Container

_LINE = re.compile(rb"(AT \d{1,3}|CLEAR|MOVES)\.\r\n")


class Template(LineDevice):
    """Asks where it stands five times a second; what it was told it does to its end."""

    twin = f"{__name__}:TemplateTwin"
    framing = Framing(9600, "8N1")
    question = b"WHERE\r\n"
    period_s = 0.2
    needs_person = False

    def __init__(self, site: Site) -> None:
        super().__init__(site)
        self.news = Signal()
        self.fault: SkillFailed | None = None
        self._slot_of = site.slot_of
        self._stands = ""
        self._wanted = ""

    @property
    def is_stopped(self) -> bool:
        return self.fault is not None or (self._stands not in ("", "MOVES") and self._wanted in ("", self._stands))

    def stop(self) -> None:
        """A container is never left hanging."""

    def bring(self, container: Container) -> Steps[None]:
        place = f"AT {self._slot_of(container)}"
        yield from self._rest()
        if self._stands not in ("CLEAR", place):
            raise SkillFailed(Code.CONTAINER_MISSING, f"the pan is not free: it stands {self._stands}")
        yield from self._go(place)

    def take_away(self) -> Steps[None]:
        yield from self._rest()
        yield from self._go("CLEAR")

    def _go(self, place: str) -> Steps[None]:
        self._wanted = place
        self._link.write(f"GO {place}\r\n".encode())
        yield from self._rest()

    def _rest(self) -> Steps[None]:
        while True:
            wake = Wake.on(self.news)
            if self.fault is not None:
                raise self.fault
            if self.is_stopped:
                return
            yield wake

    def heard(self, line: bytes) -> bool:
        if (match := _LINE.fullmatch(line)) is None:
            return False
        self._stands, self.fault = match[1].decode(), None
        self.news.fire()
        return True

    def lost(self, why: str) -> None:
        self._stands = self._wanted = ""
        self.fault = SkillFailed(Code.DEVICE_LOST, f"the changer: {why}")
        self.news.fire()


class TemplateTwin(LineTwin):
    """Swings for a moment; never make it by the driver's own expressions."""

    _stands = b"CLEAR"
    _told = b"CLEAR"
    _ends_s = 0.0

    def answer(self, command: bytes, now_s: float) -> bytes:
        if command.startswith(b"GO ") and self._stands == self._told:
            self._told, self._ends_s = command[3:], now_s + 0.3
        if self._told != self._stands and now_s >= self._ends_s:
            self._stands = self._told
            self.scene.bring(int(self._told[3:]) if self._told != b"CLEAR" else None)
        stands = self._stands if self._stands == self._told else b"MOVES"
        return stands + b".\r\n" if command == b"WHERE" else b""


DRIVER = Template
