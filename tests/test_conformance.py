"""Devices of others: a balance's dialect of another package, and what it has to pass, as ours do."""

import tomllib
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from threading import Barrier, Event, Thread
from typing import Any

import pytest
from conftest import Bench, Call, FakeDevice, LabFolder
from device_benches import WiredArmBench, WiredHandBench

from scuhand_bt.devices.balances import DIALECTS
from scuhand_bt.devices.balances.frames import Dialect, Frame, Weight
from scuhand_bt.devices.connect import connect_cell_devices
from scuhand_bt.drivers import driver_of
from scuhand_bt.failures import SkillFailed
from scuhand_bt.journal.reader import read
from scuhand_bt.kit.new_device import TEMPLATES, write_device
from scuhand_bt.lab import Lab
from scuhand_bt.problems import SourceError
from scuhand_bt.run.bench import bench_of
from scuhand_bt.run.clock import WallClock
from scuhand_bt.sim.wire.balances import balance_twin
from scuhand_bt.skill import Cell, Skill, Steps
from scuhand_bt.testing import at_the_wire, conformance, of_balances, of_motion

EXAMPLE = Path(__file__).parent.parent / "examples" / "radwag"
RADWAG = "scuhand_radwag:DRIVER"
BALANCE = "driver: shimadzu"


@pytest.fixture
def _example(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(EXAMPLE))


@pytest.mark.usefixtures("_example")
@pytest.mark.parametrize("driver", [*sorted(DIALECTS), RADWAG])
def test_every_dialect_understands_its_twin_and_nothing_else(driver: str) -> None:
    dialect, twin = driver_of("balance", driver), balance_twin(driver)
    of_balances.readings_are_understood(dialect, twin)
    of_balances.nothing_else_is_a_reading(dialect, twin)
    of_balances.questions_are_answered(dialect, twin)


@pytest.mark.real_time
@pytest.mark.usefixtures("_example")
@pytest.mark.parametrize("driver", [*(pytest.param(d, marks=pytest.mark.slow) for d in sorted(DIALECTS)), RADWAG])
def test_the_engines_driver_reads_every_dialect(driver: str) -> None:
    of_balances.the_driver_reads_it(driver)


def wrong(dialect: Dialect, what: str) -> Dialect:
    """A dialect with a mistake that somebody may make."""

    def parse(line: bytes) -> Frame | None:
        frame = dialect.parse(line)
        if not isinstance(frame, Weight):
            return Weight(frame.above * 1000, "g", True) if what == "range" and hasattr(frame, "above") else frame
        if what == "stable":
            return replace(frame, stable=True)
        if what == "sign":
            return replace(frame, value=abs(frame.value))
        return replace(frame, unit="PC" if what == "unit" else frame.unit)

    return replace(dialect, parse=parse, poll=b"XX\r\n" if what == "poll" else dialect.poll)


@pytest.mark.parametrize("name", sorted(DIALECTS))
@pytest.mark.parametrize("what", ["stable", "sign", "unit", "range"])
def test_a_dialect_with_a_mistake_does_not_conform(name: str, what: str) -> None:
    with pytest.raises(AssertionError):
        of_balances.readings_are_understood(wrong(DIALECTS[name], what), balance_twin(name))


@pytest.mark.parametrize("name", ["mt_sics", "sbi", "shimadzu"])
def test_a_dialect_whose_question_gets_no_reading_does_not_conform(name: str) -> None:
    with pytest.raises(AssertionError, match="it answers"):
        of_balances.questions_are_answered(wrong(DIALECTS[name], "poll"), balance_twin(name))


@pytest.mark.usefixtures("_example")
def test_a_cell_names_a_balance_of_another_package_and_its_twin_is_on_the_bench(lab_folder: LabFolder) -> None:
    lab_folder.replace("robot/cell.yaml", BALANCE, f'driver: "{RADWAG}"')
    lab = lab_folder.load()
    assert lab.cell.balance.driver == RADWAG
    bench = bench_of(lab)
    assert type(bench.balance.twin).__name__ == "RadwagTwin"
    for server in bench.servers.values():
        server.port.close()


def test_a_module_of_the_lab_may_be_the_balances(lab_folder: LabFolder) -> None:
    lab_folder.write("my_balance.py", "from scuhand_bt.devices.balances.sbi import DIALECT as MINE\n")
    lab_folder.replace("robot/cell.yaml", BALANCE, 'driver: "my_balance:MINE"')
    assert driver_of("balance", lab_folder.load().cell.balance.driver).name == "SBI"


