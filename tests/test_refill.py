"""Mortars that are refilled on the way: when the plan has a person come, and what the run makes of it."""

from pathlib import Path

import pytest
from conftest import Desk, LabFolder
from running import dry_run

from scuhand_bt.journal.reader import read
from scuhand_bt.lab_state.inventory import Inventory, StockEntry
from scuhand_bt.problems import SourceError
from scuhand_bt.recipe.plan import Plan, check_unattended, make_plan
from scuhand_bt.run.inventory_conflicts import conflicts

RECIPE = """recipe: refill
workflow: fill_xrd_holder
order: as_written
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 600 mg, refill: 400 mg}
  msg: {station: mortar_bay_2, container: agate_mortar, powder: monosodium_glutamate, amount: 600 mg, refill: 500 mg}
defaults: {container: xrd_holder, mass: 100 mg, tolerance: 5 mg, source: beads}
samples:
"""
SIX = "  - {id: a, repeat: 6}\n"


def plan_of(desk: Desk, samples: str, **changed: str) -> Plan:
    recipe = RECIPE
    for old, new in changed.items():
        recipe = recipe.replace(*(part.replace("_", " ") for part in (old, new)))
    return make_plan(desk.load(recipe + samples), desk.lab)


def names(plan: Plan) -> list[str]:
    return [job.name for job in plan.jobs]


def visits(plan: Plan) -> list[tuple[str | None, str]]:
    return [(person.job, person.what) for person in plan.persons if person.job is not None]


def test_a_mortar_is_refilled_before_the_sample_that_would_leave_little_in_it(desk: Desk) -> None:
    plan = plan_of(desk, SIX)  # 120 mg each with losses: the fifth would leave none of 600 mg
    assert visits(plan) == [("refill beads for a-5", "refill 'beads' at mortar_bay")]
    assert names(plan)[4:6] == ["refill beads for a-5", "a-5"]
    assert plan.refills == {"beads": 1}
    with pytest.raises(SourceError, match="one is needed at 'refill beads for a-5'"):
        check_unattended(plan)


def test_a_mortar_that_holds_enough_is_not_refilled(desk: Desk) -> None:
    assert visits(plan_of(desk, "  - {id: a, repeat: 5}\n")) == []


def test_refills_go_where_a_person_comes_anyway(desk: Desk) -> None:
    some = "  - {id: a, repeat: 3}\n  - {id: m, source: msg, repeat: 3}\n  - {id: b, repeat: 3}\n"
    plan = plan_of(desk, some)
    of_swap = "change powder to glass_beads for b-1"
    assert [job for job, _ in visits(plan)] == [
        "change powder to monosodium_glutamate for m-1",
        "refill beads for b-1",
        of_swap,
    ]
    assert names(plan)[names(plan).index(of_swap) - 1] == "refill beads for b-1"


def test_one_visit_is_for_the_mortars_of_several_powders(desk: Desk) -> None:
    some = "".join(f"  - {{id: a{n}}}\n  - {{id: m{n}, source: msg}}\n" for n in range(6))
    plan = plan_of(desk, some)
    refills = [name for name in names(plan) if name.startswith("refill")]
    persons = [job for job, _ in visits(plan) if job is not None and job.startswith("change")]
    assert {name.split()[1] for name in refills} == {"beads", "msg"}
    assert all(names(plan)[names(plan).index(name) + 1].startswith(("change", "refill")) for name in refills)
    assert persons


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("refill:_400_mg", "refill:_700_mg", "a refill of 700.0 mg is more than the mortar holds at the start"),
        ("refill:_400_mg", "refill:_110_mg", "'a-1' alone needs 120.0 mg with losses"),
        (",_refill:_400_mg", "", "its 6 samples need 720.0 mg with losses"),
        ("refill:_400_mg", "refill:_0_mg", "refill"),
    ],
)
def test_what_cannot_be_refilled_so_is_refused(desk: Desk, old: str, new: str, said: str) -> None:
    with pytest.raises(SourceError, match=said):
        plan_of(desk, SIX, **{old: new})


def test_the_run_asks_before_the_mortar_runs_short_and_books_what_has_come(tmp_path: Path) -> None:
    ran = dry_run(tmp_path, RECIPE.split("  msg")[0] + RECIPE.split("500 mg}\n")[1] + SIX)
    assert [sample.verdict for sample in ran.result.samples] == ["in tolerance"] * 6
    events = [(event["kind"], event["payload"]) for event in read(ran.journal, "event")]
    (asked,) = (said["question"] for kind, said in events if kind == "asked")
    assert asked.startswith("Put 400.0 mg of glass_beads into the mortar at mortar_bay: it holds about ")
    (refilled,) = (said for kind, said in events if kind == "refilled")
    assert (refilled["source"], refilled["mass_mg"]) == ("beads", 400.0)
    assert "scoop.nothing" not in [sample.code for sample in ran.result.samples]
    believed_mg = ran.session.cell.believed.sources_mg["beads"]
    assert believed_mg == pytest.approx(1000.0 - 600.0, abs=60.0)
    world = ran.session.world
    assert world is not None
    assert world.ledger.total_mg == pytest.approx(1000.0, rel=1e-9)
    stock = Inventory(tmp_path, ran.session.cell.spec.cell).stock(simulated=True)
    assert stock["station", "mortar_bay"].mass_mg == believed_mg


def test_an_inventory_that_has_what_the_plan_begins_with_is_enough(desk: Desk) -> None:
    plan = plan_of(desk, SIX)

    def doubts(mass_mg: float) -> list[str]:
        known = StockEntry("station", "mortar_bay", "glass_beads", mass_mg=mass_mg)
        return [one.what for one in conflicts(plan, desk.lab.cell, {(known.kind, known.name): known})]

    assert doubts(590.0) == []
    (said,) = doubts(300.0)
    assert "too little" in said


def test_a_lab_without_the_workflow_is_told_what_it_is_for(desk: Desk, lab_folder: LabFolder) -> None:
    (lab_folder.folder / "trees" / "refill.yaml").unlink()
    desk.lab = lab_folder.load()
    with pytest.raises(SourceError, match="the workflow 'refill' is missing; this plan needs it to refill mortars"):
        plan_of(desk, SIX)


def test_what_is_discarded_after_each_sample_is_refilled_too(desk: Desk) -> None:
    """A scoop for 100 mg brings all of the 600 mg; one visit, before the fifth, was planned."""
    discarding = RECIPE.replace("samples:", "leftover: discard\nsamples:")
    plan = make_plan(desk.load(discarding + SIX), desk.lab)
    assert plan.refills == {"beads": 5}
