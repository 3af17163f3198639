"""Whole batches on simulated devices: verdicts, failure policies, stopping, and safe ends."""

import re
from pathlib import Path

import pytest
from running import Ran, dry_run, make_lab

from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.journal.export import canonical
from scuhand_bt.journal.history import read_history
from scuhand_bt.journal.reader import read
from scuhand_bt.problems import SourceError
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.run.outcome import BatchResult
from scuhand_bt.run.resume import checked_history
from scuhand_bt.run.runner import Runner
from scuhand_bt.run.session import Session

ONE_DOSE = """
recipe: one
workflow: scoop_and_dispense
samples: [{id: a, source: beads, container: pellet_die_13mm, mass: 500 mg, tolerance: 10 mg}]
"""


def assert_safe(ran: Ran) -> None:
    cell = ran.session.cell
    assert cell.hand.opening_mm == 0.0
    assert cell.hand.vibration == 0.0
    assert cell.arm.is_stopped
    assert cell.hand.is_stopped


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


def test_a_dose_beyond_one_load_is_scooped_again_and_adds_up_to_one_target(tmp_path: Path) -> None:
    recipe = """
recipe: large
workflow: scoop_and_dispense
samples: [{id: a, source: beads, container: alumina_crucible, mass: 7 g, tolerance: 50 mg}]
"""
    dose = dry_run(tmp_path, recipe).sample("a")
    assert dose.verdict == "in tolerance"
    assert dose.scoops == 3, "the first one is half a load, as nobody knows yet what scoops bring"
    assert dose.true_mg == pytest.approx(7000, abs=52)


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


class Gusher:
    """A plant whose every opening gives far too much."""

    class Flow:
        def step(self, dt_s: float, opening_mm: float, vibration: float, in_cone_mg: float, rng: object) -> float:
            return min(in_cone_mg, 40_000 * dt_s) if opening_mm > 0 else 0.0

    def flow(self, powder: object) -> "Gusher.Flow":
        return self.Flow()


class LaterNan:
    """A plant that is sound when it is tried, and breaks in the run."""

    class Flow:
        steps = 0

        def step(self, dt_s: float, opening_mm: float, vibration: float, in_cone_mg: float, rng: object) -> float:
            type(self).steps += 1
            return float("nan") if self.steps > 100 else 0.0

    def flow(self, powder: object) -> "LaterNan.Flow":
        return self.Flow()


TWO_DOSES = """
recipe: two
workflow: scoop_and_dispense
defaults: {source: beads, container: pellet_die_13mm, mass: 100 mg}
samples: [{id: a}, {id: b}]
on_failure: {dose.overshoot: %s, hand.no_flow: %s, otherwise: stop}
overshoot_limit: 0
"""


def test_an_overshoot_is_flagged_and_never_reported_as_in_tolerance(tmp_path: Path) -> None:
    ran = dry_run(tmp_path, TWO_DOSES % ("flag", "stop"), plant="test_run_batch:Gusher")
    assert ran.result.exit_code == ExitCode.FLAGGED
    for sample in ran.result.samples:
        assert (sample.verdict, sample.code) == ("over", "dose.overshoot")
        assert sample.dispensed_mg > 102
        assert sample.dispensed_mg == pytest.approx(sample.true_mg, abs=2)
    assert_safe(ran)


def test_stop_ends_the_batch_and_what_was_not_run_says_so(tmp_path: Path) -> None:
    ran = dry_run(tmp_path, TWO_DOSES % ("stop", "stop"), plant="test_run_batch:Gusher")
    assert ran.result.exit_code == ExitCode.CELL_FAULT
    assert "dose.overshoot" in ran.result.reason
    assert [sample.verdict for sample in ran.result.samples] == ["over", "not run"]
    assert_safe(ran)


def test_skip_sample_goes_on_with_the_next(tmp_path: Path) -> None:
    ran = dry_run(tmp_path, TWO_DOSES % ("skip_sample", "stop"), plant="test_run_batch:Gusher")
    assert ran.result.exit_code == ExitCode.FLAGGED
    assert [sample.verdict for sample in ran.result.samples] == ["skipped", "skipped"]
    not_good = "Not good: 'a' (skipped, dose.overshoot), 'b' (skipped, dose.overshoot). For these, begin a new run"
    with pytest.raises(SourceError, match=re.escape(f"the run is complete: nothing is done again. {not_good}")):
        checked_history(ran.journal)


def test_redo_doses_a_new_container_once_and_then_flags(tmp_path: Path) -> None:
    ran = dry_run(tmp_path, TWO_DOSES % ("redo", "stop"), plant="test_run_batch:Gusher")
    attempts = [(row["sample"], row["attempt"]) for row in read(ran.journal, "job") if row["sample"]]
    assert attempts == [("a", 1), ("a", 2), ("b", 1), ("b", 2)]
    assert ran.result.exit_code == ExitCode.FLAGGED
    assert ran.sample("a").true_mg == pytest.approx(ran.sample("a").dispensed_mg, abs=2)
    assert [dose.container for dose in ran.sample("a").doses] == ["a#2"]


