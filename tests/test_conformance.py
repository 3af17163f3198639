"""Devices of others: a balance's dialect of another package, and what it has to pass, as ours do."""

from dataclasses import replace
from pathlib import Path

import pytest
from conftest import LabFolder

from scuhand_bt.devices.balances import DIALECTS, dialect_of
from scuhand_bt.devices.balances.frames import Dialect, Frame, Weight
from scuhand_bt.devices.plugged import NotPluggable
from scuhand_bt.run.make_cell import bench_of
from scuhand_bt.sim.wire.balances import TWINS, balance_twin
from scuhand_bt.testing import conformance

EXAMPLE = Path(__file__).parent.parent / "examples" / "radwag"
RADWAG = "scuhand_radwag:RADWAG"
BALANCE = "driver: shimadzu"


@pytest.fixture
def _example(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(EXAMPLE))


@pytest.mark.usefixtures("_example")
@pytest.mark.parametrize("driver", [*sorted(DIALECTS), RADWAG])
def test_every_dialect_understands_its_twin_and_nothing_else(driver: str) -> None:
    dialect, twin = dialect_of(driver), balance_twin(driver)
    conformance.readings_are_understood(dialect, twin)
    conformance.nothing_else_is_a_reading(dialect, twin)
    conformance.questions_are_answered(dialect, twin)


@pytest.mark.real_time
@pytest.mark.usefixtures("_example")
@pytest.mark.parametrize("driver", [*(pytest.param(d, marks=pytest.mark.slow) for d in sorted(DIALECTS)), RADWAG])
def test_the_engines_driver_reads_every_dialect(driver: str) -> None:
    conformance.the_driver_reads_it(driver)


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
        conformance.readings_are_understood(wrong(DIALECTS[name], what), TWINS[name])


@pytest.mark.parametrize("name", ["mt_sics", "sbi", "shimadzu"])
def test_a_dialect_whose_question_gets_no_reading_does_not_conform(name: str) -> None:
    with pytest.raises(AssertionError, match="it answers"):
        conformance.questions_are_answered(wrong(DIALECTS[name], "poll"), TWINS[name])


@pytest.mark.usefixtures("_example")
def test_a_cell_names_a_balance_of_another_package_and_its_twin_is_on_the_bench(lab_folder: LabFolder) -> None:
    lab_folder.replace("robot/cell.yaml", BALANCE, f'driver: "{RADWAG}"')
    lab = lab_folder.load()
    assert lab.cell.balance.driver == RADWAG
    bench = bench_of(lab)
    assert type(bench.balance.twin).__name__ == "RadwagTwin"
    for server in (bench.bus, bench.hand, bench.balance):
        server.port.close()


def test_a_module_of_the_lab_may_be_the_balances(lab_folder: LabFolder) -> None:
    lab_folder.write("my_balance.py", "from scuhand_bt.devices.balances.sbi import DIALECT as MINE\n")
    lab_folder.replace("robot/cell.yaml", BALANCE, 'driver: "my_balance:MINE"')
    assert dialect_of(lab_folder.load().cell.balance.driver).name == "SBI"


@pytest.mark.parametrize(
    ("driver", "problem"),
    [
        (
            "nobody.here:THING",
            "driver 'nobody.here:THING': module 'nobody.here' cannot be imported",
        ),
        ("math:pi", "driver 'math:pi': 'pi' is no Dialect; math has: none"),
    ],
)
def test_what_cannot_be_plugged_in_is_a_located_problem(lab_folder: LabFolder, driver: str, problem: str) -> None:
    lab_folder.replace("robot/cell.yaml", BALANCE, f'driver: "{driver}"')
    (found,) = lab_folder.problems()
    assert found.startswith("robot/cell.yaml:6:19: ")
    assert problem in found


def test_a_dialect_without_a_twin_cannot_be_rehearsed() -> None:
    with pytest.raises(NotPluggable, match="names no twin"):
        balance_twin("scuhand_bt.devices.balances.sbi:DIALECT")


def test_the_example_is_short() -> None:
    assert len((EXAMPLE / "scuhand_radwag.py").read_text().splitlines()) < 60
