"""What a plan's night holds."""

import json
import math
from dataclasses import replace
from datetime import timedelta

import pytest
from conftest import REPOSITORY, Call, Desk, LabFolder

from scuhand_bt.problems import SourceError
from scuhand_bt.recipe.plan import Plan, make_plan
from scuhand_bt.study.night import fates, in_words, likely_better, read_night
from scuhand_bt.study.odds import Odds, odds_of
from scuhand_bt.study.stays import stays_in_words, unforeseen_in_words
from scuhand_bt.study.trial import SampleTrial, Setup, Trial, trial

NIGHT = read_night("20:00-08:00")
RECIPE = """recipe: two
workflow: fill_xrd_holder
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 5 g}
  msg: {station: mortar_bay_2, container: agate_mortar, powder: monosodium_glutamate, amount: 5 g}
defaults: {container: xrd_holder, mass: 50 mg}
samples:
  - {id: a, source: beads}
  - {id: m, source: msg, repeat: 3}
"""


@pytest.fixture
def plan(desk: Desk) -> Plan:
    return make_plan(desk.load(RECIPE), desk.lab)


def trial_of(plan: Plan, job_s: float) -> Trial:
    """Each job takes as long."""
    samples = tuple(
        SampleTrial(one.id, True, True, "in tolerance", None, 50.0, 50.0, 50.0, job_s) for one in plan.recipe.samples
    )
    began_s = {job.name: job_s * number for number, job in enumerate(plan.jobs)}
    return Trial(
        0,
        0,
        job_s * len(plan.jobs),
        began_s,
        samples,
        dict.fromkeys(plan.recipe.sources, 1),
        {"beads": 1.0, "msg": 1.0},
        {"beads": {}, "msg": {}},
    )


def tried(plan: Plan, job_s: float) -> Odds:
    """What eight such trials tell."""
    return odds_of(plan, [trial_of(plan, job_s)] * 8)


@pytest.mark.parametrize(
    ("text", "lasts"), [("20:00-08:00", timedelta(hours=12)), ("9:30 - 17:00", timedelta(hours=7.5))]
)
def test_a_night_may_end_on_the_next_day(text: str, lasts: timedelta) -> None:
    assert read_night(text).lasts_s == lasts.total_seconds()


@pytest.mark.parametrize("text", ["", "20:00", "25:00-08:00", "8pm-6am"])
def test_what_is_no_night_is_refused(text: str) -> None:
    with pytest.raises(SourceError, match="is not a night; write hours such as 20:00-08:00"):
        read_night(text)


def test_a_night_that_ends_when_it_begins_is_refused() -> None:
    """It was taken for 24 hours."""
    with pytest.raises(SourceError, match="'20:00-20:00' ends when it begins"):
        read_night("20:00-20:00")


def test_the_same_time_of_another_day_is_told_with_the_days_that_have_gone_by(plan: Plan) -> None:
    """25 hours after eight in the evening was told as one hour after it."""
    (said,) = stays_in_words(plan, odds_of(plan, [trial_of(plan, 25.0 * 3600.0)] * 8), read_night("20:00-08:00"))
    assert said == "So a person comes 2 times: for the start, and from 19:01 to 23:09 (+1 d) (1 moment)."


def test_a_sample_behind_a_moment_that_needs_a_person_is_not_done(plan: Plan, desk: Desk) -> None:
    odds = odds_of(plan, [trial_of(plan, 600.0)] * 8)
    found = {fate.sample: fate.why for fate in fates(plan, odds, read_night("20:00-08:00"))}
    assert found["a"] is None
    assert "swap the sheet" in (found["m-1"] or "")
    told = list(in_words(plan, desk.lab, odds, read_night("20:00-08:00"), lambda made: tried(made, 600.0)))
    assert told[0].startswith("In a night from 20:00 to 08:00 (12 h 00 min) with nobody there: 1 of 4 samples")
    assert told[1].startswith("Not m-1, m-2, m-3: a person is needed before, at 'change powder to")


