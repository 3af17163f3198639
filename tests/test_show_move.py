"""The pages that draw the arm: what they show, and that they need nothing from outside."""

import base64
import gzip
import json
import math
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from browser import browser_page, needs_browser, serious_faults

from scuhand_bt.lab import load_lab, starter_lab
from scuhand_bt.motion import ApexPose, MotionPlanner, Mount
from scuhand_bt.report.cell_mesh import CellMeshes
from scuhand_bt.report.motion_panels import spread
from scuhand_bt.report.move_page import page_of_move
from scuhand_bt.report.move_picture import move_png
from scuhand_bt.report.reach import reach_page
from scuhand_bt.report.scene3d import scene_values
from scuhand_bt.report.show_move import ShownMove

LAB = load_lab(starter_lab())
MOUNT = Mount.of(LAB.cell.hand)
MORTARS = {"mortar_bay": LAB.library.mortars["agate_mortar"]}


class Page(HTMLParser):
    """What a browser would fetch for a page, and its text outside of scripts."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.text = ""
        self._in_script = False
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.fetched += [value or "" for name, value in attributes if name in ("src", "href")]
        self._in_script = tag == "script"

    def handle_endtag(self, tag: str) -> None:
        self._in_script = False

    def handle_data(self, data: str) -> None:
        if not self._in_script:
            self.text += data


def shown(speed_ratio: float = 1.0, spill_limit_deg: float | None = None) -> ShownMove:
    arm = LAB.cell.arm.model_copy(update={"speed_ratio": speed_ratio})
    planner = MotionPlanner(LAB.urdf, LAB.cell.model_copy(update={"arm": arm}), MORTARS)
    home = planner.home()
    over = np.array(LAB.cell.stations["mortar_bay"].position_mm) / 1e3 + (0.0, 0.0, 0.1)
    motion = planner.move(home, ApexPose(over), spill_limit_deg=spill_limit_deg)
    places_m = {"mortar_bay": over}
    scene = planner.scene()
    drawn = scene_values(planner, MOUNT.offset_m, [44.0], places_m, LAB.library.containers.values())
    return ShownMove("there </script>", motion, scene, planner.rates, MOUNT, places_m, drawn, "xrd_holder")


def test_the_pages_are_one_file_that_fetches_nothing_and_break_on_no_name() -> None:
    for text, title in ((page_of_move(shown()), "there </script>"), (reach_page(LAB), "starter")):
        page = Page(text)
        assert page.fetched == []
        assert "@import" not in page.text
        assert title in page.text
        # A name that ended a script would spill what follows it into the page.
        assert "DecompressionStream" not in page.text


def packed(page: str, name: str) -> Any:
    """What a page has inside, compressed."""
    found = re.search(rf'id="viewer-{name}">([^<]*)<', page)
    assert found is not None
    return json.loads(gzip.decompress(base64.b64decode(found[1])))


def test_the_page_shows_the_cell_the_stations_what_stands_on_the_pan_and_every_plot_with_its_units() -> None:
    page = page_of_move(shown())
    scene = packed(page, "shown")["scene"]
    names = {one["name"] for one in scene["solids"]}
    assert {"shield_left", "shield_right", "balance_body", "mortar_bay"} <= names
    assert [one["name"] for one in scene["places"]] == ["mortar_bay"]
    assert {one["name"] for one in scene["containers"]} == set(LAB.library.containers)
    assert packed(page, "shown")["motions"][0]["pan"] == "xrd_holder"
    for panel in shown().panels():
        assert panel.name in Page(page).text


def test_the_motion_ends_where_it_leads_and_the_chain_puts_the_cones_tip_there() -> None:
    move = shown()
    (played,) = packed(page_of_move(move), "shown")["motions"]
    assert played["joints_rad"][-1] == pytest.approx(move.motion.end, abs=1e-5)
    assert played["step_s"] * (len(played["joints_rad"]) - 1) == pytest.approx(move.motion.duration_s)
    tip_m = move.path_m(np.array([move.motion.duration_s]))[0]
    assert math.dist(_tip_m(move.drawn, move.motion.end), tip_m) < 1e-4


def _tip_m(scene: Any, q: Any) -> Any:
    """Where a chain of joints puts the cone's tip, as the viewer reckons it."""
    at = pin.SE3.Identity()
    for joint, angle in zip(scene["joints"], q, strict=True):
        fixed = pin.XYZQUATToSE3(np.array(joint["at"]))
        at = at * fixed * pin.SE3(pin.AngleAxis(angle, np.array(joint["axis"])).toRotationMatrix(), np.zeros(3))
    return at.act(np.array(scene["apex"]))


