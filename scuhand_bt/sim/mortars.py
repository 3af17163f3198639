"""The mortars of a world: they move powder between mortar, cone and sheet on the mass ledger while the cone is in one.

A bed (`scuhand_bt.sim.plant.Bed`) knows where the powder lies; only the ledger knows how much there is.
"""

import math
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from numpy.random import Generator

from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.sim.cone_over import ConePose
from scuhand_bt.sim.mass_ledger import CONE, SHEET, SPILLED, MassLedger, in_source
from scuhand_bt.sim.plain_state import Misplaced, Plain
from scuhand_bt.sim.plant import Bed, Plant
from scuhand_bt.sim.under_the_cone import into_mortar
from scuhand_bt.specs import Source

STICKING_SHARE = 0.02
"""The share of a scoop that sticks to the sheet, until the sheet holds its residue."""


class Mortars:
    """Which mortar the cone is in, and the powder of each."""

    STATE: ClassVar[tuple[str, ...]] = ("kept", "inside", "_carried_in_mg")

    def __init__(self, spec: CellSpec, sources: Mapping[str, Source], plant: Plant, ledger: MassLedger) -> None:
        self.inside: str | None = None
        """The source whose mortar the cone is in, with any part of it."""
        self._carried_in_mg = 0.0
        self._sources, self._plant, self._ledger = sources, plant, ledger
        self._slant_mm = spec.hand.sheet_radius_mm
        self._bottoms = {name: _bottom_mm(spec, source) for name, source in sources.items()}
        self._beds: dict[str, Bed] = {}

    @property
    def kept(self) -> dict[str, Plain]:
        """The state of each bed, by source."""
        with self._plant.breaks_in("bed"):
            return {name: bed.kept for name, bed in self._beds.items()}

    @kept.setter
    def kept(self, by_source: dict[str, Plain]) -> None:
        for name, kept in by_source.items():
            if name not in self._sources:
                raise Misplaced(f"a mortar of '{name}', which the recipe no longer has, was scooped from")
            with self._plant.breaks_in("bed"):
                self._bed(name).kept = kept

    def go(self, pose: ConePose, of: str | None) -> bool:
        """Move the cone, which holds powder of source `of`, here; returns whether it has just left a mortar."""
        was, self.inside = self.inside, self._around(pose)
        in_cone_mg = self._ledger.masses_mg[CONE]
        if was is not None and was != self.inside:
            in_mortar_mg = self._ledger.masses_mg[in_source(was)]
            with self._plant.breaks_in("bed"):
                _, lost_mg = self._plant.moved((0.0, self._beds[was].leave() or 0.0), in_mortar_mg, in_cone_mg)
            self._ledger.transfer(in_source(was), SPILLED, lost_mg)
            return True
        if self.inside is not None:
            if was is None:
                self._carried_in_mg = in_cone_mg
            self._move(self.inside, pose, of)
        return False

    def lifted_mg(self) -> float:
        """The mass that the cone has gained in the mortar it has just left."""
        return max(0.0, self._ledger.masses_mg[CONE] - self._carried_in_mg)

    def keep_of(self, name: str, lifted_mg: float, rng: Generator) -> None:
        """The cone has left this source's mortar with this gain: apply the scoop's yield, and let some stick."""
        ledger, place = self._ledger, in_source(name)
        there_mg = lifted_mg + ledger.masses_mg[place]
        powder = self._sources[name].powder
        with self._plant.breaks_in("scoop"):
            kept_mg = self._plant.collected(self._plant.scoop(powder).collect(lifted_mg, there_mg, rng), there_mg)
        self.give_back(name, max(0.0, lifted_mg - kept_mg))
        ledger.transfer(place, CONE, min(max(0.0, kept_mg - lifted_mg), ledger.masses_mg[place]))
        room_mg = max(0.0, powder.simulation.residue_mg - ledger.masses_mg[SHEET])
        ledger.transfer(CONE, SHEET, min(room_mg, STICKING_SHARE * kept_mg, ledger.masses_mg[CONE]))

    def give_back(self, name: str, mass_mg: float) -> None:
        """Return this mass from the cone to its mortar."""
        self._ledger.transfer(CONE, in_source(name), min(mass_mg, self._ledger.masses_mg[CONE]))

    def _move(self, name: str, pose: ConePose, of: str | None) -> None:
        masses_mg, place = self._ledger.masses_mg, in_source(name)
        local = pose.apex_mm - self._bottoms[name]
        with self._plant.breaks_in("bed"):
            gained_mg, lost_mg = self._plant.moved(
                self._bed(name).move(local, pose.axis, pose.rim_mm, masses_mg[place], masses_mg[CONE]),
                masses_mg[place],
                masses_mg[CONE],
            )
        if gained_mg >= 0.0:
            self._ledger.transfer(place, CONE, min(gained_mg, masses_mg[place]))
        else:
            self._ledger.transfer(CONE, into_mortar(self._sources, name, of), min(-gained_mg, masses_mg[CONE]))
        self._ledger.transfer(place, SPILLED, min(lost_mg, masses_mg[place]))

    def _bed(self, name: str) -> Bed:
        if name not in self._beds:
            source = self._sources[name]
            self._beds[name] = self._plant.bed(source.mortar, source.powder, self._slant_mm)
        return self._beds[name]

    def _around(self, pose: ConePose) -> str | None:
        """The source whose mortar some point of the cone is in: within its bore, below its edge."""
        x_mm, y_mm, _ = pose.apex_mm.tolist()
        for name, bottom_mm in self._bottoms.items():
            mortar, (middle_x_mm, middle_y_mm, bottom_z_mm) = self._sources[name].mortar, bottom_mm
            aside_mm = math.hypot(x_mm - middle_x_mm, y_mm - middle_y_mm)
            if aside_mm > mortar.bore_mm / 2 + self._slant_mm or pose.lowest_mm >= bottom_z_mm + mortar.depth_mm:
                continue
            points = pose.outline_mm() - bottom_mm
            is_in = (points[:, 2] < mortar.depth_mm) & (np.hypot(points[:, 0], points[:, 1]) < mortar.bore_mm / 2)
            if is_in.any():
                return name
        return None


def _bottom_mm(spec: CellSpec, source: Source) -> tuple[float, float, float]:
    """The bowl's lowest point, in the base frame."""
    x_mm, y_mm, z_mm = spec.stations[source.station].position_mm
    return x_mm, y_mm, z_mm + source.mortar.height_mm - source.mortar.depth_mm
