"""What a sample is to be composed of, and what its result says about that: powders, and atoms of each element.

`recipe/stoichiometry.py` computes both.
"""

from typing import Literal

from scuhand_bt.events.entry import Text, Values

CompositionVerdict = Literal["in tolerance", "out of tolerance", "open", "not known"]
"""`open`: in tolerance so far, but the container has not left the pan yet; `not known`: a powder's dose is unknown."""


class ComposedPowder(Values):
    """One powder lot of a composition."""

    lot: Text
    """The lot's name, as in doses."""
    formula: Text
    target_mg: float
    tolerance_mg: float
    mg_per_mmol: float
    """Mass of the lot that contains 1 mmol of the formula: molar mass / (purity (1 - water))."""
    assay_uncertainty: float
    """Relative standard uncertainty of `mg_per_mmol`, from the lot's assay."""
    counts: dict[str, float]
    """Atoms of each balanced element in one formula unit."""


class ElementShare(Values):
    """One balanced element, in atoms per formula unit of the product, excess included."""

    element: str
    asked: float
    reached: float | None = None
    uncertainty: float | None = None
    """Standard uncertainty of `reached`."""

    def __str__(self) -> str:
        if self.reached is None or self.uncertainty is None:
            return f"{self.element} – of {self.asked:.4f}"
        return f"{self.element} {self.reached:.4f} ± {self.uncertainty:.4f} of {self.asked:.4f}"


class Composition(Values):
    """What a sample was to be composed of; in its result also what was reached."""

    product: Text
    container: Text = ""
    """Which of the sample's containers this is about."""
    tolerance: float
    """Largest deviation of each element, relative to what is asked for."""
    powders: tuple[ComposedPowder, ...]
    """In the order of dosing."""
    elements: tuple[ElementShare, ...]
    verdict: CompositionVerdict = "not known"

    def __str__(self) -> str:
        return f"{', '.join(map(str, self.elements))}: {self.verdict}"
