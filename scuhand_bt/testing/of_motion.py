"""What an arm and a hand have to do, whoever's they are, connected to their hardware or to a twin.

    arm_conforms(my_arm, WallClock())       # it sways by 6°: clear its way
    hand_conforms(my_hand, WallClock())     # valve, motor and sheet move: the cone is empty

Each raises AssertionError with what is wrong.
"""

import math
import time
from collections.abc import Callable

import numpy as np

from scuhand_bt.clock import Clock, carried_out
from scuhand_bt.devices.interfaces import Arm, Hand, Joints
from scuhand_bt.testing.at_the_wire import fails, until

SWAY_RAD = math.radians(6.0)
NEAR_RAD = math.radians(1.0)
BRAKE_S = 0.3
OPENING_MM, SHUT_MM = 1.0, 0.05


class Sway:
    """All joints from rest to rest by the same angle [rad], evenly sped up and slowed down."""

    def __init__(self, begin: Joints, way_rad: Joints, duration_s: float) -> None:
        self.begin, self.way_rad, self.duration_s = begin, way_rad, duration_s

    def sample(self, time_s: float) -> Joints:
        share = min(max(time_s / self.duration_s, 0.0), 1.0)
        return self.begin + self.way_rad * (1.0 - math.cos(math.pi * share)) / 2.0

    def stopped_from(self, at_s: float) -> "Sway | Braked":
        return Braked(self, at_s) if at_s + BRAKE_S < self.duration_s else self


class Braked:
    """A sway that comes to rest within `BRAKE_S` from a time on."""

    def __init__(self, sway: Sway, at_s: float) -> None:
        self.duration_s = at_s + BRAKE_S
        self._sway, self._at_s = sway, at_s
        self._speed = (sway.sample(at_s + 1e-4) - sway.sample(at_s)) / 1e-4

    def sample(self, time_s: float) -> Joints:
        since_s = min(max(time_s - self._at_s, 0.0), BRAKE_S)
        on_the_way = self._sway.sample(min(time_s, self._at_s))
        return on_the_way + self._speed * (since_s - since_s**2 / (2 * BRAKE_S))

    def stopped_from(self, at_s: float) -> "Braked":
        return self


def arm_conforms(arm: Arm, clock: Clock) -> None:
    """It follows, stops on its way, and refuses what cannot be before anything moves; it ends where it began."""
    here = arm.positions
    assert here.shape == (7,), f"an arm has seven joints, not {here.shape}"
    assert arm.fault is None, f"{arm.fault}"
    until(lambda: arm.is_stopped, "it stands still")
    way_rad = np.where(here > 0.0, -SWAY_RAD, SWAY_RAD)
    begun: list[object] = []
    arm.on_start = begun.append

    there = Sway(here, way_rad, 1.5)
    carried_out(arm.follow(there), clock)
    assert begun == [there], "who is told of motions is told of each"
    _stands_at(arm, here + way_rad, "at the end of a motion")
    fails(lambda: arm.start(Sway(here, way_rad, 1.5)), "arm.not_following")
    fails(lambda: arm.start(Sway(arm.positions, np.full(7, 7.0), 60.0)), "arm.joint_limit")
    time.sleep(0.2)
    assert arm.is_stopped, "what was refused moves nothing"
    _stands_at(arm, here + way_rad, "after a refusal")

    arm.start(Sway(arm.positions, -way_rad, 2.5))
    assert not arm.is_stopped, "it moves as soon as it was started"
    fails(lambda: arm.start(Sway(arm.positions, way_rad, 1.0)), "device.busy")
    time.sleep(0.7)
    arm.stop()
    arm.stop()
    until(lambda: arm.is_stopped, "it comes to rest")
    rest = arm.positions
    assert np.abs(rest - here).max() > NEAR_RAD, "a stop ends a motion on its way"
    time.sleep(0.3)
    _stands_at(arm, rest, "after a stop")

    steps = arm.follow(Sway(rest, here - rest, 2.5))
    next(steps)
    time.sleep(0.7)
    steps.close()
    until(lambda: arm.is_stopped, "following that is closed stops it")
    carried_out(arm.follow(Sway(arm.positions, here - arm.positions, 1.5)), clock)
    _stands_at(arm, here, "where it began")


def hand_conforms(hand: Hand, clock: Clock) -> None:
    """Its valve opens for as long as it is told, shuts whatever happens, and what cannot be is refused.

    A sheet whose rim it does not know is taken to be as it is mounted.
    """
    assert hand.fault is None, f"{hand.fault}"
    assert hand.opening_mm <= SHUT_MM, "its valve is shut at first"
    for wrong in (
        lambda: carried_out(hand.pulse(OPENING_MM, -1.0), clock),
        lambda: carried_out(hand.pulse(OPENING_MM, hand.longest_dwell_s + 1.0), clock),
        lambda: carried_out(hand.pulse(math.nan, 0.1), clock),
        lambda: hand.set_vibration(1.5),
        lambda: hand.start_morph(3.0 * hand.spec.sheet_radius_mm),
    ):
        _is_refused(wrong)
    assert hand.is_stopped, "what was refused moves nothing"

    widest_mm, began_s = 0.0, clock.now_s
    for wake in (pulse := hand.pulse(OPENING_MM, 0.4, 0.5)):
        clock.wait([wake])
        widest_mm = max(widest_mm, hand.opening_mm)
    pulse.close()
    assert clock.now_s - began_s >= 0.4, "a pulse takes its dwell at least"
    assert abs(widest_mm - OPENING_MM) < 0.2 * OPENING_MM, f"told {OPENING_MM} mm, it opens by {widest_mm:.2f}"
    _is_shut(hand, "after a pulse")

    halted = hand.pulse(OPENING_MM, 5.0)
    clock.wait([next(halted)])
    time.sleep(0.5)
    halted.close()
    _is_shut(hand, "after a pulse that was closed in the middle")
    if hand.spec.streaming:
        hand.set_opening(OPENING_MM)
        until(lambda: hand.opening_mm > 0.5 * OPENING_MM, "it opens when it is streamed to")
        hand.set_vibration(1.0)
        hand.stop()
        hand.stop()
        _is_shut(hand, "after a stop")

    if not hand.knows_its_roller:
        hand.rim_is(hand.spec.options.start_diameter_mm)
    smaller_mm = hand.cone_diameter_mm - 5.0
    carried_out(hand.morph(smaller_mm), clock)
    assert abs(hand.cone_diameter_mm - smaller_mm) < 1.0, f"told {smaller_mm:.0f} mm, it is {hand.cone_diameter_mm}"
    carried_out(hand.morph(smaller_mm + 5.0), clock)


def _stands_at(arm: Arm, where: Joints, when: str) -> None:
    off_deg = math.degrees(float(np.abs(arm.positions - where).max()))
    assert off_deg < math.degrees(NEAR_RAD), f"{when} it is {off_deg:.1f}° off"


def _is_shut(hand: Hand, when: str) -> None:
    until(lambda: hand.is_stopped and hand.opening_mm <= SHUT_MM, f"its valve is shut {when}")


def _is_refused(act: Callable[[], object]) -> None:
    try:
        act()
    except ValueError:
        return
    raise AssertionError("what no skill should ask for is a ValueError")
