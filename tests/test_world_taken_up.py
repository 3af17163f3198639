"""A world that is taken up after a kill or an outage is the one that would have been, and goes on."""

import json
import os
import random
import signal
import warnings
from pathlib import Path
from typing import Any, NoReturn, cast

import pytest
from dose_bench import DISH
from world_bench import ALL_MG, IN_MORTAR_M, Bench, Line, dish

from scuhand_bt.clock import Wake
from scuhand_bt.run.clock import VirtualClock
from scuhand_bt.sim.world import DEAD_MAN_S, OUTAGE_S, SERVO_WATCHDOG_S, World
from scuhand_bt.sim.world_file import WorldFile


def seen(world: World) -> dict[str, float]:
    """What the program knows: the time, and what every container holds."""
    held = {name: mg for name, mg in world.masses_mg.items() if name.startswith("container:")}
    return {"now_s": world.now_s, "waste": world.masses_mg["waste"], **held}


def killed_at_work(path: Path, lines: int) -> dict[str, float]:
    """A child works until it has said this much and is then killed; the last of what it said."""
    reader, writer = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of forking beside threads: the child uses none of them
        child = os.fork()
    if child == 0:
        _be_killed(path, writer)
    os.close(writer)
    last = ""
    with os.fdopen(reader) as said:
        for _ in range(lines):
            last = said.readline()
        os.kill(child, signal.SIGKILL)
        for line in said:
            last = line if line.endswith("\n") else last
    os.waitpid(child, 0)
    said_last: dict[str, float] = json.loads(last)
    return said_last


def _be_killed(path: Path, writer: int) -> NoReturn:
    try:
        bench = Bench()
        bench.world.keep_in(path, bench.told.append)
        for wake in bench.work():
            bench.clock.wait([wake])
            bench.world.save()  # as a journal does before it says what it knows
            os.write(writer, (json.dumps(seen(bench.world)) + "\n").encode())
    finally:
        os._exit(1)


def is_sound(world: World) -> None:
    assert world.ledger.total_mg == pytest.approx(ALL_MG, rel=1e-9)
    assert min(world.masses_mg.values()) >= 0.0


@pytest.mark.parametrize("seed", range(10))
def test_a_killed_program_leaves_a_world_that_goes_on(tmp_path: Path, seed: int) -> None:
    path = tmp_path / "run.world"
    lines = random.Random(seed).randrange(2, 250)
    last = killed_at_work(path, lines)

    bench = Bench.taken_up(path)

    is_sound(bench.world)
    assert bench.clock.now_s >= last.pop("now_s") + OUTAGE_S - 1e-6
    assert all(bench.world.masses_mg[name] >= mass_mg - 1e-9 for name, mass_mg in last.items())
    assert bench.world.masses_mg["flight"] == 0.0
    cell = bench.cell
    assert all(device.is_stopped for device in (cell.arm, cell.hand, cell.changer))
    assert cell.hand.opening_mm == 0.0
    bench.drive(cell.changer.take_away())
    bench.drive(cell.changer.bring(dish("another")))
    is_sound(bench.world)


def test_it_can_be_killed_again_and_again(tmp_path: Path) -> None:
    path = tmp_path / "run.world"
    killed_at_work(path, 40)
    first = Bench.taken_up(path)
    first.world.close()  # killed before it did anything
    second = Bench.taken_up(path)
    assert second.clock.now_s >= first.clock.now_s + OUTAGE_S - 1e-6
    is_sound(second.world)


def test_the_open_valve_closes_by_its_dead_man_and_powder_falls_until_then(tmp_path: Path) -> None:
    path = tmp_path / "run.world"
    bench = Bench.with_powder(path)
    bench.cell.hand.set_opening(1.0)
    bench.let_pass(1.0)
    bench.world.save()
    before_mg = bench.world.true_mass("dish")

    restored = Bench.taken_up(path)

    # What is in the air, and what leaves in 0.3 s, the valve's dead time and its way.
    per_s = before_mg / 0.8
    assert before_mg + 0.3 * per_s < restored.world.true_mass("dish") < before_mg + 1.5 * per_s
    assert restored.cell.hand.opening_mm == 0.0
    is_sound(restored.world)


