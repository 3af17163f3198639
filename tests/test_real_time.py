"""What becomes of tests in real time that fail: an inner run, on a computer as busy as this one is told to be."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest
import real_time

Inner = Callable[[str], pytest.RunResult]
FAILS = """
import pytest
from pathlib import Path
@pytest.mark.real_time
def test_it():
    with open("tries", "a") as tries: tries.write("x")
    assert 6 * 7 == 54, "the valve was late"
"""
GETS_BETTER = FAILS.replace("6 * 7 == 54", "len(Path('tries').read_text()) == 2")
FIXTURE_FAILS = """
import pytest
from pathlib import Path
@pytest.fixture
def twin():
    with open("tries", "a") as tries: tries.write("x")
    assert len(Path("tries").read_text()) == 3, "no twin"
@pytest.mark.real_time
def test_it(twin): pass
"""


@pytest.fixture
def inner(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> Inner:
    """Runs a test in a run of its own."""
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")  # to be quick

    def run(test: str) -> pytest.RunResult:
        pytester.makeini("[pytest]\nmarkers = real_time\n")
        pytester.makepyfile(test)
        return pytester.runpytest_inprocess("-p", "real_time", "-rA")

    return run


@pytest.fixture
def busy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(real_time, "load", lambda: 9.0)
    monkeypatch.setattr(real_time, "cores", lambda: 2)
    monkeypatch.setattr(real_time, "WAIT_S", 0.0)


@pytest.fixture
def quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(real_time, "load", lambda: 0.5)
    monkeypatch.setattr(real_time, "LATE_MS", 1e9)


@pytest.mark.parametrize(("load", "attempts"), [(1.7, 1), (1.9, 3)])
@pytest.mark.usefixtures("busy")
def test_a_computer_whose_cores_are_all_wanted_by_others_is_busy(
    inner: Inner, pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch, load: float, attempts: int
) -> None:
    monkeypatch.setattr(real_time, "load", lambda: load)
    monkeypatch.setattr(real_time, "LATE_MS", 1e9)
    inner(FAILS)
    assert tries(pytester) == attempts


def tries(pytester: pytest.Pytester) -> int:
    return len((pytester.path / "tries").read_text())


@pytest.mark.usefixtures("busy")
def test_one_that_never_holds_on_a_busy_computer_fails_after_three_attempts_and_says_the_load(
    inner: Inner, pytester: pytest.Pytester
) -> None:
    result = inner(FAILS)
    assert result.ret == pytest.ExitCode.TESTS_FAILED
    assert tries(pytester) == 3
    assert result.parseoutcomes() == {"failed": 1, "retried": 2}
    result.stdout.fnmatch_lines(
        ["E *the valve was late*", "E *attempt 3 of 3: load 9.0 on 2 cores, a thread woken * ms late."]
    )


@pytest.mark.usefixtures("busy")
def test_one_that_holds_at_its_second_attempt_passes_and_the_first_is_told_of(
    inner: Inner, pytester: pytest.Pytester
) -> None:
    result = inner(GETS_BETTER)
    assert result.ret == pytest.ExitCode.OK
    assert result.parseoutcomes() == {"passed": 1, "retried": 1}
    assert tries(pytester) == 2


@pytest.mark.usefixtures("busy")
def test_each_attempt_has_fixtures_of_its_own(inner: Inner, pytester: pytest.Pytester) -> None:
    assert inner(FIXTURE_FAILS).parseoutcomes() == {"passed": 1, "retried": 2}
    assert tries(pytester) == 3


@pytest.mark.usefixtures("quiet")
def test_one_that_fails_on_a_quiet_computer_has_failed(inner: Inner, pytester: pytest.Pytester) -> None:
    result = inner(FAILS)
    assert result.parseoutcomes() == {"failed": 1}
    assert tries(pytester) == 1
    result.stdout.fnmatch_lines(["E *attempt 1 of 3: load 0.5 on *"])


@pytest.mark.usefixtures("quiet")
def test_a_thread_that_is_woken_late_makes_a_computer_busy_whatever_its_load(
    inner: Inner, pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(real_time, "LATE_MS", -1.0)
    inner(FAILS)
    assert tries(pytester) == 3


@pytest.mark.usefixtures("busy")
def test_a_test_that_is_not_in_real_time_is_never_tried_again(inner: Inner, pytester: pytest.Pytester) -> None:
    assert inner(FAILS.replace("@pytest.mark.real_time", "")).parseoutcomes() == {"failed": 1}
    assert tries(pytester) == 1


def test_an_attempt_waits_until_the_load_has_fallen(
    inner: Inner, pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    slept_s: list[float] = []
    monkeypatch.setattr(real_time, "cores", lambda: 2)
    monkeypatch.setattr(real_time, "load", lambda: 9.0 if len(slept_s) < 4 else 1.0)
    monkeypatch.setattr(real_time, "LATE_MS", 1e9)
    monkeypatch.setattr(real_time, "pause", slept_s.append)
    inner(FAILS)
    assert len(slept_s) == 4
    assert tries(pytester) == 2, "the second attempt was made on a quiet computer"


def test_those_in_real_time_run_one_after_the_other_in_a_process_that_the_others_give_way_to(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    monkeypatch.setenv("PYTHONPATH", str(Path(real_time.__file__).parent), prepend=os.pathsep)
    pytester.makeini("[pytest]\nmarkers = real_time\n")
    pytester.makepyfile(
        """
        import os, pytest
        def note(kind):
            with open("where", "a") as where: where.write(f"{kind} {os.getpid()} {os.nice(0)}\\n")
        @pytest.mark.parametrize("number", range(6))
        def test_that_computes(number): note("computes")
        @pytest.mark.real_time
        @pytest.mark.parametrize("number", range(8))
        def test_in_real_time(number): note("real_time")
        """
    )
    pytester.runpytest_subprocess("-p", "real_time", "-p", "xdist", "-n", "2", "--dist", "loadgroup").assert_outcomes(
        passed=14
    )
    where = {tuple(line.split()) for line in (pytester.path / "where").read_text().splitlines()}
    ((_, process, niceness),) = (each for each in where if each[0] == "real_time")
    assert int(niceness) == os.nice(0)
    others = [int(nice) for _, other, nice in where if other != process]
    assert others
    assert min(others) > os.nice(0)


def test_files_that_name_a_group_are_run_by_one_process_and_of_others_each_is_a_group(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    monkeypatch.setenv("PYTHONPATH", str(Path(real_time.__file__).parent), prepend=os.pathsep)
    pytester.makeini("[pytest]\nmarkers = real_time\n")
    shares = "import pytest\npytestmark = pytest.mark.xdist_group('server')\ndef test_it(): pass\n"
    alone = "def test_it(): pass\n"
    pytester.makepyfile(test_first=shares, test_second=shares, test_third=alone, test_fourth=alone)
    options = ("-p", "real_time", "-p", "xdist", "-n", "1", "--dist", "loadgroup", "-v")
    ran = pytester.runpytest_subprocess(*options).outlines
    groups = {line.strip().split("@")[-1] for line in ran if line.startswith("[gw0]")}
    assert groups == {"server", "test_third", "test_fourth"}
