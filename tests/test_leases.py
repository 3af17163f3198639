"""Leases: one skill at a time commands a device, and none before it stands still."""

from typing import cast

import pytest
from conftest import FakeDevice

from scuhand_bt.cell.cell import Cell
from scuhand_bt.tree.leases import Leases

ONE, OTHER = object(), object()


class Devices:
    """A cell that has devices and nothing else."""

    def __init__(self) -> None:
        self.devices = {name: FakeDevice() for name in ("arm", "hand", "balance")}

    def device(self, name: str) -> FakeDevice:
        return self.devices[name]


@pytest.fixture
def cell() -> Devices:
    return Devices()


@pytest.fixture
def leases(cell: Devices) -> Leases:
    return Leases(cast(Cell, cell))


def test_a_device_that_another_holds_is_not_had(leases: Leases) -> None:
    assert leases.take(["hand"], ONE) is True
    assert leases.take(["hand"], OTHER) is False
    assert leases.take(["hand"], ONE) is False, "nor twice by the same"
    assert leases.take(["arm"], OTHER) is True
    assert leases.take([], OTHER) is True


def test_all_are_leased_or_none(leases: Leases) -> None:
    leases.take(["hand"], ONE)
    assert leases.take(["arm", "hand"], OTHER) is False
    assert leases.take(iter(["arm"]), OTHER) is True, "it was not kept from the refused lease"


def test_a_device_given_back_is_had_by_another_once_it_stands_still(leases: Leases, cell: Devices) -> None:
    leases.take(["hand", "arm"], ONE)
    cell.devices["hand"].is_stopped = False
    leases.give_back(ONE)
    assert leases.take(["hand"], OTHER) is False
    assert leases.take(["hand", "arm"], OTHER) is False
    assert leases.take(["arm"], OTHER) is True, "it has stopped already"
    cell.devices["hand"].is_stopped = True
    assert leases.take(["hand"], OTHER) is True


def test_a_device_that_was_never_commanded_is_had_even_if_it_moves(leases: Leases, cell: Devices) -> None:
    cell.devices["arm"].is_stopped = False
    assert leases.take(["arm"], ONE) is True


def test_only_ones_own_devices_are_given_back_and_what_is_kept_stays(leases: Leases) -> None:
    leases.take(["hand", "arm"], ONE)
    leases.take(["balance"], OTHER)
    leases.give_back(ONE, keep=["arm"])
    assert leases.take(["balance"], ONE) is False
    assert leases.take(["arm"], OTHER) is False
    assert leases.take(["hand"], OTHER) is True
    leases.give_back(ONE)
    assert leases.take(["arm"], OTHER) is True


def test_who_waits_is_woken_by_the_news_of_the_devices_or_at_last_by_the_time(leases: Leases, cell: Devices) -> None:
    arm, hand = leases.wakes(["arm", "hand"], 7.0)
    assert (arm.until_s, hand.until_s) == (7.0, 7.0)
    assert not arm.has_fired
    cell.devices["arm"].news.fire()
    assert arm.has_fired
    assert not hand.has_fired
