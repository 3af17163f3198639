"""What a trial changes of a recipe and its lab: what is varied is what is run, and all else stays as written."""

import sys
from dataclasses import replace
from pathlib import Path

import pytest
from study_bench import FLOW, RECIPE

from scuhand_bt.problems import SourceError
from scuhand_bt.study.change import files_hash, modules_hash, with_value
from scuhand_bt.study.trial import Setup, trial

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


def test_a_value_is_changed_where_it_stands_and_all_else_stays_as_written() -> None:
    text = "# beads\nglass_beads: {belief: {coefficient: 50, spread: 15 %}}  # first\nlist:\n  - {a: 'x'}\n"
    assert with_value(text, "powders.glass_beads.belief.spread", "20 %") == text.replace("15 %", '"20 %"')
    assert with_value(text, "powders.list.0.a", 3.0) == text.replace("'x'", "3.0")
    assert with_value(text, "powders.list.0.a", "- 5") == text.replace("'x'", '"- 5"'), "no list"
    with pytest.raises(SourceError, match="'spred' is not there; known: coefficient, spread"):
        with_value(text, "powders.glass_beads.belief.spred", "20 %")


def test_a_key_with_dots_is_found() -> None:
    """A policy by its failure code was refused: "'dose' is not there; known: dose.overshoot, …"."""
    text = "on_failure: {dose: ask, dose.overshoot: flag, otherwise: stop}\n"
    assert with_value(text, "recipe.on_failure.dose.overshoot", "stop") == text.replace("flag", "stop")
    assert with_value(text, "recipe.on_failure.dose", "stop") == text.replace("ask", "stop")
    with pytest.raises(SourceError, match="'arm' is not there; known: dose, "):
        with_value(text, "recipe.on_failure.arm.limp", "stop")
    with pytest.raises(SourceError):
        with_value(text, "recipe.on_failure.dose.", "stop")


@pytest.mark.parametrize(
    ("place", "said"),
    [
        ("recipe.a.mass", "'mass' has an anchor (&), and would change wherever its alias (*) is; write it out"),
        ("recipe.b.mass", "'mass' has an anchor (&)"),
        ("recipe.c.k", "'c' has an anchor (&)"),
        ("recipe.d.0.k", "'0' has an anchor (&)"),
        ("recipe.e", "it has no value; write one, which is then varied"),
        ("recipe.d", "it has several lines; name a value in it, or write it in one line"),
        ("recipe.f", "it has several lines"),
        ("recipe.g", "it has several lines"),
    ],
)
def test_a_value_that_cannot_be_changed_by_itself_is_not(place: str, said: str) -> None:
    text = "a: {mass: &m 50 mg}\nb: {mass: *m}\nc: &x {k: 1}\nd:\n  - *x\ne:\nf:\n  k: 1\ng: |\n  1\nh: 2\n"
    with pytest.raises(SourceError) as wrong:
        with_value(text, place, "20 mg")
    assert str(wrong.value).startswith(f"{place}: {said}")
