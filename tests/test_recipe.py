"""Recipes: everything a chemist can get wrong is said before anything moves, all of it, in its place."""

import random
import time
from pathlib import Path

import pytest
from conftest import REPOSITORY, Desk, LabFolder, problems_of
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from scuhand_bt.recipe.recipe import load_recipe

HEAD = """\
recipe: test
workflow: fill_xrd_holder
sources:
  msg: {station: mortar_bay, container: agate_mortar, powder: monosodium_glutamate, amount: 6 g}
defaults: {source: msg, container: xrd_holder, tolerance: 2 mg}
samples:
"""
"""Six lines: samples begin on line 7."""


def test_the_shipped_recipes_have_no_problem(starter: object) -> None:
    for path in sorted((REPOSITORY / "recipes").glob("*.yaml")):
        assert load_recipe(path, starter).samples  # type: ignore[arg-type]


def test_a_workflow_that_is_misspelt_hides_nothing_that_is_wrong_with_its_samples(desk: Desk) -> None:
    """They are held against the workflow that was probably meant."""
    samples = "  - {id: a, mass: 50}\n  - {id: a, mass: 50 mg, tolerence: 2 mg}\n"
    whole = desk.problems(HEAD + samples)
    assert len(whole) == 3
    other, *same = desk.problems(HEAD.replace("fill_xrd_holder", "fill_xrd_holdr") + samples)
    assert "unknown workflow 'fill_xrd_holdr'" in other
    assert same == whole


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("{id: a, mass: 50}", "7:19: 'mass': '50' has no unit; write a mass with its unit, such as"),
        ("{id: a, mass: 50 mm}", "7:19: 'mass': 'mm' is a unit of length, not of mass"),
        ("{id: a, mass: }", "7:19: 'mass': nothing is not a mass"),
        ("{id: a, mass: {x: y}}", "7:19: 'mass': "),
        ("{id: a, mass: 0 mg}", "7:19: the mass is 0 mg; more than 0"),
        ("{id: a, masss: 50 mg}", "7:13: the workflow 'fill_xrd_holder' has no input 'masss'"),
        ("{id: a, masss: 50 mg}", "did you mean 'mass'?"),
        ("{id: a}", "7:5: 'mass' is missing; the workflow 'fill_xrd_holder' needs it (Mass)"),
        ("{mass: 50 mg}", "7:5: 'id' is missing"),
        ("{id: a b, mass: 50 mg}", "7:10: 'a b' is not a valid id"),
        ("{id: ../a, mass: 50 mg}", "7:10: '../a' is not a valid id"),
        ("{id: 'a#2', mass: 50 mg}", "7:10: 'a#2' is not a valid id"),  # a second attempt's container
        ("{id: a/first, mass: 50 mg}", "7:10: 'a/first' is not a valid id"),  # one of several containers
        ("{id: a, mass: 50 mg, container: xrd-holder}", "7:37: unknown container 'xrd-holder'"),
        ("{id: a, mass: 50 mg, container: xrd-holder}", "did you mean 'xrd_holder'?"),
        ("{id: a, mass: 50 mg, source: mgs}", "7:34: unknown source 'mgs'; known: msg; did you mean 'msg'?"),
        ("{id: a, mass: 50 mg, workflow: fill_xrd}", "7:36: unknown workflow 'fill_xrd'"),
        ("{id: a, mass: 50 mg, tolerance: 0.05 mg}", "7:37: the tolerance 0.05 mg is too fine for"),
        ("{id: a, mass: 50 mg, tolerance: 0.1 %}", "7:37: the tolerance 0.05 mg is too fine for"),
        ("{id: a, mass: 50 mg, tolerance: 0.19 mg}", "is too fine for a readability of 0.1 mg; at least 0.2 mg"),
        ("{id: a, mass: 50 mg, tolerance: 0 %}", "7:37: 'tolerance': '0 %' is not a tolerance; write more than 0 %"),
        ("{id: a, mass: 50 mg, tolerance: 200 %}", "7:37: 'tolerance': '200 %' is not a tolerance"),
        ("{id: a, mass: 2 mg}", "7:19: the mass 2 mg is not more than its tolerance, 2 mg"),
        ("{id: a, mass: 200 mg}", "7:19: 200.0 mg of monosodium_glutamate (0.24 cm³) does not fit into 'xrd_holder'"),
        ("{id: a, mass: 200 mg}", "it holds 0.20 cm³, 170.0 mg"),
        (
            "{id: a, container: alumina_crucible, mass: 90 g}",
            "are too heavy for the balance; its maximum is 120.0000 g",
        ),
        ("{id: a, mass: 50 mg, repeat: 0}", "7:34: 'repeat' must be a number of samples, not '0'; 1 to 20000"),
        ("{id: [a, b], mass: [1 mg, 2 mg, 3 mg]}", "7:24: 'mass' lists 3 values, but 'id' lists 2"),
        ("{id: [a, b], mass: [1 mg]}", "7:24: 'mass' lists 1 value, but 'id' lists 2"),
        ("{id: [a, b], mass: 50 mg, repeat: 2}", "7:39: a sample has both 'repeat' and a list"),
        ("{id: a, mass: []}", "7:5: an empty list gives no sample"),
        ("{table: missing.csv}", "7:13: '"),
        ("{table: [a.csv]}", "7:13: 'table' must be a file name, not a list"),
        ("nonsense", "7:5: a sample cannot be 'nonsense'"),
    ],
)
def test_what_is_wrong_with_a_sample_is_said_in_its_place(desk: Desk, line: str, said: str) -> None:
    problems = desk.problems(HEAD + f"  - {line}\n")
    assert any((said in problem and problem.startswith(said[:2])) or said in problem for problem in problems), problems


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("recipe: test", "recipe: ../../evil", "1:9: '../../evil' is not a valid name for a recipe"),
        (
            "recipe: test",
            "recipe: test\norder: random",
            "2:8: unknown order 'random'; known: as_written, by_powder, fastest, persons_together",
        ),
        ("recipe: test", "recipe: test\ncontroller: papr", "did you mean 'paper'?"),
        ("recipe: test", "recipe: test\nsample: []", "2:1: unknown key 'sample'"),
        ("workflow: fill_xrd_holder", "workflow: fill_xrd_holdr", "did you mean 'fill_xrd_holder'?"),
        ("mortar_bay,", "mortar_bey,", "4:18: unknown mortar station 'mortar_bey'"),
        ("mortar_bay,", "balance,", "4:18: unknown mortar station 'balance'"),
        ("agate_mortar", "agate", "4:41: unknown mortar 'agate'"),
        ("powder: mono", "powder: mno", "did you mean 'monosodium_glutamate'?"),
        ("amount: 6 g", "amount: 6 mL", "4:93: 'amount': 'mL' is a unit of volume, not of mass"),
        ("amount: 6 g", "amount: 0 g", "4:93: 'amount': '0 g' is not accepted; more than 0"),
        ("amount: 6 g", "amount: 900 g", "900.0000 g of monosodium_glutamate does not fit into 'agate_mortar'"),
        ("amount: 6 g", "amount: 100 mg", "4:3: 'msg' holds 100.0 mg of monosodium_glutamate, but its 2 samples need"),
        ("amount: 6 g", "amount: 6 g, colour: white", "unknown key 'colour'; known: amount, container"),
        (", amount: 6 g", "", "4:8: 'amount' is missing"),
        ("tolerance: 2 mg", "tolerence: 2 mg", "did you mean 'tolerance'?"),
        ("defaults: {", "defaults: [", "is not valid YAML"),
        ("sources:", "sourcs:", "did you mean 'sources'?"),
    ],
)
def test_what_is_wrong_with_the_head_is_said_in_its_place(desk: Desk, old: str, new: str, said: str) -> None:
    recipe = HEAD.replace(old, new) + "  - {id: a, mass: 50 mg}\n  - {id: b, mass: 60 mg}\n"
    problems = desk.problems(recipe)
    assert any(said in problem for problem in problems), problems


