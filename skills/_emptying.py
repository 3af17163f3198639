"""What `return_leftover`, `discard` and `scoop` share: letting everything out of the cone."""

from scuhand_bt.skill import Cell, Discarded, Returned, Source, Steps

SHAKE_S = 3.0
SPARE = 2.0
"""Times as long as the flow that was learnt would need: it differs from load to load."""
DOUBT = 0.2
"""The cone may hold more than believed, by this share of the load limit: scoops vary."""
LONGEST_S = 300.0


def empty_cone(cell: Cell) -> Steps[None]:
    """Open the valve wide and vibrate for as long as the believed load needs, then believe the cone empty."""
    source = cell.sources[cell.believed.cone_source or ""]
    belief = cell.powder_beliefs.get(source.sheet_key, source.powder.belief)
    opening_mm = cell.spec.hand.max_opening_mm
    flow_mg_per_s = belief.coefficient * max(opening_mm - belief.threshold_mm, 0.1) ** belief.exponent
    most_mg = cell.believed.cone_mg + DOUBT * source.powder.load_limit_mg
    duration_s = min(LONGEST_S, SHAKE_S + SPARE * most_mg / flow_mg_per_s)
    while duration_s > 0.0:
        dwell_s = min(duration_s, cell.hand.longest_dwell_s)
        yield from cell.hand.pulse(opening_mm, dwell_s, vibration=1.0)
        duration_s -= dwell_s
    cell.believed.emptied()


def empty_into(cell: Cell, source: Source) -> Steps[None]:
    """Empty the cone over the source that its powder came from, which then holds it again."""
    held_mg = cell.believed.cone_mg
    yield from empty_cone(cell)
    cell.believed.returned(source.name, held_mg)
    cell.record.event(Returned(source=source.name, expected_mg=held_mg))


def empty_at(cell: Cell, station: str) -> Steps[None]:
    """Empty the cone into the vessel at a station, from which nothing is scooped."""
    yield from cell.move_to(station)
    held_mg, source = cell.believed.cone_mg, cell.believed.cone_source
    yield from empty_cone(cell)
    cell.record.event(Discarded(expected_mg=held_mg, source=source, to=station))


def put_away(cell: Cell) -> Steps[None]:
    """What is in the cone goes where the recipe wants it; back into its mortar, unless it is to be discarded."""
    source = cell.sources[cell.believed.cone_source or ""]
    if source.leftover == "discard":
        yield from empty_at(cell, source.leftover_to or cell.spec.station_of_kind("waste").name)
    else:
        yield from cell.move_to(source.station)
        yield from empty_into(cell, source)
