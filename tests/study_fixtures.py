"""What is studied, and `plan` without the arm's ways. What they need is imported by those that use them."""

from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from conftest import LabFolder

    from scuhand_bt.study.trial import Setup


@pytest.fixture
def no_ways(monkeypatch: pytest.MonkeyPatch) -> None:
    """What `plan` says of the arm's ways, which are planned anew for each lab, is told elsewhere (`test_ways`)."""
    monkeypatch.setattr("scuhand_bt.api.labs.ways_lacking", lambda *_: [])


@pytest.fixture
def setup(lab_folder: "LabFolder") -> "Setup":
    from study_bench import RECIPE

    from scuhand_bt.study.trial import Setup

    return Setup(lab_folder.write("recipes/two.yaml", RECIPE), lab_folder.folder)
