"""Where the valve begins to open: by the flow of glass beads, weighed at a few openings.

Beverloo's law (docs/calibration.md), of an opening that really is `later` less than the map says:

    W = C' (D - later - k)^2.5         so W^0.4 is a straight line over D, and vanishes at D = later + k

k is what the powder needs to flow at all (`belief.threshold` in `robot/powders.yaml`). W is the mass that a longer
pulse brings more than a shorter one, by how much longer it is: what comes while the valve opens and shuts is in both.
The scale of the map (mm a count) cannot be told from C', which nobody knows: the step `valve_map` has it from a gauge.

A zero that is found so is off by up to a tenth of a millimetre, through which glass beads leak. So the valve is shut
as far beyond it, and opens as the map has it from `OPENS_MM` on.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from scuhand_bt.clock import carried_out
from scuhand_bt.commissioning.held_arm import held, led
from scuhand_bt.commissioning.step import Found, NotFound, Site
from scuhand_bt.device_specs.hand import HandSpec, ValvePoint
from scuhand_bt.devices.connect import Devices
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.yaml_edit import Path as Keys
from scuhand_bt.yaml_edit import Value

POWDER = "glass_beads"
OVER_CRUCIBLE = "Put an empty crucible on the pan, and lead the apex over its middle, 5 to 10 cm above the pan."
FILL = f"Put 3 to 5 g of dry {POWDER} into the cone, or check that as much is in it."
EMPTY = "Empty the cone, and take the crucible off the pan."
OPENINGS_MM = (0.9, 1.3, 1.7, 2.1)
DWELLS_S = (0.4, 1.4)
LEAST_MG = 3.0
"""What a pulse has to bring to count."""
UNEVEN_MM = 0.12
"""Flows that fit no straight line better than this tell no zero."""
CLOSER_MM = (0.0, 0.25, 0.5, 0.75)
"""By how much a valve that leaks is shut further, until it does not."""
STILL_S = 20.0
TRIES = 3
"""A pulse that the hand's dead-man has cut short, as a busy computer was silent, is given again and weighed alone."""
MOST_LATER_MM = 1.5
PRESSED_MM, OPENS_MM = 0.1, 0.05


def opens_later_mm(openings_mm: Sequence[float], flows_mg_per_s: Sequence[float], threshold_mm: float) -> float:
    """How much less the valve is open than its map says. ValueError for flows that do not tell."""
    x, y = np.array(openings_mm), np.array(flows_mg_per_s, dtype=float)
    if len(x) < 3 or (y <= 0.0).any():
        raise ValueError("too little powder flowed, or at too few openings")
    y = y**0.4
    slope, constant = np.polyfit(x, y, 1)
    if slope <= 0.0:
        raise ValueError("the flow does not grow as the valve opens wider")
    uneven_mm = float(np.sqrt(np.mean((y - slope * x - constant) ** 2)) / slope)
    if uneven_mm > UNEVEN_MM:
        raise ValueError(f"the flow varies as if the opening were wrong by {uneven_mm:.2f} mm each time")
    return float(-constant / slope) - threshold_mm


def moved(points: Sequence[ValvePoint], later_mm: float) -> tuple[ValvePoint, ...]:
    """The map of a valve that opens later by so much. ValueError beyond the servo's turn."""
    first, second = [point for point in points if point.opening_mm > 0.0][:2] if is_pressed(points) else points[:2]
    shift = round(later_mm * (second.count - first.count) / (second.opening_mm - first.opening_mm))
    return _within_a_turn((point.count + shift, point.opening_mm) for point in points)


def is_pressed(points: Sequence[ValvePoint]) -> bool:
    """Whether the map shuts the valve beyond its zero."""
    return points[1].opening_mm == OPENS_MM


def pressed(points: Sequence[ValvePoint]) -> tuple[ValvePoint, ...]:
    """The map of a valve that is shut beyond its zero. ValueError beyond the servo's turn."""
    if is_pressed(points):
        return tuple(points)
    zero, second = points[:2]
    per_mm = (second.count - zero.count) / second.opening_mm
    shut = [(round(zero.count - PRESSED_MM * per_mm), 0.0), (round(zero.count + OPENS_MM * per_mm), OPENS_MM)]
    return _within_a_turn([*shut, *((point.count, point.opening_mm) for point in points[1:])])


