"""Many dry runs of a recipe: the same trials anywhere, kept, varied, and what they say of a plan."""

import csv
import json
import logging
import os
import pickle
import re
import signal
import sqlite3
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Executor, Future, ThreadPoolExecutor
from contextlib import closing, nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
from dose_bench import shipped_powders

import scuhand_bt.study
from scuhand_bt.cli.study import tell_dominant, tell_odds
from scuhand_bt.failures import SkillFailed
from scuhand_bt.lab import Lab, load_lab
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.problems import Mark, Problem, SourceError
from scuhand_bt.recipe.plan import Plan, make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.own_modules import lab_modules, plant_files
from scuhand_bt.run.prepared_motion import prepared_motion
from scuhand_bt.sim.powder import OurPowderFlow
from scuhand_bt.sim.response import OurBalanceResponse
from scuhand_bt.study.change import changed, files_hash, modules_hash, with_value
from scuhand_bt.study.odds import Chance, odds_of
from scuhand_bt.study.optimise import Found, diff, is_better, optimised
from scuhand_bt.study.pool import all_trials, executor_of
from scuhand_bt.study.some_cell import SomeCell
from scuhand_bt.study.store import RECIPES_KEPT, open_store
from scuhand_bt.study.table import write_table
from scuhand_bt.study.trial import SampleTrial, Setup, Task, Trial, trial
from scuhand_bt.study.vary import Vary, check_setups, goes_with, means_of, read_vary
from tests.conftest import REPOSITORY, Call, LabFolder

RECIPE = """recipe: two
workflow: fill_xrd_holder
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 5 g}
samples:
  - {id: a, source: beads, container: xrd_holder, mass: 50 mg}
  - {id: b, source: beads, container: xrd_holder, mass: 50 mg}
  - {id: c, source: beads, container: xrd_holder, mass: 30 mg}
"""
FLOW = "powders.glass_beads.simulation.flow_coefficient"


@pytest.fixture(autouse=True)
def no_ways(monkeypatch: pytest.MonkeyPatch) -> None:
    """What `plan` says of the arm's ways, which are planned anew for each lab, is told elsewhere (`test_ways`)."""
    monkeypatch.setattr("scuhand_bt.api.labs.ways_lacking", lambda *_: [])


@pytest.fixture
def setup(lab_folder: LabFolder) -> Setup:
    return Setup(lab_folder.write("recipes/two.yaml", RECIPE), lab_folder.folder)


class Inline(Executor):
    """Runs what it is given at once, or this in its place, and counts it."""

    def __init__(self, instead: Callable[[Setup, int], Trial] | None = None) -> None:
        self.ran, self._instead = 0, instead

    def submit(self, fn, /, *arguments, **named):  # type: ignore[no-untyped-def]
        self.ran += 1
        future: Future[object] = Future()
        future.set_result((self._instead or fn)(*arguments, **named))
        return future


def test_a_trial_is_the_same_in_any_process_and_after_any_other(setup: Setup) -> None:
    here = [trial(setup, 3), trial(setup, 4), trial(setup, 3)]
    assert here[0] == here[2] != here[1]
    with executor_of(1, None) as executor:
        assert dict(all_trials([(setup, 3)], executor)) == {(setup, 3): here[0]}
    assert not (setup.lab / ".scuhand").exists(), "it leaves no run behind"


@pytest.mark.slow
def test_nobody_is_told_of_a_trial(setup: Setup, tmp_path: Path) -> None:
    cell, told = setup.lab / "robot" / "cell.yaml", tmp_path / "told"
    cell.write_text(f"{cell.read_text(encoding='utf-8')}\nnotify: {{command: [touch, {told}]}}\n", encoding="utf-8")
    assert trial(setup, 1).exit_code == 0
    assert not told.exists()


def test_a_trial_says_what_came_of_the_run(setup: Setup) -> None:
    one = trial(setup, 1)
    assert [sample.id for sample in one.samples] == ["a", "b", "c"]
    assert [sample.target_mg for sample in one.samples] == [50.0, 50.0, 30.0]
    dosed_mg = sum(sample.true_mg or 0.0 for sample in one.samples)
    assert dosed_mg == pytest.approx(130.0, abs=9.0)
    assert dosed_mg <= one.used_mg["beads"] < 500.0
    assert one.scoops["beads"] >= 1
    assert one.began_s["a"] == 0.0 < one.began_s["b"] < one.began_s["c"] < one.duration_s


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


@pytest.mark.slow
def test_another_study_in_one_process_is_of_the_files_of_today(setup: Setup) -> None:
    before = trial(replace(setup, files=files_hash(setup.recipe, setup.lab)), 0)
    setup.recipe.write_text(RECIPE.replace("30 mg", "31 mg"), encoding="utf-8")
    after = trial(replace(setup, files=files_hash(setup.recipe, setup.lab)), 0)
    assert [one.samples[2].target_mg for one in (before, after)] == [30.0, 31.0], "as on a Dask worker"


def tried_anew(setup: Setup, kept: Path, file: Path, texts: Sequence[str]) -> list[bool]:
    """With each text of a file, one after another: whether what was tried before does not count."""
    tried = []
    for text in texts:
        file.write_text(text, encoding="utf-8")
        with open_store(kept, setup) as store:
            tried.append(not list(store.found([(setup, 0)])))
            store.keep(setup, fake(0, 60.0, "abc"))
    return tried


