"""The benchmarks' own code; no other test imports it."""

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from dose_bench import shipped_powders
from numpy.random import Generator

from benchmarks import dosing_ablation, dosing_random, fleet, rig
from benchmarks.calibration import (
    TABLES,
    Result,
    agrees,
    count,
    departures_of,
    main,
    mean_interval,
    simulated,
    spread_interval,
)
from benchmarks.code_mutator import mutants_of
from benchmarks.dem.bed import collected_mg
from benchmarks.dem.cases import MORTARS, Case, cases
from benchmarks.dosing_ablation import FREE, LISTED, MODULES, Job, changed, jobs_of, measure_listed, read_variant, work
from benchmarks.dosing_tables import RESULTS, page_with_tables, page_with_worth, read
from benchmarks.dosing_worth import AGAIN, AS_IT_IS, filled, noise, worth
from benchmarks.oracle_model import SHUT, Model
from benchmarks.rig import UNWAITING, Setting, Trial, run_of_doses
from harness.random_physics import DrawnFlow, FlowFigures
from harness.random_plants import Drawn, draw
from scuhand_bt.device_specs.hand import HandSpec
from scuhand_bt.dosing import estimation
from scuhand_bt.dosing.controller import LONGEST_UNWEIGHED_S
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.specs import Departure, Powder

pytestmark = pytest.mark.slow
BEADS = TABLES[0]
MSG_20 = next(cell for cell in TABLES if cell.misprint == "time")


@pytest.mark.parametrize(
    ("successes", "rate", "expected"),
    [(10, 1.0, True), (9, 1.0, False), (8, 0.65, True), (4, 0.67, True), (3, 0.67, False), (10, 0.67, False)],
)
def test_a_count_agrees_within_the_two_sided_binomial_region(successes: int, rate: float, expected: bool) -> None:
    assert agrees(BEADS._replace(successes=successes), rate) is expected


def test_the_papers_mean_and_spread_are_known_as_far_as_ten_trials_tell() -> None:
    cell = BEADS._replace(mass_mg=500.5, sd_mg=1.9)
    assert mean_interval(cell) == pytest.approx((499.14, 501.86), abs=0.005)
    assert spread_interval(cell) == pytest.approx((1.307, 3.469), abs=0.005)


def test_a_cell_is_shown_beside_the_papers_and_what_does_not_agree_is_named() -> None:
    near = Result.of(BEADS, [Trial(0.5, -1.0, True, 8, 60.0, "reached")] * 9 + [Trial(5, 4, False, 8, 60.0, "over")])
    assert near.misfits == []
    assert near.row() == (
        "| glass beads | 20 mg | 9.0 (9) | 19.5 (20: 19.1 to 20.9) | 1.58 (1.3: 0.89 to 2.37) | 8.0 (8) | 60 (59) |"
    )
    off = near._replace(rate=0.5, masses_mg=np.array([18.9, 19.1]), steps=11.0, time_s=40.0)
    assert off.misfits == ["success", "mass", "spread", "steps", "time"]
    assert off.row() == (
        "| glass beads | 20 mg | **5.0** (9) | **19.0** (20: 19.1 to 20.9) | **0.14** (1.3: 0.89 to 2.37) "
        "| **11.0** (8) | **40** (59) |"
    )
    assert count([near, off]) == (
        "Cells that agree: success 1 of 2, mass 1 of 2, spread 1 of 2, steps 1 of 2, time 1 of 2."
    )


def test_a_misprinted_figure_is_marked_and_not_held_against_the_simulation() -> None:
    result = Result.of(MSG_20, [Trial(0.0, 0.1 * n - 1.8, True, 14, 100.0, "reached") for n in range(10)])
    assert "time" not in result.misfits
    assert "100 (49†)" in result.row()
    assert "time 0 of 0" in count([result])