def test_all_problems_are_said_at_once_in_the_files_order(desk: Desk) -> None:
    problems = desk.problems(
        HEAD.replace("mortar_bay,", "mortar_bey,").replace("amount: 6 g", "amount: 6 mm")
        + "  - {id: a, mass: 50}\n"
        + "  - {id: a, mass: 5 g, colour: red, tolerance: 0.01 mg}\n"
        + "on_failure: {dose.overshot: flag, otherwise: halt}\n"
    )
    assert [problem.rsplit(":", 1)[0].split(": ")[0] for problem in problems] == [
        "4:18", "4:93", "7:19", "8:10", "8:24", "8:48", "9:14", "9:46",
    ]  # fmt: skip


def test_an_id_may_stand_once_in_the_recipe_and_all_its_tables(desk: Desk) -> None:
    desk.write("one.csv", "id;mass [mg]\nx;50\ny;50\n")
    desk.write("two.csv", "id;mass [mg]\nz;50\nx;50\n")
    path = desk.write("recipe.yaml", HEAD + "  - {id: y, mass: 50 mg}\n  - {table: one.csv}\n  - {table: two.csv}\n")
    with pytest.raises(Exception, match="taken") as caught:
        load_recipe(path, desk.lab)
    folder = desk.folder
    assert str(caught.value).splitlines() == [
        f"{folder}/one.csv:3:1: the id 'y' is taken; first in {folder}/recipe.yaml:7:10",
        f"{folder}/two.csv:3:1: the id 'x' is taken; first in {folder}/one.csv:2:1",
    ]


