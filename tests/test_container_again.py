"""A container that is put on the pan again in its sample: what it holds is known, or it is refused."""

from pathlib import Path
from typing import Any

import pytest
from py_trees.common import Status
from running import HEAD, Ran, Watching, dry_run, make_lab, shared_planner

from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.journal.reader import open_contents, read
from scuhand_bt.lab import load_lab
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.report.powder_balance import powder_balance
from scuhand_bt.run.options import Options
from scuhand_bt.run.outcome import BatchResult
from scuhand_bt.run.resume import Resumable, checked_history, resumable
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun

PLACE = """
    - place_container: {container: %s}
    - tare:"""
FILL = """
    - fill: {source: $source, container: %s, mass: %s, tolerance: $tolerance}
    - park:"""
END = """
    - return_leftover: {source: $source}
    - park:
"""


def workflow(*steps: str) -> str:
    inputs = "{source: Source, first: Container, spare: Container, mass: Mass, tolerance: Mass}"
    return f"workflow: again\ninputs: {inputs}\ntree:\n  sequence:{''.join(steps)}{END}"


def again_lab(
    tmp_path: Path, *steps: str, kind: str = "xrd_holder", mass: str = "50 mg", slots: int = 24
) -> tuple[Path, Path]:
    """A lab with this workflow, and a recipe for it."""
    lab, recipe = make_lab(tmp_path / "lab", trees__again=workflow(*steps)), tmp_path / "recipe.yaml"
    cell = lab / "robot" / "cell.yaml"
    cell.write_text(cell.read_text().replace("slots: 24", f"slots: {slots}"))
    sample = f"{{id: a, source: beads, first: {kind}, spare: {kind}, mass: {mass}, tolerance: 4 mg}}"
    recipe.write_text(f"recipe: again\nworkflow: again\nsamples: [{sample}]\non_failure: {{otherwise: flag}}\n{HEAD}")
    return lab, recipe


def test_a_tare_is_the_containers_own_weighing_only_where_nothing_was_done_since(tmp_path: Path) -> None:
    ran = again(tmp_path, FIRST, WHOLE, SPARE.replace("\n    - tare:", f"{WAIT}\n    - tare:"), OF_SPARE)
    rows = list(read(ran.journal, "event"))
    first = next(row["payload"]["loaded"] for row in rows if row["kind"] == "container_again")
    *_, second = (row["payload"]["loaded"] for row in rows if row["kind"] == "container")
    at_once, later = (row["payload"]["readings"] for row in rows if row["kind"] == "tare")
    assert at_once == first["readings"]
    assert later[0]["time_s"] > second["readings"][-1]["time_s"] + 60.0


def two_samples(recipe: Path) -> None:
    """Another one like the recipe's."""
    text = recipe.read_text()
    sample = text[text.index("[") + 1 : text.index("]")]
    recipe.write_text(text.replace(sample, f"{sample}, {sample.replace('id: a', 'id: b')}"))


def again(tmp_path: Path, *steps: str, **kinds: Any) -> Ran:
    lab, recipe = again_lab(tmp_path, *steps, **kinds)
    return dry_run(tmp_path, recipe.read_text(), lab=lab, controller="adaptive")


FIRST, SPARE = PLACE % "$first", PLACE % "$spare"
HALF, WHOLE, OF_SPARE = (FILL % what for what in (("$first", "$mass / 2"), ("$first", "$mass"), ("$spare", "$mass")))
WAIT = "\n    - wait: {duration: 1 min}"
DISCARD = "\n    - discard_container:"


def test_a_container_that_was_thrown_away_makes_nothing_of_the_sample_that_is_in_the_next_one(tmp_path: Path) -> None:
    """What it held was told as a dose that broke off."""
    ran = again(tmp_path, FIRST, WHOLE, DISCARD, SPARE, OF_SPARE)
    had = ran.sample("a")
    assert (had.is_good, had.detail, [dose.container for dose in had.doses]) == (True, None, ["a/spare"])


