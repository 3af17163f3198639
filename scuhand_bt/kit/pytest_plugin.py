"""Fixtures for a lab's own tests in Python: `run_workflow` and `dry_cell`.

    def test_a_shake_takes_its_time(dry_cell):
        before_s = dry_cell.cell.clock.now_s
        dry_cell.run("shake", duration="5 s")
        assert dry_cell.cell.clock.now_s - before_s >= 5.0

    def test_it_scoops_again(run_workflow):
        ran = run_workflow(
            "scoop_and_dispense",
            sources={"beads": dict(station="mortar_bay", container="agate_mortar", powder="glass_beads", amount="5 g")},
            inputs={"source": "beads", "container": "xrd_holder", "mass": "50 mg"},
            substitute=[{"at": "**/dispense", "call": 1, "fails": "hand.cone_empty"}],
        )
        assert ran.outcome == "success"

The lab is the nearest one upward from the test's file, or that of the option `--lab`.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from scuhand_bt.kit.dry_cell import DryCell
    from scuhand_bt.kit.rehearsed import Rehearsed, Rehearser


def pytest_addoption(parser: pytest.Parser) -> None:
    """The option `--lab`."""
    group = parser.getgroup("scuhand_bt")
    group.addoption("--lab", type=Path, help="The lab whose workflows and skills are tested.")


_REHEARSERS: dict[Path, "Rehearser"] = {}


@pytest.fixture
def rehearser(request: pytest.FixtureRequest) -> "Rehearser":
    """What runs the workflows of the test's lab; planned ways are kept from test to test."""
    from scuhand_bt.kit.rehearsed import Rehearser
    from scuhand_bt.lab import find_lab, load_lab

    folder = find_lab(Path(request.path), request.config.getoption("--lab"))
    if folder not in _REHEARSERS:
        _REHEARSERS[folder] = Rehearser(load_lab(folder))
    return _REHEARSERS[folder]


@pytest.fixture
def run_workflow(rehearser: "Rehearser") -> "Callable[..., Rehearsed]":
    """Runs a workflow once on simulated devices; gives its calls, values and outcome.

    Unused substitutions are an error, as in a test file.
    """
    from scuhand_bt.kit.case_files import case_of
    from scuhand_bt.kit.cases import run_case

    def run(
        workflow: str,
        inputs: Mapping[str, Any],
        *,
        sources: Mapping[str, Mapping[str, Any]] | None = None,
        substitute: Sequence[Mapping[str, Any]] = (),
        faults: Sequence[Mapping[str, Any]] = (),
        seed: int = 0,
    ) -> "Rehearsed":
        values = {"inputs": inputs, "sources": sources, "substitute": substitute, "faults": faults, "seed": seed}
        case = case_of(workflow, values, rehearser.lab)
        result = run_case(case, rehearser, judged=False)
        if result.ran is None or result.wrong:
            pytest.fail("\n".join(result.wrong))
        return result.ran

    return run


@pytest.fixture
def dry_cell(rehearser: "Rehearser", tmp_path: Path) -> "Iterator[DryCell]":
    """A simulated cell, on which single skills are run."""
    from scuhand_bt.kit.dry_cell import DryCell

    with DryCell(rehearser, tmp_path) as cell:
        yield cell
