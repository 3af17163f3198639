"""The faults of a simulated cell, as twins show them on their cables.

The world behind the twins produces the faults of powder (clog, leak, empty scoop, wrong container, dead motor) and of
weighing (drift, draught, no stability, overload). The others are here.
"""

import time
from collections.abc import Callable, Iterable

from scuhand_bt.sim.faults import FLIPPED, Faults
from scuhand_bt.sim.hand import SLOW
from scuhand_bt.sim.wire.balances import BalanceTwin
from scuhand_bt.sim.wire.dynamixel import DynamixelTwin
from scuhand_bt.sim.wire.hand import HandTwin
from scuhand_bt.sim.wire.server import TwinServer
from scuhand_bt.sim.wire.servo import OVERLOAD_BIT, Servo

FAULTY_SERVO = 4
"""The id of the servo that is blocked, hot or overloaded: joint 3."""
NOISE = b"\xfe\x80?\x00~\xa5\r\n"
MANY = 1_000_000


class WireFaults:
    """Makes the twins of one cell show its active `Faults`."""

    def __init__(
        self,
        faults: Faults,
        bus: TwinServer[DynamixelTwin],
        hand: TwinServer[HandTwin],
        balance: TwinServer[BalanceTwin],
    ) -> None:
        self._faults = faults
        self._bus, self._hand, self._balance = bus, hand, balance
        self._there: dict[str, float] = {}
        board, servo = hand.twin, bus.twin.servos[FAULTY_SERVO]
        self._switches: dict[str, Callable[[bool], None]] = {
            "balance.silent": lambda on: setattr(balance, "paused", on),
            "balance.restarted": lambda on: setattr(balance, "paused", on),
            "balance.garbage": lambda on: setattr(balance.misbehaviour, "drop", MANY * on),
            "balance.bit_flips": lambda on: setattr(balance.misbehaviour, "flip_every", FLIPPED * on),
            "valve.stuck_open": lambda on: board.valve.lets(close=not on),
            "valve.stuck_closed": lambda on: board.valve.lets(open=not on),
            "valve.slow": lambda on: setattr(board.valve.servo, "speed_ratio", SLOW if on else 1.0),
            "servo.overheat": lambda on: setattr(servo, "temperature_c", servo.table[31] + 1.0 if on else 40.0),
            "servo.overload": lambda on: servo.fail(OVERLOAD_BIT) if on else None,
            "servo.not_following": lambda on: setattr(servo, "blocked", on),
            "arm.lost": lambda on: bus.unplug() if on else bus.plug(),
            "hand.lost": lambda on: hand.unplug() if on else hand.plug(),
            "arm.no_power": lambda on: self._supply(bus.twin.servos.values(), is_off=on),
            "valve.no_power": lambda on: self._supply([board.valve.servo], is_off=on),
            "hand.emergency_stop": lambda on: setattr(board, "emergency_stop", on),
        }

    @staticmethod
    def _supply(servos: Iterable[Servo], *, is_off: bool) -> None:
        """Switch the supply of servos off or on; bus adapters and boards have USB power."""
        for servo in servos:
            (servo.cut_power if is_off else servo.restore_power)(time.monotonic())

    def apply(self) -> None:
        """Make the twins show the active faults."""
        active = self._faults.active
        if "balance.garbage" in active:
            self._balance.say(NOISE)
        if active is self._there:
            return
        before, self._there = self._there, active
        for fault in before.keys() - active.keys() & self._switches.keys():
            self._switches[fault](False)
        for fault, since_s in active.items():
            if fault in self._switches and before.get(fault) != since_s:
                self._switches[fault](True)
