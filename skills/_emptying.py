"""What `return_leftover` and `discard` share: letting everything out of the cone."""

from scuhand_bt.skill import Cell, Steps

SHAKE_S = 3.0
SPARE = 1.5
LONGEST_S = 300.0


def empty_cone(cell: Cell) -> Steps[None]:
    """Open the valve wide and vibrate for as long as the believed load needs, then believe the cone empty."""
    source = cell.sources[cell.believed.cone_source or ""]
    belief = cell.powder_beliefs.get(source.sheet_key, source.powder.belief)
    opening_mm = cell.spec.hand.max_opening_mm
    flow_mg_per_s = belief.coefficient * max(opening_mm - belief.threshold_mm, 0.1) ** belief.exponent
    duration_s = min(LONGEST_S, SHAKE_S + SPARE * cell.believed.cone_mg / flow_mg_per_s)
    yield from cell.hand.pulse(opening_mm, duration_s, vibration=1.0)
    cell.believed.cone_mg = 0.0
    cell.believed.cone_source = None