@pytest.mark.parametrize("target_mg", [20.0, 500.0])
def test_msg_has_the_papers_mean_and_spread(target_mg: float) -> None:
    cell = next(cell for cell in TABLES if cell.label == "MSG" and cell.target_mg == target_mg)
    trials = [trial for run in range(4) for trial in simulated(cell, run, 10)]
    assert Result.of(cell, trials).misfits == []


def test_the_paper_asks_its_balance_sooner_where_it_does_not_wait() -> None:
    powder = shipped_powders()["glass_beads"]
    waited, at_once = (run_of_doses(powder, 20.0, name, 1, Setting(), 3) for name in ("paper", UNWAITING))
    for long, short in zip(waited, at_once, strict=True):
        assert long.reason == short.reason == "reached"
        assert short.duration_s / short.steps < long.duration_s / long.steps - 4.0


def test_departures_are_named_one_by_one_or_as_a_group() -> None:
    assert departures_of("none") == ()
    assert set(departures_of("all")) - set(departures_of("implied")) == {Departure.GUARD}
    assert departures_of("order,thaw") == (Departure.ORDER, Departure.THAW)
    with pytest.raises(SystemExit):
        main(["--departures", "thaws"])


def test_a_redone_dose_is_judged_by_its_second_attempt_and_takes_both_their_times() -> None:
    powder = shipped_powders()["titanium_dioxide_fine"]
    once = run_of_doses(powder, 20.0, "paper", 5, Setting(), 4)
    twice = run_of_doses(powder, 20.0, "paper", 5, Setting(redo=True), 4)
    for first, last in zip(once, twice, strict=True):
        assert last == first if first.accepted else last.duration_s > first.duration_s
    assert not all(trial.accepted for trial in once)


def model_of(figures: FlowFigures) -> Model:
    return Model(lambda: DrawnFlow(figures), HandSpec(), tolerance_mg=2.0)


def test_the_oracle_ends_a_dose_that_is_good_and_opens_the_wider_the_more_is_missing() -> None:
    model = model_of(FlowFigures(flow_mg_per_s=50.0))
    assert [model.action(missing_mg, SHUT) for missing_mg in (-5.0, -1.0, 0.0, 0.2)] == [SHUT] * 4
    opened = [model.action(missing_mg, SHUT) for missing_mg in (5.0, 20.0, 100.0, 500.0, 3000.0)]
    assert opened == sorted(opened)
    assert SHUT < opened[0] < opened[-1]
    widest = len(model.openings_mm) - 1
    assert model.action(0.5 * model.closings_mg[widest], widest) == SHUT, "too late is shut at once"


def test_of_exponential_lumps_the_oracle_expects_about_as_many_good_as_end_within_the_tolerance() -> None:
    figures = FlowFigures(flow_mg_per_s=10.0, gravity=0.0, lump_share=0.99, lump_mg=4.0)
    good = 1.0 - math.exp(-4.0 / 4.0)  # the first to cross the lower edge is memoryless beyond it
    assert good - 0.05 < model_of(figures).worth(40.0) < good + 0.1  # the best of 16 samples flatters itself


def test_the_oracle_does_not_shake_crystals_that_would_come_in_avalanches() -> None:
    crystals = shipped_powders()["monosodium_glutamate"]
    trials = run_of_doses(crystals, 500.0, "oracle", 0, Setting())
    assert all(abs(trial.true_error_mg) <= 2.0 for trial in trials)


class BridgesUntilShaken:
    """A plant whose powder flows by itself, and bridges once in 10 mg until it was shaken for a second.

    Shaken it comes in lumps of 6 mg, so that nobody would shake it who need not.
    """

    class Flow:
        def __init__(self) -> None:
            self._stands_s = 0.0

        def step(self, dt_s: float, opening_mm: float, vibration: float, in_cone_mg: float, rng: Generator) -> float:
            if self._stands_s > 0.0:
                self._stands_s -= vibration * dt_s
                return 0.0
            leaving_mg = 30.0 * opening_mm**2.5 * dt_s
            if vibration > 0.0:
                leaving_mg = 6.0 if rng.random() < leaving_mg / 6.0 else 0.0
            leaving_mg = min(leaving_mg, in_cone_mg)
            if rng.random() < leaving_mg / 10.0:
                self._stands_s = 1.0
            return leaving_mg

    def flow(self, powder: Powder) -> Flow:
        return self.Flow()


