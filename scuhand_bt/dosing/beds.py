"""What is believed to lie in a source, a mortar's bowl or a jar, and the strokes that are made in it."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeAlias

from scuhand_bt.dosing import strokes
from scuhand_bt.dosing.jars import JarBed
from scuhand_bt.dosing.ladle import Stroke
from scuhand_bt.dosing.strokes import Bed, Layer
from scuhand_bt.specs import Mortar, Powder

AnyBed: TypeAlias = Bed | JarBed


def bed_in(
    mortar: Mortar, mass_mg: float, powder: Powder, sheet_radius_mm: float, layer: Layer | None = None
) -> AnyBed:
    """So much in such a vessel, as its last strokes have left it."""
    if mortar.corner_mm is None:
        return Bed(mortar, mass_mg, powder, layer)
    return JarBed(mortar, mass_mg, powder, sheet_radius_mm, layer)


def strokes_in(bed: AnyBed, sheet_radius_mm: float, wanted_mg: float, headings_deg: Sequence[float]) -> list[Stroke]:
    """The stroke along each heading that brings so much and no more; of a jar, that brings most first.

    NoStrokeError where there is none.
    """
    if isinstance(bed, Bed):
        stroke = strokes.chosen(bed, sheet_radius_mm, wanted_mg)
        return [replace(stroke, heading_deg=heading_deg) for heading_deg in headings_deg]
    along = [bed.chosen(wanted_mg, heading_deg) for heading_deg in headings_deg]
    return sorted(along, key=bed.expected_mg, reverse=True)


def expected_mg(stroke: Stroke, bed: AnyBed, sheet_radius_mm: float) -> float:
    """What a stroke is expected to bring into the cone."""
    return strokes.expected_mg(stroke, bed, sheet_radius_mm) if isinstance(bed, Bed) else bed.expected_mg(stroke)


def layer_left(stroke: Stroke, bed: AnyBed, sheet_radius_mm: float) -> Layer:
    """What a stroke is expected to leave."""
    return strokes.layer_left(stroke, bed, sheet_radius_mm) if isinstance(bed, Bed) else bed.left_by(stroke)
