"""What is believed to lie in a source, be it a bowl or a jar, and the strokes that can be made in it."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from typing import TypeAlias

from scuhand_bt.dosing import strokes
from scuhand_bt.dosing.bed import Bed, Layer
from scuhand_bt.dosing.jars import JarBed
from scuhand_bt.dosing.ladle import Ladle, NoStrokeError, Stroke
from scuhand_bt.specs import Mortar, Powder

AnyBed: TypeAlias = Bed | JarBed

NARROWER_MM = (8.0, 16.0, 24.0)
"""By how much narrower rims are tried, where the arm can make no stroke with the widest."""
LESSER = (0.5, 0.25, 0.125, 0.0625)
"""Shares of what is wanted that are tried in a bowl where no stroke for all of it is possible, or none that the arm can
make as its lip would come too low."""


@lru_cache(maxsize=64)  # asked for by each check of a source, and at the start of each dry run of a plan
def bed_for(mortar: Mortar, mass_mg: float, powder: Powder, ladle: Ladle, layer: Layer | None = None) -> AnyBed:
    """The bed of a mass in a vessel, as its last strokes have left it, for such a hand."""
    if mortar.corner_mm is None:
        return Bed(mortar, mass_mg, powder, layer)
    return JarBed(mortar, mass_mg, powder, ladle, layer)


def strokes_in(bed: AnyBed, ladle: Ladle, wanted_mg: float, headings_deg: Sequence[float]) -> Iterator[Stroke]:
    """The strokes along each heading that bring no more than is wanted, in the order in which to try them.

    In a bowl these are first those with the widest rim, then narrower ones, which bring a little less and keep the arm
    farther from the wall. In a jar it is one along each heading, the most productive first. Raises NoStrokeError where
    there is none.
    """
    if isinstance(bed, JarBed):
        yield from bed.strokes(wanted_mg, headings_deg)
        return
    widest = strokes.chosen(bed, ladle, wanted_mg)
    yield from (replace(widest, heading_deg=heading_deg) for heading_deg in headings_deg)
    for less_mm in NARROWER_MM:
        try:
            narrower = strokes.chosen(bed, ladle, wanted_mg, widest.open_mm - less_mm)
        except NoStrokeError:
            return
        yield from (replace(narrower, heading_deg=heading_deg) for heading_deg in headings_deg)


def strokes_for_less(bed: AnyBed, ladle: Ladle, wanted_mg: float, headings_deg: Sequence[float]) -> Iterator[Stroke]:
    """Strokes in a bowl for the shares `LESSER` of what is wanted, better than none in a bed changed by strokes."""
    for share in LESSER if isinstance(bed, Bed) else ():
        with suppress(NoStrokeError):
            yield from strokes_in(bed, ladle, share * wanted_mg, headings_deg)


def expected_mg(stroke: Stroke, bed: AnyBed, sheet_radius_mm: float) -> float:
    """The mass that a stroke is expected to bring into the cone."""
    return strokes.expected_mg(stroke, bed, sheet_radius_mm) if isinstance(bed, Bed) else bed.expected_mg(stroke)


def found_mg(stroke: Stroke, bed: AnyBed, sheet_radius_mm: float) -> float:
    """The mass that a stroke brings if it finds what the last one has missed in a bowl; 0 if none was missed."""
    if isinstance(bed, Bed) and bed.if_found is not None:
        return strokes.most_mg(stroke, bed, sheet_radius_mm)
    return 0.0


def layer_left(stroke: Stroke, bed: AnyBed, sheet_radius_mm: float) -> Layer:
    """The layer that a stroke is expected to leave."""
    return strokes.layer_left(stroke, bed, sheet_radius_mm) if isinstance(bed, Bed) else bed.left_by(stroke)