def test_the_oracle_shakes_what_stands_as_a_bridge_until_it_is_shaken() -> None:
    setting = Setting(plant=f"{__name__}:BridgesUntilShaken")
    trials = run_of_doses(shipped_powders()["glass_beads"], 20.0, "oracle", 0, setting, doses=4)
    assert [trial.reason for trial in trials] == ["reached"] * 4
    assert all(abs(trial.true_error_mg) <= 2.0 for trial in trials)


def judged_plants(family: str) -> list[Drawn]:
    """Where the better of two shows within some dozens of doses.

    Of exponential lumps the first to cross the lower edge is good or not by chance, whoever doses; and with few plants
    of others one lump in a hundred doses decides.
    """
    if family != "lumps":
        return draw(family, shipped_powders(), 3)
    return [drawn for drawn in draw(family, shipped_powders(), 12) if drawn.flow.lump_kind != "exponential"]


@pytest.mark.parametrize(
    ("family", "target_mg", "count"), [("beads", 500.0, 4), ("clogging", 20.0, 4), ("lumps", 50.0, 8)]
)
def test_the_oracle_is_as_good_as_adaptive_on_each_plant_and_faster(family: str, target_mg: float, count: int) -> None:
    def of(controller: str) -> tuple[int, float]:
        doses = [
            dose
            for drawn in judged_plants(family)
            for dose in dosing_random.run_of_doses(drawn, [target_mg] * count, controller)
        ]
        return sum(abs(dose.error_mg) <= 2.0 for dose in doses), sum(dose.duration_s for dose in doses)

    (most, least_s), (good, taken_s) = of("oracle"), of("adaptive")
    assert most >= good
    assert least_s < taken_s


CODE = '''
"""A text is left alone: 1 < 2."""
LIMIT_MG = 50.0

class Pan:
    def is_over(self, mass_mg: float | None = None) -> bool:
        if mass_mg is None or not self.there:
            raise ValueError(f"{mass_mg + 1} mg")
        return mass_mg > LIMIT_MG

    def clear(self):
        self.count += 1
        self.stop()
'''


def test_code_has_a_mutant_for_each_thing_that_may_be_wrong_in_it() -> None:
    assert [mutant.name for mutant in mutants_of(CODE)] == [
        "LIMIT_MG: 50.0 in `LIMIT_MG = 50.0` -> 100.0",
        "LIMIT_MG: 50.0 in `LIMIT_MG = 50.0` -> 25.0",
        "Pan.is_over: mass_mg is None or not self.there -> not self.there",
        "Pan.is_over: mass_mg is None or not self.there -> mass_mg is None",
        "Pan.is_over: mass_mg is None -> mass_mg is not None",
        "Pan.is_over: not self.there -> self.there",
        "Pan.is_over: raise ValueError(f'{mass_mg + 1} mg') -> pass",
        "Pan.is_over: return mass_mg > LIMIT_MG -> return None",
        "Pan.is_over: mass_mg > LIMIT_MG -> mass_mg >= LIMIT_MG",
        "Pan.is_over: mass_mg > LIMIT_MG -> mass_mg <= LIMIT_MG",
        "Pan.clear: self.count += 1 -> self.count -= 1",
        "Pan.clear: 1 in `self.count += 1` -> 2",
        "Pan.clear: self.stop() -> pass",
    ]


