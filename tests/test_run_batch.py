"""Whole batches on simulated devices: doses, their order, who brings containers, and what is written down."""

from pathlib import Path

import pytest
from batch_bench import ONE_DOSE, assert_safe
from running import dry_run, make_lab

from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.journal.export import canonical
from scuhand_bt.journal.history import read_history
from scuhand_bt.journal.reader import read
from scuhand_bt.problems import SourceError
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.run.outcome import BatchResult
from scuhand_bt.run.session import Session


def test_a_dose_lands_in_tolerance_and_the_container_holds_what_the_table_says(tmp_path: Path) -> None:
    ran = dry_run(tmp_path, ONE_DOSE)
    dose = ran.sample("a")
    assert ran.result.exit_code == ExitCode.OK
    assert dose.verdict == "in tolerance"
    assert dose.dispensed_mg == pytest.approx(500, abs=10)
    assert dose.true_mg == pytest.approx(dose.dispensed_mg, abs=1.5)
    assert dose.pulses > 1
    assert dose.scoops == 1
    assert_safe(ran)


def test_the_same_seed_gives_the_same_export_and_another_seed_another(tmp_path: Path) -> None:
    exports = []
    for number, seed in enumerate((3, 3, 4)):
        folder = tmp_path / str(number)
        folder.mkdir()
        exports.append(canonical(dry_run(folder, ONE_DOSE, seed=seed).journal))
    assert exports[0] == exports[1]
    assert exports[0] != exports[2]


def test_powders_are_grouped_with_one_sheet_swap_and_never_mixed(tmp_path: Path) -> None:
    recipe = """
recipe: two
workflow: scoop_and_dispense
defaults: {container: pellet_die_13mm, mass: 300 mg, tolerance: 20 mg}
samples: [{id: a, source: beads}, {id: b, source: msg}, {id: c, source: beads}]
"""
    ran = dry_run(tmp_path, recipe)
    jobs = [row["sample"] for row in read(ran.journal, "job") if row["sample"]]
    assert jobs == ["a", "c", "b"]
    assert [sample.id for sample in ran.result.samples] == ["a", "b", "c"]
    assert sum(1 for event in read(ran.journal, "event") if event["kind"] == "sheet") == 1
    assert ran.session.world is not None
    assert ran.session.world.masses_mg["returned"] == 0.0


@pytest.mark.slow
def test_order_as_written_swaps_the_sheet_at_each_change(tmp_path: Path) -> None:
    recipe = """
recipe: two
order: as_written
workflow: scoop_and_dispense
defaults: {container: pellet_die_13mm, mass: 300 mg, tolerance: 20 mg}
samples: [{id: a, source: beads}, {id: b, source: msg}, {id: c, source: beads}]
"""
    ran = dry_run(tmp_path, recipe)
    assert [row["sample"] for row in read(ran.journal, "job") if row["sample"]] == ["a", "b", "c"]
    assert sum(1 for event in read(ran.journal, "event") if event["kind"] == "sheet") == 2


def test_every_action_is_in_the_journal_before_it_acts(tmp_path: Path) -> None:
    seen: list[str] = []

    def look(root: object) -> None:
        actions = read(next(tmp_path.glob("runs/*.sqlite")), "action")
        seen.append(actions[-1]["outcome"] if actions else "none")

    ran = dry_run(tmp_path, ONE_DOSE, at_tick=look)
    assert "started" in seen
    actions = read(ran.journal, "action")
    assert {row["outcome"] for row in actions} <= {"done", "failed"}
    assert [row["skill"] for row in actions if row["skill"] != "cone_holds"][:5] == [
        "place_container",
        "scoop",
        "open_cone",
        "tare",
        "move_over",
    ]
    assert len(read(ran.journal, "pulse")) >= ran.sample("a").pulses
    assert len(read(ran.journal, "dose")) == 1


THREE_DOSES = """
recipe: three
workflow: fill_xrd_holder
defaults: {source: beads, container: xrd_holder, mass: 40 mg}
samples: [{id: s, repeat: 3}]
"""


def lab_with_changer(folder: Path, changer: str) -> Path:
    lab = make_lab(folder)
    cell = lab / "robot" / "cell.yaml"
    lines = [f"changer: {changer}" if line.startswith("changer:") else line for line in cell.read_text().splitlines()]
    cell.write_text("\n".join(lines) + "\n")
    return lab


@pytest.mark.slow
def test_an_empty_changer_is_filled_by_a_person_whom_the_plan_named(tmp_path: Path) -> None:
    ran = dry_run(tmp_path, THREE_DOSES, lab=lab_with_changer(tmp_path / "lab", "{driver: carousel, slots: 2}"))
    assert [person.job for person in ran.session.plan.persons] == ["s-3"]
    asked = [event["payload"]["question"] for event in read(ran.journal, "event") if event["kind"] == "asked"]
    assert len(asked) == 1
    assert "changer" in asked[0]
    assert [sample.verdict for sample in ran.result.samples] == ["in tolerance"] * 3


