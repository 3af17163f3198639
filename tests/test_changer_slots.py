"""A changer with slots by kind: which one a container comes from, when a person fills it, and what is doubted."""

from collections.abc import Callable
from pathlib import Path
from types import MappingProxyType

import pytest
from conftest import Call, Desk, LabFolder
from running import HEAD, Watching, dry_run, shared_planner

from scuhand_bt.cell.believed import Believed, slot_of, slots_used
from scuhand_bt.device_specs.changer import ChangerSpec
from scuhand_bt.journal.reader import read
from scuhand_bt.lab_state.inventory import Inventory, Stock, StockEntry, counted_otherwise
from scuhand_bt.problems import SourceError
from scuhand_bt.recipe.plan import Job, make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.checking import check
from scuhand_bt.run.inventory_conflicts import conflicts, recall
from scuhand_bt.run.options import Options
from scuhand_bt.run.resume import checked_history, find_run, resumable
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun
from scuhand_bt.specs import Container

SLOTS = ChangerSpec(slots={"holder": 2, "die": 3})
BATCH = """
recipe: kinds
workflow: fill_xrd_holder
order: as_written
defaults: {source: beads, mass: 40 mg, tolerance: 5 mg}
samples:
  - {id: a, container: xrd_holder}
  - {id: b, container: pellet_die_13mm}
  - {id: c, container: xrd_holder}
  - {id: d, container: xrd_holder}
"""


def of_kind(kind: str, name: str) -> Container:
    return Container(name=kind, id=name, mouth_mm=20.0, height_mm=4.0, capacity_mm3=200.0, empty_mass_mg=9200.0)


def brought(believed: Believed, container: Container) -> int:
    """The slot that it comes from, as a changer is told it."""
    first_slot = SLOTS.first_slot(container.name)
    slot = slot_of(believed, container, first_slot)
    believed.brought(container, from_changer=True, first_slot=first_slot)
    assert slot_of(believed, container, first_slot) == slot, "and it stays there when it is asked for again"
    return slot


def test_each_kind_comes_from_its_own_slots_whatever_came_between() -> None:
    believed = Believed()
    order = [("die", "1"), ("holder", "2"), ("die", "3"), ("holder", "4"), ("die", "5")]
    slots = [brought(believed, of_kind(kind, name)) for kind, name in order]
    assert slots == [2, 0, 3, 1, 4]
    assert sorted(slots) == list(range(SLOTS.slot_count)), "no two from one slot"


def short_of(believed: Believed, *kinds: str, changer: ChangerSpec = SLOTS) -> str | None:
    return changer.short_of(slots_used(believed, changer), kinds)


def test_a_kind_is_used_up_by_itself_and_a_person_fills_all() -> None:
    believed = Believed()
    for name in ("1", "2"):
        assert short_of(believed, "holder") is None
        brought(believed, of_kind("holder", name))
    assert short_of(believed, "holder") == "holder"
    assert short_of(believed, "die") is None
    assert short_of(believed, "vial") == "vial", "which it has no slot for"
    believed.slots_refilled()
    assert short_of(believed, "holder") is None
    assert brought(believed, of_kind("holder", "3")) == 0


def test_what_a_sample_takes_has_to_be_left_before_its_first_container() -> None:
    believed, in_order = Believed(), ChangerSpec(slots=3)
    assert short_of(believed, "die", "holder", "holder") is None
    brought(believed, of_kind("holder", "1"))
    assert short_of(believed, "die", "holder", "holder") == "holder"
    assert short_of(believed, "die", "holder", "die", "die") is None
    assert short_of(believed, "die", "holder", changer=in_order) is None
    assert short_of(believed, "die", "holder", "holder", changer=in_order) == ""
    assert short_of(believed, "holder", "holder", "holder") is None, "more than it ever holds: what is left is taken"
    brought(believed, of_kind("holder", "2"))
    assert short_of(believed, "holder", "holder", "holder") == "holder"


@pytest.mark.parametrize("slots", [0, -1, "many", True, 2.5, {}, {"holder": 0}, {"holder": "x"}, [3], None])
def test_what_is_no_number_of_slots_is_refused(slots: object) -> None:
    with pytest.raises(ValueError, match="slots"):
        ChangerSpec.model_validate({"slots": slots})


