"""What a study varies: designs and their ranges, what a figure depends on, and files that vary nothing sensible."""

from dataclasses import replace
from pathlib import Path
from unittest.mock import MagicMock

import pytest
from study_bench import FLOW, RECIPE

from scuhand_bt.cli.study import tell_dominant
from scuhand_bt.problems import SourceError
from scuhand_bt.study.trial import Setup
from scuhand_bt.study.vary import Vary, goes_with, means_of, read_vary
from tests.conftest import Call

pytestmark = pytest.mark.usefixtures("no_ways")

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
    assert ("These shares are rough: some" in capsys.readouterr().out) is is_rough


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
        ("{design: sobol, draws: 12, vary: {a.b: [x]}}", "a sobol design needs a power of two"),
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
    assert str(draws) == f"{path}:2:8: 'draws': '3' is not accepted; a sobol design needs a power of two"
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
