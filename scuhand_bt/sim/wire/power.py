"""The power supplies of a cell of twins: what works without power, and what is lost when it comes back.

According to `robot/hardware`, the arm's servos and the roller have one supply, and the valve's servo another. The
hand's board has USB power; the balance and the carousel have adapters of their own.
"""

import time
from collections.abc import Callable, Iterable
from typing import Any

from scuhand_bt.sim.balance import SimulatedBalance
from scuhand_bt.sim.wire.dynamixel import DynamixelTwin
from scuhand_bt.sim.wire.server import TwinServer
from scuhand_bt.sim.wire.servo import Servo

ALL = "cell"


class Supplies:
    """Switches supplies by name: `arm`, `valve`, `hand`, `balance`, other devices with servos; or all, as `cell`."""

    def __init__(
        self,
        arm: Iterable[Servo],
        hand: TwinServer[Any],
        balance: TwinServer[Any],
        weighing: SimulatedBalance,
        others: dict[str, TwinServer[Any]],
    ) -> None:
        self._hand, self._balance, self._weighing = hand, balance, weighing
        self._switches: dict[str, Callable[[bool], None]] = {
            "arm": _of_servos(arm),
            "valve": _of_servos([hand.twin.valve.servo]),
            "hand": self._switch_board,
            "balance": self._switch_balance,
        }
        for name, server in others.items():
            if isinstance(server.twin, DynamixelTwin):
                self._switches[name] = _of_servos(server.twin.servos.values())
        self.names = (*self._switches, ALL)
        self.off: set[str] = set()
        """The supplies that are off now."""

    def switch(self, name: str, *, on: bool) -> None:
        """Switch a supply; does nothing if it is so already. Raises KeyError for an unknown name."""
        for one in self._switches if name == ALL else (name,):
            if (one in self.off) == on:
                self._switches[one](on)
                (self.off.discard if on else self.off.add)(one)

    def _switch_board(self, on: bool) -> None:
        if on:
            self._hand.twin.switch_on(time.monotonic())
            self._hand.plug()
        else:
            self._hand.unplug()
            self._hand.twin.is_powered = False

    def _switch_balance(self, on: bool) -> None:
        if on:
            self._balance.twin.switch_on(time.monotonic())
        self._weighing.switch(on=on)
        self._balance.paused = not on


def _of_servos(servos: Iterable[Servo]) -> Callable[[bool], None]:
    def switch(on: bool) -> None:
        for servo in servos:
            (servo.restore_power if on else servo.cut_power)(time.monotonic())

    return switch
