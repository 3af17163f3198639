"""Two ids that a person may take for one another are never in one recipe, and every id can be read aloud."""

import unicodedata
from datetime import datetime, tzinfo
from pathlib import Path

import pytest
from conftest import Desk
from running import dry_run

from scuhand_bt.problems import SourceError
from scuhand_bt.recipe.recipe import load_recipe

HEAD = """recipe: {name}
workflow: fill_xrd_holder
sources:
  msg: {{station: mortar_bay, container: agate_mortar, powder: monosodium_glutamate, amount: 8 g}}
defaults: {{source: msg, container: xrd_holder, tolerance: 2 mg}}
samples:
"""


def said(desk: Desk, *ids: str, name: str = "ids") -> list[str]:
    """What is wrong with a recipe of these samples: without its file, from line 7 on."""
    rows = "".join(f'  - {{id: "{one}", mass: 50 mg}}\n' for one in ids)
    path = desk.write("recipe.yaml", HEAD.format(name=name) + rows)
    try:
        load_recipe(path, desk.lab)
    except Exception as error:
        return [line.removeprefix(f"{path}:") for line in str(error).splitlines()]
    return []


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("xrd-а", "'xrd-а' mixes CYRILLIC and LATIN letters; write it in one script"),
        ("α-Al2O3", "'α-Al2O3' mixes GREEK and LATIN letters; write it in one script"),
        ("ｘrd", "'ｘrd' can be written in several ways; write 'xrd'"),
        (unicodedata.normalize("NFD", "é1"), "can be written in several ways; write 'é1'"),
        ("x²", "can be written in several ways; write 'x2'"),
        ("x\u200b1", "is not a valid id"),
        ("x\u202e1", "is not a valid id"),
        ("x٣", "is not a valid id"),
        ("ɑ1", "is not a valid id"),
        ("xı", "is not a valid id"),
    ],
)
def test_an_id_that_may_look_like_another_is_refused_with_its_place(desk: Desk, text: str, why: str) -> None:
    (problem,) = said(desk, text)
    assert problem.startswith("7:10: ")
    assert why in problem


@pytest.mark.parametrize(
    ("second", "why"),
    [
        ("XRD-10", "'XRD-10' differs from 'xrd-10' only by case; first in line 7"),
        ("xrd-1O", "'xrd-1O' looks like 'xrd-10'; first in line 7"),
        ("xrd-l0", "'xrd-l0' looks like 'xrd-10'; first in line 7"),
        ("xrd-I0", "'xrd-I0' looks like 'xrd-10'; first in line 7"),
        ("хга-10", "'хга-10' is written in another script than 'xrd-10'; first in line 7"),
    ],
)
def test_of_two_ids_that_look_alike_the_second_is_refused(desk: Desk, second: str, why: str) -> None:
    (problem,) = said(desk, "xrd-10", second)
    assert problem.startswith("8:10: ")
    assert why in problem


def test_kanji_and_kana_that_look_alike_are_told(desk: Desk) -> None:
    (problem,) = said(desk, "粉エ", "粉工")
    assert "looks like" in problem


@pytest.mark.parametrize(
    "ids", [("試料-1", "xrd-1", "サンプル"), ("проба-1", "7"), ("größe", "é"), ("시료", "B+1.2_c")]
)
def test_every_script_may_be_written_and_japanese_and_korean_beside_latin(desk: Desk, ids: tuple[str, ...]) -> None:
    assert said(desk, *ids) == []


def test_a_recipes_name_which_names_its_runs_is_held_to_the_same(desk: Desk) -> None:
    (problem,) = said(desk, "a", name="bаtch")
    assert "mixes CYRILLIC and LATIN letters" in problem


def test_two_runs_that_draw_one_id_do_not_share_a_journal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Stopped(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> datetime:
            return datetime(2026, 1, 3, 18, 15, tzinfo=tz)

    monkeypatch.setattr("scuhand_bt.run.session.datetime", Stopped)
    monkeypatch.setattr("scuhand_bt.run.session.secrets.token_hex", lambda count: "1f2a")
    sample = "{id: a, mass: 20 mg, source: beads, container: xrd_holder}"
    recipe = f"recipe: twice\nworkflow: fill_xrd_holder\nsamples: [{sample}]\n"
    ran = dry_run(tmp_path, recipe)
    before = ran.journal.read_bytes()
    with pytest.raises(SourceError, match="File exists"):
        dry_run(tmp_path, recipe)
    assert ran.journal.read_bytes() == before
