"""Texts from outside (a lot, a file's name, a question) are shown and exported as text, and do nothing."""

import csv
import io
import json
from pathlib import Path

import pytest
from conftest import Call
from running import dry_run, make_lab

from scuhand_bt import cli
from scuhand_bt.cli.streams import PlainConsole
from scuhand_bt.journal.reader import open_contents
from scuhand_bt.lab import load_lab
from scuhand_bt.problems import SourceError, harmless
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.report.weighing_record import weighing_csv

ESCAPES = "\x1b[31mred\x1b[0m \x1b]0;owned\x07 \u009b2J \u202egood\u2069 [/bold] :smile:"
SHOWN = "�[31mred�[0m �]0;owned� �2J �good� [/bold] :smile:"


def recipe_with_lot(lot: str) -> str:
    return f"""
recipe: lots
workflow: fill_xrd_holder
defaults: {{container: xrd_holder, source: beads, mass: 30 mg}}
samples: [{{id: a}}]
sources:
  beads: {{station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 20 g, lot: {json.dumps(lot)}}}
"""


@pytest.fixture(scope="module")
def lab_with_run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A lab with a run whose lot holds escapes, and that run's journal."""
    folder = tmp_path_factory.mktemp("lots")
    lab = make_lab(folder / "lab")
    ran = dry_run(folder, recipe_with_lot(ESCAPES))
    runs = lab / ".scuhand" / "runs"
    runs.mkdir(parents=True)
    return lab, ran.journal.rename(runs / ran.journal.name)


@pytest.mark.parametrize("words", [("show",), ("show", "--json"), ("export", "--csv"), ("export", "--json")])
def test_no_command_to_the_terminal_comes_out_of_a_lot(
    lab_with_run: tuple[Path, Path], command: Call, words: tuple[str, ...]
) -> None:
    code, out, err = command(words[0], lab_with_run[1], *words[1:])
    assert (code, err) == (0, "")
    assert "red" in out
    assert all(c.isprintable() or c in "\r\n" for c in out)


def test_json_loses_nothing_of_what_the_terminal_does_not_show(lab_with_run: tuple[Path, Path], command: Call) -> None:
    story = json.loads(command("show", lab_with_run[1], "--json")[1])
    assert story["header"]["sources"]["beads"]["lot"] == ESCAPES


def test_the_console_shows_markup_and_emoji_codes_as_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    PlainConsole(width=200).print(ESCAPES)
    assert capsys.readouterr().out == SHOWN.replace("owned�", "owned") + "\n"  # rich leaves out a bell


def test_colours_of_our_own_still_reach_a_terminal() -> None:
    text = io.StringIO()
    PlainConsole(file=text, force_terminal=True, color_system="standard").print("good", style="green")
    assert text.getvalue() == "\x1b[32mgood\x1b[0m\n"


def test_an_unknown_name_is_told_without_its_escapes() -> None:
    assert "\x1b" not in cli.shared.unknown("powder", ESCAPES, [ESCAPES]).message


@pytest.mark.parametrize("text", ["0 ± 2 µg", "二酸化チタン", ""])
def test_what_can_be_read_stays_as_it_is(text: str) -> None:
    assert harmless(text) == text


@pytest.mark.parametrize(
    ("lot", "cell"),
    [
        ("=1+1", "'=1+1"),
        (" @SUM(A1)", "' @SUM(A1)"),
        ("－1", "'－1"),
        ("a;=1+1", "a;'=1+1"),
        ("a\n=1+1", "a =1+1"),
        ('a;"b",c', 'a;"b",c'),
        (ESCAPES, SHOWN),
    ],
)
def test_a_lot_is_a_text_to_every_spreadsheet(tmp_path: Path, lot: str, cell: str) -> None:
    ran = dry_run(tmp_path, recipe_with_lot(lot))
    with open_contents(ran.journal) as contents:
        text = weighing_csv(contents)
    rows = list(csv.DictReader(io.StringIO(text)))
    assert {row["lot"] for row in rows if row["weighing"] in ("dose", "result")} == {cell}
    assert all(line.startswith('"') and line.endswith('"') for line in text.splitlines())


# --- what a recipe may read


@pytest.fixture
def outside(tmp_path: Path) -> Path:
    """A file that is none of the lab's, with a first line that is nobody's business."""
    path = tmp_path / "secret.csv"
    path.write_text("hunter2\nsecond\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("name", ["../../secret.csv", "{outside}", "link.csv", "a\0b"])
def test_a_table_outside_the_lab_is_refused_and_nothing_of_it_shown(tmp_path: Path, outside: Path, name: str) -> None:
    lab = make_lab(tmp_path / "lab")
    (lab / "recipes").mkdir()
    (lab / "recipes" / "link.csv").symlink_to(outside)
    path = lab / "recipes" / "r.yaml"
    table = json.dumps(name.format(outside=outside))
    path.write_text(f"recipe: r\nworkflow: fill_xrd_holder\nsamples: [{{table: {table}}}]\n", encoding="utf-8")
    with pytest.raises(SourceError) as caught:
        load_recipe(path, load_lab(lab))
    assert "neither in the recipe's folder nor in the lab" in str(caught.value)
    assert "hunter2" not in str(caught.value)


@pytest.mark.parametrize("name", ["r.csv", "../tables/r.csv"])
def test_a_table_of_the_lab_is_read(tmp_path: Path, name: str) -> None:
    lab = make_lab(tmp_path / "lab")
    for folder in ("recipes", "tables"):
        (lab / folder).mkdir()
        (lab / folder / "r.csv").write_text("id,mass [mg]\na,30\n", encoding="utf-8")
    path = lab / "recipes" / "r.yaml"
    text = (
        recipe_with_lot("").replace("samples: [{id: a}]", f"samples: [{{table: {name}}}]").replace(", mass: 30 mg", "")
    )
    path.write_text(text, encoding="utf-8")
    loaded = load_lab(lab)
    assert [sample.id for sample in make_plan(load_recipe(path, loaded), loaded).recipe.samples] == ["a"]
