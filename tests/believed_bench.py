"""Sources, weighings and what a container came to: of these the tests tell what is believed of a cell."""

from dose_bench import DISH, MORTAR, shipped_powders

from scuhand_bt.cell.pan_bracket import ClosedBracket
from scuhand_bt.dosing.bracket import Drift, Gross, Net
from scuhand_bt.specs import Source

POWDERS = shipped_powders()


def source(name: str, powder: str, lot: str) -> Source:
    return Source(name=name, station=name, mortar=MORTAR, powder=POWDERS[powder], amount_mg=5000.0, lot=lot)


BEADS = source("beads", "glass_beads", "L7")
MORE_BEADS = source("more", "glass_beads", "L7")
SALT = source("salt", "monosodium_glutamate", "")

STILL = Drift(0.0, 0.005)


def weighed(gross_mg: float, time_s: float = 2.0) -> Gross:
    return Gross(gross_mg, 0.05, time_s)


def gone(container: str = DISH.id) -> ClosedBracket:
    """What a container came to that has gone."""
    return ClosedBracket(container, {"glass_beads/L7": Net(50.0, 0.1)}, True, 0.0, "it closes")