def test_a_mutant_is_the_file_with_that_one_change() -> None:
    over = next(mutant for mutant in mutants_of(CODE, ["Pan.is_over"]) if mutant.after.endswith(">= LIMIT_MG"))
    assert over.source == CODE.replace("mass_mg > LIMIT_MG", "(mass_mg >= LIMIT_MG)")
    assert {mutant.function for mutant in mutants_of(CODE, ["LIMIT_MG", "Pan.clear"])} == {"LIMIT_MG", "Pan.clear"}


DEM = json.loads((Path(__file__).parent.parent / "benchmarks" / "dem_results.json").read_text())
JUDGED = [name for name, row in DEM["cases"].items() if name.endswith(" deg")]


@pytest.mark.parametrize("name", JUDGED)
def test_the_height_field_collects_what_the_discrete_elements_do_within_a_fifth(name: str) -> None:
    row = DEM["cases"][name]
    mortar = next(one for one in MORTARS if one.name == row["mortar"])
    way = DEM["ways"][row["ways"][0]]
    found = collected_mg(Case(name, mortar, row["fill_mg"], *row["friction_deg"], (way,)), row["fill_mg"])
    assert found.collected_mg[0] == pytest.approx(row["collected_mg"][0], rel=0.2)
    assert found.collected_mg == pytest.approx(row["height_field_mg"], rel=0.01), "as the docs have it"


def test_discrete_elements_have_judged_the_strokes_that_are_made_today() -> None:
    for case in cases():
        judged = [DEM["ways"][number] for number in DEM["cases"][case.name]["ways"]]
        for way, today in zip(judged, case.strokes, strict=True):
            assert len(way["times_s"]) == len(today["times_s"]), f"run `benchmarks.dem --only '{case.name}'`"
            for name, close in (("apex_mm", 0.1), ("axis", 0.002), ("rim_mm", 0.1)):
                np.testing.assert_allclose(today[name], way[name], atol=close, err_msg=case.name)


STROKES = json.loads((Path(__file__).parent.parent / "benchmarks" / "strokes_results.json").read_text())


def test_by_anothers_kinematics_the_lip_is_on_its_wall_and_the_apex_off_it() -> None:
    assert len(STROKES["each"]) >= 20
    assert {row["mortar"] for row in STROKES["each"]} == {"agate_mortar", "small_agate_mortar"}
    assert min(row["looked_at"] for row in STROKES["each"]) > 100
    assert max(row["lip_off_mm"] for row in STROKES["each"]) < 0.3
    assert min(row["apex_mm"] for row in STROKES["each"]) > 3.0 - 0.01
    assert max(row["attack_off_deg"] for row in STROKES["each"]) < 3.0


@pytest.mark.parametrize("mortar", ["agate_mortar", "small_agate_mortar"])
@pytest.mark.parametrize("way", ["dry run", "twins"])
def test_arm_and_roller_were_beside_each_other(way: str, mortar: str) -> None:
    row = STROKES[f"{way}, {mortar}"]
    assert row["looked_at"] > 100
    assert row["most_ms"] < 20.0
    assert row["most_rim_mm"] < 1.0


def test_an_ablation_changes_a_constant_wherever_the_law_uses_it_and_gives_it_back() -> None:
    using = [module for module in MODULES if hasattr(module, "RISK")]
    assert len(using) > 1
    with changed(read_variant("constraint.RISK=0.1,estimation.CHANGE_S=(0.3,9)")):
        assert {module.RISK for module in using} == {0.1}
        assert estimation.CHANGE_S == (0.3, 9)
    assert {module.RISK for module in using} == {0.005}
    assert estimation.CHANGE_S == (0.3, 3.0)


def test_doses_of_a_variant_differ_and_those_of_other_seeds_too() -> None:
    job = Job(20.0, "glass_beads", 0, None, 1)
    as_it_is = work({}, job)
    assert work({}, job) == as_it_is
    assert work({"knowledge.AIM_UNDER_MG": 1.0}, job) != as_it_is
    assert work({}, job._replace(run=1)) != as_it_is
    assert work({}, job._replace(streaming=False)) != as_it_is


