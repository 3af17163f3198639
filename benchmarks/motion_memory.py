"""The planner's memory over many scoops, each with a cone of its own size: `python -m benchmarks.motion --scoops 1000`.

Each scoop is what a run plans for it: the stroke in what is left of the bed, out of the mortar, the cone to its usual
size, with the load to the pan past a container, and back empty. Cones of all sizes carry loads too, as where nothing
gives them their usual one. What the process holds is read from the system after the first scoop, which loads what
there is to load, and after every tenth of them.
"""

import gc
import math
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from scuhand_bt.cell.carrying import carrying_limit_deg
from scuhand_bt.cell.places import over_balance, over_mortar
from scuhand_bt.cell.scooping import planned_stroke
from scuhand_bt.device_specs.hand import MOUNTED_DIAMETER_MM
from scuhand_bt.dosing.bed import Bed
from scuhand_bt.dosing.cone import Cone
from scuhand_bt.dosing.ladle import Ladle, NoStrokeError
from scuhand_bt.dosing.strokes import chosen
from scuhand_bt.dosing.swing import stroke_path
from scuhand_bt.dosing.vessel import Vessel
from scuhand_bt.failures import SkillFailed
from scuhand_bt.lab import load_lab, starter_lab
from scuhand_bt.motion import ApexPose, MotionPlanner

STATION, TURN_DEG = "mortar_bay", 20.0
BED_MG = (100.0, 1500.0)
PAGE_MB = os.sysconf("SC_PAGE_SIZE") / 1e6


def held_mb() -> float:
    """What this process holds in memory."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE_MB


class Scoops:
    """The starter lab's first mortar, scooped from again and again."""

    def __init__(self) -> None:
        lab = load_lab(starter_lab())
        self.cell, self.mortar = lab.cell, lab.library.mortars["agate_mortar"]
        self.powder = lab.library.powders[sorted(lab.library.powders)[0]]
        self.container = lab.library.containers["alumina_crucible"]
        self.planner = MotionPlanner(lab.urdf, lab.cell, {STATION: self.mortar})
        self.pan, over_pan_mm = over_balance(lab.cell, self.container)
        over_mortar_mm = over_mortar(lab.cell.stations[STATION], self.mortar)
        for name, at_mm in ((self.pan, over_pan_mm), (STATION, over_mortar_mm)):
            self.planner.add_place(name, ApexPose(np.array(at_mm) / 1e3))
        self.sizes_mm: set[float] = set()
        self.failed = 0

    def scoop(self, k: int, of: int) -> None:
        """The k-th of so many: another bed, another direction."""
        bed_mg = BED_MG[1] + (BED_MG[0] - BED_MG[1]) * k / of
        hand = self.cell.hand
        stroke = chosen(Bed(self.mortar, bed_mg, self.powder), Ladle.of(hand), self.powder.load_limit_mg)
        stroke = replace(stroke, heading_deg=(k * TURN_DEG) % 360.0)
        self.planner.set_geometry()
        try:
            path = stroke_path(Vessel.of(self.mortar), stroke, Ladle.of(hand))
            swing = planned_stroke(
                self.planner, self.planner.standing_at(STATION), path, self.cell, STATION, self.mortar
            )
            self._out(swing.end[:-1], float(path.rim_mm[-1]))
        except (NoStrokeError, SkillFailed):
            self.failed += 1
        self._carried(60.0 + 38.0 * k / of)

    def _out(self, end: Any, rim_mm: float) -> None:
        self.sizes_mm.add(round(rim_mm, 1))
        self.planner.set_geometry(rim_mm / 1e3, self.container)
        limit_deg = carrying_limit_deg(self.cell, self.powder, self.powder.load_limit_mg, rim_mm)
        there = self.planner.move(end, STATION, spill_limit_deg=limit_deg).end
        self.planner.reform(there, STATION, MOUNTED_DIAMETER_MM, self._roller_rad)

    def _carried(self, rim_mm: float) -> None:
        self.sizes_mm.add(round(rim_mm, 1))
        self.planner.set_geometry(rim_mm / 1e3, self.container)
        try:
            there = self.planner.move(self.planner.standing_at(STATION), self.pan, spill_limit_deg=20.0)
            self.planner.move(there.end, STATION)
        except SkillFailed:
            self.failed += 1

    def _roller_rad(self, rim_mm: float) -> float:
        return math.radians(Cone(rim_mm, self.cell.hand.sheet_radius_mm).roller_deg(self.cell.hand))


def scoops(count: int) -> dict[str, Any]:
    """What the process holds more after so many scoops."""
    bench = Scoops()
    bench.scoop(0, count)
    held = [held_mb()]
    for k in range(1, count):
        bench.scoop(k, count)
        if k % max(1, count // 10) == 0 or k == count - 1:
            held.append(held_mb())
            print(f"{k} scoops: {held[-1] - held[0]:.0f} MB more", flush=True)
    return {
        "scoops": count,
        "sizes of cones": len(bench.sizes_mm),
        "not planned": bench.failed,
        "held after the first": f"{held[0]:.0f} MB",
        "more after each tenth": ", ".join(f"{one - held[0]:.0f}" for one in held[1:]) + " MB",
    }
