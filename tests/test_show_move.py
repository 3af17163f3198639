"""The pages that draw the arm: what they show, and that they need nothing from outside."""

import re
from pathlib import Path

import numpy as np
import pytest

from scuhand_bt.lab import load_lab, starter_lab
from scuhand_bt.motion import ApexPose, MotionPlanner
from scuhand_bt.report.reach import reach_page
from scuhand_bt.report.show_move import ShownMove, move_page, move_png

LAB = load_lab(starter_lab())
OFFSET_M = LAB.cell.hand.apex_offset_mm / 1e3


def shown(speed_ratio: float = 1.0, spill_limit_deg: float | None = None) -> ShownMove:
    arm = LAB.cell.arm.model_copy(update={"speed_ratio": speed_ratio})
    planner = MotionPlanner(LAB.urdf, LAB.cell.model_copy(update={"arm": arm}))
    home = planner.home()
    over = np.array(LAB.cell.stations["mortar_bay"].position_mm) / 1e3 + (0.0, 0.0, 0.1)
    motion = planner.move(home, ApexPose(over), spill_limit_deg=spill_limit_deg)
    return ShownMove("there </script>", motion, planner.scene(), planner.rates, OFFSET_M, {"mortar_bay": over})


def test_the_page_is_one_file_with_the_cell_the_stations_and_five_plots() -> None:
    page = move_page(shown())
    assert not re.search(r"https?:|src=|href=|@import", page)
    assert page.count("</script>") == 1
    assert page.count("<svg") == 5
    for name in ("shield_left", "balance_body", "mortar_bay"):
        assert f'"{name}"' in page


def test_the_plots_show_each_joints_own_limits_as_planned_with() -> None:
    position, speed, *_, spill = shown(speed_ratio=0.5).panels()
    assert (-159.0, "j4") in position.limits
    assert (90.0, "j2 j6") in position.limits
    assert [whose for _, whose in speed.limits] == ["all but j2", "j2", "j2", "all but j2"]
    assert speed.limits[-1][0] == pytest.approx(4.817 / 2, abs=1e-3)
    assert np.abs(speed.values).max() <= 4.817 / 2 + 1e-6
    assert spill.limits == []


def test_a_loads_spill_angle_is_plotted_under_its_limit() -> None:
    move = shown(spill_limit_deg=12.0)
    spill = move.panels()[-1]
    assert spill.limits == [(move.motion.spill_limit_deg, "")]
    assert 0 < spill.values.max() <= 12.0


def test_the_picture_is_a_png(tmp_path: Path) -> None:
    move_png(shown(), tmp_path / "move.png")
    assert (tmp_path / "move.png").read_bytes().startswith(b"\x89PNG")


def test_a_station_out_of_reach_is_marked_on_the_map() -> None:
    far = LAB.cell.stations["waste"].model_copy(update={"position_mm": (0.0, 590.0, 100.0)})
    cell = LAB.cell.model_copy(update={"stations": {**LAB.cell.stations, "waste": far}})
    assert reach_page(cell).count("cannot be reached") == 1
