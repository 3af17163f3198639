"""Leases: one skill at a time commands a device, and none before it stands still."""

from typing import cast

import pytest
from conftest import Agenda, FakeCell

from scuhand_bt.cell.cell import Cell
from scuhand_bt.run.clock import VirtualClock
from scuhand_bt.tree.leases import Leases

ONE, OTHER = object(), object()


@pytest.fixture
def cell() -> FakeCell:
    return FakeCell(VirtualClock(Agenda()))


@pytest.fixture
def leases(cell: FakeCell) -> Leases:
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


def test_a_device_given_back_is_had_by_another_once_it_stands_still(leases: Leases, cell: FakeCell) -> None:
    leases.take(["hand", "arm"], ONE)
    cell.devices["hand"].is_stopped = False
    leases.give_back(ONE)
    assert leases.take(["hand"], OTHER) is False
    assert leases.take(["hand", "arm"], OTHER) is False
    assert leases.take(["arm"], OTHER) is True, "it has stopped already"
    cell.devices["hand"].is_stopped = True
    assert leases.take(["hand"], OTHER) is True


def test_a_device_that_was_never_commanded_is_had_even_if_it_moves(leases: Leases, cell: FakeCell) -> None:
    cell.devices["arm"].is_stopped = False
    assert leases.take(["arm"], ONE) is True


def test_only_ones_own_devices_are_given_back(leases: Leases) -> None:
    leases.take(["hand", "arm"], ONE)
    leases.take(["balance"], OTHER)
    leases.give_back(ONE)
    assert leases.take(["balance"], ONE) is False
    assert leases.take(["arm", "hand"], OTHER) is True


def test_who_waits_is_woken_by_the_news_of_the_devices_or_at_last_by_the_time(leases: Leases, cell: FakeCell) -> None:
    arm, hand, way = leases.wakes(["arm", "hand"], 7.0)
    assert (arm.until_s, hand.until_s) == (7.0, 7.0)
    assert not arm.has_fired
    cell.devices["arm"].news.fire()
    assert arm.has_fired
    assert not hand.has_fired
    leases.give_back(ONE)
    assert way.has_fired, "another has given something back"


def test_a_zone_is_leased_with_the_devices_and_free_once_these_stand_still(leases: Leases, cell: FakeCell) -> None:
    assert leases.take(["changer"], ONE, ["pan"]) is True
    assert leases.take(["hand"], OTHER, ["pan"]) is False
    assert leases.missing(["hand"], OTHER, ["pan"]) == ["pan"]
    assert leases.take(["hand"], OTHER) is True, "it was not kept from the refused lease"
    cell.devices["changer"].is_stopped = False
    leases.give_back(ONE)
    assert leases.missing([], OTHER, ["pan"]) == ["pan"], "what has left it still swings"
    cell.devices["changer"].is_stopped = True
    assert leases.take([], OTHER, ["pan"]) is True


def test_a_zone_is_closed_to_the_arm_of_another_alone(leases: Leases, cell: FakeCell) -> None:
    leases.take(["arm"], ONE, ["pan"])
    assert cell.right_of_way.closed == frozenset()
    leases.give_back(ONE)
    leases.take(["arm"], ONE)
    leases.take(["changer"], OTHER, ["pan"])
    assert cell.right_of_way.closed == {"pan"}


def test_a_zone_that_the_arm_may_be_crossing_is_not_had(leases: Leases, cell: FakeCell) -> None:
    way = cell.right_of_way
    leases.take(["arm"], ONE)
    way.crossing()
    assert leases.take(["changer"], OTHER, ["pan"]) is False
    cell.entered = frozenset({"pan"})
    way.crossed()
    assert leases.take(["changer"], OTHER, ["pan"]) is False, "it has come to rest in there, and may go on"
    cell.entered = frozenset()
    way.crossed()
    assert leases.take(["changer"], OTHER, ["pan"]) is True