def test_what_is_wrong_in_a_table_is_said_with_the_cells_line_and_column(desk: Desk) -> None:
    desk.write("t.csv", "\ufeffid;container;mass\r\na;xrd_holder;50\r\n\r\nb;xrd;60 mg\r\nc;xrd_holder;5 g\r\n")
    assert [problem.split(": ")[0] for problem in desk.problems(HEAD + "  - {table: t.csv}\n")] == [
        "2:14",
        "4:3",
        "5:14",
    ]


def test_a_wrong_column_is_said_once_at_the_header(desk: Desk) -> None:
    desk.write("t.csv", "id,mas\na,50 mg\nb,60 mg\n")
    problems = desk.problems(HEAD + "  - {table: t.csv}\n")
    assert [problem for problem in problems if "'mas'" in problem] == [problems[0]]
    assert problems[0].startswith("1:4: ")


def test_a_cell_that_is_refused_is_not_told_to_be_missing_as_well(desk: Desk) -> None:
    desk.write("t.csv", "id;mass [mg]\na;50,5\nb;1.000\n")
    (problem,) = desk.problems(HEAD + "  - {table: t.csv}\n")
    assert "3:3: '1.000' could mean thousands" in problem
    desk.write("t.csv", "id;mass mg\na;50\nb;60\n")
    (problem,) = desk.problems(HEAD + "  - {table: t.csv}\n")
    assert "1:4: 'mass mg' is not a column name" in problem


def test_tables_repeats_and_lists_become_samples(desk: Desk) -> None:
    desk.write("t.csv", "id;mass;tolerance\nt1;50,5 mg;\nt2;0,06 g;1 mg\n")
    recipe = desk.load(
        HEAD
        + "  - {table: t.csv, container: alumina_crucible}\n"
        + "  - {id: r, mass: 20 mg, repeat: 12}\n"
        + "  - {id: l, mass: [30 mg, 40 mg]}\n"
        + "  - {id: [m, n], mass: 70 mg, tolerance: 10 %}\n"
    )
    assert [sample.id for sample in recipe.samples][:4] == ["t1", "t2", "r-01", "r-02"]
    assert [(sample.id, sample.mass_mg, sample.tolerance_mg) for sample in recipe.samples][-4:] == [
        ("l-1", 30.0, 2.0),
        ("l-2", 40.0, 2.0),
        ("m", 70.0, 7.0),
        ("n", 70.0, 7.0),
    ]
    first, second = recipe.samples[:2]
    assert (first.mass_mg, first.tolerance_mg, second.mass_mg, second.tolerance_mg) == (50.5, 2.0, 60.0, 1.0)
    assert first.container is not None
    assert (first.container.name, first.container.id) == ("alumina_crucible", "t1")


def test_demand_counts_losses_and_every_source_by_itself(desk: Desk) -> None:
    recipe = HEAD.replace("amount: 6 g", "amount: 500 mg") + "  - {id: a, mass: 100 mg, repeat: 5}\n"
    (problem,) = desk.problems(recipe)
    assert "its 5 samples need 600.0 mg with losses" in problem


