import contextlib
import itertools
import json
import math
import os
import pickle
import random
import signal
import warnings
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn, cast

import numpy as np
import pytest
from dose_bench import BAY, DISH, MORTAR, PAN, shipped_powders
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from scuhand_bt.cell.cell import Cell
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.clock import Steps, Wake
from scuhand_bt.devices.interfaces import Joints, Operator
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.motion.kinematics import ApexPose
from scuhand_bt.problems import SourceError
from scuhand_bt.record import Record
from scuhand_bt.run.clock import VirtualClock
from scuhand_bt.sim import cell as cell_module
from scuhand_bt.sim.cone_load import ConeLoad
from scuhand_bt.sim.mass_ledger import Compartment
from scuhand_bt.sim.plain_state import Misplaced, read, written
from scuhand_bt.sim.plant import Plant
from scuhand_bt.sim.powder import OurPowderFlow
from scuhand_bt.sim.world import DEAD_MAN_S, OUTAGE_S, SERVO_WATCHDOG_S, World
from scuhand_bt.sim.world_file import WorldFile
from scuhand_bt.specs import Container, Powder, Source

BEADS = shipped_powders()["glass_beads"]
ALL_MG = 10_000.0
OVER_PAN_M = (0.330, 0.0, 0.140)
IN_MORTAR_M = (0.0, 0.300, 0.012)


class Line:
    """A motion of the arm of this bench, whose first three joints are the apex's position [m]."""

    def __init__(self, begin: Joints, apex_m: tuple[float, float, float], duration_s: float) -> None:
        self.duration_s = duration_s
        self._begin, self._end = begin, np.array([*apex_m, 0.0, 0.0, 0.0, 0.0])

    def sample(self, time_s: float) -> Joints:
        share = min(1.0, max(0.0, time_s / self.duration_s))
        joints: Joints = self._begin + share * (self._end - self._begin)
        return joints

    def stopped_from(self, at_s: float) -> "Line":
        raise AssertionError("nobody stops it")


class Bench:
    """A cell of a mortar, a carousel and a balance."""

    def __init__(self) -> None:
        spec = CellSpec(cell="bench", stations={"balance": PAN, "bay": BAY})
        self.clock = VirtualClock()
        self.cell: Cell
        self.world: World
        self.told: list[str] = []
        self.cell, self.world = cell_module.simulated_cell(
            spec,
            {"store": Source(name="store", station="bay", mortar=MORTAR, powder=BEADS, amount_mg=ALL_MG)},
            clock=self.clock,
            record=Record(),
            motion=cast(MotionPlanner, None),
            operator=cast(Operator, None),
            seed=1,
            joints=np.array([*OVER_PAN_M, 0.0, 0.0, 0.0, 0.0]),
            apex_of=lambda joints: ApexPose(joints[:3]),
        )
        self.clock.process = self.world

    @classmethod
    def with_powder(cls, path: Path) -> "Bench":
        """Living in a file, with a dish under a loaded cone, and all at rest."""
        bench = cls()
        bench.world.keep_in(path, bench.told.append)
        bench.world.place(DISH)
        bench.world.load_cone("store", 5000.0)
        bench.let_pass(2.0)
        return bench

    @classmethod
    def taken_up(cls, path: Path) -> "Bench":
        """After the outage of the world in a file."""
        bench = cls()
        bench.clock.go_on_from(bench.world.restore(path, bench.told.append))
        return bench

    def let_pass(self, duration_s: float) -> None:
        end_s = self.clock.now_s + duration_s
        while self.clock.now_s < end_s:
            self.clock.wait([Wake(end_s)])

    def drive(self, steps: Steps[Any]) -> Any:
        while True:
            try:
                wake = next(steps)
            except StopIteration as done:
                return done.value
            self.clock.wait([wake])

    def work(self) -> Steps[None]:
        """Scoop, carry, stream and pulse into one container after the other, without an end."""
        cell, hand = self.cell, self.cell.hand
        for number in itertools.count():
            self.world.begin_sample(f"s{number}", 1)
            yield from cell.changer.bring(dish(f"dish {number}"))
            yield from cell.arm.follow(Line(cell.arm.positions, IN_MORTAR_M, 1.0))
            yield from hand.morph(80.0)
            yield from hand.morph(76.0)
            yield from cell.arm.follow(Line(cell.arm.positions, OVER_PAN_M, 1.5))
            hand.set_vibration(0.5)
            for opening_mm in (0.6, 1.2, 0.9, 0.0):
                hand.set_opening(opening_mm)
                for _ in range(8):
                    yield from cell.balance.next_reading()
            yield from hand.pulse(1.0, 0.3, 1.0)
            yield from cell.balance.stable_mean()
            yield from cell.changer.take_away()
            self.world.swap_sheet()


def dish(name: str) -> Container:
    return DISH.model_copy(update={"id": name})


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


