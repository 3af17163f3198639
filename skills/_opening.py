"""What `open_cone`, `move_over` and the emptying of the cone share: the size in which it lets powder out."""

from scuhand_bt.device_specs.hand import MOUNTED_DIAMETER_MM
from scuhand_bt.skill import Cell, Steps

OPENED_MM = 0.5
"""So near to a size the cone has it."""


def open_to_let_out(cell: Cell) -> Steps[None]:
    """The cone as wide as it is where the valve's flow is known; where it is, nothing moves.

    A load is opened where it was scooped, above its mortar, into which what is too much would fall.
    """
    if abs(cell.hand.cone_diameter_mm - MOUNTED_DIAMETER_MM) <= OPENED_MM:
        return
    source = cell.sources.get(cell.believed.cone_source or "")
    place = source.station if source is not None else cell.spec.station_of_kind("park").name
    yield from cell.form_upright(place, MOUNTED_DIAMETER_MM)
