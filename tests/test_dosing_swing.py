"""The lip-led swing, by properties that are checked with a geometry of their own."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from scuhand_bt.dosing.ladle import Ladle, NoStrokeError, Stroke
from scuhand_bt.dosing.swing import StrokePath, headings_deg, stroke_path
from scuhand_bt.dosing.swing_plane import fitting_rim_mm, least_attack_deg
from scuhand_bt.dosing.vessel import Vessel

AGATE = Vessel.bowl(90.0, 30.0, 115.0)
SMALL = Vessel.bowl(65.0, 22.0, 85.0)
JAR = Vessel.cylinder(110.0, 40.0, 116.0)
LADLE = Ladle()

strokes = st.builds(
    Stroke,
    open_mm=st.floats(46.0, 86.0),
    closed_mm=st.floats(46.0, 86.0),
    begin_mm=st.floats(-35.0, 5.0),
    attack_deg=st.floats(15.0, 45.0),
    heading_deg=st.floats(0.0, 360.0),
)


def _bowl_centre_mm(vessel: Vessel) -> np.ndarray:
    return np.array([0.0, 0.0, ((vessel.bore_mm / 2) ** 2 + vessel.depth_mm**2) / (2 * vessel.depth_mm)])


def _made(vessel: Vessel, stroke: Stroke) -> StrokePath:
    try:
        return stroke_path(vessel, stroke, LADLE)
    except NoStrokeError:
        assume(False)
        raise


def _tilts_deg(path: StrokePath, heading_deg: float) -> np.ndarray:
    heading = math.radians(heading_deg)
    return np.degrees(np.arctan2(path.axis[:, :2] @ [math.cos(heading), math.sin(heading)], path.axis[:, 2]))


@settings(max_examples=25, deadline=None)
@given(strokes, st.sampled_from([AGATE, SMALL]))
def test_in_a_bowl_the_lip_follows_the_wall_and_the_apex_touches_nothing(stroke: Stroke, bowl: Vessel) -> None:
    path = _made(bowl, stroke)
    centre_mm = _bowl_centre_mm(bowl)
    alpha = np.arcsin(path.rim_mm / 100.0)[:, None]
    down = (np.cos(alpha) * path.axis - path.seam) / np.sin(alpha)
    lip_mm = path.apex_mm + 50.0 * (np.cos(alpha) * path.axis + np.sin(alpha) * down)
    off_mm = centre_mm[2] - np.linalg.norm(lip_mm - centre_mm, axis=1)
    assert np.abs(off_mm[path.on_wall]).max() <= 0.3
    below_edge = path.apex_mm[:, 2] < bowl.depth_mm
    clear_mm = centre_mm[2] - np.linalg.norm(path.apex_mm - centre_mm, axis=1)
    assert (clear_mm[below_edge] >= 3.0 - 1e-6).all()
    edge_mm = np.hypot(np.hypot(*path.apex_mm[:, :2].T) - bowl.bore_mm / 2, path.apex_mm[:, 2] - bowl.depth_mm)
    assert (edge_mm >= 3.0 - 1e-6).all()


@settings(max_examples=25, deadline=None)
@given(strokes)
def test_tilt_and_place_on_the_wall_add_up_to_a_right_angle_and_attack_less_half_angle(stroke: Stroke) -> None:
    path = _made(AGATE, stroke)
    outward = (path.lip_mm - _bowl_centre_mm(AGATE))[path.on_wall]
    heading = math.radians(stroke.heading_deg)
    phi_deg = np.degrees(np.arctan2(outward[:, :2] @ [math.cos(heading), math.sin(heading)], -outward[:, 2]))
    alpha_deg = np.degrees(np.arcsin(path.rim_mm / 100.0))[path.on_wall]
    theta_deg = _tilts_deg(path, stroke.heading_deg)[path.on_wall]
    assert theta_deg + phi_deg == pytest.approx(90.0 + path.attack_deg[path.on_wall] - alpha_deg, abs=0.05)
    # The attack as it is: between the lip's generator and the wall's tangent there.
    generator = ((path.lip_mm - path.apex_mm) / 50.0)[path.on_wall]
    normal = outward / np.linalg.norm(outward, axis=1)[:, None]
    attack_deg = np.degrees(np.arcsin((generator * normal).sum(axis=1)))
    assert attack_deg == pytest.approx(path.attack_deg[path.on_wall], abs=0.05)
    assert (attack_deg >= stroke.attack_deg - 0.05).all()


@pytest.mark.parametrize("asked_deg", [35.5, 40.0, 45.0])
def test_an_attack_that_keeps_the_apex_clear_is_kept_as_asked(asked_deg: float) -> None:
    path = stroke_path(AGATE, Stroke(80.0, 72.0, -20.0, attack_deg=asked_deg), LADLE)
    assert np.abs(path.attack_deg[path.on_wall] - asked_deg).max() <= 3.0


def test_an_attack_too_flat_for_the_apex_becomes_the_flattest_that_is_not() -> None:
    path = stroke_path(AGATE, Stroke(80.0, 80.0, -28.0, attack_deg=22.0), LADLE)
    attack_deg = path.attack_deg[path.on_wall]
    assert attack_deg[0] == pytest.approx(22.0, abs=3.0)  # as long as the apex is above the edge
    assert attack_deg[-1] == pytest.approx(least_attack_deg(48.75, 50.0), abs=0.5)


def test_the_flattest_attack_leaves_the_apex_just_clear_of_the_bowl() -> None:
    beta = math.radians(least_attack_deg(48.75, 50.0))
    from_centre_mm = math.sqrt(48.75**2 - 2 * 48.75 * 50.0 * math.sin(beta) + 50.0**2)
    assert 48.75 - from_centre_mm == pytest.approx(3.0)
    with pytest.raises(NoStrokeError, match="too large"):
        least_attack_deg(25.0, 50.0)


def test_the_fitting_rim_is_as_wide_as_the_wall_is_where_it_lies() -> None:
    for attack_deg in (22.0, 34.8):
        rim_mm = fitting_rim_mm(48.75, 50.0, attack_deg)
        alpha = math.asin(rim_mm / 100.0)
        assert rim_mm / 2 == pytest.approx(48.75 * math.cos(alpha - math.radians(attack_deg)))
    assert fitting_rim_mm(48.75, 50.0, 22.0) == pytest.approx(82.0, abs=0.3)


@settings(max_examples=25, deadline=None)
@given(strokes)
def test_no_part_of_the_sheet_enters_the_wall(stroke: Stroke) -> None:
    path = _made(AGATE, stroke)
    centre_mm = _bowl_centre_mm(AGATE)
    across = np.cross(path.axis, path.seam)
    across /= np.linalg.norm(across, axis=1)[:, None]
    other = np.cross(path.axis, across)
    alpha = np.arcsin(path.rim_mm / 100.0)[:, None]
    for psi in np.linspace(0.0, 2 * math.pi, 40):
        ring = math.cos(psi) * across + math.sin(psi) * other
        rim_mm = path.apex_mm + 50.0 * (np.cos(alpha) * path.axis + np.sin(alpha) * ring)
        low = rim_mm[:, 2] < AGATE.depth_mm
        is_outside = np.hypot(*rim_mm[:, :2].T) > AGATE.outer_mm / 2
        inside_mm = centre_mm[2] - np.linalg.norm(rim_mm - centre_mm, axis=1)
        assert (inside_mm[low & ~is_outside] >= -0.2).all()


@pytest.mark.parametrize(("bore_mm", "depth_mm", "outer_mm"), [(104.0, 47.0, 112.0), (127.0, 52.5, 135.0)])
def test_the_edge_of_a_large_deep_bowl_comes_between_no_points_of_the_sheet(
    bore_mm: float, depth_mm: float, outer_mm: float
) -> None:
    """It stands where the cone is turned upright, and is a corner: the sheet is clear on either side of it."""
    bowl = Vessel.bowl(bore_mm, depth_mm, outer_mm)
    path = stroke_path(bowl, Stroke(92.0, 80.0, begin_mm=-44.0), LADLE)
    around = np.linspace(0.0, 2 * math.pi, 73)
    edge_mm = np.stack([bore_mm / 2 * np.cos(around), bore_mm / 2 * np.sin(around), np.full(73, depth_mm)], axis=1)
    for apex_mm, axis, rim_mm in zip(path.apex_mm, path.axis, path.rim_mm, strict=True):
        alpha = math.asin(rim_mm / 100.0)
        from_apex_mm = edge_mm - apex_mm
        away_mm = np.linalg.norm(from_apex_mm, axis=1)
        off = np.arccos(np.clip(from_apex_mm @ axis / away_mm, -1.0, 1.0)) - alpha
        inside_mm = away_mm * np.sin(-off)
        assert (inside_mm[(away_mm < 45.0) & (abs(off) < 0.5)] <= 0.2).all()


def test_a_stroke_comes_in_from_above_and_ends_upright_above_the_edge() -> None:
    path = stroke_path(AGATE, Stroke(82.0, 74.0, -28.0, heading_deg=130.0), LADLE)
    for end in (0, -1):
        height_mm = path.lip_mm[end, 2] if end == 0 else path.apex_mm[end, 2]
        assert height_mm >= AGATE.depth_mm + 9.0
    assert path.axis[-1] == pytest.approx([0.0, 0.0, 1.0], abs=1e-9)
    assert (np.diff(path.times_s) > 0).all()
    assert path.rim_mm[0] == pytest.approx(82.0, abs=0.1)
    assert path.rim_mm[-1] == pytest.approx(74.0, abs=1.0)
    assert np.linalg.norm(np.diff(path.apex_mm, axis=0), axis=1).max() < 4.0


def test_the_handle_continues_the_seam_on_the_side_away_from_the_lip() -> None:
    path = stroke_path(AGATE, Stroke(90.0 - 3, 80.0, -20.0), LADLE)
    half_deg = np.degrees(np.arcsin(path.rim_mm / 100.0))
    assert np.degrees(np.arccos((path.seam * path.axis).sum(axis=1))) == pytest.approx(half_deg)
    assert path.seam[-1, 0] < 0 < path.lip_mm[-1, 0] - path.apex_mm[-1, 0]


def test_a_tilt_that_is_not_allowed_is_never_used_and_shortens_the_stroke() -> None:
    whole = stroke_path(AGATE, Stroke(80.0, 80.0, -28.0), LADLE)
    less = stroke_path(AGATE, Stroke(80.0, 80.0, -28.0, max_tilt_deg=60.0), LADLE)
    assert _tilts_deg(less, 0.0).max() <= 60.0
    assert less.lip_mm[less.on_wall][0, 0] > whole.lip_mm[whole.on_wall][0, 0] + 20.0


def test_over_travel_presses_the_lip_into_the_wall_and_not_the_apex() -> None:
    path = stroke_path(AGATE, Stroke(80.0, 80.0, -20.0, gap_mm=-1.5), LADLE)
    off_mm = 48.75 - np.linalg.norm(path.lip_mm - _bowl_centre_mm(AGATE), axis=1)
    assert off_mm[path.on_wall] == pytest.approx(-1.5, abs=0.01)
    assert AGATE.clearance_mm(path.apex_mm).min() >= 3.0 - 1e-6


def test_in_a_jar_the_lip_sweeps_the_floor() -> None:
    path = stroke_path(JAR, Stroke(90.0, 82.0, -49.0, max_tilt_deg=120.0), LADLE)
    lip_mm = path.lip_mm[path.on_wall]
    assert lip_mm[:, 2] == pytest.approx(0.1, abs=0.3)
    assert lip_mm[0, 0] < -45.0
    assert lip_mm[-1, 0] > 40.0
    assert path.apex_mm[:, 2].min() >= 3.0 - 1e-6
    assert path.axis[-1, 2] == pytest.approx(1.0)


def test_a_rim_that_does_not_go_in_and_one_that_no_sheet_makes_are_refused() -> None:
    with pytest.raises(NoStrokeError, match="does not fit into a bore of 65 mm"):
        stroke_path(SMALL, Stroke(66.0, 60.0, -20.0), LADLE)
    with pytest.raises(ValueError, match="cannot make rims"):
        stroke_path(AGATE, Stroke(80.0, 120.0, -20.0), LADLE)


def test_a_cylinder_whose_handle_cannot_pass_its_edge_is_refused() -> None:
    with pytest.raises(NoStrokeError):
        stroke_path(Vessel.cylinder(70.0, 400.0, 76.0), Stroke(50.0, 45.0, -20.0), LADLE)


def test_strokes_are_turned_as_far_from_each_other_as_they_can_be() -> None:
    assert list(headings_deg(4)) == [0.0, 180.0, 90.0, 270.0]


def test_a_vessel_is_clear_of_what_is_beside_and_above_it() -> None:
    points_mm = np.array([[0, 0, 5.0], [0, 0, -2.0], [45.0, 0, 33.0], [50, 0, 35.0], [50, 0, 29.0], [70.0, 0, 10.0]])
    assert AGATE.clearance_mm(points_mm) == pytest.approx([5.0, -2.0, 3.0, 5.0, 48.75 - math.hypot(50, 19.75), 12.5])
    assert JAR.clearance_mm(np.array([[0, 0, 2.0], [53.0, 0, 20.0]])) == pytest.approx([2.0, 2.0])


def test_the_wall_is_where_and_as_steep_as_the_vessel_is() -> None:
    out_mm, high_mm, steep = AGATE.wall(np.array([-AGATE.to_edge_mm, 0.0, AGATE.to_edge_mm]))
    assert out_mm == pytest.approx([-45.0, 0.0, 45.0])
    assert high_mm == pytest.approx([30.0, 0.0, 30.0])
    assert np.degrees(steep) == pytest.approx([-67.38, 0.0, 67.38], abs=0.01)
    out_mm, high_mm, steep = JAR.wall(np.array([50.0, JAR.to_edge_mm]))
    assert out_mm == pytest.approx([50.0, 55.0])
    assert high_mm == pytest.approx([0.0, 40.0])
    assert np.degrees(steep) == pytest.approx([0.0, 90.0])
