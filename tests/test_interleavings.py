"""Random interleavings of several processes on one lab do no harm, and the checker would see it if they did."""

import functools
import tempfile
from pathlib import Path

import pytest

from harness.interleaving_judge import Tally, judge
from harness.interleavings import Made, interleave, shared_motion
from harness.planted_bugs import BUGS
from scuhand_bt.motion import MotionPlanner

pytestmark = pytest.mark.slow
QUICK = ("append.anywhere", "exit.zero", "exit.by_skill", "journal.removed", "redo.collides")


@functools.cache
def motion() -> MotionPlanner:
    with tempfile.TemporaryDirectory() as folder:
        return shared_motion(Path(folder))


@pytest.mark.parametrize(("seed", "has_outages"), [(1, False), (2, True)])
def test_what_a_random_interleaving_comes_to_is_allowed(tmp_path: Path, seed: int, has_outages: bool) -> None:
    tally = Tally()
    done = interleave(Made(seed, tmp_path, motion(), has_outages=has_outages))
    assert judge(done, tally) == []
    assert tally.good > 0


@pytest.mark.parametrize("name", QUICK)
def test_the_checker_finds_a_planted_bug_and_nothing_without_it(tmp_path: Path, name: str) -> None:
    bug = BUGS[name]
    outcomes = []
    for plant in (lambda: None, bug.plant):
        folder = tmp_path / f"{len(outcomes)}"
        folder.mkdir()
        made = Made(0, folder, motion(), plant, bool(bug.only), bug.only, bug.careless, script=bug.at(0))
        outcomes.append(judge(interleave(made), Tally()))
    sound, planted = outcomes
    assert sound == []
    assert planted != []


def test_an_interleaving_is_its_seeds(tmp_path: Path) -> None:
    happened = []
    for name in ("first", "again"):
        (tmp_path / name).mkdir()
        done = interleave(Made(5, tmp_path / name, motion(), steps=6))
        happened.append([(command.args[0], command.code) for command in done.ended])
    assert happened[0] == happened[1]