@pytest.mark.parametrize(
    ("driver", "problem"),
    [
        (
            "nobody.here:THING",
            "driver 'nobody.here:THING': module 'nobody.here' cannot be imported",
        ),
        ("math:pi", "driver 'math:pi': 'pi' is not a Driver; math has: none"),
    ],
)
def test_what_cannot_be_plugged_in_is_a_located_problem(lab_folder: LabFolder, driver: str, problem: str) -> None:
    lab_folder.replace("robot/cell.yaml", BALANCE, f'driver: "{driver}"')
    (found,) = lab_folder.problems()
    assert found.startswith("robot/cell.yaml:6:19: ")
    assert problem in found


def test_a_dialect_without_a_twin_cannot_be_rehearsed(lab_folder: LabFolder) -> None:
    imports = "from dataclasses import replace\nfrom scuhand_bt.devices.balances.sbi import DIALECT\n"
    lab_folder.write("dumb.py", f'{imports}DUMB = replace(DIALECT, twin="")\n')
    lab_folder.replace("robot/cell.yaml", BALANCE, 'driver: "dumb:DUMB"')
    with pytest.raises(SourceError, match=r"cell.yaml:6:19: driver 'dumb:DUMB' names no twin: it cannot be rehearsed"):
        bench_of(lab_folder.load())


# --- every kind of device


DRIVERS: list[tuple[str, str, dict[str, str]]] = [
    ("sensor", "vaisala", {}),
    ("scanner", "keyboard_wedge", {}),
    ("changer", "carousel", {"slot": "0.3 s"}),
    *((kind, f"scuhand_bt.kit.templates.{module}:DRIVER", {}) for kind, module in TEMPLATES.items()),
]


def found_at_once(drivers: Iterable[tuple[str, str, dict[str, str]]]) -> dict[str, BaseException | None]:
    """What each of them fails by, if it does: at a wire there is much more to wait for than to compute."""
    with ThreadPoolExecutor(4) as pool:
        all_there = Barrier(4)  # of its own threads none is taken for a driver's
        list(pool.map(lambda _: all_there.wait(), range(4)))
        asked = {
            f"{kind} {name}": pool.submit(conformance.conforms, kind, name, **more) for kind, name, more in drivers
        }
        return {name: one.exception() for name, one in asked.items()}


@pytest.mark.real_time
def test_every_driver_of_ours_and_every_template_conforms() -> None:
    assert {name: wrong for name, wrong in found_at_once(DRIVERS).items() if wrong is not None} == {}


def test_a_thread_that_a_device_leaves_behind_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(at_the_wire, "PATIENCE_S", 1.0)
    is_over = Event()
    leaves_one = pytest.raises(AssertionError, match="its threads end with it")
    with leaves_one, at_the_wire.at_the_wire("sensor", "vaisala", {}):
        Thread(target=is_over.wait, daemon=True).start()
    is_over.set()


@pytest.mark.slow
@pytest.mark.real_time
def test_our_arm_and_our_hand_conform(starter: Lab) -> None:
    clock = WallClock()
    with bench_of(starter) as bench:
        devices = connect_cell_devices(bench.spec, clock)
        try:
            of_motion.arm_conforms(devices.arm, clock)
            of_motion.hand_conforms(devices.hand, clock)
        finally:
            devices.close()


class Numb:
    """A device of which one verb does nothing, or something else."""

    def __init__(self, device: Any, **others: Any) -> None:
        self.__dict__.update(_device=device, **others)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._device, name)

    def __setattr__(self, name: str, value: Any) -> None:
        setattr(self._device, name, value)