def test_of_many_samples_that_are_not_done_the_first_and_the_last_are_named(desk: Desk) -> None:
    plan = make_plan(desk.load(RECIPE.replace("repeat: 3", "repeat: 23")), desk.lab)
    told = list(in_words(plan, desk.lab, tried(plan, 600.0), NIGHT, lambda made: tried(made, 600.0)))
    assert told[1].startswith("Not m-01, m-02, m-03, …, m-23 (23 samples): a person is needed before")


def test_all_that_a_person_is_needed_for_at_a_moment_is_said(plan: Plan) -> None:
    swap = next(person for person in plan.persons if person.job is not None)
    both = replace(plan, persons=(*plan.persons, replace(swap, what="refill 'a'")))
    found = {fate.sample: fate.why for fate in fates(both, tried(plan, 600.0), NIGHT)}
    assert str(found["m-1"]).endswith(f": {swap.what}; refill 'a'")


def test_no_job_is_told_to_begin_before_one_that_comes_before_it(plan: Plan) -> None:
    """Of three dry runs the slow one was stopped before the last sample: that began after 11 min, that before it 12."""
    slow, quick = trial_of(plan, 600.0), trial_of(plan, 100.0)
    stopped = replace(slow, began_s=dict([*slow.began_s.items()][:-2]))
    odds = odds_of(plan, [stopped, replace(stopped, seed=1), quick])
    began_s = [*odds.began_s.values()]
    for name in ("low", "middle", "high"):
        times_s = [getattr(one, name) for one in began_s]
        assert times_s == sorted(times_s)


def test_a_sample_that_ends_too_late_is_not_done(desk: Desk) -> None:
    plan = make_plan(desk.load(RECIPE.replace("source: beads}", "source: msg}")), desk.lab)
    odds = odds_of(plan, [trial_of(plan, 600.0)] * 8)
    done = [fate.why is None for fate in fates(plan, odds, read_night("20:00-20:25"))]
    assert done == [True, True, False, False], "the second ends after 20 minutes, give or take some"


def test_a_night_until_the_last_sample_is_said_to_be_done_holds_as_many(desk: Desk) -> None:
    """Said to be done by 20:22, it is by 20:22:25, and in a night until then was not."""
    plan = make_plan(desk.load(RECIPE.replace("source: beads}", "source: msg}")), desk.lab)
    odds = odds_of(plan, [trial_of(plan, 607.0)] * 8)
    said, *_ = in_words(plan, desk.lab, odds, read_night("20:00-20:25"), lambda _: odds)
    assert "2 of 4 samples, the last by " in said
    by = said.partition("the last by ")[2].partition(".")[0]
    assert sum(fate.why is None for fate in fates(plan, odds, read_night(f"20:00-{by}"))) == 2


def test_no_sample_is_done_before_one_that_comes_before_it(desk: Desk) -> None:
    """Of dry runs that differ at first the second sample was done by 20:18, and the first perhaps not at 20:20."""
    plan = make_plan(desk.load(RECIPE.replace("source: beads}", "source: msg}")), desk.lab)
    found = []
    for first_s in (100.0, 300.0, 900.0):
        whole = trial_of(plan, 300.0)
        began_s = dict(zip(whole.began_s, (0.0, first_s, 1000.0, 1010.0, 1020.0), strict=True))
        found.append(replace(whole, began_s=began_s, duration_s=1030.0))
    fate, *others = fates(plan, odds_of(plan, found), read_night("20:00-20:20"))
    assert (fate.why, [one.why for one in others]) == ("it may take longer", ["it may take longer"] * 3)
    assert {one.done_s for one in others} == {fate.done_s}


