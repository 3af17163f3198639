"""How far the roller turns for a millimetre of sheet, by the rims that a person measures; and where it stands.

The sheet's edge runs along the rim (`dosing/cone.py`), so the rim is a straight line over the roller's angle psi [deg]
from the flat sheet, whatever the sheet's radius R:

    D = 2 R - psi / (pi k)         k [deg/mm] = -1 / (pi dD/dpsi)
"""

import math
from collections.abc import Sequence

import numpy as np

from scuhand_bt.clock import carried_out
from scuhand_bt.commissioning.held_arm import held, led
from scuhand_bt.commissioning.step import Found, NotFound, Site
from scuhand_bt.devices.roller import FILE_NAME
from scuhand_bt.dosing.cone import Cone
from scuhand_bt.yaml_edit import Path as Keys
from scuhand_bt.yaml_edit import Value

RIMS = (0.87, 0.73, 0.60)
"""Where the rim is measured, as shares of the mounted one."""
MOUNTED_WITHIN_MM = 3.0
UNEVEN_MM = 1.0
"""Rims that are farther from a straight line were misread, or the sheet slips on its roller."""
MOST_OFF = 1.5
"""No roller is wider or narrower than described by more than this factor."""
NOTED_MM = 1.0
"""A mounted sheet that differs by less is as described: a rim is not read off any better."""


def deg_per_mm(turned_deg: Sequence[float], rims_mm: Sequence[float]) -> tuple[float, float]:
    """k [deg/mm], and how far the worst rim is from the line [mm]. ValueError for rims that do not become narrower."""
    slope, constant = np.polyfit(turned_deg, rims_mm, 1)
    if slope >= 0.0:
        raise ValueError("the rim does not become narrower: does the roller turn the sheet, and the right way?")
    off_mm = float(np.abs(np.array(rims_mm) - slope * np.array(turned_deg) - constant).max())
    return -1.0 / (math.pi * float(slope)), off_mm


def find_roller(site: Site) -> Found:
    """The roller's angle per millimetre of sheet, the mounted sheet's rim, and the roller's count from there."""
    person, hand = site.person, site.cell.hand
    mounted_mm = hand.options.start_diameter_mm
    person.ask(f"Empty the cone, and mount the sheet again, with a rim of {mounted_mm:g} mm.")
    first_mm = person.measure("How wide is its rim, as the mean of two directions at right angles? [mm]")
    if abs(first_mm - mounted_mm) > MOUNTED_WITHIN_MM:
        raise NotFound(
            f"the rim is {first_mm:g} mm wide, but a sheet is mounted with {mounted_mm:g} mm: mount it so, or correct "
            "`start_diameter` of the hand in robot/cell.yaml"
        )
    led(site, "Lead the hand to where its rim can be measured, and hold the arm there.")
    with held(site) as devices:
        devices.hand.rim_is(min(max(first_mm, hand.rim_limits_mm[0]), hand.rim_limits_mm[1]))
        turned_deg, rims_mm = [Cone(devices.hand.cone_diameter_mm, hand.sheet_radius_mm).roller_deg(hand)], [first_mm]
        for share in RIMS:
            to_mm = share * mounted_mm
            person.ask(
                f"The roller will now make the cone narrower by itself, to about {to_mm:.0f} mm. May it?",
                ("go", "stop"),
            )
            carried_out(devices.hand.morph(to_mm), site.clock)
            turned_deg.append(Cone(devices.hand.cone_diameter_mm, hand.sheet_radius_mm).roller_deg(hand))
            rims_mm.append(person.measure("How wide is the rim now, as the mean of two directions? [mm]"))
        carried_out(devices.hand.morph(mounted_mm), site.clock)
        last_mm = person.measure("The roller has gone back. How wide is the rim now? [mm]")
    try:
        per_mm, off_mm = deg_per_mm(turned_deg, rims_mm)
    except ValueError as error:
        raise NotFound(f"{error}") from None
    if off_mm > UNEVEN_MM or abs(last_mm - first_mm) > 2 * UNEVEN_MM:
        raise NotFound(
            f"the rims are up to {off_mm:.1f} mm from a straight line, and the last one is {last_mm - first_mm:+.1f} "
            "mm from the first: measure again, and check whether the sheet slips on its roller"
        )
    if not 1 / MOST_OFF < per_mm / hand.roller_deg_per_mm < MOST_OFF:
        raise NotFound(
            f"{per_mm:.2f}° per mm cannot be this hand's roller: robot/cell.yaml has {hand.roller_deg_per_mm:g}° per mm"
        )
    per_mm = round(per_mm, 3)
    values: dict[Keys, Value] = {("hand", "roller_deg_per_mm"): f"{per_mm:g}"}
    changes: dict[str, object] = {"roller_deg_per_mm": per_mm}
    if abs(first_mm - mounted_mm) > NOTED_MM:
        values["hand", "options", "start_diameter"] = f"{first_mm:g} mm"
        changes["options"] = hand.options.model_copy(update={"start_diameter_mm": first_mm})
    found = hand.model_copy(update=changes)
    with held(site, found, site.state / FILE_NAME) as devices:
        devices.hand.rim_is(min(max(last_mm, found.rim_limits_mm[0]), found.rim_limits_mm[1]))
    words = {
        "the roller turns": f"{per_mm:g}° per mm of sheet",
        "a mounted sheet's rim": f"{first_mm:g} mm",
        "measured to within": f"{off_mm:.2f} mm",
        "and back to": f"{last_mm:g} mm",
    }
    return Found(words, values)
