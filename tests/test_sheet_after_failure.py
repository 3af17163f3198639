"""A sample that has failed within a mixture leaves another sheet than the plan has: that costs no other sample."""

from pathlib import Path

from running import HEAD, Ran, dry_run, make_lab

from scuhand_bt.journal.reader import read

BLEND = """
workflow: blend
inputs: {{first: Source, second: Source, container: Container, mass: Mass, tolerance: {{type: Mass, default: 5 mg}}}}
result: $dose
tree:
  sequence:
    - place_container: {{container: $container}}
    - tare:
    - fill: {{source: $first, container: $container, mass: $mass, tolerance: $tolerance}}
    {fails_early}
    - change_powder: {{source: $first}}
    - fill: {{source: $second, container: $container, mass: $mass, tolerance: $tolerance, as: dose}}
    {fails_late}
    - return_leftover: {{source: $second}}
    - park:
"""
FAILS, GOES_ON = "- invert: {wait: {duration: 1 s}}", "- wait: {duration: 1 s}"
RECIPE = """
recipe: blends
workflow: fill_xrd_holder
order: as_written
defaults: {first: msg, second: beads, container: alumina_crucible, mass: 50 mg}
samples:
"""
MIXED = "  - {id: mixed, workflow: blend}\n"
BEADS = "  - {id: beads, source: beads, container: xrd_holder}\n"
MSG = "  - {id: msg, source: msg, container: xrd_holder}\n"


def ran(tmp_path: Path, samples: str, action: str = "skip_sample", *, early: str = GOES_ON, late: str = GOES_ON) -> Ran:
    lab = make_lab(tmp_path / "lab", trees__blend=BLEND.format(fails_early=early, fails_late=late))
    return dry_run(tmp_path, f"{RECIPE}{samples}on_failure: {{otherwise: {action}}}{HEAD}", lab=lab)


def jobs(ran: Ran) -> list[str]:
    return [row["name"] for row in read(ran.journal, "job")]


def test_a_mixture_that_fails_before_its_second_powder_costs_none_of_those_that_begin_with_that(tmp_path: Path) -> None:
    """Each sample after it was lost to hand.wrong_powder, to the end of the batch."""
    failed = ran(tmp_path, MIXED + BEADS, early=FAILS)
    assert [sample.verdict for sample in failed.result.samples] == ["skipped", "in tolerance"]
    assert jobs(failed) == [
        "mixed",
        "after mixed with msg",
        "change powder to glass_beads for beads after msg",
        "beads",
        "finish the batch",
    ]


def test_a_mixture_that_is_done_once_more_begins_with_a_fresh_sheet(tmp_path: Path) -> None:
    again = ran(tmp_path, MIXED, "redo", late=FAILS)
    doses = [(dose.container, dose.lot) for dose in again.watching.results[-1].doses]
    assert doses == [("mixed#2", "monosodium_glutamate"), ("mixed#2", "glass_beads")]
    assert jobs(again)[:3] == [
        "mixed",
        "after mixed with beads",
        "change powder to monosodium_glutamate for mixed after beads",
    ]


def test_where_nothing_fails_or_the_sheet_fits_all_the_same_it_is_changed_where_planned_and_nowhere_else(
    tmp_path: Path,
) -> None:
    assert jobs(ran(tmp_path, MIXED + BEADS)) == ["mixed", "beads", "finish the batch"]
    planned = "change powder to monosodium_glutamate for msg"
    (tmp_path / "again").mkdir()
    assert jobs(ran(tmp_path / "again", MIXED + MSG, late=FAILS)) == [
        "mixed",
        "after mixed with beads",
        planned,
        "msg",
        "finish the batch",
    ]