def test_the_file_names_its_compartments_in_the_text_that_they_always_had(tmp_path: Path) -> None:
    path = tmp_path / "run.world"
    bench = Bench.with_powder(path)
    bench.cell.hand.set_opening(1.0)
    bench.let_pass(1.0)
    bench.world.save()
    _, state, _ = WorldFile.open(path)
    beside, (_, load, *_) = json.loads(state)
    _, _, masses_mg = read(beside)
    places = {"cone", "sheet", "flight", "pan", "returned", "waste", "spilled", "source:store", "container:dish"}
    assert {type(name) for name in masses_mg} == {str}
    assert masses_mg.keys() == places
    flying = read(load[ConeLoad.STATE.index("flying")])
    assert flying
    assert {(type(place), place) for _, _, place in flying} == {(str, "balance")}


@pytest.mark.parametrize("text", ["cone", "source:a mortar: the first", "container:xrd-1", "balance"])
def test_a_compartments_text_is_read_back_as_it_was_written(text: str) -> None:
    assert str(Compartment.of_text(text)) == text


@pytest.mark.parametrize("text", ["", "mortar", "cones", "a:source"])
def test_a_text_that_names_no_compartment_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=f"powder is never in '{text}'"):
        Compartment.of_text(text)


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


class Unwritable(OurPowderFlow):
    """Somebody's flow, which holds what is no data."""

    def __init__(self, powder: Powder) -> None:
        super().__init__(powder)
        self.factor = lambda: 1.0


class UnwritablePlant:
    def flow(self, powder: Powder) -> Unwritable:
        return Unwritable(powder)


def test_a_plant_that_cannot_be_saved_is_told_once_and_refused_on_resume(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.world"
    monkeypatch.setattr(cell_module, "probed_plant", lambda *_: Plant(UnwritablePlant(), "my_lab:Unwritable"))
    bench = Bench.with_powder(path)
    bench.drive(bench.cell.hand.pulse(1.0, 0.5))
    bench.let_pass(1.0)
    assert bench.world.true_mass(DISH.id) > 1.0
    assert len(bench.told) == 1
    assert "my_lab:Unwritable cannot be written down" in bench.told[0]
    with pytest.raises(SourceError, match=r"cannot be read: No such file.*begin"):
        Bench.taken_up(path)


class Hopper:
    """A part of somebody's flow, with whatever data it likes."""

    def __init__(self) -> None:
        self.level_mg = 3.0
        self.by_size: dict[Any, Any] = {}


@dataclass(frozen=True)
class Figures:
    """Values that a plant's objects share."""

    factor: float = 1.0


SHARED = Figures()


class Rich(OurPowderFlow):
    """Somebody's flow, of many kinds of data."""

    def __init__(self, powder: Powder) -> None:
        super().__init__(powder)
        self.hopper = Hopper()
        self.figures = SHARED

    def step(self, dt_s: float, opening_mm: float, vibration: float, in_cone_mg: float, rng: Any) -> float:
        self.hopper.by_size[2.5, "fine"] = (np.arange(3), math.inf, deque([(1, b"\xff")], maxlen=4))
        self.figures = Figures(2.0)
        self.later = self.hopper.by_size.keys() == {(2.5, "fine")}
        return super().step(dt_s, opening_mm, vibration, in_cone_mg, rng)


class RichPlant:
    def flow(self, powder: Powder) -> Rich:
        return Rich(powder)


def test_a_plants_objects_come_back_with_all_their_data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.world"
    monkeypatch.setattr(cell_module, "probed_plant", lambda *_: Plant(RichPlant(), "my_lab:Rich"))
    bench = Bench.with_powder(path)
    bench.drive(bench.cell.hand.pulse(1.0, 0.5))
    bench.world.save()

    flow = cast(Rich, Bench.taken_up(path).world.load.flow)

    assert vars(flow).keys() == vars(bench.world.load.flow).keys()
    ((key, (array, infinite, queue)),) = flow.hopper.by_size.items()
    assert (key, array.tolist(), infinite) == ((2.5, "fine"), [0, 1, 2], math.inf)
    assert (queue, queue.maxlen) == (deque([(1, b"\xff")]), 4)
    assert (flow.figures, flow.later, SHARED) == (Figures(2.0), True, Figures(1.0))


# --- a file from elsewhere ---


class Command:
    """What a pickle of it does when it is read."""

    def __reduce__(self) -> tuple[Any, ...]:
        return os.system, ("touch was_run",)


@pytest.mark.parametrize(
    "state",
    [
        pickle.dumps(Command()),
        b'[{"object":["posix.system",{"command":"touch was_run"}]},[]]',
        b'[[],[[null,null],[{"object":["test_world_file.Command",{}]},null,[],false,null,"",null,null,0.0],[],[]]]',
    ],
)
def test_a_crafted_file_is_refused_and_runs_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, state: bytes
) -> None:
    monkeypatch.chdir(tmp_path)
    WorldFile.create(tmp_path / "a.world", state).close()
    with pytest.raises(SourceError, match="nothing can go on from it"):
        Bench.taken_up(tmp_path / "a.world")
    assert not (tmp_path / "was_run").exists()


@pytest.mark.parametrize(
    "plain",
    [
        {"object": ["test_world_file.Hopper", {"__class__": 1}]},
        {"object": ["test_world_file.Hopper"]},
        {"generator": {"bit_generator": "default_rng"}},
        {"array": ["|O", ["x"]]},
        {"eval": "1"},
    ],
)
def test_state_that_was_never_written_is_not_read(plain: Any) -> None:
    with pytest.raises((LookupError, TypeError, ValueError)):
        read(plain, Hopper())


