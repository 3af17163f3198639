"""Trials that are kept: what was tried of these files is not tried again, and of others it does not count."""

import json
import os
import sqlite3
from collections.abc import Callable
from contextlib import closing, nullcontext
from dataclasses import replace
from pathlib import Path

import pytest
from study_bench import FLOW, RECIPE, Inline, fake

import scuhand_bt.study
from scuhand_bt.lab import Lab
from scuhand_bt.problems import SourceError
from scuhand_bt.recipe.plan import Plan
from scuhand_bt.study.change import files_hash
from scuhand_bt.study.pool import all_trials
from scuhand_bt.study.store import RECIPES_KEPT, open_store
from scuhand_bt.study.trial import Setup, Trial, trial
from tests.conftest import Call

pytestmark = pytest.mark.usefixtures("no_ways")


def test_a_study_that_broke_off_goes_on_and_one_of_other_files_begins_anew(setup: Setup, tmp_path: Path) -> None:
    kept, inline = tmp_path / "s.sqlite", Inline(lambda _, seed: fake(seed, 600.0 + seed, "ab"))
    tasks = [(setup, seed) for seed in range(3)]
    with open_store(kept, setup) as store:
        first = dict(all_trials(tasks[:2], inline, store))
    with open_store(kept, setup) as store:
        again = dict(all_trials(tasks, inline, store))
    assert (inline.ran, list(again)) == (3, tasks)
    assert all(again[task] == one for task, one in first.items())
    for other in (replace(setup, controller="paper"), replace(setup, order="as_written")):
        with open_store(kept, setup) as store:
            dict(all_trials([(other, 0)], inline, store))
    assert inline.ran == 5
    setup.recipe.write_text(RECIPE.replace("30 mg", "31 mg"), encoding="utf-8")
    with open_store(kept, setup) as store:
        dict(all_trials([(setup, 0)], inline, store))
    assert inline.ran == 6


