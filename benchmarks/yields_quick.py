"""How well the cone's content is believed, without arm, hand and balance: `benchmarks.yields` in seconds, not minutes.

    python -m benchmarks.yields_quick [--seeds 3] [--first 0] [--only TEXT]

Of the shipped lab's skills the ones that decide: which stroke is made, and whether a load is gone on with; what they
expect, and what is learnt, are the cell's own; strokes go through the height field along their planned poses, in the
directions that come first. A dose takes what it wants, or all but a few mg of the load. Left out is all that takes
time, the spread of doses, and what clings. Every case is run with two fills and doses of three sizes.
"""

import argparse
import itertools
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np

from benchmarks.yields import DOSES, LEARNT_AFTER
from scuhand_bt.cell.believed import Believed
from scuhand_bt.dosing.ladle import Ladle
from scuhand_bt.dosing.swing import stroke_path
from scuhand_bt.dosing.vessel import Vessel
from scuhand_bt.lab import Lab, load_lab, starter_lab
from scuhand_bt.sim.bed import HeightField
from scuhand_bt.sim.scoop import OurScoopYield
from scuhand_bt.skill import SkillFailed
from scuhand_bt.specs import Source

POWDERS = ("glass_beads", "monosodium_glutamate", "titanium_dioxide")
FILLS_MG = {
    "agate_mortar": ((20_000.0, 2000.0), (16_000.0, 1600.0), (24_000.0, 2400.0)),
    "small_agate_mortar": ((12_000.0, 1000.0), (10_000.0, 1100.0), (14_000.0, 1300.0)),
}
"""What is in a mortar, and each dose."""
SHARES = (0.5, 1.0, 2.0)
DOUBT = 0.2
"""Of the load limit: a load that gives out is short where so much more is believed to be in it (as in `dispense`)."""
CLINGS_MG = 5.0


class Lot:
    """One lot in its mortar, and the cone, in a world whose scoops bring a share of what is lifted."""

    def __init__(self, lab: Lab, source: Source, share: float, seed: int) -> None:
        self.scoops: list[tuple[int, float, float]] = []
        """Doses before it, believed and true content [mg] after it."""
        self._rng, self._share, self._source = np.random.default_rng(seed), share, source
        self._skills: Mapping[str, Any] = lab.library.skills
        self._hand = lab.cell.hand
        self._tries = int(lab.library.workflows["fill"].tree.arguments["attempts"].text)
        self._field, self._yield = HeightField(source.mortar, source.powder), OurScoopYield(source.powder)
        self._mortar_mg, self._cone_mg, self._doses = source.amount_mg, 0.0, 0
        self._believed = Believed()
        self._believed.source_holds(source.name, source.amount_mg)
        self._cell: Any = SimpleNamespace(
            believed=self._believed,
            sources={source.name: source},
            spec=lab.cell,
            strokes_made={},
            record=SimpleNamespace(event=lambda told: None),
        )

    def dose(self, mass_mg: float) -> None:
        """Scoops whenever the cone holds too little, as the workflow `fill` does."""
        left_mg, powder = mass_mg, self._source.powder
        holds = self._skills["cone_holds"](powder=powder, wanted_mg=mass_mg)
        for _ in range(self._tries):
            try:
                holds.check(self._cell)
            except SkillFailed:
                self._scoop(mass_mg)
            gives_mg = min(max(0.0, self._cone_mg - CLINGS_MG * self._rng.random()), left_mg)
            self._cone_mg -= gives_mg
            left_mg -= gives_mg
            self._believed.dosing_ended(gives_mg, 0.0)
            if left_mg <= 0.0:
                break
            self._believed.gave_out(is_short=self._believed.cone_mg >= DOUBT * powder.load_limit_mg)
        self._doses += 1

    def _scoop(self, wanted_mg: float) -> None:
        source, believed = self._source, self._believed
        if believed.cone_source is not None:
            held_mg = believed.cone_mg
            believed.emptied()
            believed.returned(source.name, held_mg)
        believed.emptied()
        self._mortar_mg, self._cone_mg = self._mortar_mg + self._cone_mg, 0.0
        scoop = self._skills["scoop"](source=source, wanted_mg=wanted_mg, may_scoop_again=True)
        bed = scoop._bed(self._cell)
        stroke = next(scoop._wished(self._cell, bed, believed.sources_mg[source.name]))
        self._cell.strokes_made.setdefault(source.name, []).append(stroke.heading_deg)
        lifted_mg, lost_mg = self._lifted(stroke_path(Vessel.of(source.mortar), stroke, Ladle.of(self._hand)))
        there_mg = self._mortar_mg - lost_mg
        self._cone_mg = min(there_mg, self._share * self._yield.collect(lifted_mg, there_mg, self._rng))
        self._mortar_mg = there_mg - self._cone_mg
        scoop._believe(self._cell, stroke, 0.0, 0.0, bed)
        self.scoops.append((self._doses, believed.cone_mg, self._cone_mg))

    def _lifted(self, path: Any) -> tuple[float, float]:
        in_cone_mg = lost_mg = 0.0
        for apex_mm, axis, rim_mm in zip(path.apex_mm, path.axis, path.rim_mm, strict=True):
            there_mg = self._mortar_mg - in_cone_mg - lost_mg
            gained_mg, over_mg = self._field.move(apex_mm, axis, float(rim_mm), there_mg, in_cone_mg)
            in_cone_mg += gained_mg
            lost_mg += over_mg
        self._field.leave()
        return in_cone_mg, lost_mg


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--only", default="", help="cases whose names have this in them")
    given = parser.parse_args()
    lab = load_lab(starter_lab())
    for mortar, powder, share in itertools.product(FILLS_MG, POWDERS, SHARES):
        name = f"{mortar}, {powder}, {share:g}"
        if given.only not in name:
            continue
        off, count = [], 0
        for (fill_mg, dose_mg), seed in itertools.product(
            FILLS_MG[mortar], range(given.first, given.first + given.seeds)
        ):
            kinds: dict[str, Any] = {
                "lot": None,
                "mortar": lab.library.mortars[mortar],
                "powder": lab.library.powders[powder],
            }
            source = Source.model_construct(name="lot", station="mortar_bay", amount_mg=fill_mg, **kinds)
            lot = Lot(lab, source, share, seed)
            for _ in range(DOSES):
                lot.dose(dose_mg)
            count += len(lot.scoops)
            off += [believed_mg / max(true_mg, 1.0) - 1 for doses, believed_mg, true_mg in lot.scoops
                    if doses >= LEARNT_AFTER]  # fmt: skip
        told = f"{np.mean(np.abs(off)):.0%} of {len(off)} (mean {np.mean(off):+.0%})" if off else "none"
        print(f"{name}: {told}; {count} scoops", flush=True)


if __name__ == "__main__":
    main()