@pytest.mark.slow
def test_an_arm_and_a_hand_with_a_mistake_do_not_conform(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(at_the_wire, "PATIENCE_S", 3.0)
    with WiredArmBench().open() as bench, pytest.raises(AssertionError, match="ends a motion on its way"):
        of_motion.arm_conforms(Numb(bench.device, stop=lambda: None), bench.clock)
    with WiredHandBench().open() as bench:
        with pytest.raises(AssertionError, match="ValueError"):
            of_motion.hand_conforms(Numb(bench.device, set_vibration=lambda level: None), bench.clock)
        with pytest.raises(AssertionError, match="after a stop"):
            of_motion.hand_conforms(Numb(bench.device, stop=lambda: None), bench.clock)


MISTAKES = [
    ("sensor", '"humidity_percent": float(match[2])', '"humidity_percent": float(match[1])'),
    ("scanner", "code.decode()", "code.decode().lower()"),
    ("ioniser", 'b"ON\\r\\n" if value else b"OFF\\r\\n"', 'b"OFF\\r\\n" if value else b"ON\\r\\n"'),
    ("capper", '": False}', '": True}'),
    ("changer", 'not in ("CLEAR", place)', 'in ("nowhere",)'),
    ("watcher", "at_mm=(x, y, z)", "at_mm=(x, -y, z)"),
    ("watcher", "    def parse(", "    def opened(self):\n        self.fault = None\n\n    def parse("),
]


@pytest.mark.real_time
def test_drivers_with_a_mistake_do_not_conform(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(at_the_wire, "PATIENCE_S", 4.0)
    monkeypatch.syspath_prepend(str(tmp_path))
    drivers: list[tuple[str, str, dict[str, str]]] = []
    for number, (kind, right, wrong) in enumerate(MISTAKES):
        name = f"wrong_{kind}_{number}"
        module = write_device(name, kind, tmp_path / name)[0]
        assert right in module.read_text()
        (tmp_path / f"{name}.py").write_text(module.read_text().replace(right, wrong))
        drivers.append((kind, f"{name}:DRIVER", {}))
    found = found_at_once(drivers)
    assert len(found) == len(MISTAKES)
    assert [name for name, wrong in found.items() if not isinstance(wrong, AssertionError | SkillFailed)] == []


UNASKED = """

class UnaskedTwin(CurtainTwin):
    next_s = 0.0

    def unasked(self, now_s):
        if 0.0 < self.next_s - now_s <= 0.2:
            return b""
        self.next_s = now_s + 0.2
        return self.answer(b"LOOK", now_s)


class Unasked(Curtain):
    twin = f"{__name__}:UnaskedTwin"
    question = b""


DRIVER = Unasked
"""


@pytest.mark.real_time
@pytest.mark.slow
def test_a_watcher_that_speaks_by_itself_conforms_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = write_device("curtain", "watcher", tmp_path / "made")[0]
    module.write_text(module.read_text() + UNASKED)
    monkeypatch.syspath_prepend(str(module.parent))
    conformance.conforms("watcher", "scuhand_curtain:DRIVER")


# --- named in robot/cell.yaml


ROOM = "devices: {room: {kind: sensor, driver: vaisala, port: /dev/ttyUSB7, options: {baud: 9600}}}\n"


def with_devices(lab_folder: LabFolder, text: str) -> None:
    cell = (lab_folder.folder / "robot" / "cell.yaml").read_text()
    lab_folder.write("robot/cell.yaml", cell + text)


def test_a_driver_of_an_installed_package_is_named_by_its_entry_point(
    lab_folder: LabFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = write_device("room_air", "sensor", tmp_path / "site")
    info = made[0].parent / "scuhand_room_air-0.1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: scuhand-room-air\nVersion: 0.1.0\n")
    said = tomllib.loads(made[3].read_text())["project"]["entry-points"]
    points = "".join(f"[{group}]\n" + "".join(f"{k} = {v}\n" for k, v in one.items()) for group, one in said.items())
    (info / "entry_points.txt").write_text(points)
    monkeypatch.syspath_prepend(str(made[0].parent))
    with_devices(lab_folder, ROOM.replace("vaisala", "room_air"))
    assert lab_folder.problems() == []
    assert driver_of("sensor", "room_air").__name__ == "RoomAir"  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("changed", "problem"),
    [
        (("9600", "fast"), "'baud': 'fast' is not accepted; a whole number"),
        (("baud", "buad"), "unknown key 'buad'; known: baud, bits; did you mean 'baud'?"),
        (("vaisala", "visala"), "'driver': 'visala' is not accepted; write 'vaisala', package.module:NAME"),
        (("kind: sensor", "kind: ear"), "'kind': 'ear' is not accepted"),
        (("room:", "arm:"), "'arm' is not a valid name"),
        (("/dev/ttyUSB7", "/dev/ttyUSB1"), "the room and the balance are both on /dev/ttyUSB1"),
    ],
)
def test_what_is_wrong_with_a_further_device_is_located(
    lab_folder: LabFolder, changed: tuple[str, str], problem: str
) -> None:
    with_devices(lab_folder, ROOM.replace(*changed))
    (found,) = lab_folder.problems()
    assert found.startswith("robot/cell.yaml:28:")
    assert problem in found


def test_the_options_of_an_arm_of_others_are_read_by_its_own_model(lab_folder: LabFolder) -> None:
    lab_folder.write("my_arm.py", MY_ARM)
    lab_folder.replace(
        "robot/cell.yaml", "{driver: dynamixel, port: /dev/ttyUSB0", "{driver: 'my_arm:MyArm', " + GENTLE
    )
    assert lab_folder.load().cell.options_of("arm").model_dump() == {"gain": 0.5}
    lab_folder.replace("robot/cell.yaml", "gain: 0.5", "gain: much")
    (found,) = lab_folder.problems()
    assert found.startswith("robot/cell.yaml:4:47: 'gain': 'much' is not accepted")


OUR_ARM = "driver: dynamixel, port: /dev/ttyUSB0"
GENTLE = "options: {gain: 0.5}"
MY_ARM = """\
from pydantic import BaseModel

class Mine(BaseModel):
    gain: float

class MyArm:
    Options = Mine
    twin = ""

    @classmethod
    def connect(cls, site):
        raise NotImplementedError
"""


def test_an_arm_of_others_is_not_rehearsed_by_an_arm_of_ours(lab_folder: LabFolder) -> None:
    lab_folder.write("my_arm.py", MY_ARM)
    lab_folder.replace(
        "robot/cell.yaml", "{driver: dynamixel, port: /dev/ttyUSB0", "{driver: 'my_arm:MyArm', " + GENTLE
    )
    with pytest.raises(SourceError, match=r"cell.yaml:4:15: driver 'my_arm:MyArm' names no twin"):
        bench_of(lab_folder.load())


# --- leased by skills


WATCHES_AIR = """
from scuhand_bt.devices.instruments import Scanner, Sensor
from scuhand_bt.skill import Cell, Skill, Steps


class WatchAir(Skill[None]):
    \"\"\"Write down the air, and what stands on the pan.\"\"\"

    devices = ("room", "codes")

    def run(self, cell: Cell) -> Steps[None]:
        air: Sensor = cell.device("room")
        scanner: Scanner = cell.device("codes")
        code = yield from scanner.read()
        sample = yield from air.read()
        cell.record.note("lab.air", {**sample.value, "code": code.value})
"""
AIR_TREE = """\
workflow: air
inputs: {container: Container}
tree:
  sequence: [{place_container: {container: $container}}, {watch_air: }, {remove_container: }]
"""
AIR_RECIPE = "recipe: air\nworkflow: air\nsamples: [{id: a, container: xrd_holder}]\n"
BOTH = ROOM.replace("}}}", "}}, codes: {kind: scanner, driver: keyboard_wedge, port: /dev/input/event7}}")


def test_a_skill_leases_a_device_by_its_name_and_a_dry_run_has_it_simulated(
    lab_folder: LabFolder, command: Call
) -> None:
    with_devices(lab_folder, BOTH)
    lab_folder.write("skills/watch_air.py", WATCHES_AIR)
    lab_folder.write("trees/air.yaml", AIR_TREE)
    (lab_folder.folder / "recipes").mkdir(exist_ok=True)
    recipe = lab_folder.write("recipes/air.yaml", AIR_RECIPE)
    done = command("run", recipe, "--dry-run")
    assert done.returncode == 0, done
    (journal,) = (lab_folder.folder / ".scuhand" / "runs").glob("*.sqlite")
    (note,) = (row["payload"] for row in read(journal, "event") if row["kind"] == "lab.air")
    assert note == {"temperature_c": 22.0, "humidity_percent": 45.0, "code": "a"}


@pytest.mark.parametrize(
    ("wrong", "problem"),
    [
        ('devices = ("room",)', "the codes is used here, but 'devices' does not lease it"),
        ('devices = ("room", "codse")', "names an unknown device 'codse'; known: arm, balance, changer, codes"),
    ],
)
def test_a_device_that_is_not_leased_or_not_there_is_found_before_a_run(
    lab_folder: LabFolder, wrong: str, problem: str
) -> None:
    with_devices(lab_folder, BOTH)
    lab_folder.write("skills/watch_air.py", WATCHES_AIR.replace('devices = ("room", "codes")', wrong))
    assert any(problem in found for found in lab_folder.problems())


class Bar(FakeDevice):
    stops = 0

    def stop(self) -> None:
        self.stops += 1
        self.is_stopped = True


BAR = Bar()


class Knocks(Skill[None]):
    """Something knocks against the bar, which nobody has leased."""

    def run(self, cell: Cell) -> Steps[None]:
        BAR.is_stopped = False
        return
        yield


def test_a_further_device_that_moves_on_after_the_job_is_stopped_and_said(bench: Bench) -> None:
    bench.cell.devices = {**bench.cell.devices, "bar": BAR}
    outcome = bench.run("knocks:", {"knocks": Knocks})
    assert outcome.failure is not None
    assert "bar still moved" in outcome.failure.detail
    assert BAR.stops > 0