def _within_a_turn(points: Iterable[tuple[int, float]]) -> tuple[ValvePoint, ...]:
    listed = list(points)
    if not all(0 <= count <= 4095 for count, _ in listed):
        raise ValueError("the valve's servo would have to turn beyond its range; check its linkage")
    return tuple(ValvePoint(count=count, opening_mm=opening_mm) for count, opening_mm in listed)


def find_valve_zero(site: Site) -> Found:
    """The valve's map with its zero where the flow says."""
    if (powder := site.lab.library.powders.get(POWDER)) is None:
        raise NotFound(f"this step needs the powder '{POWDER}', which is not in robot/powders.yaml")
    threshold_mm, points = powder.belief.threshold_mm, site.cell.hand.options.valve_map
    led(site, OVER_CRUCIBLE)
    try:
        for closer_mm in CLOSER_MM:
            told = moved(points, -closer_mm)
            with held(site, with_map(site.cell.hand, told)) as devices:
                site.person.ask(FILL)
                flows = weighed_flows(devices, site, OPENINGS_MM)
            if flows is not None:
                break
            site.person.tell("Powder runs though the valve is shut. It will be shut a quarter of a millimetre further.")
        else:
            raise NotFound(
                "powder runs however far the valve is shut: look for something in the valve, and check its linkage"
            )
        found = [(opening_mm, flow) for opening_mm, flow in zip(OPENINGS_MM, flows, strict=True) if flow > 0.0]
        later_mm = opens_later_mm([one for one, _ in found], [flow for _, flow in found], threshold_mm) - closer_mm
        if abs(later_mm) > MOST_LATER_MM:
            raise ValueError(f"the zero would be {later_mm:+.2f} mm off")
        new = pressed(moved(points, later_mm))
    except ValueError as error:
        raise NotFound(f"{error}; is the powder dry, the cone full enough, and nothing in the valve?") from None
    site.person.ask(EMPTY)
    values = as_written(new) if new != points else {}
    rates = ", ".join(f"{flow:.0f} mg/s at {opening_mm:g} mm" for opening_mm, flow in found)
    return Found({"the valve opens later by": f"{later_mm:+.2f} mm", "flow": rates}, values)


def with_map(hand: HandSpec, points: Sequence[ValvePoint]) -> HandSpec:
    """The hand with another map of its valve."""
    options = hand.options.model_copy(update={"valve_map": tuple(points)})
    return hand.model_copy(update={"options": options})


def as_written(points: Sequence[ValvePoint]) -> dict[Keys, Value]:
    """The map as the cell's file has it."""
    listed: list[Value] = [{"count": point.count, "opening": f"{point.opening_mm:g} mm"} for point in points]
    return {("hand", "options", "valve_map"): listed}


def weighed_flows(devices: Devices, site: Site, openings_mm: Sequence[float]) -> list[float] | None:
    """The flow at each of these openings [mg/s], 0 where next to nothing came; None where powder runs all the time."""
    try:
        gross_mg = carried_out(devices.balance.stable_mean(STILL_S), site.clock).value_mg
        flows = []
        for opening_mm in openings_mm:
            masses_mg = []
            for dwell_s in DWELLS_S:
                brought_mg, gross_mg = weighed_pulse(devices, site, opening_mm, dwell_s, gross_mg)
                masses_mg.append(brought_mg)
            more_mg = masses_mg[1] - masses_mg[0]
            flows.append(more_mg / (DWELLS_S[1] - DWELLS_S[0]) if masses_mg[1] >= LEAST_MG and more_mg > 0.0 else 0.0)
        return flows
    except SkillFailed as failure:
        if failure.code == Code.BALANCE_UNSTABLE:
            return None
        raise


def weighed_pulse(
    devices: Devices, site: Site, opening_mm: float, dwell_s: float, gross_mg: float
) -> tuple[float, float]:
    """What one pulse brings [mg], and what the balance shows then; SkillFailed."""
    left = TRIES
    while True:
        left -= 1
        try:
            carried_out(devices.hand.pulse(opening_mm, dwell_s), site.clock)
        except SkillFailed as failure:
            if failure.code != Code.DEVICE_LOST or not left:
                raise
            gross_mg = carried_out(devices.balance.stable_mean(STILL_S), site.clock).value_mg
        else:
            now_mg = carried_out(devices.balance.stable_mean(STILL_S), site.clock).value_mg
            return now_mg - gross_mg, now_mg
