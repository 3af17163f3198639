"""A search for what is better: what counts as better, where it begins, and what it proposes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from study_bench import FLOW, RECIPE, Inline

from scuhand_bt.study.change import changed
from scuhand_bt.study.optimise import Found, diff, is_better, optimised
from scuhand_bt.study.store import open_store
from scuhand_bt.study.trial import SampleTrial, Setup, Trial
from scuhand_bt.study.vary import Vary, check_setups


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