def test_what_a_journal_was_not_told_is_kept_to_the_second(tmp_path: Path) -> None:
    path = tmp_path / "run.world"
    bench = Bench.with_powder(path)
    bench.cell.hand.set_opening(1.0)
    for _ in range(47):
        bench.let_pass(0.1)

    lives_from_s = Bench.taken_up(path).clock.now_s - OUTAGE_S

    assert bench.clock.now_s - 1.1 <= lives_from_s <= bench.clock.now_s


def test_a_world_taken_up_is_the_one_that_would_have_been(tmp_path: Path) -> None:
    path = tmp_path / "run.world"
    bench = Bench.with_powder(path)
    bench.cell.hand.start_morph(70.0)
    bench.cell.hand.set_vibration(0.7)
    bench.cell.hand.set_opening(1.1)
    bench.let_pass(0.37)
    bench.world.save()
    bench.world.close()

    restored = Bench.taken_up(path)
    hand, silent_s = cast(Any, bench.cell.hand), bench.clock.now_s
    bench.let_pass(SERVO_WATCHDOG_S)
    hand.hold_sheet()
    bench.let_pass(silent_s + DEAD_MAN_S - bench.clock.now_s)
    hand.shut(bench.clock.now_s)
    bench.let_pass(silent_s + OUTAGE_S - bench.clock.now_s)

    assert restored.clock.now_s == pytest.approx(bench.clock.now_s)
    assert restored.world.masses_mg == pytest.approx(bench.world.masses_mg, rel=1e-9)
    assert restored.cell.hand.cone_diameter_mm == pytest.approx(bench.cell.hand.cone_diameter_mm)
    assert 70.0 < restored.cell.hand.cone_diameter_mm < 90.0
    means = [rig.drive(rig.cell.balance.stable_mean()).value_mg for rig in (bench, restored)]
    assert means[0] == pytest.approx(means[1])


def test_the_arm_is_held_where_its_watchdog_stops_it(tmp_path: Path) -> None:
    path = tmp_path / "run.world"
    bench = Bench.with_powder(path)
    line = Line(bench.cell.arm.positions, IN_MORTAR_M, 2.0)
    bench.cell.arm.start(line)
    bench.let_pass(0.5)
    bench.world.save()
    restored = Bench.taken_up(path)
    assert restored.cell.arm.is_stopped
    assert restored.cell.arm.positions == pytest.approx(line.sample(0.5 + SERVO_WATCHDOG_S))


def test_the_carousel_ends_its_swing(tmp_path: Path) -> None:
    path = tmp_path / "run.world"
    bench = Bench()
    bench.world.keep_in(path, bench.told.append)
    swing = bench.cell.changer.bring(DISH)
    next(swing)
    bench.let_pass(1.0)
    bench.world.save()

    restored = Bench.taken_up(path)

    assert restored.world.pan.container_id == DISH.id
    before_s = restored.clock.now_s
    restored.drive(restored.cell.changer.bring(DISH))  # again: it is there
    assert restored.clock.now_s == before_s
    restored.drive(restored.cell.changer.take_away())
    assert restored.world.pan.container_id is None


def test_containers_come_back_with_what_they_hold_and_cost_a_save_nothing(tmp_path: Path) -> None:
    path = tmp_path / "run.world"
    bench = Bench.with_powder(path)
    bench.drive(bench.cell.hand.pulse(1.0, 0.5))
    bench.let_pass(1.0)
    held_mg = bench.world.true_mass(DISH.id)
    sizes = []
    for number in range(300):
        bench.world.remove()
        bench.world.place(dish(f"dish {number:03}"))
        bench.world.save()
        sizes.append(len(WorldFile.open(path)[1]))
    assert sizes[-1] == pytest.approx(sizes[0], abs=20)

    restored = Bench.taken_up(path)
    assert restored.world.true_mass(DISH.id) == held_mg > 1.0
    restored.world.remove()
    restored.world.place(DISH)
    is_sound(restored.world)


def test_a_world_is_saved_every_second_counted_from_when_the_journal_saved_it() -> None:
    saved_s = list[float]()

    class Process:
        def step(self, now_s: float, limit_s: float) -> float:
            return limit_s

        def save(self) -> None:
            saved_s.append(clock.now_s)

    clock = VirtualClock(Process())
    for until_s in (0.4, 0.6):
        clock.wait([Wake(until_s)])
    clock.save()  # as a journal does
    for until_s in (1.2, 1.5, 1.8, 2.4, 2.7):
        clock.wait([Wake(until_s)])
    assert saved_s == [0.0, 0.6, 1.8]
