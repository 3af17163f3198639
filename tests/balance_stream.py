"""A balance's driver that is fed with bytes, on a clock that the test moves."""

import pytest

from scuhand_bt.device_specs.balance import BalanceSpec
from scuhand_bt.devices.balances import DIALECTS, SerialBalance
from scuhand_bt.devices.interfaces import Reading
from scuhand_bt.devices.serial_link import LineBuffer
from scuhand_bt.run.clock import VirtualClock
from scuhand_bt.sim.wire.balances import BalanceTwin, StillPan, balance_twin

ALL = sorted(DIALECTS)
ASKS = {"and": b"Q\r\n", "mt_sics": b"SI\r\n", "sbi": b"\x1bP\r\n", "shimadzu": b"D07\r\n"}
PERIOD_S = 0.1


class Stream:
    """A driver that is fed with bytes, and what it gives out."""

    def __init__(self, name: str, readability_mg: float = 0.1, shown_mg: float = 0.1, **spec: object) -> None:
        self.name = name
        self.pan = StillPan()
        self.twin: BalanceTwin = balance_twin(name)(self.pan, shown_mg)
        self.clock = VirtualClock()
        figures = BalanceSpec(driver=name, readability_mg=readability_mg, **spec)  # type: ignore[arg-type]
        self.balance = SerialBalance(figures, DIALECTS[name], self.clock, DIALECTS.values())
        self.balance.opened()
        self.written: list[Reading] = []
        self.balance.on_reading = self.written.append
        self.buffer = LineBuffer()

    def line(self, load_mg: float, stable: bool = True) -> bytes:
        """What the balance sends with this load on its pan."""
        self.pan.load_mg, self.pan.stable = load_mg, stable
        return b"".join(self.twin.hear(ASKS[self.name], 0.0))

    def feed(self, *messages: bytes) -> list[Reading]:
        """The readings given out while these come, one a period."""
        given: list[Reading] = []
        for message in messages:
            self.clock.now_s += PERIOD_S
            for line in self.buffer.feed(message):
                before = self.balance.latest
                self.balance.line(line)
                if self.balance.latest is not None and self.balance.latest is not before:
                    given.append(self.balance.latest)
        return given

    def weigh(self, *loads_mg: float, stable: bool = True) -> list[Reading]:
        return self.feed(*(self.line(load_mg, stable) for load_mg in loads_mg))

    def settle(self, load_mg: float) -> None:
        assert self.weigh(*[load_mg] * 12)[-1].stable
        assert self.balance.latest is not None
        assert self.balance.latest.value_mg == pytest.approx(load_mg)