def test_a_listed_run_that_was_broken_off_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    small = FREE._replace(targets_mg=(20.0,), families=("beads",), powders=("glass_beads",), doses=1, plants=1)
    listed = tmp_path / "listed.yaml"
    listed.write_text("small: [knowledge.AIM_UNDER_MG=1]\n")
    monkeypatch.setattr(dosing_ablation, "LISTED", listed)
    monkeypatch.setattr(dosing_ablation, "WORLDS", {"small": small})
    results = tmp_path / "results.json"
    results.write_text(json.dumps({f"small | shipped | {AS_IT_IS} | glass_beads | 20": {"doses": 7}}))
    measure_listed(results, processes=1)
    kept = json.loads(results.read_text())
    assert len(kept) == 6
    assert [of["doses"] for of in kept.values()] == [7, 2, 1, 2, 1, 2]


def fails(*_: object) -> None:
    raise SkillFailed(Code.BALANCE_UNSTABLE, "no stable reading")


def test_a_dose_that_no_bare_pan_has_confirmed_is_not_told_good(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rig, "take_container_away", fails)
    (trial,) = run_of_doses(shipped_powders()["glass_beads"], 20.0, "adaptive", 1, Setting(), 1)
    assert abs(trial.true_error_mg) < 2.0
    assert not trial.accepted


def test_the_paper_is_not_held_up_by_a_watch_that_its_experiments_had_not() -> None:
    (trial,) = run_of_doses(shipped_powders()["glass_beads"], 20.0, "paper", 1, Setting(), 1)
    assert trial.duration_s > LONGEST_UNWEIGHED_S, "in a lab its pan is watched by then"
    assert trial.duration_s / trial.steps == pytest.approx(7.2, rel=0.06), "its Table II, and the valve's time open"


def test_a_balance_that_weighs_no_dish_gives_no_dose(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dosing_random, "Bench", fails)
    (drawn,) = draw("beads", shipped_powders(), 1)
    assert dosing_random.run_of_doses(drawn, [20.0, 20.0], "adaptive") == []


def test_each_listed_variant_is_of_constants_that_the_law_has() -> None:
    for variants in yaml.safe_load(LISTED.read_text()).values():
        assert all(read_variant(text) for text in variants)


def test_other_seeds_are_other_runs_and_the_same_plants() -> None:
    shipped, others = (jobs_of(FREE, False, other=other)["glass_beads", 20.0] for other in (0, 5000))
    assert [job.run for job in others] == [job.run + 5000 for job in shipped]
    plants, again = (jobs_of(FREE, True, other=other)["msg", 500.0] for other in (0, 5000))
    assert [job.drawn.flow for job in plants] == [job.drawn.flow for job in again]
    assert [job.drawn.seed + 5000 for job in plants] == [job.drawn.seed for job in again]


FIGURES = {
    "doses": 100, "true": 98.0, "over": 1, "beyond_20mg": 0, "out": 0, "reported": 97,
    "mean_mg": -0.1, "sd_mg": 0.5, "mean_s": 10.0, "sd_s": 2.0,
}  # fmt: skip


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({}, "no dose differs"),
        ({"true": 96.0, "over": 3, "mean_mg": -0.05, "mean_s": 10.1}, "within noise"),
        ({"true": 90.0, "over": 8}, "success -8.0 points, too much 8 instead of 1"),
        ({"beyond_20mg": 5, "out": 5}, "> 20 mg 5 instead of 0, false 'in tolerance' 5 instead of 0"),
        ({"mean_mg": 0.1, "mean_s": 12.0}, "mean error +0.20 mg, time x 1.20"),
        ({"reported": 80}, "reported good -17.0 points"),
    ],
)
def test_worth_is_told_where_it_is_more_than_chance(changed: dict[str, float], told: str) -> None:
    assert worth([(FIGURES, FIGURES | changed)]) == told