def test_an_order_that_lets_more_be_done_is_named(plan: Plan, desk: Desk) -> None:
    odds = odds_of(plan, [trial_of(plan, 600.0)] * 8)
    said = list(in_words(plan, desk.lab, odds, NIGHT, lambda made: tried(made, 600.0)))
    assert said[-1] == "With `order: persons_together` it would be 3, by the same number of dry runs."


def test_another_order_is_named_only_for_what_its_own_dry_runs_say(plan: Plan, desk: Desk) -> None:
    odds = odds_of(plan, [trial_of(plan, 600.0)] * 8)

    def apart(made: Plan) -> Odds:
        assert [job.name for job in made.jobs[:3]] == ["m-1", "m-2", "m-3"]
        return odds_of(made, [trial_of(made, time_s) for time_s in (300.0, 700.0, 1200.0)])  # it tells little

    hours = read_night("20:00-21:00")
    said = list(in_words(plan, desk.lab, odds, hours, apart))
    assert "1 of 4 samples" in said[0]
    assert not any(line.startswith("With") for line in said)


def test_an_order_is_not_named_that_does_no_more_than_is_said_to_be_done(desk: Desk) -> None:
    beads = "  - {id: [y, z], workflow: characterise, container: alumina_crucible, mass: 1 g, source: beads}\n"
    recipe = f"{RECIPE.replace('  - {id: a, source: beads}', '').replace('repeat: 3', 'repeat: 2')}{beads}"
    plan = make_plan(desk.load(recipe.replace("workflow", "order: persons_together\nworkflow", 1)), desk.lab)
    assert [job.name for job in plan.jobs][:2] == ["y", "z"], "which take longer, by the forecast of skills"
    odds = odds_of(plan, [trial_of(plan, 600.0)] * 8)
    hours = read_night("20:00-20:22")
    better = likely_better(plan, desk.lab, odds, hours)
    assert better is not None
    assert better.recipe.order == "by_powder"
    said = list(in_words(plan, desk.lab, odds, hours, lambda made: tried(made, 600.0)))
    assert "2 of 4 samples" in said[0]
    assert not any(line.startswith("With") for line in said)


def test_moments_soon_after_each_other_are_one_stay(plan: Plan, desk: Desk) -> None:
    (_, swap, *_), job_s = plan.jobs, 600.0
    odds = odds_of(plan, [trial_of(plan, job_s)] * 8)
    assert swap.name.startswith("change powder")
    (said,) = stays_in_words(plan, odds, read_night("20:00-08:00"))
    assert said == "So a person comes 1 time: from the start until 20:11 (1 moment)."
    (said,) = stays_in_words(plan, odds, None)
    assert said == "So a person comes 1 time: from the start until 10 min 51 s after it (1 moment)."
    odds = odds_of(plan, [trial_of(plan, 4.0 * job_s)] * 8)
    (said,) = stays_in_words(plan, odds, read_night("20:00-08:00"))
    assert said == "So a person comes 2 times: for the start, and from 20:36 to 20:44 (1 moment)."
    odds = odds_of(plan, [trial_of(plan, 12.0 * job_s)] * 8)
    latest_s = max(when.high for _, when in odds.persons_s(plan) if when is not None)
    hours, minutes = divmod(math.ceil(latest_s / 60.0), 60)
    assert f" to {hours} h {minutes:02d} min after it (1 moment)." in next(stays_in_words(plan, odds, None))


@pytest.mark.parametrize(
    ("job_s", "comes", "moments"),
    [(300.0, "1 time: from the start until ", "3 moments"), (2000.0, "4 times: for", "1 moment")],
)
def test_persons_come_twice_where_what_needs_them_is_close_together(
    desk: Desk, job_s: float, comes: str, moments: str
) -> None:
    recipe = RECIPE.replace("id: m, source: msg, repeat: 3", "id: [m, b], source: [msg, beads]")
    plan = make_plan(
        desk.load(f"{recipe}  - {{id: n, source: msg}}\n".replace("workflow: f", "order: as_written\nworkflow: f")),
        desk.lab,
    )
    odds = odds_of(plan, [trial_of(plan, job_s)] * 8)
    (said,) = stays_in_words(plan, odds, None)
    assert said.startswith(f"So a person comes {comes}")
    assert said.endswith(f"({moments}).")


