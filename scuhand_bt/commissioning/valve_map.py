"""Which opening belongs to which position of the valve's servo: its shape by weighing, its scale by one gauge.

The opening is what powder flows through, not what the rack moves. By Beverloo's law (`commissioning/valve.py`)

    W^0.4 = C'^0.4 (D - k)

so the openings at several positions are known to each other, whatever C' is; the widest of them, measured with pins or
drill shanks of known diameters, gives the scale. Where nobody has measured it, it stays what the map has said.

One pulse tells W by all that it brings: the valve goes to D and back at its speed v, on which ways as much falls as
in 2 (D - k) / 3.5 v seconds at D. The difference of two pulses would tell it without v, and worse by far: each opening
is a little other than the last, and both their errors come into a small difference (docs/commissioning.md).
"""

from collections.abc import Sequence

import numpy as np

from scuhand_bt.clock import carried_out
from scuhand_bt.commissioning.held_arm import held, led
from scuhand_bt.commissioning.step import Found, NotFound, Site
from scuhand_bt.commissioning.valve import (
    EMPTY,
    FILL,
    OPENS_MM,
    OVER_CRUCIBLE,
    POWDER,
    STILL_S,
    as_written,
    weighed_pulse,
)
from scuhand_bt.device_specs.hand import ValvePoint
from scuhand_bt.devices.connect import Devices
from scuhand_bt.failures import Code, SkillFailed

SHARES = (0.3, 0.45, 0.6, 0.8, 1.0)
"""Where the flow is weighed, of the widest opening."""
DWELLS_S = (2.0, 1.6, 1.3, 1.0, 1.0)
"""So long that the ways there and back count little, and a round does not empty the cone."""
ROUNDS = 3
"""The median of so many counts at each opening: now and then the sheet sticks, and opens wider."""
STRAIGHT_MM = 0.06
"""Openings that differ less from the present map leave it as it is: the flow at one opening varies by as much."""
MOST_OFF = 0.4
"""No valve's opening differs from its map by a larger share."""


def equivalent_mm(flows_mg_per_s: Sequence[float], threshold_mm: float, widest_mm: float) -> list[float]:
    """The openings that let so much flow, the last of which is `widest_mm`. ValueError for flows that do not rise."""
    roots = np.array(flows_mg_per_s, dtype=float) ** 0.4
    if (np.diff(roots) <= 0.0).any() or roots[0] <= 0.0:
        raise ValueError("the flow does not grow as the valve opens wider")
    openings_mm: list[float] = (threshold_mm + (widest_mm - threshold_mm) * roots / roots[-1]).tolist()
    return openings_mm


def find_valve_map(site: Site) -> Found:
    """The valve's map by points, where weighing and a gauge tell another than it has."""
    if (powder := site.lab.library.powders.get(POWDER)) is None:
        raise NotFound(f"this step needs the powder '{POWDER}', which is not in robot/powders.yaml")
    hand = site.cell.hand
    points = hand.options.valve_map
    told_mm = [round(share * hand.max_opening_mm, 2) for share in SHARES]
    led(site, OVER_CRUCIBLE)
    with held(site) as devices:
        rounds = []
        for _ in range(ROUNDS):
            site.person.ask(FILL)
            rounds.append(weighed_round(devices, site, told_mm, powder.belief.threshold_mm))
            if rounds[-1] is None:
                break
        site.person.ask(EMPTY)
        gauged_mm = _gauged_mm(devices, site)
    told = [one for one in rounds if one is not None]
    if len(told) < len(rounds):
        raise NotFound("powder runs though the valve is shut: run `scuhand-bt commission valve` first")
    flows = np.median(told, axis=0).tolist()
    try:
        openings_mm = equivalent_mm(flows, powder.belief.threshold_mm, gauged_mm or told_mm[-1])
    except ValueError as error:
        raise NotFound(f"{error}; is the powder dry, the cone full enough, and nothing in the valve?") from None
    pairs = list(zip(told_mm, openings_mm, strict=True))
    if any(abs(is_mm - opening_mm) > MOST_OFF * opening_mm for opening_mm, is_mm in pairs):
        found = ", ".join(f"{is_mm:.2f} mm at {opening_mm:g} mm" for opening_mm, is_mm in pairs)
        raise NotFound(
            f"the valve would be open by {found}, which is not possible: weigh again, and look for something in the "
            "valve"
        )
    words = {
        "the valve is open": ", ".join(f"{is_mm:.2f} mm at {opening_mm:g} mm" for opening_mm, is_mm in pairs),
        "its scale": f"{gauged_mm:g} mm by a gauge" if gauged_mm else "as in the map before; nobody has measured it",
    }
    if max(abs(is_mm - opening_mm) for opening_mm, is_mm in pairs) < STRAIGHT_MM:
        return Found(words | {"the map": "as it was"})
    counts = [round(float(np.interp(mm, [p.opening_mm for p in points], [p.count for p in points]))) for mm in told_mm]
    new = [point for point in points if point.opening_mm <= OPENS_MM] + [
        ValvePoint(count=count, opening_mm=round(is_mm, 2)) for count, is_mm in zip(counts, openings_mm, strict=True)
    ]
    values = as_written(new)
    if new[-1].opening_mm < hand.max_opening_mm:
        values["hand", "max_opening"] = f"{new[-1].opening_mm:g} mm"
    return Found(words, values)


def flow_mg_per_s(
    mass_mg: float, opening_mm: float, dwell_s: float, threshold_mm: float, speed_mm_per_s: float
) -> float:
    """The flow at an opening of which one pulse there has brought so much."""
    return mass_mg / (dwell_s + 2.0 * max(0.0, opening_mm - threshold_mm) / (3.5 * speed_mm_per_s))


def weighed_round(
    devices: Devices, site: Site, openings_mm: Sequence[float], threshold_mm: float
) -> list[float] | None:
    """The flow at each of these openings [mg/s]; None where powder runs all the time."""
    speed_mm_per_s = site.cell.hand.valve_speed_mm_per_s  # slowed or not: the board is told it
    try:
        gross_mg = carried_out(devices.balance.stable_mean(STILL_S), site.clock).value_mg
        flows = []
        for opening_mm, dwell_s in zip(openings_mm, DWELLS_S, strict=True):
            brought_mg, gross_mg = weighed_pulse(devices, site, opening_mm, dwell_s, gross_mg)
            flows.append(flow_mg_per_s(max(0.0, brought_mg), opening_mm, dwell_s, threshold_mm, speed_mm_per_s))
        return flows
    except SkillFailed as failure:
        if failure.code == Code.BALANCE_UNSTABLE:
            return None
        raise


def _gauged_mm(devices: Devices, site: Site) -> float:
    """The widest opening as a person measures it; 0 where that is not done."""
    hand, widest_mm = devices.hand, site.cell.hand.max_opening_mm
    if not site.cell.hand.streaming:
        return 0.0
    hand.set_opening(widest_mm)
    try:
        return site.person.measure(
            f"The valve is open by {widest_mm:g} mm. How thick is the thickest pin that passes? [mm; 0: no pins at "
            "hand]"
        )
    finally:
        hand.set_opening(0.0)
