"""How long a scoop takes, and what it does where its cone cannot be formed on the way."""

import math
from pathlib import Path
from typing import Any

import pytest
from running import HEAD, Ran, dry_run, make_lab

from scuhand_bt.cell.carrying import carrying_limit_deg
from scuhand_bt.device_specs.hand import MOUNTED_DIAMETER_MM
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


def _actions(ran: Ran) -> list[tuple[str, float]]:
    """What was done, and how long it took [s]."""
    return [(row["skill"], row["ended_s"] - row["started_s"]) for row in read(ran.journal, "action")]


def _scoop_s(ran: Ran) -> float:
    (took_s,) = [took_s for skill, took_s in _actions(ran) if skill == "scoop"]
    return took_s


@pytest.mark.parametrize(("source", "most_s"), [("beads", 9.0), ("msg", 12.0)], ids=["larger mortar", "small mortar"])
def test_how_long_a_scoop_takes_to_the_mortar_and_back_to_its_place(tmp_path: Path, source: str, most_s: float) -> None:
    ran = dry_run(tmp_path, RECIPE % source, seed=2)
    assert ran.sample("a").verdict == "in tolerance"
    assert _scoop_s(ran) < most_s


def test_powder_is_let_out_of_a_cone_of_its_usual_size_only(tmp_path: Path) -> None:
    """Which the cone gets as part of the way to the pan, and of none that comes later."""
    ran = dry_run(tmp_path, RECIPE % "beads")
    assert ran.session.cell.hand.cone_diameter_mm == pytest.approx(MOUNTED_DIAMETER_MM)
    over_s = [took_s for skill, took_s in _actions(ran) if skill == "move_over"]
    assert over_s[-1] > math.pi * (MOUNTED_DIAMETER_MM - 70.0) / ran.session.cell.spec.hand.morph_speed_mm_per_s


@pytest.mark.parametrize(("thick_mm", "gap_mm", "force_n"), [(0.2, -1.0, 0.22), (0.6, -0.34, 2.0)])
def test_a_lip_is_pressed_into_the_wall_for_the_last_powder_and_a_stiff_one_less_far(
    tmp_path: Path, thick_mm: float, gap_mm: float, force_n: float
) -> None:
    """A strip's stiffness goes by the cube of its thickness: 27 times as much would be 5.9 N."""
    lab = make_lab(tmp_path / "lab")
    cell = lab / "robot" / "cell.yaml"
    hand = f"{{driver: hand_controller, port: /dev/ttyACM0, sheet_thickness: {thick_mm} mm}}"
    cell.write_text(cell.read_text().replace("{driver: hand_controller, port: /dev/ttyACM0}", hand))
    recipe = RECIPE % "beads" + HEAD.replace("20 g", "1.2 g")
    ran = dry_run(tmp_path, recipe, lab=lab)
    (scoop,) = (row["payload"] for row in read(ran.journal, "event") if row["kind"] == "scoop")
    assert scoop["gap_mm"] == pytest.approx(gap_mm, abs=0.01)
    assert scoop["lip_force_n"] == pytest.approx(force_n, abs=0.01)
    assert scoop["lip_force_limit_n"] == 2.0


def test_where_the_cone_cannot_be_formed_on_the_way_it_is_formed_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    on_the_way_s = _scoop_s(dry_run(tmp_path, RECIPE % "beads"))

    def never(*asked: Any) -> None:
        raise SkillFailed(Code.ARM_NO_PATH, "the cone would touch something while its rim changes to 82 mm")

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