def test_each_moment_of_a_job_comes_when_dry_runs_have_asked_for_it(plan: Plan) -> None:
    """Three containers that a person puts on the pan for one sample were all told when the first one is."""
    swap = next(person for person in plan.persons if person.job is not None)
    job, whole = str(swap.job), trial_of(plan, 600.0)
    of_three = replace(plan, persons=(swap, replace(swap, what="b"), replace(swap, what="c")))
    asked = replace(whole, asked_s={job: [[610.0, 610.0], [700.0, 760.0], [3000.0, 3060.0]]})
    more = replace(whole, asked_s={job: [[610.0, 3060.0], [620.0, 680.0], [710.0, 770.0], [2900.0, 2960.0]]})

    def told(made: Plan, trials: list[Trial]) -> list[tuple[int, int, int]]:
        found = [when for _, when in odds_of(made, trials).persons_s(made) if when is not None]
        return [(round(when.low), round(when.middle), round(when.high)) for when in found]

    each = [(562, 610, 662), (645, 700, 825), (2763, 3000, 3322)]
    assert told(of_three, [*[asked] * 7, more]) == each
    assert told(of_three, [asked, asked]) == [(610, 610, 610), (700, 700, 760), (3000, 3000, 3060)]
    assert told(of_three, [whole] * 8) == [(553, 600, 651)] * 3, "nobody was asked: when the job begins"
    unknown = (562, 610, 3322)
    assert told(plan, [asked] * 8) == [unknown], "an action that asks unforeseen: nobody knows which is which"
    assert told(of_three, [asked, asked, *[more] * 6]) == [unknown] * 3, "of too few"
    (said,) = stays_in_words(of_three, odds_of(of_three, [asked] * 8), None)
    assert said.startswith("So a person comes 2 times: from the start until 13 min 45 s after it (2 moments), and ")
    assert said.endswith(" (1 moment).")


def test_no_moment_is_told_to_be_over_before_one_that_comes_before_it(plan: Plan) -> None:
    """Of few dry runs that differ at first the second one was over by 17:26, and the first by 17:56."""
    swap = next(person for person in plan.persons if person.job is not None)
    job, whole = str(swap.job), trial_of(plan, 600.0)
    made = replace(plan, persons=(swap, replace(swap, what="b"), replace(swap, what="c")))
    asked_s = [[[at_s, at_s], [4000.0 + at_s / 1e4, 4000.0], [6000.0, 6000.0]] for at_s in (1000.0, 2000.0, 3900.0)]
    odds = odds_of(made, [replace(whole, asked_s={job: spans}) for spans in asked_s])
    first, second, third = (when for _, when in odds.persons_s(made) if when is not None)
    assert odds.moments_s[job][1].high < first.high, "by itself"
    assert second.low > first.low
    assert (second.middle, second.high) == (odds.moments_s[job][1].middle, first.high)
    assert third.high == first.high, "nor any behind it"


def test_no_moment_is_told_to_come_before_one_that_comes_before_it(plan: Plan) -> None:
    swap = next(person for person in plan.persons if person.job is not None)
    job, whole = str(swap.job), trial_of(plan, 600.0)
    made = replace(plan, persons=(swap, replace(swap, what="b")))
    asked_s = [[[1000.0, 1000.0], [at_s, at_s]] for at_s in (1001.0, 1010.0, 3000.0)]
    odds = odds_of(made, [replace(whole, asked_s={job: spans}) for spans in asked_s])
    first, second = (when for _, when in odds.persons_s(made) if when is not None)
    assert odds.moments_s[job][1].low < first.low, "by itself"
    assert (second.low, second.high) == (first.low, odds.moments_s[job][1].high)


