"""What a sample is composed of: of each powder so much, and how many atoms of each element that comes to.

It is reckoned in `recipe/stoichiometry.py`; here is what a sample is to be, and what its result says of it.
"""

from typing import Literal

from scuhand_bt.events.entry import Text, Values

CompositionVerdict = Literal["in tolerance", "out of tolerance", "open", "not known"]
"""`open`: in tolerance as far as it is known, and the container is still to go; `not known`: a powder's dose is not."""


class ComposedPowder(Values):
    """One powder lot of a composition."""

    lot: Text
    """As doses name it."""
    formula: Text
    target_mg: float
    tolerance_mg: float
    mg_per_mmol: float
    """So much of the lot has a mmol of the formula: molar mass / (purity (1 - water))."""
    assay_uncertainty: float
    """Standard uncertainty of that, relative, by the lot's assay."""
    counts: dict[str, float]
    """Atoms of each element that is balanced, in one formula."""


class ElementShare(Values):
    """One element that is balanced, in atoms per formula of the product, excess included."""

    element: str
    asked: float
    reached: float | None = None
    uncertainty: float | None = None
    """Standard uncertainty of what was reached."""

    def __str__(self) -> str:
        if self.reached is None or self.uncertainty is None:
            return f"{self.element} – of {self.asked:.4f}"
        return f"{self.element} {self.reached:.4f} ± {self.uncertainty:.4f} of {self.asked:.4f}"


class Composition(Values):
    """What a sample was to be composed of; in its result also what that came to."""

    product: Text
    container: Text = ""
    """Which one of the sample's it is that of."""
    tolerance: float
    """How far each element may be from what is asked, relative."""
    powders: tuple[ComposedPowder, ...]
    """In the order in which they are dosed."""
    elements: tuple[ElementShare, ...]
    verdict: CompositionVerdict = "not known"

    def __str__(self) -> str:
        return f"{', '.join(map(str, self.elements))}: {self.verdict}"