def test_a_plan_tries_what_it_has_not_tried_of_these_files(
    setup: Setup, command: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    inline = Inline(lambda _, seed: fake(seed, 600.0 + seed, "abc"))
    monkeypatch.setattr(scuhand_bt.study, "executor_of", lambda *_: nullcontext(inline), raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "caches"))

    def plan(trials: int) -> tuple[int, object]:
        """How many dry runs it took, and what they came to."""
        before, ended = inline.ran, command("plan", setup.recipe, "--lab", setup.lab, "--trials", trials, "--json")
        assert ended.returncode == 0, ended.stderr
        return inline.ran - before, json.loads(ended.stdout)["odds"]

    (first, odds), again, more = plan(3), plan(3), plan(5)
    assert (first, again, more[0]) == (3, (0, odds), 2)
    powders = setup.lab / "robot" / "powders.yaml"
    powders.write_text(f"{powders.read_text(encoding='utf-8')}\n# another word\n", encoding="utf-8")
    assert plan(3) == (3, odds)
    kept = list((tmp_path / "caches" / "scuhand_bt" / "trials").iterdir())
    assert len(kept) == 1, "what was tried of other files is not tried again"
    for number in range(RECIPES_KEPT + 3):
        (of_another := kept[0].with_name(f"{number}-another.sqlite")).touch()
        os.utime(of_another, (1000.0 + number, 1000.0 + number))
    os.utime(kept[0], (1.0, 1.0))
    assert plan(3) == (0, odds)
    assert kept[0].stat().st_mtime > 1e9, "it is not the oldest for having lacked nothing"
    there = {path.name for path in kept[0].parent.iterdir()}
    assert len(there) == RECIPES_KEPT
    assert {kept[0].name, "66-another.sqlite"} < there, "the oldest have gone"
    for path in set(kept[0].parent.iterdir()) - set(kept):
        path.unlink()
    with monkeypatch.context() as another:
        another.setattr("scuhand_bt.study.store.source_digest", lambda: "of another program")
        assert plan(3) == (3, odds)
    assert plan(3) == (3, odds)
    kept = list(kept[0].parent.iterdir())
    kept[0].write_text("this is no database")
    assert (plan(3), plan(3)) == ((3, odds), (3, odds))
    kept[0].unlink()
    plan(3)
    with closing(sqlite3.connect(kept[0])) as database, database:
        database.execute("UPDATE trial SET figures = '{' WHERE seed = 1")
    assert plan(3) == (1, odds)
    kept[0].write_bytes(kept[0].read_bytes()[:4096].ljust(12288, b"\xff"))
    assert plan(3) == (3, odds), "it has its table still, and no trial can be read or kept"
    (tmp_path / "a file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "a file"))
    assert plan(3) == (3, odds)


@pytest.mark.parametrize("file", ["recipes/two.yaml", "recipes/rows.csv", "robot/powders.yaml"])
def test_trials_of_files_that_are_changed_meanwhile_are_not_taken_for_theirs(setup: Setup, file: str) -> None:
    rows = setup.lab / "recipes" / "rows.csv"
    rows.write_text("id,source,container,mass [mg]\nd,beads,xrd_holder,40\n", encoding="utf-8")
    setup.recipe.write_text(f"{RECIPE}  - {{table: rows.csv}}\n", encoding="utf-8")
    begun = replace(setup, files=files_hash(setup.recipe, setup.lab))
    with (setup.lab / file).open("a", encoding="utf-8") as edited:
        edited.write("\n")
    for changes in ((), ((FLOW, "90"),)):
        with pytest.raises(SourceError, match="its lab has changed since these dry runs began"):
            trial(replace(begun, changes=changes), 1)


def test_another_order_is_tried_with_the_files_that_the_plan_was_made_of(
    setup: Setup, command: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried: list[Setup] = []

    def edited(of: Setup, seed: int) -> Trial:
        tried.append(of)
        setup.recipe.write_text(RECIPE.replace("30 mg", "31 mg"), encoding="utf-8")
        return fake(seed, 600.0, "abc")

    def of_another(made: Plan, lab: Lab, odds: object, hours: object, tried: Callable[[Plan], object]) -> list[str]:
        tried(replace(made, recipe=replace(made.recipe, order="as_written")))
        return []

    monkeypatch.setattr(scuhand_bt.study, "executor_of", lambda *_: nullcontext(Inline(edited)), raising=False)
    monkeypatch.setattr(scuhand_bt.study, "in_words", of_another, raising=False)
    before = files_hash(setup.recipe, setup.lab)
    ended = command("plan", setup.recipe, "--lab", setup.lab, "--trials", 3, "--night", "20:00-08:00")
    assert ended.returncode == 0, ended.stderr
    assert [of.order for of in tried] == ["by_powder"] * 3 + ["as_written"] * 3
    assert {of.files for of in tried} == {before}, "the process that tries it says that they have changed"


def test_a_database_of_something_else_is_refused_and_stays_as_it_is(setup: Setup, tmp_path: Path) -> None:
    """A run's journal had the trials in it then."""
    path = tmp_path / "run.sqlite"
    with closing(sqlite3.connect(path)) as database:
        database.execute("CREATE TABLE entry (seq INTEGER PRIMARY KEY)")
        database.commit()
    before = path.read_bytes()
    refused = pytest.raises(SourceError, match="cannot be kept there: it is a database of something else")
    with refused, open_store(path, setup):
        pass
    assert path.read_bytes() == before


def test_a_file_that_is_no_store_is_refused(setup: Setup, tmp_path: Path) -> None:
    path = tmp_path / "s.sqlite"
    path.write_text("no database, and long enough not to be taken for one", encoding="utf-8")
    with pytest.raises(SourceError, match="cannot be kept there"), open_store(path, setup):
        pass


def test_what_fails_beside_the_store_is_not_told_of_it(setup: Setup, tmp_path: Path) -> None:
    with pytest.raises(OSError, match="another file"), open_store(tmp_path / "s.sqlite", setup):
        raise OSError("another file")
