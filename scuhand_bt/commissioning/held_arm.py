"""The arm held where it was led, and moved a little by the program: only after the person has said that it may."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from scuhand_bt.clock import carried_out
from scuhand_bt.commissioning.limp_arm import limp
from scuhand_bt.commissioning.step import Site
from scuhand_bt.device_specs.changer import ChangerSpec
from scuhand_bt.device_specs.hand import HandSpec
from scuhand_bt.devices.connect import Devices, connect_cell_devices

SLOW_RATIO = 0.2
"""What moves by itself in a commissioning does so at this share of the cell's speeds."""
HOLD = "The servos will now hold the arm. May they?"


def led(site: Site, where: str) -> None:
    """Have the arm led there by hand, and the person say that it may be held."""
    with limp(site.cell.arm, site.person, site.cell.hand.options.roller_id):
        site.person.ask(where)
        site.person.ask(HOLD)


@contextmanager
def held(site: Site, hand: HandSpec | None = None, roller_file: Path | None = None) -> Iterator[Devices]:
    """The devices of the cell, the arm held where it is; the hand as `hand` has it, if that is given.

    SkillFailed device.lost. At the end the valve is shut, and the arm goes on holding.
    """
    cell = site.cell.slowed(SLOW_RATIO)
    if hand is not None:
        hand = hand.model_copy(update={"morph_speed_mm_per_s": cell.hand.morph_speed_mm_per_s})
    changes = {"hand": hand or cell.hand, "changer": ChangerSpec(driver="operator"), "devices": {}}
    devices = connect_cell_devices(cell.model_copy(update=changes), site.clock, roller_file=roller_file)
    try:
        yield devices
    finally:
        devices.close()


class Jogger:
    """Turns one joint at a time, slowly, on ways that the planner has found free."""

    def __init__(self, site: Site, devices: Devices) -> None:
        self._site, self._arm = site, devices.arm
        self._motion = replace(site.lab, cell=site.cell.slowed(SLOW_RATIO)).motion_planner({})

    def turn(self, joint: int, by_deg: float) -> float:
        """Turn joint `joint` (0 to 6) by so much; the farthest that any joint then is from its goal [deg].

        SkillFailed arm.* where there is no way, or the arm does not follow.
        """
        begin = self._arm.positions
        goal = begin.copy()
        goal[joint] += math.radians(by_deg)
        carried_out(self._arm.follow(self._motion.move(begin, goal)), self._site.clock)
        return float(np.degrees(np.abs(self._arm.positions - goal).max()))