def test_a_plant_that_breaks_in_the_run_ends_it_safe_and_is_named(tmp_path: Path) -> None:
    ran = dry_run(tmp_path, ONE_DOSE, plant="test_run_batch:LaterNan")
    assert ran.result.exit_code == ExitCode.CELL_FAULT
    assert "LaterNan" in ran.result.reason
    assert [sample.verdict for sample in ran.result.samples] == ["interrupted"]


BROKEN_SKILL = '''
"""A skill with a bug."""
from scuhand_bt.skill import Cell, Skill, Steps, pause

class Broken(Skill[None]):
    """Divide by nothing while the valve is open."""
    devices = ("hand",)
    def run(self, cell: Cell) -> Steps[None]:
        cell.hand.set_opening(2.0)
        cell.hand.set_vibration(1.0)
        yield from pause(cell, 1.0)
        1 / 0
'''


def test_a_bug_in_a_skill_stops_the_run_safe_and_says_which(tmp_path: Path) -> None:
    tree = "workflow: w\ninputs: {source: Source}\ntree: {sequence: [{park: }, {broken: }]}\n"
    lab = make_lab(tmp_path / "lab", skills__broken=BROKEN_SKILL, trees__w=tree)
    ran = dry_run(tmp_path, "recipe: r\nworkflow: w\nsamples: [{id: a, source: beads}]\n", lab=lab)
    assert ran.result.exit_code == ExitCode.CELL_FAULT
    assert "the skill broken broke: ZeroDivisionError: division by zero (broken.py, line 12)" in ran.result.reason
    assert [sample.verdict for sample in ran.result.samples] == ["interrupted"]
    assert_safe(ran)


def test_what_was_dosed_before_a_bug_in_a_skill_is_told_and_not_called_not_run(tmp_path: Path) -> None:
    inputs = "{source: Source, container: Container, mass: Mass}"
    dosed = "scoop_and_dispense: {source: $source, container: $container, mass: $mass}"
    tree = f"workflow: w\ninputs: {inputs}\ntree: {{sequence: [{{{dosed}}}, {{broken: }}]}}\n"
    lab = make_lab(tmp_path / "lab", skills__broken=BROKEN_SKILL, trees__w=tree)
    samples = "samples: [{id: [a, b], source: beads, container: xrd_holder, mass: [50 mg, 50 mg]}]\n"
    ran = dry_run(tmp_path, f"recipe: r\nworkflow: w\n{samples}", lab=lab)
    a, b = ran.result.samples
    assert (a.verdict, b.verdict) == ("interrupted", "not run")
    assert a.dispensed_mg == pytest.approx(50.0, abs=2.0)
    assert a.true_mg == pytest.approx(a.dispensed_mg, abs=1.0)


STUCK_SKILL = '''
"""A skill that waits for nothing."""
from scuhand_bt.skill import Cell, Signal, Skill, Steps, Wake

class Stuck(Skill[None]):
    """Wait for a signal that nobody fires."""
    def run(self, cell: Cell) -> Steps[None]:
        yield Wake.on(Signal())

'''
BUSY_SKILL = '''
"""A skill that never lets time pass."""
from scuhand_bt.skill import Cell, Skill, Steps, Wake

class Stuck(Skill[None]):
    """Ask for the next tick at once, for ever."""
    def run(self, cell: Cell) -> Steps[None]:
        while True:
            yield Wake(cell.clock.now_s)
'''


@pytest.mark.parametrize(("skill", "words"), [(STUCK_SKILL, "never comes"), (BUSY_SKILL, "without letting time")])
def test_a_skill_that_would_hang_ends_the_run(tmp_path: Path, skill: str, words: str) -> None:
    tree = "workflow: w\ninputs: {source: Source}\ntree: {stuck: }\n"
    lab = make_lab(tmp_path / "lab", skills__stuck=skill, trees__w=tree)
    ran = dry_run(tmp_path, "recipe: r\nworkflow: w\nsamples: [{id: a, source: beads}]\n", lab=lab)
    assert ran.result.exit_code == ExitCode.CELL_FAULT
    assert words in ran.result.reason


def test_a_stop_that_comes_while_the_tree_is_ticked_is_heard_at_once(tmp_path: Path) -> None:
    waiting = "workflow: waiting\ninputs: {container: Container}\ntree: {sequence: [{wait: {duration: 60 s}}]}\n"
    recipe = "recipe: r\nworkflow: waiting\nsamples: [{id: a, container: xrd_holder}]\n"
    ran = dry_run(tmp_path, recipe, lab=make_lab(tmp_path / "lab", trees__waiting=waiting), stop_at=1)
    assert ran.result.exit_code == ExitCode.INTERRUPTED
    assert ran.session.cell.clock.now_s < 5.0