def test_a_container_that_was_thrown_away_with_powder_in_it_does_not_come_again(tmp_path: Path) -> None:
    """Whether what is brought is another one, empty, nobody knows."""
    ran = again(tmp_path, FIRST, HALF, DISCARD, FIRST, WHOLE)
    had = ran.sample("a")
    assert (had.code, had.is_good) == ("container.changed", False)
    assert had.detail == "'a/first' was on the pan before: it was thrown away"


def test_what_a_dose_has_brought_that_broke_off_is_in_the_books(tmp_path: Path) -> None:
    """The report had it as not booked."""
    fill = "{source: $source, container: $first, mass: $mass, tolerance: $tolerance}"
    broken_off = f"\n    - optional: {{child: {{timeout: {{duration: 25 s, child: {{fill: {fill}}}}}}}}}\n    - park:"
    ran = again(tmp_path, FIRST, broken_off, SPARE, OF_SPARE, kind="alumina_crucible", mass="2 g")
    spare = next(dose for dose in ran.sample("a").doses if dose.container == "a/spare")
    assert ran.session.world is not None
    broke_off_mg = ran.session.world.masses_mg["container:a/first"]
    with open_contents(ran.journal) as contents:
        beads = next(one for one in powder_balance(contents) if one.name == "beads")
    assert broke_off_mg > 100.0
    assert beads.dosed_mg == pytest.approx(spare.dispensed_mg + broke_off_mg, abs=1.0)


def test_what_one_lot_has_brought_out_of_two_mortars_is_in_the_books_once(tmp_path: Path) -> None:
    steps = "".join(
        f"\n    - {step}"
        for step in (
            "place_container: {container: $container}",
            "tare:",
            "fill: {source: $one, container: $container, mass: $mass / 4, tolerance: $tolerance}",
            "return_leftover: {source: $one}",
            "optional: {child: {timeout: {duration: 25 s, child: "
            "{fill: {source: $two, container: $container, mass: $mass, tolerance: $tolerance}}}}}",
            "return_leftover: {source: $two}",
            "park:",
        )
    )
    inputs = "{one: Source, two: Source, container: Container, mass: Mass, tolerance: Mass}"
    lab = make_lab(tmp_path / "lab", trees__two=f"workflow: two\ninputs: {inputs}\ntree:\n  sequence:{steps}\n")
    at = "container: agate_mortar, powder: glass_beads, amount: 20 g, lot: G1"
    recipe = (
        "recipe: two\nworkflow: two\non_failure: {otherwise: flag}\n"
        f"sources:\n  one: {{station: mortar_bay, {at}}}\n  two: {{station: mortar_bay_2, {at}}}\n"
        "samples: [{id: a, one: one, two: two, container: alumina_crucible, mass: 2 g, tolerance: 4 mg}]\n"
    )
    ran = dry_run(tmp_path, recipe, lab=lab, controller="adaptive")
    assert ran.session.world is not None
    there_mg = ran.session.world.masses_mg["container:a"]
    with open_contents(ran.journal) as contents:
        assert sum(source.dosed_mg for source in powder_balance(contents)) == pytest.approx(there_mg, abs=1.0)
    assert there_mg > 600.0, "the second dose broke off, and not before it had begun"


def test_a_container_that_is_put_back_where_it_stands_may_weigh_what_it_has_got(tmp_path: Path) -> None:
    """2 g are more than crucibles differ by: it was taken for a wrong one."""
    ran = again(tmp_path, FIRST, WHOLE, FIRST, WHOLE, kind="alumina_crucible", mass="2 g")
    had = ran.sample("a")
    assert (had.is_good, had.detail) == (True, None)
    assert had.doses[0].lasted_s > 15.0, "the first visit's, which brought nearly all of it, too"
    assert had.dispensed_mg == pytest.approx(ran.session.world.masses_mg["container:a/first"], abs=0.6)


