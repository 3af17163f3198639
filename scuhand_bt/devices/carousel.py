"""A carousel beside the balance: a wheel of slots on the shaft of one Dynamixel, that pushes containers along a floor
flush with the pan. docs/protocols/carousel.md.

With slot k on the pan the wheel stands at k turns of 360°/slots, with the pan bare half of one further. The servo knows
its place within a turn, so that after a power cut nothing has to be homed. It is in extended mode, so that the wheel
takes the short way round.
"""

import math
from collections.abc import Callable
from typing import ClassVar

import numpy as np

from scuhand_bt.clock import Signal, Steps, Wake
from scuhand_bt.device_specs.changer import CarouselOptions, ChangerSpec
from scuhand_bt.devices.dynamixel import registers as r
from scuhand_bt.devices.dynamixel.axes import Axis
from scuhand_bt.devices.dynamixel.axis_group import AxisGroup
from scuhand_bt.devices.dynamixel.bus import DynamixelBus
from scuhand_bt.devices.dynamixel.servo_loop import ServoChain, fault_of
from scuhand_bt.devices.interfaces import Joints, Site
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.specs import Container

NEAR = 0.1
"""So near to a place, in slots, the wheel stands there."""


class Swing:
    """A turn [rad] from rest to rest; only a fault ends it on its way, as containers are not left hanging."""

    def __init__(self, begin_rad: float, end_rad: float, duration_s: float) -> None:
        self.duration_s = duration_s
        self._begin_rad, self._way_rad = begin_rad, end_rad - begin_rad

    def sample(self, time_s: float) -> Joints:
        share = min(max(time_s / self.duration_s, 0.0), 1.0)
        return np.array([self._begin_rad + self._way_rad * (1.0 - math.cos(math.pi * share)) / 2.0])

    def stopped_from(self, at_s: float) -> "Swing":
        return self


class Carousel:
    """`driver: carousel`; meets `devices.interfaces.Changer`."""

    Options: ClassVar = CarouselOptions
    twin: ClassVar = "scuhand_bt.sim.wire.carousel:CarouselTwin"
    needs_person = False

    @classmethod
    def connect(cls, site: Site) -> "Carousel":
        """The carousel, its servo held where it is; SkillFailed device.lost, servo.overload."""
        spec: ChangerSpec = site.spec
        options: CarouselOptions = site.options
        axis = Axis(
            servo=options.servo_id,
            name="carousel",
            model=r.XM430,
            mode=r.EXTENDED_POSITION_MODE,
            home_count=options.first_slot_count,
            direction=options.direction,
            following_limit_rad=math.pi / spec.slot_count,
        )
        group = AxisGroup([axis], watched=False)
        chain = ServoChain(
            DynamixelBus(spec.port, options.baud, 1000 * options.latency_s), [group], Signal(), site.liveness
        )
        chain.open()  # also one without torque: holding a wheel where it is moves nothing
        return cls(spec.slot_count, options, chain, group, site.slot_of)

    def __init__(
        self,
        slots: int,
        options: CarouselOptions,
        chain: ServoChain,
        group: AxisGroup,
        slot_of: Callable[[Container], int],
    ) -> None:
        self._slots, self._options = slots, options
        self._chain, self._group = chain, group
        self._slot_of = slot_of
        self._on_pan: str | None = None

    @property
    def news(self) -> Signal:
        return self._chain.news

    @property
    def is_stopped(self) -> bool:
        return not self._group.is_moving

    @property
    def fault(self) -> SkillFailed | None:
        fault = fault_of(self._chain, self._group)
        return None if fault is None else _of_carousel(fault)

    def stop(self) -> None:
        """It ends the swing it is in: a container is never left hanging."""

    def close(self) -> None:
        """Close the bus; the servo goes on holding."""
        self._chain.close()

    def bring(self, container: Container) -> Steps[None]:
        slot = self._slot_of(container) % self._slots
        yield from self._rest()
        if self._is_at(slot) and self._on_pan in (None, container.id):
            self._on_pan = container.id
            return
        other = self._slot_on_pan
        if other not in (None, slot) or self._on_pan not in (None, container.id):
            there = f"'{self._on_pan}'" if self._on_pan is not None else f"what is in slot {(other or 0) + 1}"
            raise SkillFailed(Code.CONTAINER_MISSING, f"the pan is not free: {there} stands on it")
        self._on_pan = container.id
        yield from self._turn(slot)

    def take_away(self) -> Steps[None]:
        yield from self._rest()
        if (slot := self._slot_on_pan) is not None:
            yield from self._turn(slot + 0.5)
        self._on_pan = None

    @property
    def _place(self) -> float:
        """Where the wheel stands, in slots, from 0 to less than their number."""
        return float(self._group.positions_rad[0]) / (2 * math.pi) * self._slots % self._slots

    def _is_at(self, place: float) -> bool:
        return abs(self._way_to(place)) < NEAR

    def _way_to(self, place: float) -> float:
        """The short way there, in slots."""
        return (place - self._place + self._slots / 2) % self._slots - self._slots / 2

    @property
    def _slot_on_pan(self) -> int | None:
        """The slot whose container stands on the pan; also one whose swing to it or away has broken off."""
        place = self._place
        return None if 0.5 - NEAR < place % 1.0 < 0.5 + NEAR else round(place) % self._slots

    def _turn(self, place: float) -> Steps[None]:
        begin_rad, way = float(self._group.positions_rad[0]), self._way_to(place)
        end_rad = begin_rad + way / self._slots * 2 * math.pi
        self._group.move(Swing(begin_rad, end_rad, self._options.swing_s(abs(way))))
        yield from self._rest()
        if (fault := self._group.fault) is not None:
            raise _of_carousel(fault)

    def _rest(self) -> Steps[None]:
        """Wait until the wheel stands still; SkillFailed while its servo cannot be used."""
        while True:
            wake = Wake.on(self.news)
            if (trouble := self._chain.trouble) is not None:
                raise _of_carousel(trouble)
            if self.is_stopped:
                return
            yield wake


def _of_carousel(fault: SkillFailed) -> SkillFailed:
    """The fault as it is the carousel's: one of the arm would mean that the cone is."""
    code = fault.code if fault.code in (Code.SERVO_OVERLOAD, Code.COMPUTER_BUSY) else Code.DEVICE_LOST
    return SkillFailed(code, f"the carousel: {fault.detail}")