@pytest.mark.slow
@needs_browser
def test_in_a_browser_the_page_draws_the_arm_where_its_motion_has_it_and_needs_no_network(
    tmp_path: Path, browser: Any
) -> None:
    move = shown()
    (tmp_path / "move.html").write_text(page_of_move(move), encoding="utf-8")
    (tmp_path / "reach.html").write_text(reach_page(LAB), encoding="utf-8")
    with browser_page(browser) as page:
        page.goto((tmp_path / "move.html").as_uri())
        page.locator("#viewer canvas").wait_for()
        page.evaluate(
            """() => { const slider = document.querySelector("[data-part=slider]");
               slider.value = slider.max; slider.dispatchEvent(new Event("input")); }"""
        )
        drawn_m = page.evaluate("document.getElementById('viewer').viewer.apex()")
        assert math.dist(drawn_m, move.path_m(np.array([move.motion.duration_s]))[0]) < 1e-3
        now = page.evaluate("document.documentElement.style.getPropertyValue('--now')")
        assert float(now) == pytest.approx(1.0)
        page.get_by_role("button", name="Play").click()
        page.get_by_role("button", name="Halt").wait_for()
        assert serious_faults(page) == []
        page.goto((tmp_path / "reach.html").as_uri())
        page.locator("#viewer canvas").wait_for()
        assert serious_faults(page) == []


def test_the_drawn_solids_are_closed_and_as_large_as_the_collision_shapes() -> None:
    scene = shown().scene
    meshes = CellMeshes(scene)
    box = next(mesh for mesh in meshes.standing if mesh.name == "balance_body")
    assert (len(box.triangles), len(box.edges)) == (12, 12)
    for mesh in [*meshes.standing, *meshes.arm(np.zeros(7))]:
        a, b, c = (mesh.points_m[mesh.triangles[:, k]] for k in range(3))
        volume_m3 = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
        assert volume_m3 > 0, "seen from outside, the corners run counter-clockwise"
        sides = np.sort(np.vstack([mesh.triangles[:, [0, 1]], mesh.triangles[:, [1, 2]], mesh.triangles[:, [2, 0]]]))
        assert (np.unique(sides, axis=0, return_counts=True)[1] == 2).all()
    for thing in scene.shapes.geometryObjects:
        if thing.name == "mortar_bay":
            mortar = next(mesh for mesh in meshes.standing if mesh.name == thing.name)
            assert np.ptp(mortar.points_m[:, 2]) == pytest.approx(2 * thing.geometry.halfLength)
            assert np.ptp(mortar.points_m[:, 0]) == pytest.approx(2 * thing.geometry.radius)


def test_the_plots_show_each_joints_own_limits_as_planned_with() -> None:
    position, speed, *_, spill = shown(speed_ratio=0.5).panels()
    assert (-159.0, "j4") in position.limits
    assert (90.0, "j2 j6") in position.limits
    assert [whose for _, whose in speed.limits] == ["all but j2", "j2", "j2", "all but j2"]
    assert speed.limits[-1][0] == pytest.approx(4.817 / 2, abs=1e-3)
    assert np.abs(speed.values).max() <= 4.817 / 2 + 1e-6
    assert spill.limits == []


def test_labels_of_limits_keep_their_distance() -> None:
    assert spread([-167.0, -159.0, 0.0], 20.0) == [-167.0, -147.0, 0.0]


def test_a_loads_spill_angle_is_plotted_under_its_limit() -> None:
    move = shown(spill_limit_deg=12.0)
    spill = move.panels()[-1]
    assert spill.limits == [(move.motion.spill_limit_deg, "")]
    assert 0 < spill.values.max() <= 12.0


@pytest.mark.slow
def test_the_picture_is_a_png(tmp_path: Path) -> None:
    move_png(shown(), tmp_path / "move.png")
    assert (tmp_path / "move.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_a_station_out_of_reach_is_marked_on_the_map() -> None:
    far = LAB.cell.stations["waste"].model_copy(update={"position_mm": (0.0, 750.0, 100.0)})
    cell = LAB.cell.model_copy(update={"stations": {**LAB.cell.stations, "waste": far}})
    assert Page(reach_page(replace(LAB, cell=cell))).text.count("cannot be reached") == 1
    assert Page(reach_page(LAB)).text.count("cannot be reached") == 0