@pytest.mark.slow
def test_in_a_dry_run_the_plan_says_when_a_kind_has_run_out_and_the_run_asks_then(
    tmp_path: Path, lab_folder: LabFolder
) -> None:
    lab_folder.replace("robot/cell.yaml", "slots: 24", "slots: {xrd_holder: 2, pellet_die_13mm: 3}")
    ran = dry_run(tmp_path, BATCH, lab=lab_folder.folder)
    assert [(one.job, one.what) for one in ran.session.plan.persons] == [
        ("d", "fill the changer again (it holds 2 xrd_holder)")
    ]
    asked = [event["payload"]["question"] for event in read(ran.journal, "event") if event["kind"] == "asked"]
    assert asked == ["Fill the changer, from its first slot on: all 2 xrd_holder containers are used."]
    assert [sample.verdict for sample in ran.result.samples] == ["in tolerance"] * 4
    believed = ran.session.cell.believed
    assert (dict(believed.slots), dict(believed.slots_of_kinds)) == ({"d": 0}, {"xrd_holder": 1})


def test_the_inventory_counts_each_kind_and_a_batch_that_one_is_too_few_for_is_doubted(
    desk: Desk, lab_folder: LabFolder
) -> None:
    lab_folder.replace("robot/cell.yaml", "slots: 24", "slots: {xrd_holder: 5, pellet_die_13mm: 3}")
    desk.lab = lab_folder.load()
    sources = "sources: {beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 5 g}}\n"
    plan = make_plan(desk.load(BATCH.strip() + "\n" + sources), desk.lab)

    def doubts(holders: int, dies: int) -> list[str]:
        entries = (
            StockEntry("changer", "xrd_holder", used=holders),
            StockEntry("changer", "pellet_die_13mm", used=dies),
        )
        return [one.what for one in conflicts(plan, desk.lab.cell, {(one.kind, one.name): one for one in entries})]

    assert doubts(2, 2) == []
    (said,) = doubts(3, 2)
    assert "3 of the changer's 5 slots for xrd_holder are used" in said
    assert said.endswith("the batch has 3 containers of the kind xrd_holder")


ALIQUOTS = """
recipe: sets
workflow: aliquots
order: as_written
defaults: {source: beads, mass: 40 mg, tolerance: 5 mg}
samples:
  - {id: a, containers: [xrd_holder, xrd_holder]}
  - {id: b, containers: [pellet_die_13mm, xrd_holder]}
  - {id: c, containers: [xrd_holder, pellet_die_13mm, xrd_holder]}
  - {id: d, containers: [xrd_holder, pellet_die_13mm, xrd_holder]}
"""


def checked(lab_folder: LabFolder, slots: str) -> list[tuple[str, str]]:
    """What `check` says of the samples' slots, and where."""
    lab_folder.replace("robot/cell.yaml", "{driver: carousel, slots: 24}", slots)
    recipe = lab_folder.write("recipes/sets.yaml", ALIQUOTS.strip() + HEAD)
    found = check(lab_folder.load(), recipe, fast=True).problems
    return [(f"{one.mark.line}:{one.mark.column}", one.message) for one in found if one.code == "few-slots"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("slots", "visits"),
    [
        ("5", [("c", "1 of 5 containers left"), ("d", "2 of 5 containers left, and this sample needs 3")]),
        ("{xrd_holder: 4, pellet_die_13mm: 9}", [("c", "1 of 4 xrd_holder containers left, and this sample needs 2")]),
        ("2", [("b", "all 2"), ("c", "all 2"), ("c", "all 2"), ("d", "all 2")]),
    ],
    ids=["in order", "by kind", "fewer than a sample takes"],
)
def test_the_changer_is_filled_before_a_sample_as_the_plan_says_and_with_the_pan_bare(
    tmp_path: Path, lab_folder: LabFolder, slots: str, visits: list[tuple[str, str]]
) -> None:
    """It was filled with the last container on the pan, which kept its slot, and came again as an empty one."""
    lab_folder.replace("robot/cell.yaml", "slots: 24", f"slots: {slots}")
    ran = dry_run(tmp_path, ALIQUOTS, lab=lab_folder.folder, seed=1)
    assert [sample.verdict for sample in ran.result.samples] == ["in tolerance"] * 4
    assert [one.job for one in ran.session.plan.persons] == [job for job, _ in visits]
    job, on_pan, answered_s, found = "", "", 0.0, list[tuple[str, str, str]]()
    for row in read(ran.journal, "entry"):
        kind, payload = row["kind"], row["payload"]
        job = payload["name"] if kind == "job_started" else job
        on_pan = {"container": payload.get("container"), "bracket": ""}.get(kind, on_pan)
        if kind == "asked":
            found.append((job, payload["question"], on_pan))
        elif kind == "answered":
            answered_s = row["time_s"]
        elif kind == "container":
            assert payload["bare"]["readings"][0]["time_s"] >= answered_s, "it may have been touched"
    assert [(job, on_pan) for job, _, on_pan in found] == [(job, "") for job, _ in visits]
    assert all(said in question for (_, question, _), (_, said) in zip(found, visits, strict=True))