def test_a_container_whose_changer_was_filled_again_meanwhile_does_not_come_again(tmp_path: Path) -> None:
    """An empty one would come of the slot that is next, and be told to hold what the former got."""
    ran = again(tmp_path, FIRST, HALF, SPARE, OF_SPARE, FIRST, WHOLE, slots=1)
    had = ran.sample("a")
    assert (had.code, had.is_good) == ("container.changed", False)
    assert "filled again" in str(had.detail)


def test_the_changer_is_filled_before_a_sample_whose_container_comes_again(tmp_path: Path) -> None:
    """Filled in its midst, it had nothing of what the first container's first visit had brought."""
    lab, recipe = again_lab(tmp_path, FIRST, HALF, SPARE, OF_SPARE, FIRST, WHOLE, slots=3)
    two_samples(recipe)
    ran = dry_run(tmp_path, recipe.read_text(), lab=lab, controller="adaptive")
    assert [str(one) for one in ran.session.plan.persons] == ["needed at 'b': fill the changer again (it holds 3)"]
    assert [(had.is_good, had.detail) for had in ran.result.samples] == [(True, None)] * 2
    assert [row["kind"] for row in read(ran.journal, "event")].count("asked") == 1


class StopsAsItWaits(Watching):
    """Stops the run in a `wait`."""

    def ticked(self, root: Any) -> None:
        assert self.session is not None
        if any(node.name == "wait" and node.status is Status.RUNNING for node in root.iterate()):
            self.session.control.wish("stop_now")


def stopped_and_resumed(tmp_path: Path, lab: Path, path: Path, stops: Watching) -> tuple[Session, BatchResult]:
    """A run that is stopped as `stops` wishes, and then gone on with to its end."""
    loaded = load_lab(lab)
    plan = make_plan(load_recipe(path, loaded), loaded)
    options, planner = Options(DryRun(), "adaptive", tmp_path / "runs"), shared_planner(plan, loaded)

    def run(watching: Watching, found: Resumable | None = None) -> tuple[Session, BatchResult]:
        watching.session = session = Session(plan, loaded, options, planner, resumes=found)
        try:
            return session, session.run(watching)
        finally:
            session.close()

    session, result = run(stops)
    assert result.exit_code == ExitCode.INTERRUPTED
    journal = session.journal.path
    return run(Watching(), resumable(journal, checked_history(journal), plan, loaded, accept_changes=False))


def test_a_run_that_stopped_before_the_first_container_of_a_sample_goes_on_with_what_that_takes(tmp_path: Path) -> None:
    """It forgot, and filled the changer between two visits of one container."""
    lab, recipe = again_lab(tmp_path, WAIT, FIRST, HALF, SPARE, FIRST, WHOLE, slots=3)
    two_samples(recipe)

    class StopsInTheSecond(StopsAsItWaits):
        def ticked(self, root: Any) -> None:
            assert self.session is not None
            if self.session.cell.believed.slots:
                super().ticked(root)

    session, result = stopped_and_resumed(tmp_path, lab, recipe, StopsInTheSecond())
    assert [(had.is_good, had.detail) for had in result.samples] == [(True, None)] * 2
    assert dict(session.cell.believed.slots) == {"b/first": 0, "b/spare": 1}


def test_an_outage_in_a_second_visit_finds_what_the_first_has_brought(tmp_path: Path) -> None:
    """It was taken for a part of the empty container, which held less then than it can."""
    lab, path = again_lab(tmp_path, FIRST, HALF, SPARE, FIRST, WAIT, WHOLE)
    session, result = stopped_and_resumed(tmp_path, lab, path, StopsAsItWaits())
    (had,) = result.samples
    (told,) = (row["payload"] for row in read(session.journal.path, "event") if row["kind"] == "container_reweighed")
    assert (told["counts"], told["held_mg"]) == (True, pytest.approx(25.0, abs=2.0))
    assert (had.is_good, [dose.lot for dose in had.doses]) == (True, ["glass_beads"])
    assert session.world is not None
    assert had.dispensed_mg == pytest.approx(session.world.masses_mg["container:a/first"], abs=0.6)