def test_physics_of_ones_own_that_were_changed_are_tried_anew(
    setup: Setup, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    here, own = replace(setup, plant="physics_of_mine:Mine"), tmp_path / "physics_of_mine.py"
    texts = ("class Mine: ...", "class Mine: ...", "class Mine: is_damp = True")
    assert tried_anew(here, tmp_path / "s.sqlite", own, texts) == [True, False, True]


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


@pytest.mark.parametrize("of", ["skill", "skill in the lab", "driver"])
def test_modules_of_ones_own_that_a_lab_is_made_of_and_were_changed_are_tried_anew(
    setup: Setup, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, of: str
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    dots, folder = ("..", setup.lab) if of == "skill in the lab" else ("", tmp_path)
    mine, deep = folder / "module_of_mine.py", folder / "deep_of_mine.py"
    mine.write_text(f"from {dots[:1]}deep_of_mine import X\nraise SystemExit('it was run')\n", encoding="utf-8")
    cell, skill = setup.lab / "robot" / "cell.yaml", setup.lab / "skills" / "park.py"
    if of == "driver":
        text = cell.read_text(encoding="utf-8").replace("driver: shimadzu", "driver: 'module_of_mine:DRIVER'")
        cell.write_text(text, encoding="utf-8")
    else:
        text = skill.read_text(encoding="utf-8")
        skill.write_text(f"{text}\nfrom {dots}module_of_mine import X\n", encoding="utf-8")
    assert tried_anew(setup, tmp_path / "s.sqlite", deep, ("X = 1", "X = 1", "X = 2")) == [True, False, True]
    assert set(lab_modules(setup.lab).values()) == {mine, deep}


def test_modules_are_found_and_none_is_run(setup: Setup, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    installed = tmp_path / "opt" / "dist-packages"
    for folder in (tmp_path, installed):
        monkeypatch.syspath_prepend(folder)
    runs = "raise RuntimeError('it was run')\n"
    texts = {
        tmp_path / "camera_of_mine" / "__init__.py": runs,
        tmp_path / "camera_of_mine" / "parts" / "lens.py": runs,
        tmp_path / "camera_of_mine" / "grab.py": f"import rig_of_mine.left.arm\n{runs}",
        tmp_path / "rig_of_mine" / "left" / "arm.py": runs,
        installed / "camera_driver" / "__init__.py": f"import camera_driver.low\n{runs}",
        installed / "camera_driver" / "low.py": runs,
    }
    for path, text in texts.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    skill = setup.lab / "skills" / "park.py"
    tried = (
        "\nwith suppress(Exception):\n    from camera_of_mine.parts import lens\n    from camera_of_mine import grab\n"
    )
    skill.write_text(skill.read_text(encoding="utf-8") + tried + "    import camera_driver.low\n", encoding="utf-8")
    assert set(lab_modules(setup.lab).values()) == {path for path in texts if not path.is_relative_to(installed)}


def test_what_a_skill_imports_from_beside_the_labs_folders_is_in_the_lab_of_each_draw(
    setup: Setup, monkeypatch: pytest.MonkeyPatch
) -> None:
    (setup.lab / "pauses").mkdir()
    for file in ("__init__.py", "long.py"):
        (setup.lab / "pauses" / file).write_text("LONG_S = 1.0\n", encoding="utf-8")
    skill = setup.lab / "skills" / "park.py"
    text = skill.read_text(encoding="utf-8")
    skill.write_text(f"{text}\nfrom ..pauses.long import LONG_S\n", encoding="utf-8")
    monkeypatch.chdir(setup.lab.parent)
    for named in (setup.lab, Path(setup.lab.name)):
        with changed(setup.recipe, named, ((FLOW, "20"),)) as (_, lab):
            assert load_lab(lab).library.skills["park"].typical_s > 0.0


def test_what_physics_of_ones_own_import_is_theirs(
    setup: Setup, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    for folder in ("of_mine", "of_mine/deep"):
        (tmp_path / folder).mkdir()
    texts = {
        "of_mine/__init__.py": "",
        "of_mine/damp.py": "import json\nimport numpy as np\nfrom scuhand_bt.sim.plant import Plant\nimport beside\n",
        "of_mine/plants.py": "from . import damp\nfrom .deep import er\nimport nowhere\n",
        "of_mine/deep/__init__.py": "",
        "of_mine/deep/er.py": "import of_mine.plants\n",
        "beside.py": "raise SystemExit('it was run')\n",
        "unrelated.py": "",
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    before = {modules_hash("of_mine.plants:Mine", setup.lab)}
    (tmp_path / "unrelated.py").write_text("other = True", encoding="utf-8")
    assert {modules_hash("of_mine.plants:Mine", setup.lab)} == before
    for edited in ("of_mine/__init__.py", "of_mine/damp.py", "beside.py", "of_mine/deep/er.py"):
        (tmp_path / edited).write_text(f"{texts[edited]}other = True", encoding="utf-8")
        before.add(modules_hash("of_mine.plants:Mine", setup.lab))
    assert len(before - {""}) == 5
    assert set(plant_files("of_mine.plants:Mine")) == {
        "of_mine", "of_mine.damp", "of_mine.plants", "of_mine.deep", "of_mine.deep.er", "beside",
    }, "what is installed beside is not"  # fmt: skip
    assert set(plant_files("scuhand_bt.sim.plant:Plant")) == {"scuhand_bt.sim.plant"}, "its version is told anyway"
    for name in [name for name in sys.modules if name.partition(".")[0] == "of_mine"]:
        del sys.modules[name]


@pytest.mark.slow
def test_what_a_process_has_read_of_physics_before_their_file_was_changed_is_not_tried_for_them(
    setup: Setup, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a Dask worker has, which goes on from study to study."""
    monkeypatch.syspath_prepend(tmp_path)
    own, name = tmp_path / "physics_of_today.py", "physics_of_today:Mine"
    text = "from scuhand_bt.sim.plant import Plant\n\n\nclass Mine(Plant):\n    pass\n"
    own.write_text(text, encoding="utf-8")
    before = replace(setup, plant=name, modules=modules_hash(name, setup.lab))
    came = trial(before, 0)
    own.write_text(f"{text}    # another one\n", encoding="utf-8")
    after = replace(before, modules=modules_hash(name, setup.lab))
    with pytest.raises(SourceError, match="the --plant are made of has changed since"):
        trial(after, 0)
    assert trial(before, 0) == came, "what began with them goes on"


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


TELLING = """from scuhand_bt.sim.powder import OurPowderFlow
from scuhand_bt.sim.response import OurBalanceResponse

FLOWS = []


class Telling:
    def flow(self, powder):
        FLOWS.append(powder.simulation.flow_coefficient)
        return OurPowderFlow(powder)
"""


def test_what_is_varied_is_what_is_run(setup: Setup, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The physics tell what they were made with: how long a dose takes is as much chance's."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "telling_physics.py").write_text(TELLING, encoding="utf-8")
    name, changes = "telling_physics:Telling", ((FLOW, "20"), ("recipe.samples.2.mass", "90 mg"))
    tried = trial(replace(setup, plant=name, modules=modules_hash(name, setup.lab), changes=changes), 0)
    assert [one.target_mg for one in tried.samples] == [50.0, 50.0, 90.0]
    assert set(sys.modules["telling_physics"].FLOWS) == {20.0}


@pytest.mark.parametrize(
    ("place", "said"),
    [
        ("powders.glass_beads.simulation.flow", "'flow' is not there; known: flow_coefficient"),
        ("powders.beads.repose", "'beads' is not there; known: glass_beads"),
        ("recipe.samples.3.mass", "'3' is not there; known: 0, 1, 2"),
        ("robot.balance", "a place begins with its file; known: recipe, powders, containers, cell"),
    ],
)
def test_a_place_that_there_is_not_is_told_with_those_that_there_are(setup: Setup, place: str, said: str) -> None:
    with pytest.raises(SourceError) as wrong:
        trial(replace(setup, changes=((place, "1"),)), 0)
    assert str(wrong.value).startswith(f"{place}: {said}")


def test_a_change_that_no_lab_may_have_is_refused_as_in_any_lab(setup: Setup) -> None:
    with pytest.raises(SourceError, match="flow_coefficient") as wrong:
        trial(replace(setup, changes=((FLOW, "-3"),)), 0)
    said = str(wrong.value)
    assert said.startswith(f"{setup.lab / 'robot' / 'powders.yaml'}:"), "the user's file, not the copy that is gone"
    assert said.endswith(f"(with {FLOW}: -3)")


@pytest.mark.slow
def test_tables_beside_a_recipe_below_it_and_elsewhere_in_the_lab_are_tried_too(setup: Setup) -> None:
    for folder in ("recipes/deep", "tables"):
        (setup.lab / folder).mkdir()
    table = "id;source;container;mass [mg]\n{0}1;beads;xrd_holder;30\n{0}2;beads;xrd_holder;40\n"
    names = {"beside.csv": "p", "deep/below.csv": "q", "../tables/elsewhere.csv": "r"}
    for name, letter in names.items():
        (setup.recipe.parent / name).write_text(table.format(letter), encoding="utf-8")
    entries = "".join(f"  - {{table: {name}}}\n" for name in names)
    setup.recipe.write_text(f"{RECIPE.split('  - ')[0]}{entries}", encoding="utf-8")
    one = trial(replace(setup, changes=((FLOW, "90"),)), 0)
    assert [sample.id for sample in one.samples] == ["p1", "p2", "q1", "q2", "r1", "r2"]


@pytest.mark.parametrize("to_it", ["recipes", "trees/../recipes", "../mine/recipes"])
def test_a_table_elsewhere_in_the_lab_is_tried_whatever_of_the_recipe_is_varied(setup: Setup, to_it: str) -> None:
    (setup.lab / "tables").mkdir()
    (setup.lab / "tables/one.csv").write_text(
        "id;source;container;mass [mg]\np;beads;xrd_holder;30\n", encoding="utf-8"
    )
    setup.recipe.write_text(f"{RECIPE.split('  - ')[0]}  - {{table: ../tables/one.csv}}\n", encoding="utf-8")
    lab = setup.lab.rename(setup.lab.with_name("mine"))
    setup = replace(setup, lab=lab, recipe=lab / to_it / setup.recipe.name)
    changes = (("recipe.sources.beads.amount", "4 g"),)
    varied = replace(setup, files=files_hash(setup.recipe, setup.lab), changes=changes)
    assert [sample.id for sample in trial(varied, 0).samples] == ["p"]


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
        (1, "the process was killed, as for want of memory: try again"),
        (2, "one of 2 processes was killed, as for want of memory: take fewer, and try again"),
    ],
)
def test_a_process_that_is_killed_ends_the_study_in_words(many: int, said: str) -> None:
    with pytest.raises(SourceError, match=said), executor_of(many, None) as executor:
        executor.submit(os.kill, executor.submit(os.getpid).result(), signal.SIGKILL).result()


@pytest.fixture
def cluster(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """In the place of Dask, which is an extra."""
    client = MagicMock()
    client.__exit__.return_value = client.get_executor().__exit__.return_value = False
    killed = type("KilledWorker", (Exception,), {})
    fake_dask = SimpleNamespace(Client=lambda *asked, **how: client, KilledWorker=killed, client=client)
    monkeypatch.setitem(sys.modules, "distributed", fake_dask)
    return fake_dask


def test_a_cluster_that_goes_away_ends_the_study_in_words(
    cluster: SimpleNamespace, caplog: pytest.LogCaptureFixture
) -> None:
    for error in (CancelledError, cluster.KilledWorker):
        with pytest.raises(SourceError, match="--dask tcp://x: the cluster was lost"), executor_of(None, "tcp://x"):
            raise error
    logging.getLogger("distributed.client").error("by a traceback")
    assert not caplog.records


def test_a_cluster_without_a_worker_is_not_waited_for(cluster: SimpleNamespace) -> None:
    cluster.client.wait_for_workers.side_effect = TimeoutError
    with pytest.raises(SourceError, match="--dask tcp://x: the scheduler has no worker"), executor_of(None, "tcp://x"):
        pass


def test_that_all_workers_of_a_cluster_have_gone_is_told_each_time_once(
    cluster: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A study waited without a word for ever."""
    monkeypatch.setattr("scuhand_bt.study.cluster.LOOKS_S", 0.0)
    some, none = {"tcp://a": 1}, dict[str, int]()
    seen = [*[none] * 9, some, *[none] * 30, some, *[none] * 10]
    told, when, is_lost = list[str](), list[int](), threading.Event()

    def nthreads() -> dict[str, int]:
        if not seen:
            is_lost.set()
            raise OSError("the scheduler is gone")
        return seen.pop(0)

    def tell(what: str) -> None:
        told.append(what)
        when.append(len(seen))

    cluster.client.nthreads = nthreads
    with executor_of(None, "tcp://x", tell):
        assert is_lost.wait(10.0)
    assert when == [31, 0]
    assert told[0].startswith("--dask tcp://x: the cluster has no worker any more: it goes on when one comes")
    assert told[0].endswith("Ctrl-C ends it, and the same command goes on with what was kept")


NONE = ModuleNotFoundError("No module named 'scuhand_bt'")


def of_none(call: bytes) -> Any:
    raise NONE


def of_another(call: bytes) -> Any:
    """As a worker of another source makes of what it is sent."""
    with pytest.MonkeyPatch.context() as there:
        there.setattr("scuhand_bt.study.cluster.source_digest", lambda: "another")
        return pickle.loads(call)


def run_on(workers: dict[str, Callable[[bytes], Any]]) -> Callable[..., dict[str, Any]]:
    """As `Client.run` with `on_error="return"`."""

    def run(_: Any, call: bytes, **__: Any) -> dict[str, Any]:
        said = {}
        for address, makes_of in workers.items():
            try:
                said[address] = makes_of(call)
            except ImportError as error:
                said[address] = error
        return said

    return run


@pytest.mark.parametrize(
    ("makes_of", "why"), [(of_none, NONE), (of_another, f"it has {scuhand_bt.__version__} of another source")]
)
def test_a_worker_of_another_version_or_without_the_program_is_named(
    cluster: SimpleNamespace, makes_of: Callable[[bytes], Any], why: object
) -> None:
    cluster.client.run.side_effect = run_on({"tcp://a": pickle.loads, "tcp://b": makes_of})
    with pytest.raises(SourceError) as wrong, executor_of(None, "tcp://x"):
        pass
    (problem,) = wrong.value.problems
    assert problem.message.startswith(
        f"the worker tcp://b has not this scuhand-bt {scuhand_bt.__version__} ({why}): install it there"
    )


@pytest.mark.parametrize("has_left", [False, True])
@pytest.mark.parametrize("makes_of", [of_none, of_another])
def test_a_trial_of_a_worker_that_came_later_and_has_another_program_does_not_count(
    cluster: SimpleNamespace, setup: Setup, makes_of: Callable[[bytes], Any], *, has_left: bool
) -> None:
    workers = {"tcp://a": pickle.loads}
    cluster.client.run.side_effect = run_on(workers)
    threads = ThreadPoolExecutor(1)
    cluster.client.get_executor().__enter__().submit = lambda _, call: threads.submit(makes_of, call)

    def study() -> None:
        with threads, executor_of(None, "tcp://x") as executor:
            workers.update({} if has_left else {"tcp://late": makes_of})
            list(all_trials([(setup, 0)], executor))

    with pytest.raises(SourceError) as wrong:
        study()
    (problem,) = wrong.value.problems
    said = "a worker has not all that a trial takes" if has_left else "the worker tcp://late has not this"
    assert problem.message.startswith(said)
    assert problem.message.endswith("the same command goes on with what was kept")


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


@pytest.mark.parametrize("options", [(), ("--vary", "flow.yaml", "--optimise", 2)])
def test_a_ctrl_c_says_that_what_was_tried_is_kept_and_how_it_goes_on(
    setup: Setup, command: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: tuple[object, ...]
) -> None:
    flow, kept = tmp_path / "flow.yaml", tmp_path / "s.sqlite"
    flow.write_text(f"vary: {{{FLOW}: [50, 75]}}", encoding="utf-8")
    monkeypatch.setattr("scuhand_bt.study.executor_of", MagicMock(side_effect=KeyboardInterrupt))
    ended = command("study", setup.recipe, "--store", kept, *(flow if one == "flow.yaml" else one for one in options))
    said = f"Interrupted. The dry runs that have ended are kept in {kept}; the same command goes on with the others.\n"
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", said)


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


RANGES = {FLOW: {"from": "50", "to": "100"}, "recipe.samples.0.mass": {"from": "20 mg", "to": "60 mg"}}


def test_designs_stay_in_their_ranges_and_are_the_same_each_time() -> None:
    grid = Vary.model_validate({"design": "grid", "draws": 3, "vary": {**RANGES, "recipe.order": ["x", "y"]}})
    assert len(grid.changes()) == 3 * 3 * 2
    assert grid.changes()[0] == ((FLOW, "50"), ("recipe.samples.0.mass", "20 mg"), ("recipe.order", "x"))
    for design, many in (("latin_hypercube", 16), ("sobol", 16 * 4)):
        vary = Vary.model_validate({"design": design, "draws": 16, "vary": RANGES})
        draws = vary.changes()
        assert len(draws) == many
        assert draws == vary.changes() != vary.changes(1)
        flows = [float(dict(draw)[FLOW]) for draw in draws]
        assert 50.0 <= min(flows) < 58.0 < 92.0 < max(flows) <= 100.0
        assert all(dict(draw)["recipe.samples.0.mass"].endswith(" mg") for draw in draws)


def test_sobol_indices_tell_what_a_figure_depends_on() -> None:
    vary = Vary.model_validate({"design": "sobol", "draws": 512, "vary": RANGES})
    flows = [float(dict(draw)[FLOW]) / 50.0 for draw in vary.changes()]
    masses = [float(dict(draw)["recipe.samples.0.mass"].split()[0]) / 40.0 for draw in vary.changes()]
    found = vary.indices([2.0 * flow + mass for flow, mass in zip(flows, masses, strict=True)])
    assert found[FLOW] == pytest.approx((0.8, 0.8), abs=0.05)
    assert found["recipe.samples.0.mass"] == pytest.approx((0.2, 0.2), abs=0.05)
    assert vary.indices([1.0] * len(flows))[FLOW] == (0.0, 0.0)
    alone = Vary.model_validate({"design": "sobol", "draws": 2, "vary": {FLOW: RANGES[FLOW]}})
    assert alone.indices([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]) == {FLOW: (1.0, 1.0)}


@pytest.mark.parametrize(
    ("first", "total", "is_rough"),
    [
        (0.4, 0.5, False),
        (-0.05, 0.0, False),
        (1.05, 1.05, False),
        (3.8, 7.1, True),
        (-0.2, 0.3, True),
        (0.6, 0.3, True),
    ],
)
def test_indices_that_there_cannot_be_are_told_with_that_they_are_rough(
    first: float, total: float, is_rough: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of one draw a place explained 3.78 of the variance, and 7.14 with others."""
    tell_dominant({"duration_s": {FLOW: {"first": first, "total": total}}}, "sobol")
    assert ("tells how rough they are. More `draws`" in capsys.readouterr().out) is is_rough


def test_ranks_tell_what_goes_with_a_figure() -> None:
    draws = [Setup(Path("r"), Path("l"), changes=((FLOW, str(flow)), ("recipe.order", "x"))) for flow in (1, 2, 3)]
    assert goes_with(draws, [9.0, 5.0, 1.0]) == {FLOW: pytest.approx(-1.0)}
    assert goes_with(draws, [1.0, 1.0, 1.0]) == {FLOW: 0.0}
    masses = [Setup(Path("r"), Path("l"), changes=(("m", mass),)) for mass in ("20 mg", "0.1 g", "250 mg")]
    assert goes_with(masses, [1.0, 2.0, 3.0]) == {"m": pytest.approx(1.0)}, "by what they are, not by their digits"
    assert goes_with([*masses, replace(masses[0], changes=(("m", "3 s"),))], [1.0, 2.0, 3.0, 4.0]) == {}


@pytest.mark.slow
def test_of_a_place_with_names_the_mean_with_each_is_told(setup: Setup, command: Call, tmp_path: Path) -> None:
    draws = [
        Setup(Path("r"), Path("l"), changes=((FLOW, str(flow)), ("recipe.controller", name)))
        for flow, name in ((1, "paper"), (2, "adaptive"), (3, "paper"))
    ]
    assert means_of(draws, [9.0, 5.0, 1.0]) == {"recipe.controller": {"paper": 5.0, "adaptive": 5.0}}
    setup.recipe.write_text(RECIPE.replace("workflow", "controller: paper\nworkflow", 1), encoding="utf-8")
    vary = tmp_path / "vary.yaml"
    vary.write_text("{draws: 8, vary: {recipe.controller: [adaptive, paper]}}", encoding="utf-8")
    shown = command("study", setup.recipe, "--trials", 1, "--vary", vary, "--workers", 1).stdout
    assert [shown.count(text) for text in ("recipe.controller: adaptive", "recipe.controller: paper")] == [2, 2]
    assert "rank correlation" not in shown, "what heads means are not correlations"
    assert [line.split()[-1] for line in shown.splitlines() if " with " in line] == ["mean", "mean"]
    assert "By 2 dry runs" in shown, "draws that are alike are tried, and counted, once"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("vary: {a.b: {from: 20 mg, to: 60 g}}", "a range goes from a smaller to a larger number of the same unit"),
        ("vary: {a.b: {from: 60 mg, to: 20 mg}}", "a range goes from a smaller to a larger number"),
        ("{design: sobol, draws: 12, vary: {a.b: [x]}}", "a sobol design takes a power of two"),
        ("{design: random, vary: {a.b: [x]}}", "design"),
        ("vary: {a.b: {from: 1 mg, to: 1e999 mg}}", "a range goes from a smaller to a larger number"),
        ("vary: {a.b: {from: -1e309, to: 2}}", "a range goes from a smaller to a larger number"),
        ("vary: {}", "at least one place, such as"),
        ("vary: {a.b: 20 mg}", "'a.b': '20 mg' is not accepted; a range, such as {from: 20 mg, to: 60 mg}, or a list"),
        ("vary: {a.b: {from: 1, to: 2, steps: 2}}", "unknown key 'steps'; known: from, to"),
        ("vary: {recipe.order: []}", "a list of at least 1"),
        ("{design: grid, draws: 300, vary: {a.b: {from: 1, to: 2}, c.d: {from: 1, to: 2}}}", "a grid of 90000 points"),
        (f"{{vary: {{{FLOW}s: [x]}}}}", f"'{FLOW}s': 'flow_coefficients' is not there; known: flow_coefficient, "),
        ("vary: {recipe.samples.7.mass: [1 mg]}", "'7' is not there; known: 0, 1, 2"),
    ],
)
def test_a_file_that_varies_nothing_sensible_is_told_where(setup: Setup, tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "vary.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SourceError) as wrong:
        read_vary(path, setup.recipe, setup.lab)
    assert str(wrong.value).startswith(f"{path}:1:")
    assert said in str(wrong.value)


def test_a_range_that_is_none_is_told_by_the_name_of_its_place(setup: Setup, tmp_path: Path) -> None:
    path = tmp_path / "vary.yaml"
    path.write_text(
        "vary: {recipe.samples.0.mass: {from: 60 mg, to: 20 mg}, cell.balance.period: 75}", encoding="utf-8"
    )
    with pytest.raises(SourceError) as wrong:
        read_vary(path, setup.recipe, setup.lab)
    told = [problem.message for problem in wrong.value.problems]
    assert [message.split(":")[0] for message in told] == ["'recipe.samples.0.mass'", "'cell.balance.period'"], told


def test_places_that_there_are_not_are_told_together_with_ranges_that_are_none(setup: Setup, tmp_path: Path) -> None:
    path = tmp_path / "vary.yaml"
    path.write_text(
        "{design: sobl, vary: {nowhere.x: [1], recipe.samples.0.mass: {from: 60 mg, to: 20 mg}, recipe.y: [1]}}",
        encoding="utf-8",
    )
    with pytest.raises(SourceError) as wrong:
        read_vary(path, setup.recipe, setup.lab)
    told = sorted(problem.message.split(":")[0] for problem in wrong.value.problems)
    assert told == ["'design'", "'nowhere.x'", "'recipe.samples.0.mass'", "'recipe.y'"]


def test_draws_that_are_no_power_of_two_are_told_together_with_a_range_that_is_none(
    setup: Setup, tmp_path: Path
) -> None:
    """They were told only when all else had been mended."""
    path = tmp_path / "vary.yaml"
    path.write_text(
        "design: sobol\ndraws: 3\nvary: {recipe.samples.0.mass: {from: 60 mg, to: 20 mg}}\n", encoding="utf-8"
    )
    with pytest.raises(SourceError) as wrong:
        read_vary(path, setup.recipe, setup.lab)
    draws, places = wrong.value.problems
    assert str(draws) == f"{path}:2:8: 'draws': '3' is not accepted; a sobol design takes a power of two"
    assert places.message.startswith("'recipe.samples.0.mass'")


def test_a_value_that_may_not_be_is_told_before_the_first_dry_run(
    setup: Setup, command: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    vary = tmp_path / "vary.yaml"
    monkeypatch.setattr("scuhand_bt.study.executor_of", MagicMock(side_effect=AssertionError("it was begun")))
    for ranges, said in (
        (f"{FLOW}: {{from: -1, to: 60}}", "more than 0 (with"),
        (f"{FLOW}: [50, 60, -3]", f"more than 0 (with {FLOW}: -3)"),
        ("recipe.samples.2.mass: {from: 0.04 g, to: 90 g}", "two.yaml:8:57: "),
        ("recipe.samples.0.container: [xrd_holder, nowhere]", "unknown container 'nowhere'"),
    ):
        vary.write_text(f"vary: {{{ranges}}}", encoding="utf-8")
        for search in ([], ["--optimise", 2]):
            refused = command("study", setup.recipe, "--vary", vary, "--store", tmp_path / "s.sqlite", *search)
            assert (refused.returncode, said in refused.stderr) == (2, True), refused.stderr


@pytest.mark.parametrize(
    ("words", "module", "said"),
    [
        (("study", "--plot", "odds.png"), "matplotlib", "'odds.png' needs matplotlib: pip install 'scuhand-bt[plot]'"),
        (("study", "-o", "t.parquet"), "pyarrow", "'t.parquet' needs pyarrow: pip install 'scuhand-bt[study]'"),
        (("plan", "--html", "p.html"), "jinja2", "'p.html' needs jinja2: pip install 'scuhand-bt[report]'"),
        (("study", "--plot", "nosuch/odds.png"), "", "'nosuch/odds.png' cannot be written: No such file or directory"),
        (("study", "-o", "nosuch/t.csv"), "", "'nosuch/t.csv' cannot be written: No such file or directory"),
        (("plan", "--html", "nosuch/p.html"), "", "'nosuch/p.html' cannot be written: No such file or directory"),
    ],
)
def test_what_could_not_be_written_at_the_end_is_told_before_the_first_dry_run(
    setup: Setup,
    command: Call,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: tuple[str, ...],
    module: str,
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("scuhand_bt.study.executor_of", MagicMock(side_effect=AssertionError("it was begun")))
    if module:
        monkeypatch.setitem(sys.modules, module, None)
    refused = command(words[0], setup.recipe, *words[1:])
    assert (refused.returncode, said in " ".join(refused.stderr.split())) == (2, True), refused.stderr


def test_what_is_written_at_the_end_is_as_it_was_until_then(
    setup: Setup, command: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before, new = tmp_path / "before.csv", tmp_path / "new.csv"
    before.write_text("of another study", encoding="utf-8")
    monkeypatch.setattr("scuhand_bt.study.executor_of", MagicMock(side_effect=KeyboardInterrupt))
    for file in (before, new):
        assert command("study", setup.recipe, "-o", file).returncode == 130
    assert before.read_text(encoding="utf-8") == "of another study"
    assert not new.exists()


def fake(seed: int, duration_s: float, good: str) -> Trial:
    """A trial of the three samples of which these are good."""
    samples = tuple(
        SampleTrial(name, name in good, name in good, "in tolerance" if name in good else "over",
                    None if name in good else "dose.overshoot", 50.0, 50.0, 50.0, 10.0)
        for name in "abc"
    )  # fmt: skip
    scoops, left_mg = {"beads": 1 + seed % 2}, {"beads": {"kept": 100.0}}
    return Trial(seed, 0, duration_s, {"a": 0.0, "b": 100.0}, samples, scoops, {"beads": 200.0}, left_mg)


@pytest.mark.parametrize(
    ("had", "said"),
    [
        ((2, 0), "2 of 5 dry runs had ended, the quickest first: others may take longer"),
        ((), "no dry run had ended; with fewer --trials one ends sooner"),
    ],
)
def test_a_ctrl_c_tells_what_a_plan_has_come_to_so_far(
    setup: Setup, command: Call, monkeypatch: pytest.MonkeyPatch, had: tuple[int, ...], said: str
) -> None:
    def broken_off(tasks: Sequence[Task], *_: object) -> Iterator[tuple[Task, Trial]]:
        for seed in had:
            yield tasks[seed], fake(seed, 600.0, "ab")
        raise KeyboardInterrupt

    monkeypatch.setattr("scuhand_bt.study.all_trials", broken_off)
    asked = ("plan", setup.recipe, "--trials", 5, "--night", "20:00-08:00")
    ended = command(*asked)
    assert ended.returncode == 130
    assert f"Interrupted: {said}; what a night holds is not told by these.\n" in ended.stderr
    assert "finish the batch" in ended.stdout, "the jobs stand there before any dry run has ended"
    assert ("By 2 dry runs" in ended.stdout, "Roughly" in ended.stdout) == (bool(had), not had)
    assert "After the start no person is needed." in ended.stdout
    assert "In a night" not in ended.stdout
    assert "what a night holds" not in command(*asked[:4]).stderr, "who has not asked for one"
    as_json = command(*asked, "--json")
    assert (as_json.returncode, as_json.stdout) == (130, ""), "what reads it would take it for the whole"


def test_a_plan_and_a_study_tell_that_runs_stop_and_need_a_person_then(
    setup: Setup, command: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of samples that overshot in a row only those were told that were not run then, and that nobody is needed."""

    def some_stop(tasks: Sequence[Task], *_: object) -> Iterator[tuple[Task, Trial]]:
        for seed, task in enumerate(tasks):
            yield task, replace(fake(seed, 600.0, "a"), stopped=f"b: overshot, {seed}" if seed else "")

    monkeypatch.setattr("scuhand_bt.study.all_trials", some_stop)
    for asked in ("plan", "study"):
        told = command(asked, setup.recipe, "--trials", 4)
        assert "Of 4 dry runs 3 stopped before the end, which shortens the time" in told.stdout
        assert "to resume the run. The first: b: overshot, 1\n" in told.stdout
        assert "no person is needed" not in told.stdout
    stopped = json.loads(command("plan", setup.recipe, "--trials", 4, "--json").stdout)["odds"]["stopped"]
    assert stopped == ["b: overshot, 1", "b: overshot, 2", "b: overshot, 3"]


def test_verdicts_without_a_failure_are_told_apart_from_what_failed(setup: Setup) -> None:
    lab = load_lab(setup.lab)
    plan = make_plan(load_recipe(setup.recipe, lab), lab)
    failed = fake(0, 600.0, "a")
    b, c = (
        replace(one, code=None, verdict=word)
        for one, word in zip(failed.samples[1:], ("over", "in tolerance"), strict=True)
    )
    odds = odds_of(plan, [failed, replace(failed, seed=1, samples=(failed.samples[0], b, c))])
    assert (odds.codes, odds.verdicts) == ({"dose.overshoot": 1.0}, {"over": 0.5, "in tolerance": 0.5})
    assert odds.not_good == {
        "dose.overshoot": 1.0,
        "verdict 'over', no failure": 0.5,
        "verdict 'in tolerance', not confirmed": 0.5,
    }


def test_odds_hold_alike_samples_together_and_warn_of_those_that_fail(setup: Setup) -> None:
    lab = load_lab(setup.lab)
    plan = make_plan(load_recipe(setup.recipe, lab), lab)
    times_s = np.random.default_rng(1).normal(600.0, 30.0, 40)
    odds = odds_of(plan, [fake(seed, time_s, "a" if seed % 2 else "ab") for seed, time_s in enumerate(times_s)])
    assert (odds.trials, odds.samples["a"].tried, odds.samples["c"].tried) == (40, 80, 40)
    assert odds.samples["a"] == odds.samples["b"]
    assert odds.samples["a"].probability == pytest.approx(0.73, abs=0.02)
    assert odds.samples["c"].probability < 0.06
    assert odds.samples["c"].low < odds.samples["c"].probability < odds.samples["c"].high
    assert odds.unlikely == ["a", "b", "c"]
    assert odds.codes == {"dose.overshoot": 1.5}
    assert odds.duration_s.low < 550.0 < 600.0 == pytest.approx(odds.duration_s.middle, abs=15.0)
    assert odds.duration_s.high > 650.0
    assert odds.scoops["beads"].low == 1.0 < odds.scoops["beads"].high == 2.0


def test_two_trials_tell_what_they_had_and_no_interval(setup: Setup, capsys: pytest.CaptureFixture[str]) -> None:
    """By Student's t of one degree of freedom a run of 5 to 13 minutes took from seconds to half a day."""
    lab = load_lab(setup.lab)
    plan = make_plan(load_recipe(setup.recipe, lab), lab)
    odds = odds_of(plan, [fake(0, 300.0, "abc"), fake(1, 780.0, "abc")])
    assert (odds.duration_s.low, odds.duration_s.high) == (300.0, 780.0)
    assert (odds.scoops["beads"].low, odds.scoops["beads"].high) == (1.0, 2.0)
    tell_odds(odds)
    said = " ".join(capsys.readouterr().out.split())
    assert (
        "By 2 dry runs, which tell no interval (what these had): it takes 9 min 00 s (5 min 00 s to 13 min 00 s)."
        in said
    )
    tell_odds(odds_of(plan, [fake(seed, 300.0, "abc") for seed in range(3)]))
    said = " ".join(capsys.readouterr().out.split())
    assert "By 3 dry runs (intervals of 90 %): it takes" in said
    assert "What is left is what each run reckons, by what its scoops should bring: no interval tells" in said


def shown_after_s(balance: OurBalanceResponse) -> float:
    """So long a balance takes to show nine tenths of a gram."""
    rng, now_s = np.random.default_rng(0), 0.0
    while balance.step(0.02, 1000.0, 0.0, 0.0, rng) < 900.0:
        now_s += 0.02
    return now_s


def test_four_dry_runs_in_a_row_say_how_long_nine_of_ten_take_and_no_wider(setup: Setup) -> None:
    """Times that go with the balance, as most of a run's do: by Student's t they would hold 98 of 100."""
    lab = load_lab(setup.lab)
    plan = make_plan(load_recipe(setup.recipe, lab), lab)
    times_s = []
    for SomeCell.seed in range(60):
        times_s.append(300.0 * shown_after_s(SomeCell().balance(lab.cell.balance)))
    inside, wide = list[float](), list[float]()
    for first in range(56):
        few, others = times_s[first : first + 4], [*times_s[:first], *times_s[first + 4 :]]
        said = odds_of(plan, [fake(seed, time_s, "abc") for seed, time_s in enumerate(few)]).duration_s
        inside.append(float(np.mean([said.low <= time_s <= said.high for time_s in others])))
        wide.append(said.high / said.low)
    least_s, most_s = np.quantile(times_s, (0.05, 0.95)).tolist()
    assert np.mean(inside) == pytest.approx(0.9, abs=0.03)
    assert np.median(wide) < 1.6 * most_s / least_s


def test_one_more_run_uses_what_a_few_dry_runs_say_nine_times_of_ten(setup: Setup) -> None:
    """Between the quantiles of four are 55 of 100 such runs."""
    lab = load_lab(setup.lab)
    plan = make_plan(load_recipe(setup.recipe, lab), lab)
    one, inside = fake(0, 600.0, "abc"), 0
    for *tried_mg, next_mg in np.random.default_rng(2).normal(2000.0, 100.0, (200, 5)).tolist():
        said = odds_of(plan, [replace(one, used_mg={"beads": mg}) for mg in tried_mg]).used_mg["beads"]
        inside += said.low <= next_mg <= said.high
    assert inside == pytest.approx(180, abs=12)


def test_no_more_is_said_to_be_left_than_was_in_any_dry_run(setup: Setup) -> None:
    """Of one load that went back in three runs, and two in another, up to 31 g did by Student's t, of 20 g."""
    lab = load_lab(setup.lab)
    plan = make_plan(load_recipe(setup.recipe, lab), lab)
    left_mg = [3900.0, 4000.0, 4100.0, 11000.0]
    found = [replace(fake(0, 600.0, "abc"), leftovers_mg={"beads": {"returned": mg}}) for mg in left_mg]
    said = odds_of(plan, found).leftovers_mg["beads"]["returned"]
    assert 3900.0 <= said.low < said.middle == 4050.0 < said.high <= 11000.0


def test_a_cell_may_use_some_milligrams_more_than_dry_runs_that_all_use_the_same(setup: Setup) -> None:
    lab = load_lab(setup.lab)
    one = fake(0, 600.0, "abc")
    had = [replace(one, used_mg={"beads": mg}) for mg in (2000.0, 2000.4, 1999.6)]
    said = odds_of(make_plan(load_recipe(setup.recipe, lab), lab), had).used_mg["beads"]
    assert (said.low, said.high) == pytest.approx((1983.5, 2016.5), abs=0.5)


def test_no_mass_is_said_to_be_less_than_none(setup: Setup) -> None:
    lab = load_lab(setup.lab)
    plan = make_plan(load_recipe(setup.recipe, lab), lab)
    one = fake(0, 600.0, "abc")
    said = odds_of(plan, [replace(one, used_mg={"beads": mg}) for mg in (0.0, 0.0, 0.0, 90.0)]).used_mg
    assert said["beads"].low == said["beads"].middle == 0.0
    assert said["beads"].high > 90.0


def test_samples_that_come_out_alike_are_warned_of_once(setup: Setup, capsys: pytest.CaptureFixture[str]) -> None:
    lab = load_lab(setup.lab)
    odds = odds_of(make_plan(load_recipe(setup.recipe, lab), lab), [fake(seed, 300.0, "abc") for seed in range(3)])
    alike, other, well = Chance(0.5, 0.4, 0.6, 4, 2), Chance(0.896, 0.8, 0.95, 44, 43), Chance(0.896, 0.8, 0.95, 4, 4)
    tell_odds(replace(odds, samples={**{f"x-{n}": alike for n in range(1, 301)}, "y": other, "z": well}))
    warned = [line for line in capsys.readouterr().out.splitlines() if line.startswith("Warning")]
    assert warned == [
        "Warning: x-1, x-2, x-3, …, x-300 (300 samples) are each in tolerance with a probability of 50% (40% to 60%).",
        "Warning: y is in tolerance with a probability of 89.6% (80% to 95%).",
    ]
    assert well.told == "90% (80% to 95%)", "of which nobody is warned"


def test_what_is_varied_of_the_samples_is_judged_by_the_trials_that_asked_for_it(setup: Setup) -> None:
    """As of `repeat`: a trial has fewer samples than are written, or more; `a` and `b`, alike as written, are not."""
    lab = load_lab(setup.lab)
    plan = make_plan(load_recipe(setup.recipe, lab), lab)
    few, many = (fake(0, 600.0, "abcd"), fake(1, 900.0, "acd"))
    few = replace(few, samples=few.samples[:2], began_s={"a": 0.0, "b": 100.0, "finish the batch": 500.0})
    many = replace(many, samples=(*many.samples, replace(many.samples[2], id="d")), began_s={
        "a": 0.0, "b": 100.0, "c": 200.0, "d": 300.0, "finish the batch": 800.0
    })  # fmt: skip
    odds = odds_of(plan, [few, many], as_written=False)
    assert {name: (one.good, one.tried) for name, one in odds.samples.items()} == {
        "a": (2, 2), "b": (1, 2), "c": (1, 1), "d": (1, 1)
    }  # fmt: skip
    assert odds.asked == 3.0
    assert odds.good == pytest.approx(sum(odds.samples[name].probability for name in "ababcd") / 2)
    assert odds.unlikely == ["b"]
    assert (odds.ended["b"], odds.alone["b"], odds.ended["c"], odds.ended["finish the batch"]) == (2, 2, 1, 2)


def test_a_mass_that_was_tried_a_few_times_is_judged_by_its_neighbours_as_far_as_they_agree(setup: Setup) -> None:
    lab = load_lab(setup.lab)
    samples = "".join(
        f"  - {{id: s{mg}, source: beads, container: xrd_holder, mass: {mg} mg}}\n" for mg in range(30, 40)
    )
    setup.recipe.write_text(f"{RECIPE.split('  - ')[0]}{samples}", encoding="utf-8")
    plan = make_plan(load_recipe(setup.recipe, lab), lab)
    names = [sample.id for sample in plan.recipe.samples]

    def chances(good_in: Mapping[str, int]) -> list[float]:
        one = fake(0, 600.0, "a").samples[0]
        found = []
        for seed in range(8):
            samples = tuple(replace(one, id=name, good=seed < good_in[name]) for name in names)
            found.append(replace(fake(seed, 600.0, "a"), samples=samples))
        return [odds_of(plan, found).samples[name].probability for name in names]

    every = chances(dict.fromkeys(names, 8))
    assert 0.985 < min(every) == max(every) < 0.998, "what no trial has may happen, however many were good"
    alike = chances(dict(zip(names, (4, 5, 3, 4, 5, 4, 3, 4, 5, 3), strict=True)))
    assert max(alike) - min(alike) < 0.12, "eight trials each: chance, not ten kinds"
    apart = chances(dict(zip(names, (8, 8, 8, 8, 8, 0, 0, 0, 0, 0), strict=True)))
    assert apart[0] > 0.9
    assert apart[-1] < 0.1


@pytest.mark.slow
def test_the_command_tries_the_physics_that_it_is_told(command: Call, setup: Setup) -> None:
    """A yield of nothing, where the simulation's own fills all."""
    shown = command("study", setup.recipe, "--trials", 1, "--workers", 1, "--plant", "test_own_plant:Nothing").stdout
    assert "scoop.nothing" in shown


def test_draws_of_a_recipe_share_its_lab_and_its_motions_and_have_the_figures_of_one_alone(
    setup: Setup, monkeypatch: pytest.MonkeyPatch
) -> None:
    setup.recipe.write_text(RECIPE.partition("  - {id: b")[0], encoding="utf-8")
    setup = replace(setup, files=files_hash(setup.recipe, setup.lab))
    prepared = []

    def prepare(plan: Plan, lab: Lab) -> MotionPlanner:
        prepared.append(plan)
        return prepared_motion(plan, lab)

    monkeypatch.setattr("scuhand_bt.study.dry_run.prepared_motion", prepare)
    of_recipe = [replace(setup, changes=(("recipe.samples.0.mass", mass),)) for mass in ("20 mg", "30 mg", "40 mg")]
    found = [trial(one, 1) for one in of_recipe]
    assert len(prepared) == 1
    assert [one.samples[0].target_mg for one in found] == [20.0, 30.0, 40.0]
    trial(replace(setup, changes=((FLOW, "75"),)), 1)
    trial(replace(setup, changes=(("recipe.sources.beads.station", "mortar_bay_2"),)), 1)
    assert len(prepared) == 3, "another lab, and another place of the mortar"
    assert trial(replace(of_recipe[0], files=""), 1) == found[0]
    assert len(prepared) == 4, "which files they are nobody has told"


def test_three_trials_have_lumps_of_three_kinds() -> None:
    powder = shipped_powders()["titanium_dioxide"]
    kinds = set()
    for SomeCell.seed in range(3):
        narrow, wide = (lumps_mg(SomeCell().flow(powder), opening_mm) for opening_mm in (0.8, 1.6))
        kinds.add((bool(wide.std() < 0.2 * wide.mean()), bool(wide.mean() > 3.0 * narrow.mean())))
    assert kinds == {(False, False), (True, False), (False, True)}, "equal, and growing with the gap"


def test_scoops_bring_more_or_less_in_each_trial() -> None:
    powder, rng, yields = shipped_powders()["glass_beads"], np.random.default_rng(1), list[float]()
    for SomeCell.seed in range(40):
        scoop = SomeCell().scoop(powder)
        yields.append(float(np.mean([scoop.collect(3000.0, 9000.0, rng) for _ in range(400)])) / 3000.0)
    assert yields[0] == pytest.approx(1.0, abs=0.02), "the first cell is in the middle"
    low, high = np.quantile(yields, (0.05, 0.95))
    assert (low, high) == (pytest.approx(0.78, abs=0.04), pytest.approx(1.28, abs=0.06))


def lumps_mg(flow: OurPowderFlow, opening_mm: float) -> np.ndarray:
    """What comes at once of a full cone that is shaken."""
    rng = np.random.default_rng(1)
    steps_mg = np.array([flow.step(0.02, opening_mm, 1.0, 4000.0, rng) for _ in range(4000)])
    return steps_mg[steps_mg > 0.6]


def test_a_sample_that_never_failed_in_a_few_trials_is_not_warned_of(setup: Setup) -> None:
    lab = load_lab(setup.lab)
    plan = make_plan(load_recipe(setup.recipe, lab), lab)
    odds = odds_of(plan, [fake(seed, 600.0, "abc") for seed in range(4)])
    assert isinstance(odds.samples["c"], Chance)
    assert 0.9 < odds.samples["c"].probability < 1.0
    assert (odds.unlikely, odds.codes) == ([], {})
    assert odds_of(plan, [fake(0, 600.0, "abc")]).unlikely == []
    assert odds_of(plan, [fake(0, 600.0, "ab")]).unlikely == ["c"]


def test_the_command_tells_the_odds_and_writes_every_sample(
    setup: Setup, command: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scuhand_bt.study, "executor_of", lambda *_: nullcontext(Inline()))
    vary = tmp_path / "vary.yaml"
    vary.write_text(f"{{design: grid, draws: 2, vary: {{{FLOW}: {{from: 40, to: 150}}}}}}", encoding="utf-8")
    rows, kept = tmp_path / "rows.csv", tmp_path / "s.sqlite"
    asked = ("study", setup.recipe, "--trials", 2, "--vary", vary, "--store", kept, "-o", rows)
    found = json.loads(command(*asked, "--json").stdout)
    assert (found["draws"], found["trials"]) == (2, 4)
    assert found["indices"]["duration_s"][FLOW]["rank"] == pytest.approx(-1.0)
    with rows.open(encoding="utf-8", newline="") as file:
        written = list(csv.DictReader(file))
    assert len(written) == 4 * 3
    assert {row[FLOW] for row in written} == {"40", "150"}
    picture = tmp_path / "came.svg"
    shown = command(*asked, "--plot", picture).stdout
    drawing = picture.read_text(encoding="utf-8")
    drawn = " ".join(re.findall("<!-- (.*?) -->", drawing))  # beside their curves
    legend = drawing[drawing.index('id="legend_1"') :]
    assert re.findall("fill: (#[0-9a-f]+)", legend)[:2] == ["#ffffff", "#cfe8cf"], (
        "green on white, not on its own green"
    )
    for words in ("dry runs (SIMULATED): 4", "how long a run takes", "beads", "what time depends on", "Spearman"):
        assert words in drawn
    assert "By 4 dry runs" in shown
    assert "of 3 samples are to be expected" in shown
    assert "what duration_s depends on" in shown
    assert command("study", setup.recipe, "-o", "rows.txt").returncode == 2


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--vary", "order.yaml", "--controller", "paper"), "--controller: it is what --vary names"),
        (("--dask", "tcp://127.0.0.1:1", "--workers", 2), "--workers: a Dask cluster has its own"),
        (("--vary", "order.yaml", "--optimise", 2, "-o", "x.csv"), "--output: a search proposes figures"),
        (("--vary", "order.yaml", "--optimise", 2, "--plot", "x.png"), "--plot: a search proposes figures"),
        (("--plot", "x.jpg"), "--plot: 'x.jpg' is to be a file of this kind: .png, .svg"),
        (("--trials", 10_000_000), "--trials: these are 10000000 dry runs, and 1000000 the most"),
        (
            ("--vary", "order.yaml", "--optimise", 2, "--trials", 10**9),
            "--trials: these are 5000000000 dry runs, and 1000",
        ),
        (("--first-seed", 10**19), "--first-seed"),
    ],
)
def test_options_that_do_not_go_together_are_refused(
    setup: Setup, command: Call, tmp_path: Path, options: tuple[object, ...], said: str
) -> None:
    setup.recipe.write_text(RECIPE.replace("workflow", "controller: paper\nworkflow", 1), encoding="utf-8")
    vary = tmp_path / "order.yaml"
    vary.write_text("vary: {recipe.controller: [adaptive, paper]}", encoding="utf-8")
    refused = command("study", setup.recipe, *(vary if one == "order.yaml" else one for one in options))
    assert refused.returncode == 2
    assert said in refused.stderr


def test_a_plan_has_no_more_dry_runs_than_a_study(setup: Setup, command: Call) -> None:
    refused = command("plan", setup.recipe, "--trials", 10**9)
    assert refused.returncode == 2
    assert "less than or equal to 1000000" in " ".join(refused.stderr.replace("│", " ").split())


@pytest.mark.slow
def test_a_plan_tells_when_a_person_is_needed_and_what_to_expect(setup: Setup, command: Call) -> None:
    setup.recipe.write_text(
        RECIPE.replace("samples:", "  msg: {station: mortar_bay_2, container: agate_mortar, "
                       "powder: monosodium_glutamate, amount: 5 g}\nsamples:").replace(
                           "{id: c, source: beads", "{id: c, source: msg"), encoding="utf-8"
    )  # fmt: skip
    shown = command("plan", setup.recipe, "--trials", 3).stdout
    assert "By 3 dry runs (intervals of 90 %): it takes " in shown
    assert "Each dry run has a cell of its own" in shown
    assert "swap the sheet (two screws), wipe rollers and clamp (after " in shown
    one = " ".join(command("plan", setup.recipe, "--trials", 1).stdout.split())
    assert re.search(r"By 1 dry run, which tells no interval: it takes [^(]+\. ", one)
    told = (
        r"wipe rollers and clamp \(after [\d a-z]+\)\. So a person comes 1 time: from the start until \d[\d a-z]+ after"
    )
    assert re.search(told, one)
    found = json.loads(command("plan", setup.recipe, "--trials", 1, "--json").stdout)
    assert found["odds"]["trials"] == 1
    assert len(set(found["odds"]["duration_s"].values())) == 1, "one dry run tells no interval"
    assert set(found["odds"]["samples"]) == {"a", "b", "c"}
    assert json.loads(command("plan", setup.recipe, "--trials", 0, "--json").stdout)["odds"] is None


@pytest.mark.slow
def test_trials_are_written_as_parquet_too(setup: Setup, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    one = trial(setup, 1)
    varied = replace(setup, changes=((FLOW, "75"), ("recipe.samples.0.mass", "50 mg")))
    write_table(tmp_path / "t.parquet", [((varied, 1), one)])
    table = parquet.read_table(tmp_path / "t.parquet")
    rows = table.to_pylist()
    assert (rows[0][FLOW], rows[0]["recipe.samples.0.mass"]) == (75.0, "50 mg")
    assert [sample.code for sample in one.samples] == [None] * 3
    assert str(table.schema.field("code").type) == "string", "as in a study of which one has failed"
    written = {name for name in table.column_names if "." not in name}
    told = re.findall(r"`(\w+)`", (REPOSITORY / "docs" / "study.md").read_text(encoding="utf-8"))
    assert written <= set(told), "each column is told of"
    assert [(row["seed"], row["id"], row["true_mg"]) for row in rows] == [
        (1, sample.id, sample.true_mg) for sample in one.samples
    ]


def test_a_value_is_changed_where_it_stands_and_all_else_stays_as_written() -> None:
    text = "# beads\nglass_beads: {belief: {coefficient: 50, spread: 15 %}}  # first\nlist:\n  - {a: 'x'}\n"
    assert with_value(text, "powders.glass_beads.belief.spread", "20 %") == text.replace("15 %", '"20 %"')
    assert with_value(text, "powders.list.0.a", 3.0) == text.replace("'x'", "3.0")
    assert with_value(text, "powders.list.0.a", "- 5") == text.replace("'x'", '"- 5"'), "no list"
    with pytest.raises(SourceError, match="'spred' is not there; known: coefficient, spread"):
        with_value(text, "powders.glass_beads.belief.spred", "20 %")


@pytest.mark.parametrize(
    ("place", "said"),
    [
        ("recipe.a.mass", "'mass' has an anchor (&), and would change wherever its alias (*) is; write it out"),
        ("recipe.b.mass", "'mass' has an anchor (&)"),
        ("recipe.c.k", "'c' has an anchor (&)"),
        ("recipe.d.0.k", "'0' has an anchor (&)"),
        ("recipe.e", "nothing is written there; write a value, which is then varied"),
        ("recipe.d", "it is written in lines of their own; name a value in it, or write it in one line"),
        ("recipe.f", "it is written in lines of their own"),
        ("recipe.g", "it is written in lines of their own"),
    ],
)
def test_a_value_that_cannot_be_changed_by_itself_is_not(place: str, said: str) -> None:
    text = "a: {mass: &m 50 mg}\nb: {mass: *m}\nc: &x {k: 1}\nd:\n  - *x\ne:\nf:\n  k: 1\ng: |\n  1\nh: 2\n"
    with pytest.raises(SourceError) as wrong:
        with_value(text, place, "20 mg")
    assert str(wrong.value).startswith(f"{place}: {said}")


def test_less_time_is_better_by_what_it_brings() -> None:
    """Runs that stop at their first failure are over sooner than those that go well."""

    def costs_less(as_written: Found, proposed: Found) -> bool:
        return proposed.cost(as_written) < as_written.cost(as_written)

    assert not costs_less(Found(0.0, 600.0), Found(0.0, 1.0))
    assert costs_less(Found(0.5, 600.0), Found(0.5, 300.0))
    assert costs_less(Found(0.0, 1.0), Found(0.1, 600.0))
    assert costs_less(Found(1 / 24, 30.0), Found(1.0, 720.0))
    assert not costs_less(Found(1.0, 720.0), Found(1 / 24, 30.0))


def test_what_is_better_by_chance_is_not_proposed() -> None:
    """Of proposals that change nothing every second one was, as by half a second of 183."""
    rng = np.random.default_rng(1)
    good = SampleTrial("a", True, True, "in tolerance", None, 50.0, 50.0, 50.0, 60.0)

    def runs(shorter_s: float) -> list[Trial]:
        return [
            Trial(seed, 0, 180.0 + 60.0 * (seed % 3) + float(rng.normal(0.0, 1.0)) - shorter_s, {}, (good,), {}, {}, {})
            for seed in range(6)
        ]

    assert sum(is_better(runs(0.0), runs(0.0)) for _ in range(200)) <= 20
    assert all(is_better(runs(0.0), runs(10.0)) for _ in range(20))
    assert not is_better(runs(0.0)[:1], runs(10.0)[:1])


@pytest.mark.parametrize("readabilities", [["0.1 mg", "1 mg"], ["1 mg", "0.1 mg"]])
def test_a_search_begins_in_whichever_order_names_are_listed(setup: Setup, readabilities: list[str]) -> None:
    """Each end was tried with the middle one of each list: of the two orders one was refused."""
    setup.recipe.write_text(RECIPE.replace("30 mg}", "30 mg, tolerance: 2 mg}"), encoding="utf-8")
    both = {"cell.balance.readability": readabilities, "recipe.samples.2.tolerance": {"from": "1 mg", "to": "2 mg"}}
    ends = Vary.model_validate({"vary": both}).ends()
    check_setups([replace(setup, changes=changes) for changes in ends])
    assert {one for changes in ends for one in changes} >= {(place, "1 mg") for place in both}


def test_a_search_goes_on_after_a_candidate_that_no_recipe_may_have(setup: Setup, tmp_path: Path) -> None:
    """Each of its figures may be, and not both: the same command came to it each time, and never to an end."""
    pytest.importorskip("optuna")
    both = {"recipe.samples.0.mass": ["50 mg", "100 mg"], "recipe.sources.beads.amount": ["5 g", "150 mg"]}
    vary, tried = Vary.model_validate({"vary": both}), list[object]()

    def quick(of: Setup, seed: int) -> Trial:
        tried.append(of.changes)
        return Trial(seed, 0, 100.0, {}, (), {}, {}, {})

    with open_store(tmp_path / "s.sqlite", setup) as store:
        found = optimised(setup, vary, 12, range(1), range(1, 2), Inline(quick), store)
    assert 0 < found.refused < 12
    assert tuple((place, values[1]) for place, values in both.items()) not in tried
    assert found.changes in tried


@pytest.mark.slow
def test_a_search_proposes_what_is_better_on_seeds_that_it_has_not_seen(setup: Setup, tmp_path: Path) -> None:
    pytest.importorskip("optuna")
    vary = Vary.model_validate({"vary": {"powders.glass_beads.simulation.flow_coefficient": ["75", "20"]}})
    slow = replace(setup, changes=((FLOW, "20"),))
    with changed(slow.recipe, slow.lab, slow.changes) as (recipe, lab):
        here = Setup(recipe, lab)
        with open_store(tmp_path / "s.sqlite", here) as store:
            found = optimised(here, vary, 6, range(4), range(4, 8), Inline(), store)
        assert found.changes == ((FLOW, "75"),)
        assert found.is_better
        assert found.proposed.duration_s < found.as_written.duration_s
        shown = list(diff(here, found.changes))
    assert [line for line in shown if line.startswith(("-  ", "+  "))] == [
        "-    flow_coefficient: 20",
        "+    flow_coefficient: 75",
    ]