def test_without_a_changer_the_operator_brings_each_container(tmp_path: Path) -> None:
    ran = dry_run(tmp_path, THREE_DOSES, lab=lab_with_changer(tmp_path / "lab", "{driver: operator}"))
    brought = [person.job for person in ran.session.plan.persons if "on the pan" in person.what]
    assert brought == ["s-1", "s-2", "s-3"]
    asked = [event["payload"]["question"] for event in read(ran.journal, "event") if event["kind"] == "asked"]
    assert sum("Put the xrd_holder" in question for question in asked) == 3
    assert [sample.verdict for sample in ran.result.samples] == ["in tolerance"] * 3


def test_two_mortars_of_one_powder_lot_share_a_sheet_and_each_gets_back_what_is_its_own(tmp_path: Path) -> None:
    recipe = """
recipe: twins
workflow: fill_xrd_holder
sources:
  m1: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 6 g}
  m2: {station: mortar_bay_2, container: agate_mortar, powder: glass_beads, amount: 6 g}
defaults: {container: xrd_holder, mass: 40 mg}
samples: [{id: a, source: m1}, {id: b, source: m2}]
"""
    ran = dry_run(tmp_path, recipe)
    assert ran.result.exit_code == ExitCode.OK
    assert ran.session.plan.swaps == 0


def test_a_dose_that_does_not_fit_is_refused_before_the_valve_opens(tmp_path: Path) -> None:
    tree = """
workflow: careless
inputs: {source: Source, container: Container}
tree:
  sequence:
    - place_container: {container: $container}
    - tare: {as: gross}
    - scoop: {source: $source}
    - move_over: {container: $container}
    - dispense: {mass: $gross}   # known only when it runs: a check before refuses what it can tell
"""
    lab = make_lab(tmp_path / "lab", trees__careless=tree)
    recipe = "recipe: r\nworkflow: careless\nsamples: [{id: a, source: beads, container: xrd_holder}]\n"
    ran = dry_run(tmp_path, recipe, lab=lab)
    assert ran.sample("a").code == "container.too_small"
    assert ran.session.world is not None
    assert ran.session.world.masses_mg["pan"] == 0.0


@pytest.mark.parametrize(
    "call", ["shake: {level: 250 %}", "scoop: {source: $source, speed: 0 mm/s}", "dispense: {mass: 0 mg}"]
)
def test_a_value_that_a_skill_refuses_is_found_by_the_check(tmp_path: Path, call: str) -> None:
    tree = f"workflow: w\ninputs: {{source: Source}}\ntree: {{{call}}}\n"
    lab = make_lab(tmp_path / "lab", trees__w=tree)
    with pytest.raises(SourceError, match=r"w\.yaml:3:"):
        dry_run(tmp_path, "recipe: r\nworkflow: w\nsamples: [{id: a, source: beads}]\n", lab=lab)


def test_a_step_of_the_zero_that_is_seen_later_doubts_what_was_confirmed_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sessions: list[Session] = []
    run = Session.run

    def noticed(session: Session, observer: BatchObserver) -> BatchResult:
        sessions.append(session)
        return run(session, observer)

    def step_while_c_stands_there(root: object) -> None:
        (session,) = sessions
        assert session.world is not None
        if session.world.pan.container_id == "c" and session.cell.believed.zero_stepped_mg == 0.0:
            session.cell.believed.zero_stepped(8.0)

    monkeypatch.setattr(Session, "run", noticed)
    recipe = """
recipe: steps
workflow: fill_xrd_holder
defaults: {container: xrd_holder, source: beads, mass: 30 mg}
samples: [{id: a}, {id: b}, {id: c}]
"""
    assert dry_run(tmp_path, recipe).sample("a").is_good
    sessions.clear()
    doubted = dry_run(tmp_path, recipe, at_tick=step_while_c_stands_there).sample("a")
    assert not doubted.is_good
    assert "zero was seen to step by 8.00 mg" in (doubted.detail or "")


def test_what_the_bare_pan_says_of_a_sample_is_in_its_journal_too(tmp_path: Path) -> None:
    """A resumed run has it from there."""
    recipe = """
recipe: one
workflow: fill_xrd_holder
defaults: {container: xrd_holder, source: beads, mass: 30 mg}
samples: [{id: a}]
"""
    ran = dry_run(tmp_path, recipe)
    assert ran.sample("a").doses[0].bracket == "closed"
    assert read_history(ran.journal).samples["a", 1].doses == ran.sample("a").doses