@pytest.mark.parametrize("onto", [None, Figures()])
def test_an_object_is_read_only_onto_one_of_its_class(onto: object) -> None:
    with pytest.raises(Misplaced, match=r"there is no test_world_file.Hopper where one was"):
        read(json.loads(json.dumps(written(Hopper()))), onto)


@pytest.mark.parametrize("name", ["PCG64", "MT19937", "Philox", "SFC64"])
def test_a_generator_goes_on_where_it_was(name: str) -> None:
    rng = np.random.Generator(getattr(np.random, name)(5))
    rng.standard_normal(3)
    again = read(json.loads(json.dumps(written(rng))))
    assert again.standard_normal(9).tolist() == rng.standard_normal(9).tolist()
    assert again.integers(0, 9, 9, np.uint8).tolist() == rng.integers(0, 9, 9, np.uint8).tolist()


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


# --- the file itself ---


def last_of(path: Path) -> tuple[bytes, bytes]:
    file, state, log = WorldFile.open(path)
    file.close()
    return state, log


few = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
sizes = st.one_of(st.integers(0, 300), st.integers(0, 20_000))
changes = st.lists(st.tuples(st.booleans(), sizes, st.booleans()), max_size=20)


@few
@given(changes)
def test_what_was_written_last_is_read(tmp_path: Path, todo: list[tuple[bool, int, bool]]) -> None:
    path = tmp_path / "a.world"
    file, state, log, pending = WorldFile.create(path, b"first"), b"first", b"", b""
    for number, (appends, size, reopens) in enumerate(todo):
        content = bytes([number]) * size
        if appends:
            file.append(content)
            pending += content
        else:
            file.write(content)
            state, log, pending = content, log + pending, b""
        if reopens:  # as after a kill: what was appended since the last write is forgotten
            file.close()
            file, *read = WorldFile.open(path)
            assert read == [state, log]
            pending = b""
    file.close()
    assert last_of(path) == (state, log)
    assert list(tmp_path.iterdir()) == [path]


@few
@given(st.integers(0, 3000), st.integers(0, 3000), st.integers(0, 500), st.floats(0.0, 1.0))
def test_a_write_cut_short_leaves_the_state_before(tmp_path: Path, old: int, new: int, log: int, share: float) -> None:
    path = tmp_path / "a.world"
    file = WorldFile.create(path, b"first")
    file.append(b"l" * 10)
    file.write(b"o" * old)
    before = path.read_bytes()
    file.append(b"m" * log)
    appended = path.read_bytes()
    file.write(b"n" * new)
    after = path.read_bytes()
    file.close()
    changed = [at for at in range(len(appended)) if appended[at] != after[at]]
    cut = changed[math.floor(share * (len(changed) - 1))]
    assert len(before) <= len(appended) == len(after)
    path.write_bytes(after[:cut] + appended[cut:])
    assert last_of(path) == (b"o" * old, b"l" * 10)


@pytest.mark.parametrize("size", [10, 9000])
def test_a_process_from_which_another_has_taken_the_world_over_changes_it_no_more(tmp_path: Path, size: int) -> None:
    path = tmp_path / "a.world"
    overtaken = WorldFile.create(path, b"first")
    overtaken.write(b"before")
    heir, *_ = WorldFile.open(path)
    for writes in range(1, 4):
        heir.append(b"l")
        heir.write(b"of the heir")
        overtaken.append(b"stale")
        overtaken.write(b"s" * size)
        assert last_of(path) == (b"of the heir", b"l" * writes)
    overtaken.close()
    heir.close()


@few
@given(st.data())
def test_damage_is_an_older_state_or_a_clear_error(tmp_path: Path, data: st.DataObject) -> None:
    path = tmp_path / "a.world"
    file = WorldFile.create(path, b"first")
    file.write(b"o" * 700)
    file.append(b"l" * 100)
    file.write(b"n" * 700)
    file.close()
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        content[data.draw(st.integers(0, len(content) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    del content[data.draw(st.one_of(st.just(len(content)), st.integers(0, len(content)))) :]
    path.write_bytes(content)
    with contextlib.suppress(SourceError):
        assert last_of(path) in ((b"o" * 700, b""), (b"n" * 700, b"l" * 100))


@pytest.mark.parametrize(
    "content", [b"", b"SQLite format 3\0" + bytes(9000), b"scuhand_bt world 4\n", b"scuhand_bt world 3\n" + bytes(9000)]
)
def test_a_foreign_file_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.world"
    path.write_bytes(content)
    with pytest.raises(SourceError, match="not the file of a simulated world"):
        WorldFile.open(path)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"cannot be read: No such file.*begin anew"):
        WorldFile.open(tmp_path / "a.world")


def test_a_state_of_another_version_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.world"
    WorldFile.create(path, b'["of another", "shape", 1]').close()
    with pytest.raises(SourceError, match="another version of the program or the plant"):
        Bench.taken_up(path)