def test_a_plan_that_needs_nobody_says_nothing_of_stays(desk: Desk) -> None:
    plan = make_plan(desk.load(RECIPE.replace("source: beads}", "source: msg}")), desk.lab)
    assert not list(stays_in_words(plan, odds_of(plan, [trial_of(plan, 600.0)] * 8), None))


def test_a_night_says_of_what_no_dry_run_has_come_to_that_none_has(plan: Plan) -> None:
    stopped = trial_of(plan, 60.0)
    began_s = {plan.jobs[0].name: 0.0}
    found = {fate.sample: fate for fate in fates(plan, odds_of(plan, [replace(stopped, began_s=began_s)]), NIGHT)}
    assert (found["a"].done_s, found["a"].why) == (None, "every dry run has stopped before its end")
    assert "a person is needed before" in str(found["m-1"].why)


def test_a_sample_that_some_dry_runs_have_stopped_before_is_counted_only_if_19_of_20_have_not(desk: Desk) -> None:
    plan = make_plan(desk.load(RECIPE.replace("source: beads}", "source: msg}")), desk.lab)
    whole = trial_of(plan, 60.0)
    stopped = replace(whole, began_s={job.name: whole.began_s[job.name] for job in plan.jobs[:2]})
    for many, why in ((1, None), (2, "2 of 20 dry runs have stopped before its end")):
        odds = odds_of(plan, [*[whole] * (20 - many), *[stopped] * many])
        assert [fate.why for fate in fates(plan, odds, NIGHT)] == [None, why, why, why]


def test_a_last_sample_that_stops_the_run_is_not_done(desk: Desk) -> None:
    recipe = "recipe: none\nworkflow: weigh_blank\nsamples:\n  - {id: blank, container: xrd_holder, repeat: 2}\n"
    plan = make_plan(desk.load(recipe), desk.lab)
    whole = trial_of(plan, 60.0)
    for exit_code, why in ((0, None), (1, None), (3, "every dry run has stopped before its end")):
        odds = odds_of(plan, [replace(whole, exit_code=exit_code)] * 4)
        assert [fate.why for fate in fates(plan, odds, NIGHT)] == [None, why], "no job of the plan's follows it"


def test_fewer_dry_runs_than_show_what_stops_one_of_twenty_are_said_to_be_so(desk: Desk) -> None:
    plan = make_plan(desk.load(RECIPE.replace("source: beads}", "source: msg}")), desk.lab)
    rare = "4 dry runs may not show what stops one run in 20: use more `--trials`."
    for many in (4, 20):
        odds = odds_of(plan, [trial_of(plan, 60.0)] * many)
        (said,) = in_words(plan, desk.lab, odds, NIGHT, lambda made: tried(made, 60.0))
        assert "4 of 4 samples" in said
        assert said.endswith(rare) == (many == 4)


def test_what_a_dry_run_asks_a_person_nobody_answers_at_night(desk: Desk) -> None:
    plan = make_plan(desk.load(RECIPE.replace("source: beads}", "source: msg}")), desk.lab)
    whole = trial_of(plan, 60.0)
    asked = replace(whole, asked_s={"m-2": [[150.0, 150.0]]})
    for many, why in ((1, None), (2, "in 2 of 20 dry runs a person was asked for something before its end")):
        odds = odds_of(plan, [*[whole] * (20 - many), *[asked] * many])
        assert [fate.why for fate in fates(plan, odds, NIGHT)] == [None, None, why, why]


