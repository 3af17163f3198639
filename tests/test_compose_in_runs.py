"""A composed sample in a dry run that was resumed: every face tells the same of it."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from atomic_weights import CO, LI, C, O
from conftest import REPOSITORY, Call
from running import Watching, shared_planner

from scuhand_bt.dashboard.page_state import Page
from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.journal.follow import Follower
from scuhand_bt.journal.reader import read
from scuhand_bt.lab import load_lab, starter_lab
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.options import Options
from scuhand_bt.run.outcome import BatchResult
from scuhand_bt.run.resume import Resumable, checked_history, find_run, resumable
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun


class StopInTheSecond(Watching):
    """Stops a run while it doses its second powder."""

    def ticked(self, root: Any) -> None:
        assert self.session is not None
        is_second = bool(self.session.journal.so_far.doses)
        self.ticks += is_second and self.session.cell.believed.dosing.target_mg is not None
        if self.ticks == 20:
            self.session.control.wish("stop_now")


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The journal of a dry run of one of the shipped samples that was stopped in its second dose, and resumed."""
    folder, lab = tmp_path_factory.mktemp("composed"), load_lab(starter_lab())
    head, samples = (REPOSITORY / "recipes/cathodes.yaml").read_text(encoding="utf-8").split("samples:\n")
    rich = next(line for line in samples.splitlines() if "lco-rich" in line)
    (folder / "rich.yaml").write_text(f"{head}samples:\n{rich}\n", encoding="utf-8")
    plan = make_plan(load_recipe(folder / "rich.yaml", lab), lab)
    options = Options(DryRun(1), None, folder / "runs")

    def go(watching: Watching, found: Resumable | None = None) -> BatchResult:
        watching.session = Session(plan, lab, options, shared_planner(plan, lab), resumes=found)
        try:
            return watching.session.run(watching)
        finally:
            watching.session.close()

    stopped = StopInTheSecond()
    assert go(stopped).exit_code == ExitCode.INTERRUPTED
    before = stopped.results[-1]
    assert (before.verdict, before.composition and before.composition.verdict) == ("interrupted", "not known")
    journal = find_run(folder / "runs", "last")
    ended = go(Watching(), resumable(journal, checked_history(journal), plan, lab, accept_changes=False))
    assert (ended.exit_code, ended.samples[0].is_good) == (ExitCode.OK, True)
    doses = [row["outcome"] for row in read(journal, "action") if row["skill"] == "dispense"]
    assert doses.count("done") == 2, "and the first is not done again"
    return journal


def test_every_face_of_a_run_tells_the_same_composition(ran: Path, command: Call, tmp_path: Path) -> None:
    exported = command("export", ran, "--json").stdout
    (sample,) = json.loads(exported)["samples"]
    elements = {one["element"]: one for one in sample["composition"]["elements"]}
    doses = {dose["lot"]: dose["dispensed_mg"] for dose in sample["doses"]}
    li = doses["lithium_carbonate/LC-17"] * 0.995 * 0.998 / (2 * LI + C + 3 * O) * 2
    co = doses["cobalt_oxide/CO-4"] * 0.997 / (3 * CO + 4 * O) * 3
    by_hand = {"Li": 2.05 * li / (li + co), "Co": 2.05 * co / (li + co)}
    assert {e: one["reached"] for e, one in elements.items()} == pytest.approx(by_hand, rel=1e-4)
    assert {e: one["asked"] for e, one in elements.items()} == {"Li": 1.05, "Co": 1.0}
    assert sample["composition"]["verdict"] == "in tolerance"
    cell = ", ".join(
        f"{e} {one['reached']:.4f} ± {one['uncertainty']:.4f} of {one['asked']:.4f}" for e, one in elements.items()
    )
    command("report", ran, "-o", tmp_path / "report.html")
    assert f"{cell}: in tolerance" in (tmp_path / "report.html").read_text(encoding="utf-8")
    rows = [line.split(",") for line in command("export", ran, "--csv").stdout.splitlines()]
    header = [name.strip('"') for name in rows[0]]
    written = [
        dict(zip(header, (cell.strip('"') for cell in row), strict=False)) for row in rows if '"composition"' in row
    ]
    assert {row["element"]: row["atoms_reached"] for row in written} == {
        e: f"{one['reached']:.4f}" for e, one in elements.items()
    }
    assert {(row["product"], row["verdict"], row["composition_tolerance"]) for row in written} == {
        ("LiCoO2", "in tolerance", "0.0150")
    }
    story = command("show", ran).stdout
    assert f"Li {elements['Li']['reached']:.4f}" in story


def test_a_page_tells_what_a_composed_sample_asks_for_before_and_while_it_is_dosed(ran: Path) -> None:
    begun = Page(Follower(ran, until_s=0.0)).news(is_held=True)
    assert begun["rows"][0]["what"] == "798.3 mg ± 10.3 mg from li + 1.6452 g ± 21.2 mg from co"
    dosed_s = next(row["time_s"] for row in read(ran, "entry") if row["kind"] == "dose")
    told = Page(Follower(ran, until_s=dosed_s)).news(is_held=True)
    of = "798.3 mg ± 10.3 mg of lithium_carbonate + 1.6452 g ± 21.2 mg of cobalt_oxide"
    assert told["job"]["about"] == f"lco-rich: {of} into lco-rich (alumina_crucible)"


def test_a_plan_tells_what_each_sample_is_made_of(command: Call) -> None:
    told = command("plan", "recipes/cathodes.yaml", "--trials", 0).stdout
    assert re.search(
        r"^lco-rich: LiCoO2 \(Li 1\.05 Co 1, each within 1\.5 %\): 798\.3 mg ± 10\.\d* mg of lithium", told, re.M
    )
    page = (REPOSITORY / "docs/compose.md").read_text(encoding="utf-8")
    shown = [line for line in page.splitlines() if re.match(r"lco\S*: LiCoO2 ", line)]
    assert len(shown) == 2
    assert [line for line in shown if line not in told] == [], "the page shows what the command says"
    values = json.loads(command("plan", "recipes/cathodes.yaml", "--trials", 0, "--json").stdout)
    (job,) = (job for job in values["jobs"] if job["sample"] == "lco")
    assert [powder["formula"] for powder in job["composition"]["powders"]] == ["Li2CO3", "Co3O4"]
