"""A world's file: what is written last is read, of a plant's own objects too; cut short, damaged or foreign."""

import contextlib
import json
import math
import os
import pickle
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from dose_bench import DISH
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from world_bench import Bench

from scuhand_bt.problems import SourceError
from scuhand_bt.sim import cell as cell_module
from scuhand_bt.sim.cone_load import ConeLoad
from scuhand_bt.sim.mass_ledger import Compartment
from scuhand_bt.sim.plain_state import Misplaced, read, written
from scuhand_bt.sim.plant import Plant
from scuhand_bt.sim.powder import OurPowderFlow
from scuhand_bt.sim.world_file import WorldFile
from scuhand_bt.specs import Powder


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
