"""The cone's diameter for letting powder out, shared by `open_cone`, `move_over` and all that empties the cone."""

from scuhand_bt.device_specs.hand import MOUNTED_DIAMETER_MM
from scuhand_bt.skill import Cell, Steps

OPENED_MM = 0.5
"""A diameter this near to the wanted one counts as reached."""


def open_to_let_out(cell: Cell) -> Steps[None]:
    """Open the cone to the diameter at which the valve's flow is known; does nothing where it has that.

    A load is opened above the mortar that it came from: what may fall out falls back.
    """
    if abs(cell.hand.cone_diameter_mm - MOUNTED_DIAMETER_MM) <= OPENED_MM:
        return
    source = cell.sources.get(cell.believed.cone_source or "")
    place = source.station if source is not None else cell.spec.station_of_kind("park").name
    yield from cell.form_upright(place, MOUNTED_DIAMETER_MM)
