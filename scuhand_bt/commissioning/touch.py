"""The apex in the hand, and where table and balance stand: by points that the apex touches, the arm led by hand."""

import math
from collections.abc import Callable, Mapping

import numpy as np

from scuhand_bt.commissioning.limp_arm import LimpArm, limp
from scuhand_bt.commissioning.step import Found, NotFound, Site
from scuhand_bt.devices.dynamixel.registers import COUNTS_PER_RAD
from scuhand_bt.motion.kinematics import Mount, apex
from scuhand_bt.motion.touching import calibrated, standing
from scuhand_bt.yaml_edit import Path as Keys
from scuhand_bt.yaml_edit import Value

HOWS = (
    "upright",
    "leaning left",
    "leaning right",
    "leaning forward",
    "leaning back",
    "upright, the hand turned by a quarter",
)
ELBOWS = ("the elbow up", "the elbow aside")
OFF_MM = 1.5
"""Touched points that fit no better than this were not touched with care, or the joints' zero is not right."""
ZERO_DEG = 2.0
"""No mark is missed by so much."""
TILT_DEG = 1.0
"""What leans more is to be levelled: a container on it would, and powder would land beside."""


def find_apex(site: Site) -> Found:
    """The apex in the flange's frame, sideways too, and what the joints' marks are off by."""
    with limp(site.cell.arm, site.person, site.cell.hand.options.roller_id) as arm:
        site.person.tell("Put something with a sharp point firmly on the table, some 30 cm in front of the arm.")
        met = []
        postures = [f"the cone {how}, {elbow}" for elbow in ELBOWS for how in HOWS]
        for number, posture in enumerate(postures, start=1):
            site.person.ask(f"Touch that point with the apex, {posture} ({number} of {len(postures)}).")
            met.append(arm.joints(site.cell.arm))
    try:
        found = calibrated(np.array(met))
    except ValueError as error:
        raise NotFound(f"{error}") from None
    if found.off_mm > OFF_MM:
        raise NotFound(
            f"the apex was up to {found.off_mm:.1f} mm from the point: touch it with care, or set the joints' zero "
            "first (`scuhand-bt commission zero`)"
        )
    if (worst_deg := math.degrees(np.abs(found.off_rad).max())) > ZERO_DEG:
        raise NotFound(
            f"a joint would be {worst_deg:.1f}° off its mark: put the arm straight up with more care "
            "(`scuhand-bt commission zero`), and touch again"
        )
    x_mm, y_mm, along_mm = (round(mm, 2) + 0.0 for mm in found.apex_mm.tolist())
    options = site.cell.arm.options
    homes = [
        home - round(way * off_rad * COUNTS_PER_RAD)
        for home, way, off_rad in zip(options.home_counts, options.directions, found.off_rad.tolist(), strict=True)
    ]
    values: Mapping[Keys, Value] = {
        ("hand", "apex_offset"): f"{along_mm:g} mm",
        ("hand", "apex_aside"): [f"{x_mm:g} mm", f"{y_mm:g} mm"],
        ("arm", "options", "home_counts"): homes,
    }
    words = {
        "along the handle": f"{along_mm:g} mm from the flange",
        "the joints beside their marks": ", ".join(f"{off:+.2f}" for off in np.degrees(found.off_rad)[1:6])
        + "° (2 to 6)",
        "beside it": f"{x_mm:+.2f} mm, {y_mm:+.2f} mm",
        "touched to within": f"{found.off_mm:.2f} mm",
    }
    return Found(words, values)


def find_frame(name: str) -> Callable[[Site], Found]:
    """Where one of the cell's frames stands."""

    def find(site: Site) -> Found:
        frame = site.cell.frames.get(name)
        if frame is None or frame.landmarks_mm is None:
            raise NotFound(
                f"the cell has no frame '{name}' with `landmarks`, three points that can be touched; the starter lab's "
                "robot/cell.yaml shows one"
            )
        with limp(site.cell.arm, site.person, site.cell.hand.options.roller_id) as arm:
            touched = [_touched_mm(site, arm, name, point_mm) for point_mm in frame.landmarks_mm]
        try:
            found = standing(np.array(frame.landmarks_mm), np.array(touched), np.array(frame.pivot_mm))
        except ValueError as error:
            raise NotFound(f"the landmarks of '{name}': {error}") from None
        if found.off_mm > OFF_MM:
            raise NotFound(
                f"the points touched are up to {found.off_mm:.1f} mm from where robot/cell.yaml has them: touch them "
                "with care, or correct `landmarks`"
            )
        if found.tilt_deg > TILT_DEG:
            raise NotFound(f"the {name} leans by {found.tilt_deg:.1f}° against the arm's base: level both first")
        shift = [f"{mm:.2f} mm" for mm in found.shift_mm.tolist()]
        words = {
            "shifted by": ", ".join(f"{mm:+.2f}" for mm in found.shift_mm.tolist()) + " mm",
            "turned by": f"{found.yaw_deg:+.2f}°",
            "leans by": f"{found.tilt_deg:.2f}°",
            "touched to within": f"{found.off_mm:.2f} mm",
        }
        return Found(words, {("frames", name, "shift"): shift, ("frames", name, "yaw"): f"{found.yaw_deg:.3f} deg"})

    return find


def _touched_mm(site: Site, arm: LimpArm, name: str, point_mm: tuple[float, float, float]) -> list[float]:
    at = ", ".join(f"{mm:g}" for mm in point_mm)
    site.person.ask(f"Touch the mark of the {name} at ({at}) mm with the apex, the cone being upright.")
    mount = Mount.of(site.cell.hand)
    touched_mm: list[float] = (1e3 * apex(arm.joints(site.cell.arm), mount).position_m).tolist()
    return touched_mm