@pytest.mark.parametrize(
    "words",
    ["--days 0", "--seeds 0", "--draw 0", "--queue 0", "--queue 999", "--chaos 0", "--draw 1 --queue 1000", ""],
)
def test_a_fleet_of_nothing_is_refused_and_its_results_stay(
    words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`--draw 0` simulated the fleets anew, and wrote them over what there was."""
    kept = tmp_path / "kept.json"
    kept.write_text('{"fleets": 1}', encoding="utf-8")
    with pytest.raises(SystemExit) as ended:
        fleet.main([*words.split(), "--json", str(kept)])
    assert ended.value.code == 2
    assert re.search("it is at least|not allowed with|has no dry runs", capsys.readouterr().err)
    assert kept.read_text(encoding="utf-8") == '{"fleets": 1}'


def test_of_other_dry_runs_no_fleet_is_told_any_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = tmp_path / "kept.json"
    kept.write_text('{"fleets": 1, "assumed": 2, "queue": 3}', encoding="utf-8")
    monkeypatch.setattr(fleet, "draw", lambda seeds: [])
    with pytest.raises(SystemExit):
        fleet.main(["--draw", "1", "--json", str(kept)])
    assert json.loads(kept.read_text(encoding="utf-8")) == {"queue": 3, "kinds": []}


def test_the_table_of_constants_is_filled_from_the_results() -> None:
    of = {
        f"free | shipped | {AS_IT_IS} | beads | 20": FIGURES,
        f"free | shipped | {AGAIN} | beads | 20": FIGURES | {"over": 2, "mean_s": 10.1},
        "free | shipped | knowledge.FOLLOWS=0 | beads | 20": FIGURES | {"true": 90.0},
        f"free | randomised | {AS_IT_IS} | beads | 20": FIGURES,
        f"free | randomised | {AS_IT_IS} | beads | 50": FIGURES,
        "free | randomised | knowledge.FOLLOWS=0 | beads | 50": FIGURES | {"true": 89.0},
    }
    row = "| `FOLLOWS` | 0.04 | how far | tuned | {} | {} |\n| `RISK` | 0.005 | chance | specified |  |  |\n"
    missing = "| `SLOWER` | 0.7 | how low | tuned | {0} | {0} |\n"
    marks = "<!-- noise -->\n{}\n<!-- end of noise -->\nrest"
    listed = {"free": ["knowledge.FOLLOWS=0", "knowledge.SLOWER=0"]}
    told = noise(of, listed)
    assert told == (
        "* `free`, shipped: 100 doses; noise is 4.0 points, 0.14 mg and 6 % of the time; "
        "other seeds alone: too much 2 instead of 1, time x 1.01."
    )
    page = filled(row.format("", "") + missing.format("") + marks.format("old"), of, listed)
    assert page == (
        row.format("`FOLLOWS=0`: success -8.0 points", "`FOLLOWS=0`: success -9.0 points (100 doses)")
        + missing.format("`SLOWER=0`: not measured yet")
        + marks.format(told)
    )


def test_what_constants_are_worth_is_as_it_was_measured() -> None:
    page = (Path(__file__).parent.parent / "docs" / "dosing-constants.md").read_text(encoding="utf-8")
    assert page_with_worth(page) == page


def test_the_tables_of_the_dosing_benchmark_are_as_they_were_measured() -> None:
    page = (Path(__file__).parent.parent / "docs" / "dosing-benchmark.md").read_text(encoding="utf-8")
    assert page_with_tables(page, read(RESULTS)) == page


@pytest.mark.parametrize(
    "text", ["constraint.RISKS=0.1", "valve.GRAIN_S=0.1", "constraint.chance=1", "constraint.RISK=x"]
)
def test_an_ablation_of_what_is_no_constant_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"no constant|no value"):
        read_variant(text)
