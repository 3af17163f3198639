"""What is believed to lie in a source, a mortar's bowl or a jar, and the strokes that are made in it."""

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
"""How much narrower rims are tried where the arm can make no stroke with the widest."""
LESSER = (0.5, 0.25, 0.125, 0.0625)
"""Of what is wanted, the shares for which there often is a stroke in a bowl where there is none for all of it, or none
that the arm can make, as its lip would come too low."""


@lru_cache(maxsize=64)  # the same one is asked for by each check of a source, and as each dry run of a plan begins
def bed_for(mortar: Mortar, mass_mg: float, powder: Powder, ladle: Ladle, layer: Layer | None = None) -> AnyBed:
    """So much in such a vessel, as its last strokes have left it, for such a hand."""
    if mortar.corner_mm is None:
        return Bed(mortar, mass_mg, powder, layer)
    return JarBed(mortar, mass_mg, powder, ladle, layer)


def strokes_in(bed: AnyBed, ladle: Ladle, wanted_mg: float, headings_deg: Sequence[float]) -> Iterator[Stroke]:
    """The strokes along each heading that bring so much and no more, in the order in which they are to be tried.

    In a bowl those with the widest rim, and then narrower ones, which bring a little less, and with which the arm is
    farther from the wall; in a jar the one along each heading, that brings most first. NoStrokeError where there is
    none.
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
    """Those in a bowl for the shares `LESSER` of what is wanted: where strokes have changed it better than none."""
    for share in LESSER if isinstance(bed, Bed) else ():
        with suppress(NoStrokeError):
            yield from strokes_in(bed, ladle, share * wanted_mg, headings_deg)


def expected_mg(stroke: Stroke, bed: AnyBed, sheet_radius_mm: float) -> float:
    """What a stroke is expected to bring into the cone."""
    return strokes.expected_mg(stroke, bed, sheet_radius_mm) if isinstance(bed, Bed) else bed.expected_mg(stroke)


def found_mg(stroke: Stroke, bed: AnyBed, sheet_radius_mm: float) -> float:
    """What a stroke should bring instead, if what the last one has missed in a bowl lies on its way; 0 if none was."""
    if isinstance(bed, Bed) and bed.if_found is not None:
        return strokes.most_mg(stroke, bed, sheet_radius_mm)
    return 0.0


def layer_left(stroke: Stroke, bed: AnyBed, sheet_radius_mm: float) -> Layer:
    """What a stroke is expected to leave."""
    return strokes.layer_left(stroke, bed, sheet_radius_mm) if isinstance(bed, Bed) else bed.left_by(stroke)