@pytest.mark.parametrize("stop_at", [1, 7, 20, 33, 60])
def test_a_stop_at_any_tick_ends_safe_with_a_verdict_for_every_sample(tmp_path: Path, stop_at: int) -> None:
    ran = dry_run(tmp_path, TWO_DOSES % ("flag", "flag"), stop_at=stop_at)
    assert ran.result.exit_code == ExitCode.INTERRUPTED
    assert [sample.verdict for sample in ran.result.samples] == ["interrupted", "not run"]
    assert_safe(ran)
    assert read(ran.journal, "event")[-1]["kind"] == "matter"


def test_a_stop_on_a_disk_that_is_full_by_then_is_a_fault_as_nobody_can_read_how_the_run_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Making the cell safe is told that the journal is lost, goes on all the same, and was the only one to know."""
    make_safe = Runner.make_safe

    def on_a_full_disk(one: Runner) -> bool:
        monkeypatch.setattr(Runner, "make_safe", make_safe)
        one._journal._store.db.execute("PRAGMA query_only=ON")  # as a full disk
        return make_safe(one)

    monkeypatch.setattr(Runner, "make_safe", on_a_full_disk)
    ran = dry_run(tmp_path, ONE_DOSE, stop_at=33)
    assert ran.result.exit_code == ExitCode.CELL_FAULT
    assert ran.result.reason.startswith("how the run ended is not written")
    assert_safe(ran)


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


DRAIN = """
workflow: drain
inputs: {source: Source}
tree:
  retry:
    attempts: 12
    child:
      sequence:
        - scoop: {source: $source}
        - discard:
        - invert: {wait: {duration: 1 s}}
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("source", "left", "spilled"),
    [("beads", 0.01, 0.001), ("msg", 0.02, 0.001)],
    ids=["beads", "msg, small mortar"],
)
def test_several_scoops_empty_a_mortar_to_its_last_per_cent(
    tmp_path: Path, source: str, left: float, spilled: float
) -> None:
    lab = make_lab(tmp_path / "lab", trees__drain=DRAIN)
    recipe = f"recipe: r\nworkflow: drain\nsamples: [{{id: a, source: {source}}}]\non_failure: {{otherwise: flag}}\n"
    ran = dry_run(tmp_path, recipe, lab=lab)
    world = ran.session.world
    assert world is not None
    amount_mg = ran.session.cell.sources[source].amount_mg
    assert world.masses_mg[f"source:{source}"] < left * amount_mg
    assert world.masses_mg["spilled"] < spilled * amount_mg
    scoops = [event["payload"]["expected_mg"] for event in read(ran.journal, "event") if event["kind"] == "scoop"]
    assert len(scoops) <= 10
    assert max(scoops) <= ran.session.cell.sources[source].powder.load_limit_mg


@pytest.mark.slow
@pytest.mark.parametrize(
    ("bore", "depth", "height", "outer"), [(110, 50, 62, 130), (120, 40, 52, 140), (95, 40, 52, 120)]
)
def test_a_wide_and_deep_bowl_is_scooped_with_a_rim_that_the_arm_can_swing_in_it(
    tmp_path: Path, bore: int, depth: int, height: int, outer: int
) -> None:
    """With the widest that goes in the swing ended halfway, or the arm was in the wall in every direction."""
    lab = make_lab(tmp_path / "lab")
    kinds = lab / "robot" / "containers.yaml"
    bowl = f"  bowl: {{bore: {bore} mm, depth: {depth} mm, height: {height} mm, outer_diameter: {outer} mm}}\n"
    kinds.write_text(kinds.read_text() + bowl)
    text = BOWL + "".join(f"  - {{id: s{n}, mass: 1 g}}\n" for n in range(9))
    ran = dry_run(tmp_path, text, lab=lab, controller="adaptive")
    assert {sample.verdict for sample in ran.result.samples} == {"in tolerance"}
    scoops = [row["payload"] for row in read(ran.journal, "event") if row["kind"] == "scooped"]
    assert len(scoops) <= 5


BOWL = """
recipe: bowl
workflow: scoop_and_dispense
sources:
  beads: {station: mortar_bay, container: bowl, powder: glass_beads, amount: 12 g}
defaults: {source: beads, container: alumina_crucible, tolerance: 5 mg}
samples:
"""


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 9, 11])
def test_a_scoop_that_brought_less_than_expected_is_scooped_again_and_not_taken_for_a_bridge(
    tmp_path: Path, seed: int
) -> None:
    recipe = """
recipe: large
workflow: fill_crucible
sources:
  beads: {station: mortar_bay, container: small_agate_mortar, powder: glass_beads, amount: 12 g}
samples: [{id: a, source: beads, container: alumina_crucible, mass: 11 g, tolerance: 1 %}]
"""
    ran = dry_run(tmp_path, recipe, seed=seed, controller="adaptive")
    assert (ran.sample("a").verdict, ran.sample("a").code) == ("in tolerance", None)


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
