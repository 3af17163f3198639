"""The processes of a study: their errors are told here, and they end with it, whoever is killed or interrupted."""

import os
import pickle
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from study_bench import FLOW

from scuhand_bt.failures import SkillFailed
from scuhand_bt.problems import Mark, Problem, SourceError
from scuhand_bt.study.pool import all_trials, executor_of
from scuhand_bt.study.trial import Setup
from tests.conftest import REPOSITORY


@pytest.mark.slow
def test_what_is_wrong_in_another_process_is_told_here(setup: Setup) -> None:
    wrong = replace(setup, changes=((FLOW, "-3"),)), replace(setup, plant="nowhere:Nothing")
    with executor_of(1, None) as executor:
        for one, said in zip(wrong, ("more than 0", "module 'nowhere' cannot be imported"), strict=True):
            with pytest.raises(SourceError, match=said):
                list(all_trials([(one, 0)], executor))


def test_errors_are_the_same_in_another_process() -> None:
    problems = [Problem(Mark("a.yaml", 3, 4), "is wrong", "bad-value"), Problem(Mark("--x", 0), "is none")]
    assert pickle.loads(pickle.dumps(SourceError(problems))).problems == SourceError(problems).problems
    failed = pickle.loads(pickle.dumps(SkillFailed("arm.no_path", "from a to b")))
    assert (str(failed), failed.code) == ("arm.no_path: from a to b", "arm.no_path")


@pytest.mark.parametrize(
    ("many", "said"),
    [
        (1, "the process was killed, perhaps for lack of memory: try again"),
        (2, "one of 2 processes was killed, perhaps for lack of memory: use fewer, and try again"),
    ],
)
def test_a_process_that_is_killed_ends_the_study_in_words(many: int, said: str) -> None:
    with pytest.raises(SourceError, match=said), executor_of(many, None) as executor:
        executor.submit(os.kill, executor.submit(os.getpid).result(), signal.SIGKILL).result()


def test_the_processes_of_a_study_that_is_killed_end_too(tmp_path: Path) -> None:
    program = tmp_path / "study.py"
    program.write_text(
        "import os, signal\nfrom scuhand_bt.study.pool import executor_of\n"
        "if __name__ == '__main__':\n    with executor_of(1, None) as executor:\n"
        "        executor.submit(os.getpid).result()\n        os.kill(os.getpid(), signal.SIGKILL)\n",
        encoding="utf-8",
    )
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    # Its output ends when nobody has it any more: the process that it has left neither.
    ended = subprocess.run([sys.executable, program], capture_output=True, env=environment, timeout=60, check=False)
    assert ended.returncode == -signal.SIGKILL


@pytest.mark.slow
def test_a_study_that_breaks_off_while_its_processes_end_says_nothing_else(tmp_path: Path) -> None:
    program = tmp_path / "study.py"
    program.write_text(
        "import os, signal, time\nfrom scuhand_bt.study import trial\nfrom scuhand_bt.study.pool import executor_of\n"
        "def slow(setup, seed):\n    time.sleep(0.2)\n    return os.getpid()\n"
        "if __name__ == '__main__':\n    trial.trial = slow\n    with executor_of(1, None) as executor:\n"
        "        for _, process in trial.trials([(None, seed) for seed in range(50)], executor):\n"
        "            os.kill(process, signal.SIGKILL)\n            raise KeyboardInterrupt\n",
        encoding="utf-8",
    )
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    command = [sys.executable, program]
    ended = subprocess.run(command, capture_output=True, env=environment, timeout=60, check=False, text=True)
    assert ended.returncode == -signal.SIGINT
    assert "InvalidStateError" not in ended.stderr
    assert ended.stderr.strip().endswith("KeyboardInterrupt")


@pytest.mark.parametrize(("handler", "ends"), [("default_int_handler", -signal.SIGINT), ("SIG_IGN", 0)])
def test_a_ctrl_c_ends_a_study_in_the_midst_of_a_trial_that_takes_it_for_its_own(
    tmp_path: Path, handler: str, ends: int
) -> None:
    """As it is given in a terminal: to all of its processes. In the background of a script it is ignored."""
    program = tmp_path / "study.py"
    program.write_text(
        "import os, signal, time\nfrom contextlib import suppress\nfrom scuhand_bt.study.pool import executor_of\n"
        "def ctrl_c(trial_s):\n    with suppress(KeyboardInterrupt):\n        os.killpg(0, signal.SIGINT)\n"
        "        time.sleep(1.0)\n    time.sleep(trial_s)\n"
        f"if __name__ == '__main__':\n    signal.signal(signal.SIGINT, signal.{handler})\n"
        "    with executor_of(1, None) as executor:\n"
        f"        executor.submit(ctrl_c, {600.0 if ends else 0.0}).result()\n",
        encoding="utf-8",
    )
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    ended = subprocess.run(
        [sys.executable, program],
        capture_output=True,
        env=environment,
        timeout=30,
        check=False,
        start_new_session=True,
    )
    assert ended.returncode == ends


@pytest.mark.slow
def test_a_ctrl_c_while_the_processes_of_a_study_begin_is_answered_by_none_of_them(tmp_path: Path) -> None:
    program = tmp_path / "study.py"
    program.write_text(
        "import os, signal, time\nfrom contextlib import suppress\nfrom scuhand_bt.study.pool import executor_of\n"
        "if __name__ == '__main__':\n    with suppress(KeyboardInterrupt), executor_of(1, None) as executor:\n"
        "        executor.submit(time.sleep, 600.0).result()\n"
        "else:  # as a process of it imports what it needs\n    os.killpg(0, signal.SIGINT)\n",
        encoding="utf-8",
    )
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    command = [sys.executable, program]
    ended = subprocess.run(
        command, capture_output=True, env=environment, timeout=30, check=False, text=True, start_new_session=True
    )
    assert (ended.returncode, ended.stderr) == (0, "")
