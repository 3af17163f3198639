"""What trials say of a plan: the odds of its samples, and how long it takes and what it uses, with intervals."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from study_bench import RECIPE, fake

from scuhand_bt.cli.study import tell_odds
from scuhand_bt.lab import load_lab
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.sim.response import OurBalanceResponse
from scuhand_bt.study.odds import Chance, odds_of
from scuhand_bt.study.some_cell import SomeCell
from scuhand_bt.study.trial import Setup


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
        "By 2 dry runs, too few for an interval (ranges are of these runs): "
        "it takes 9 min 00 s (5 min 00 s to 13 min 00 s)." in said
    )
    tell_odds(odds_of(plan, [fake(seed, 300.0, "abc") for seed in range(3)]))
    said = " ".join(capsys.readouterr().out.split())
    assert "By 3 dry runs (intervals of 90 %): it takes" in said
    assert "Leftovers are what each run estimates, by what its scoops should bring: no interval says" in said


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


def test_a_sample_that_never_failed_in_a_few_trials_is_not_warned_of(setup: Setup) -> None:
    lab = load_lab(setup.lab)
    plan = make_plan(load_recipe(setup.recipe, lab), lab)
    odds = odds_of(plan, [fake(seed, 600.0, "abc") for seed in range(4)])
    assert isinstance(odds.samples["c"], Chance)
    assert 0.9 < odds.samples["c"].probability < 1.0
    assert (odds.unlikely, odds.codes) == ([], {})
    assert odds_of(plan, [fake(0, 600.0, "abc")]).unlikely == []
    assert odds_of(plan, [fake(0, 600.0, "ab")]).unlikely == ["c"]
