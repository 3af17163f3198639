"""The apex in the hand, and where table and balance stand: by points that the apex touches, the arm led by hand."""

from collections.abc import Callable, Mapping

import numpy as np

from scuhand_bt.commissioning.limp_arm import LimpArm, limp
from scuhand_bt.commissioning.step import Found, NotFound, Site
from scuhand_bt.motion.kinematics import Mount, apex
from scuhand_bt.motion.touching import apex_in_flange, standing
from scuhand_bt.yaml_edit import Path as Keys
from scuhand_bt.yaml_edit import Value

POSTURES = 6
LEANS = ("upright", "leaning left", "leaning right", "leaning towards you", "leaning away", "turned about its own axis")
OFF_MM = 1.5
"""Touched points that fit no better than this were not touched with care, or the joints' zero is not right."""
TILT_DEG = 1.0
"""What leans more is to be levelled: a container on it would, and powder would land beside."""


def find_apex(site: Site) -> Found:
    """The apex in the flange's frame, sideways too."""
    with limp(site.cell.arm, site.person) as arm:
        site.person.tell("Put something with a sharp point firmly on the table, some 30 cm in front of the arm.")
        met = []
        for number, how in enumerate(LEANS[:POSTURES], start=1):
            site.person.ask(f"Touch that point with the apex, the cone {how} ({number} of {POSTURES}).")
            met.append(arm.joints(site.cell.arm))
    try:
        found = apex_in_flange(np.array(met))
    except ValueError as error:
        raise NotFound(f"{error}") from None
    if found.off_mm > OFF_MM:
        raise NotFound(
            f"the apex was up to {found.off_mm:.1f} mm from the point: touch it with care, or see to the joints' zero "
            "first (`scuhand-bt commission zero`)"
        )
    x_mm, y_mm = (round(beside_mm, 2) + 0.0 for beside_mm in found.aside_mm)
    values: Mapping[Keys, Value] = {
        ("hand", "apex_offset"): f"{found.offset_mm:.2f} mm",
        ("hand", "apex_aside"): [f"{x_mm:g} mm", f"{y_mm:g} mm"],
    }
    words = {
        "along the handle": f"{found.offset_mm:.2f} mm from the flange",
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
        with limp(site.cell.arm, site.person) as arm:
            touched = [_touched_mm(site, arm, name, point_mm) for point_mm in frame.landmarks_mm]
        try:
            found = standing(np.array(frame.landmarks_mm), np.array(touched), np.array(frame.pivot_mm))
        except ValueError as error:
            raise NotFound(f"the landmarks of '{name}': {error}") from None
        if found.off_mm > OFF_MM:
            raise NotFound(
                f"the points were not touched where they are, or stand otherwise than robot/cell.yaml says: "
                f"{found.off_mm:.1f} mm off"
            )
        if found.tilt_deg > TILT_DEG:
            raise NotFound(
                f"the {name} leans by {found.tilt_deg:.1f}° against the arm's base: level it, and the base, first"
            )
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
    site.person.ask(f"Touch the mark of the {name} at ({at}) mm with the apex, the cone upright.")
    mount = Mount.of(site.cell.hand)
    touched_mm: list[float] = (1e3 * apex(arm.joints(site.cell.arm), mount).position_m).tolist()
    return touched_mm
