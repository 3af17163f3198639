"""How long a scoop takes, and what it does where its cone cannot be formed on the way."""

from pathlib import Path
from typing import Any

import pytest
from running import Ran, dry_run

from scuhand_bt.cell.cell import carrying_limit_deg
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.journal.reader import read
from scuhand_bt.lab import load_lab, starter_lab
from scuhand_bt.motion import MotionPlanner

RECIPE = """
recipe: r
workflow: prime_and_fill   # nothing else goes on while it scoops
defaults: {container: alumina_crucible, waste: alumina_crucible, prime: 0 mg, tolerance: 5 mg}
samples:
  - {id: a, source: %s, mass: 500 mg}
"""
TO_THE_PLACE_S = 1.1


def _scoop_s(ran: Ran) -> float:
    (scoop,) = [row for row in read(ran.journal, "action") if row["skill"] == "scoop"]
    took_s: float = scoop["ended_s"] - scoop["started_s"]
    return took_s


@pytest.mark.parametrize(
    ("source", "most_s"), [("beads", 12.0), ("msg", 19.4)], ids=["larger mortar", "small mortar, where the edge binds"]
)
def test_how_long_a_scoop_takes_from_the_mortars_place_back_to_it(tmp_path: Path, source: str, most_s: float) -> None:
    ran = dry_run(tmp_path, RECIPE % source)
    assert ran.sample("a").verdict == "in tolerance"
    assert _scoop_s(ran) < most_s + TO_THE_PLACE_S


def test_where_the_cone_cannot_be_formed_on_the_way_it_is_formed_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    on_the_way_s = _scoop_s(dry_run(tmp_path, RECIPE % "beads"))

    def never(*asked: Any) -> None:
        raise SkillFailed(Code.ARM_NO_PATH, "a cone that becomes 82 mm wide would touch something")

    monkeypatch.setattr(MotionPlanner, "forming", never)
    (tmp_path / "again").mkdir()
    ran = dry_run(tmp_path / "again", RECIPE % "beads")
    assert ran.sample("a").verdict == "in tolerance"
    assert _scoop_s(ran) > on_the_way_s + 0.5


def test_a_rim_that_a_servos_count_has_moved_carries_its_load_by_the_same_limit() -> None:
    lab = load_lab(starter_lab())
    limits_deg = {
        carrying_limit_deg(lab.cell, lab.library.powders["glass_beads"], 4000.0, rim_mm)
        for rim_mm in (69.99999999999, 70.0, 70.00000000001)
    }
    assert len(limits_deg) == 1