@pytest.mark.parametrize(
    ("slots", "said"),
    [
        ("{driver: carousel, slots: 3}", []),
        ("{driver: carousel, slots: {pellet_die_13mm: 1, xrd_holder: 2}}", []),
        ("{driver: operator, slots: 2}", []),
        ("{driver: carousel, slots: 2}", [("8:25", "'c' takes more containers than the changer has slots: 2.")]),
        (
            "{driver: carousel, slots: {pellet_die_13mm: 1, xrd_holder: 1}}",
            [
                ("6:25", "'a' takes more containers of the kind xrd_holder than the changer has slots: 1."),
                ("8:25", "'c' takes more containers of the kind xrd_holder than the changer has slots: 1."),
            ],
        ),
    ],
)
def test_check_warns_of_samples_with_more_containers_than_the_changer_holds_of_those_alike_once(
    lab_folder: LabFolder, slots: str, said: list[tuple[str, str]]
) -> None:
    found = checked(lab_folder, slots)
    assert [place for place, _ in found] == [place for place, _ in said]
    assert all(message.startswith(what) for (_, message), (_, what) in zip(found, said, strict=True))


def test_the_inventory_counts_every_container_of_a_batch(desk: Desk, lab_folder: LabFolder) -> None:
    """It counted samples: a run began with too few left, and filled the changer when the plan did not say so."""
    plan = make_plan(desk.load(ALIQUOTS.strip() + HEAD), desk.lab)
    for used, many in ((14, 0), (15, 1)):
        stock = {("changer", ""): StockEntry("changer", "", used=used)}
        found = [one.what for one in conflicts(plan, desk.lab.cell, stock)]
        assert len(found) == many
        assert all(what.endswith("the batch has 10 containers") for what in found)


def test_a_run_goes_on_where_the_inventory_says_that_each_kind_is(tmp_path: Path, lab_folder: LabFolder) -> None:
    lab_folder.replace("robot/cell.yaml", "slots: 24", "slots: {xrd_holder: 4, pellet_die_13mm: 3}")
    cell = dry_run(tmp_path, BATCH, lab=lab_folder.folder).session.cell
    cell.believed = Believed()
    stock = {("changer", "xrd_holder"): StockEntry("changer", "xrd_holder", used=3)}
    recall(cell, MappingProxyType(stock))  # type: ignore[arg-type]
    changer = cell.spec.changer
    assert (cell.believed.slots_used, dict(cell.believed.slots_of_kinds)) == (3, {"xrd_holder": 3})
    assert [slot_of(cell.believed, of_kind(kind, "x"), changer.first_slot(kind)) for kind in changer.kinds] == [3, 4]


def test_a_person_corrects_the_count_of_a_kind_or_says_that_all_is_filled(command: Call, lab_folder: LabFolder) -> None:
    lab_folder.replace("robot/cell.yaml", "slots: 24", "slots: {xrd_holder: 5, pellet_die_13mm: 3}")
    lab = ("--lab", lab_folder.folder)
    assert command("inventory", "set", *lab, "changer/xrd_holder", 4)[0] == 0
    assert "changer/xrd_holder" in command("inventory", *lab)[1]
    for what, value, said in (
        ("changer/xrd_holder", 6, "more than the changer's 5 slots"),
        ("changer/xrd_holdr", 1, "did you mean 'xrd_holder'"),
        ("changer", 4, "changer/pellet_die_13mm"),
    ):
        code, _, error = command("inventory", "set", *lab, what, value)
        assert code == 2
        assert said in " ".join(error.replace("│", " ").split())
    assert command("inventory", "set", *lab, "changer", 0)[0] == 0
    shown = command("inventory", *lab)[1]
    assert shown.count("0 used") == 2


def of_changer(*counts: tuple[str, int, str]) -> Stock:
    entries = (StockEntry("changer", name, used=used, at=f"2026-11-{day}T09:00:00+01:00") for name, used, day in counts)
    return {(entry.kind, entry.name): entry for entry in entries}


