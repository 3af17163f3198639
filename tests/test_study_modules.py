"""Modules of one's own that trials are made of: found without running any, and tried anew when they were changed."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from study_bench import FLOW, fake

from scuhand_bt.lab import load_lab
from scuhand_bt.problems import SourceError
from scuhand_bt.run.own_modules import lab_modules, plant_files
from scuhand_bt.study.change import changed, modules_hash
from scuhand_bt.study.store import open_store
from scuhand_bt.study.trial import Setup, trial


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
    with pytest.raises(SourceError, match="the --plant import, has changed since"):
        trial(after, 0)
    assert trial(before, 0) == came, "what began with them goes on"