def test_a_plan_tells_where_dry_runs_asked_a_person_for_what_it_does_not_know_of(plan: Plan) -> None:
    change = "change powder to monosodium_glutamate for m-1"
    whole = trial_of(plan, 60.0)
    assert [*unforeseen_in_words(plan, odds_of(plan, [replace(whole, asked_s={change: [[70.0, 70.0]]})] * 4))] == []
    odds = odds_of(
        plan, [whole, whole, whole, replace(whole, asked_s={change: [[70.0, 70.0]], "m-2": [[150.0, 150.0]]})]
    )
    (said,) = unforeseen_in_words(plan, odds)
    assert said.startswith("In dry runs a person was also asked for something at m-2, which may not happen: ")


@pytest.mark.slow
def test_dry_runs_of_another_order_are_in_that_order(lab_folder: LabFolder) -> None:
    setup = Setup(lab_folder.write("recipes/two.yaml", RECIPE), lab_folder.folder, order="persons_together")
    assert list(trial(setup, 0).began_s)[:3] == ["m-1", "m-2", "m-3"]


ASKING = """recipe: asking
workflow: fails
sources: {beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 5 g}}
samples:
  - {id: a, source: beads}
on_failure: {otherwise: ask}
"""


def test_a_trial_says_when_a_person_was_asked(lab_folder: LabFolder) -> None:
    tree = "tree: {timeout: {duration: 5 s, child: {wait: {duration: 10 s}}}}\n"
    lab_folder.write("trees/fails.yaml", f"workflow: fails\ninputs: {{source: Source}}\n{tree}")
    one = trial(Setup(lab_folder.write("recipes/asking.yaml", ASKING), lab_folder.folder), 0)
    assert list(one.asked_s) == ["a"]
    ((first_s, last_s),) = one.asked_s["a"]
    assert 5.0 <= first_s == last_s < one.began_s["finish the batch"]


def test_a_trial_that_stops_says_why(lab_folder: LabFolder) -> None:
    tree = "tree: {timeout: {duration: 5 s, child: {wait: {duration: 10 s}}}}\n"
    lab_folder.write("trees/fails.yaml", f"workflow: fails\ninputs: {{source: Source}}\n{tree}")
    for policy, why in (("stop", "a: "), ("flag", "")):
        recipe = lab_folder.write(f"recipes/{policy}.yaml", ASKING.replace("ask}", f"{policy}}}"))
        one = trial(Setup(recipe, lab_folder.folder), 0)
        assert (one.stopped[:3], one.samples[0].good) == (why, False)


def test_a_trial_says_from_when_until_when_each_action_of_a_job_asked_a_person(lab_folder: LabFolder) -> None:
    """Of containers that are changed by hand each is a moment: one is taken off, the bare pan weighed, the next put."""
    lab_folder.replace("robot/cell.yaml", "{driver: carousel, slots: 24}", "{driver: operator}")
    path = lab_folder.write("recipes/aliquots.yaml", (REPOSITORY / "recipes/aliquots.yaml").read_text(encoding="utf-8"))
    one = trial(Setup(path, lab_folder.folder), 0)
    first, second, third = one.asked_s["set-1"]
    assert first[0] == first[1] < second[0] < second[1] < third[0] < third[1] < one.began_s["finish the batch"]


@pytest.mark.slow
def test_plan_says_what_its_night_holds(lab_folder: LabFolder, command: Call) -> None:
    path = lab_folder.write("recipes/two.yaml", RECIPE)
    said = command("plan", path, "--trials", "3", "--workers", "1", "--night", "20:00-08:00")
    assert "with nobody there: 1 of 4 samples" in said.stdout
    refused = command("plan", path, "--trials", "2", "--night", "20:00-08:00")
    told = json.loads(command("plan", path, "--trials", "3", "--night", "20:00-08:00", "--json").stdout)["night"]
    assert (told["lasts_s"], [one["why"] is None for one in told["samples"]]) == (43200.0, [True, False, False, False])
    assert told["better_order"] == {"order": "persons_together", "samples": 3}
    assert (said.returncode, refused.returncode) == (0, 2)
    assert "at least 3" in refused.stderr, "two do not tell how much runs differ"