@pytest.mark.parametrize(
    ("slots", "counts", "kind", "said"),
    [
        ("{xrd_holder: 4, pellet_die_13mm: 3}", [("", 17, "20")], "by kind", "17 slots"),
        (
            "24",
            [("", 3, "20"), ("xrd_holder", 4, "22"), ("alumina_crucible", 2, "22")],
            "in the plan's order",
            "6 slots",
        ),
    ],
    ids=["by kind now", "by number now"],
)
def test_a_count_of_slots_that_were_divided_otherwise_says_nothing_of_those_of_now(
    desk: Desk,
    lab_folder: LabFolder,
    tmp_path: Path,
    slots: str,
    counts: list[tuple[str, int, str]],
    kind: str,
    said: str,
) -> None:
    lab_folder.replace("robot/cell.yaml", "slots: 24", f"slots: {slots}")
    desk.lab = lab_folder.load()
    cell = dry_run(tmp_path, BATCH, lab=lab_folder.folder).session.cell
    sources = "sources: {beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 5 g}}\n"
    plan = make_plan(desk.load(BATCH.strip() + "\n" + sources), desk.lab)

    (doubt,) = conflicts(plan, desk.lab.cell, of_changer(*counts))
    assert said in doubt.what
    assert doubt.what.endswith(f"({kind})")
    assert [answer for answer, _ in doubt.answers] == ["filled"]
    cell.believed = Believed()
    recall(cell, of_changer(*counts))
    assert (cell.believed.slots_used, dict(cell.believed.slots_of_kinds)) == (0, {})

    now = "xrd_holder" if kind == "by kind" else ""
    known = of_changer(*counts, (now, 1, "23"))
    assert not conflicts(plan, desk.lab.cell, known), "once it was counted as it is divided now"
    recall(cell, known)
    assert cell.believed.slots_used == 1


def test_the_inventory_counts_slots_anew_once_they_are_divided_otherwise(tmp_path: Path, lab_folder: LabFolder) -> None:
    cell = dry_run(tmp_path, BATCH, lab=lab_folder.folder).session.cell
    cell.believed.containers_taken(4, {})
    for entry in of_changer(("xrd_holder", 2, "20"), ("", 4, "10")).values():
        Inventory(tmp_path, cell.spec.cell).enter(entry)
    assert Inventory(tmp_path, cell.spec.cell).keep(cell, "run") is None
    kept = Inventory(tmp_path, cell.spec.cell).stock(simulated=cell.simulated)
    assert counted_otherwise((), kept) is None


class Wishing(Watching):
    """Stops the run while a container is changed."""

    def job_started(self, job: Job, number: int) -> None:
        assert self.session is not None
        if job.name == "c":
            self.stop_at = self.ticks + 20


@pytest.fixture
def stopped(tmp_path: Path, lab_folder: LabFolder) -> Callable[..., tuple[Session, Watching]]:
    """Runs the batch until it is stopped in its third sample; then again, to go on with it."""
    lab_folder.replace("robot/cell.yaml", "slots: 24", "slots: {pellet_die_13mm: 3, xrd_holder: 3}")
    recipe, runs = tmp_path / "recipe.yaml", tmp_path / "runs"
    recipe.write_text(BATCH + HEAD, encoding="utf-8")

    def run(*, resumes: bool) -> tuple[Session, Watching]:
        lab = lab_folder.load()
        plan = make_plan(load_recipe(recipe, lab), lab)
        found = None
        if resumes:
            path = find_run(runs, "last")
            found = resumable(path, checked_history(path), plan, lab, accept_changes=True)
        session = Session(plan, lab, Options(DryRun(), "paper", runs), shared_planner(plan, lab), resumes=found)
        watching = Watching(session) if resumes else Wishing(session)
        try:
            session.run(watching)
        finally:
            session.close()
        return session, watching

    run(resumes=False)
    return run


@pytest.mark.slow
def test_a_resumed_run_goes_on_with_the_slots_of_each_kind(stopped: Callable[..., tuple[Session, Watching]]) -> None:
    session, watching = stopped(resumes=True)
    assert watching.results[-1].id == "d"
    believed = session.cell.believed
    assert dict(believed.slots) == {"a": 3, "b": 0, "c": 4, "d": 5}
    assert dict(believed.slots_of_kinds) == {"xrd_holder": 3, "pellet_die_13mm": 1}
    assert not [event for event in read(session.journal.path, "event") if event["kind"] == "asked"]


def test_a_run_whose_changer_was_divided_otherwise_is_not_resumed(
    stopped: Callable[..., tuple[Session, Watching]], lab_folder: LabFolder
) -> None:
    lab_folder.replace("robot/cell.yaml", "slots: {pellet_die_13mm: 3, xrd_holder: 3}", "slots: 24")
    with pytest.raises(SourceError, match="slots were 3 pellet_die_13mm, 3 xrd_holder when this run began, and are 24"):
        stopped(resumes=True)