def test_an_unreachable_station_is_said_before_anything_moves(lab_folder: LabFolder, desk: Desk) -> None:
    lab_folder.replace("robot/cell.yaml", "[200 mm,  240 mm, 0 mm]", "[900 mm,  240 mm, 0 mm]")
    desk.lab = lab_folder.load()
    (problem,) = desk.problems(HEAD + "  - {id: a, mass: 50 mg}\n")
    assert problem.startswith("4:3: the arm cannot reach 'mortar_bay' of robot/cell.yaml with the cone upright")


def test_a_batch_bomb_is_refused_at_once(desk: Desk) -> None:
    began_s = time.process_time()
    lines = "".join(f"  - {{id: a{i}, mass: 50 mg, repeat: 20000}}\n" for i in range(1000))
    (problem,) = desk.problems(HEAD + lines)
    assert "more than 20000 samples" in problem
    assert time.process_time() - began_s < 5.0


def test_the_hash_follows_the_text_and_the_tables(desk: Desk) -> None:
    recipe = HEAD + "  - {table: t.csv}\n"
    desk.write("t.csv", "id,mass\na,50 mg\n")
    first, again = desk.load(recipe).hash, desk.load(recipe).hash
    desk.write("t.csv", "id,mass\na,51 mg\n")
    assert first == again != desk.load(recipe).hash


def test_the_failure_policy_has_defaults_that_a_recipe_overrides(desk: Desk) -> None:
    recipe = desk.load(HEAD + "  - {id: a, mass: 50 mg}\non_failure: {dose.overshoot: redo, otherwise: skip_sample}\n")
    actions = [recipe.action_for(code) for code in ("dose.overshoot", "dose.not_reached", "arm.no_path")]
    assert actions == ["redo", "flag", "skip_sample"]


def test_a_workflow_with_a_wrong_default_is_reported_and_breaks_nothing(lab_folder: LabFolder, desk: Desk) -> None:
    lab_folder.replace("trees/fill_xrd_holder.yaml", "default: 2 mg", "default: 2 mm")
    desk.lab = lab_folder.load()
    problems = desk.problems(HEAD + "  - {id: a, mass: 50}\n")
    assert problems[0].startswith("4:93: 'tolerance' takes a Mass: 'mm' is a unit of length")
    assert problems[1].startswith("7:19: 'mass': '50' has no unit")


BASE = (
    HEAD + "  - {id: a, mass: 50 mg, repeat: 3}\n  - {id: [b, c], mass: [10 mg, 5 %]}\non_failure: {otherwise: stop}\n"
)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 10**9))
def test_any_mutated_recipe_is_a_recipe_or_located_problems(desk: Desk, seed: int) -> None:
    chance = random.Random(seed)
    text = list(BASE)
    for _ in range(chance.randint(1, 6)):
        at = chance.randrange(len(text))
        what = chance.choice(
            ["", "x", "\n", " ", ":", "{", "}", "[", "]", "5", "-", "~", ",", "%", '"', "mg", "&a ", "*a"]
        )
        text[at : at + chance.randint(0, 4)] = what
    path = Path(desk.folder / "recipe.yaml")
    path.write_text("".join(text), encoding="utf-8")
    problems_of(lambda: load_recipe(path, desk.lab))


def test_an_unknown_key_of_a_source_hides_nothing_else(desk: Desk) -> None:
    problems = desk.problems(HEAD.replace("amount: 6 g", "amount: 6 kg, colour: white") + "  - {id: a, mass: 50 mg}\n")
    assert any("unknown key 'colour'" in problem for problem in problems)
    assert any("does not fit into" in problem for problem in problems)


def test_a_table_of_something_else_is_one_problem(desk: Desk) -> None:
    path = desk.write("other.csv", "name;colour\na;red\nb;blue\n")
    assert desk.problems(HEAD + f"  - {{table: {path.name}}}\n") == [
        "1:1: has no column 'id', which a table of samples needs; such as id, container, mass [mg], …"
    ]


def test_a_table_whose_id_is_written_otherwise_is_told_how_it_is_written(desk: Desk) -> None:
    path = desk.write("other.csv", "ID;mass [mg]\na;50\n")
    assert desk.problems(HEAD + f"  - {{table: {path.name}}}\n") == [
        "1:1: has no column 'id', which a table of samples needs; write 'id' for 'ID'"
    ]
