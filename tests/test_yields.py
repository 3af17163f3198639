"""Worlds whose scoops bring half, or twice, of what the bed's geometry lifts: believed by weighing."""

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from conftest import read
from numpy.random import Generator
from running import Ran, dry_run

from scuhand_bt.sim.scoop import OurScoopYield
from scuhand_bt.specs import Powder

RECIPE = """
recipe: r
workflow: fill_xrd_holder
defaults: {container: alumina_crucible, source: beads, tolerance: 5 mg, mass: MASS}
samples:
  - {id: a}
  - {id: b}
  - {id: c}
  - {id: d}
  - {id: e}
  - {id: f}
"""
MSG = """
sources:
  msg: {station: mortar_bay_2, container: agate_mortar, powder: monosodium_glutamate, amount: 20 g}
"""
DOSES = 3


class Other:
    """A plant with another yield, which notes what its scoops bring."""

    share = 1.0
    brought_mg: ClassVar[list[float]] = []

    class Yield(OurScoopYield):
        def __init__(self, powder: Powder, plant: "Other") -> None:
            super().__init__(powder)
            self._plant = plant

        def collect(self, lifted_mg: float, there_mg: float, rng: Generator) -> float:
            kept_mg = min(there_mg, self._plant.share * super().collect(lifted_mg, there_mg, rng))
            self._plant.brought_mg.append(kept_mg)
            return kept_mg

    def __init__(self) -> None:
        self.brought_mg.clear()

    def scoop(self, powder: Powder) -> OurScoopYield:
        return self.Yield(powder, self)


class Half(Other):
    share = 0.5


class Double(Other):
    share = 2.0


def scoops(ran: Ran) -> list[tuple[int, float, float]]:
    """The doses that were before it, and what it was expected to bring [mg], and did; of each."""
    events = [event for event in read(ran.journal, "event") if event["kind"] in ("scoop", "dose_weighed")]
    expected = [
        (sum(earlier["kind"] == "dose_weighed" for earlier in events[:place]), event["payload"]["expected_mg"])
        for place, event in enumerate(events)
        if event["kind"] == "scoop"
    ]
    brought_mg = Other.brought_mg[-len(expected) :]  # those before them tried the plant
    return [(doses, mass_mg, came_mg) for (doses, mass_mg), came_mg in zip(expected, brought_mg, strict=True)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("plant", "mass", "seeds", "off_by"), [("Half", "2400 mg", (0, 1, 2), 0.1), ("Double", "2 g", (0, 1, 2), 0.1)]
)
def test_what_a_scoop_brings_is_believed_after_three_doses(
    tmp_path: Path, plant: str, mass: str, seeds: Sequence[int], off_by: float
) -> None:
    """Within a tenth, and no load of any is more than the cone may carry, by more than chance."""
    recipe, later = RECIPE.replace("MASS", mass), list[float]()
    for seed in seeds:
        ran = dry_run(tmp_path, recipe, plant=f"{__name__}:{plant}", controller="adaptive", seed=seed)
        assert {sample.verdict for sample in ran.result.samples} == {"in tolerance"}
        made = scoops(ran)
        off = [(doses, abs(expected_mg / brought_mg - 1.0)) for doses, expected_mg, brought_mg in made]
        assert off[0][1] > 0.2, "the world is not as the skill expects it"
        assert off[-1][0] >= DOSES, "a scoop was made after the third dose"
        later += [share for doses, share in off if doses >= DOSES]
        limit_mg = ran.session.cell.sources["beads"].powder.load_limit_mg
        assert max(brought_mg for _, _, brought_mg in made) < 1.1 * limit_mg
        assert ran.session.world is not None
        assert ran.session.world.masses_mg["spilled"] < 10.0, (
            "no cone that was believed to be empty, and was not, has swung"
        )
    assert np.mean(later) < off_by


@pytest.mark.slow
def test_no_load_of_which_twice_as_much_comes_and_a_rest_stays_is_more_than_the_cone_may_carry(tmp_path: Path) -> None:
    """Of crystals first loads of 7 to 10 g came, where 5 g are the limit, and others after them."""
    recipe = RECIPE.replace("MASS", "2 g").replace("source: beads", "source: msg").replace("5 mg", "10 mg") + MSG
    ran = dry_run(tmp_path, recipe, plant=f"{__name__}:Double", controller="adaptive", seed=906)
    assert {sample.verdict for sample in ran.result.samples} == {"in tolerance"}
    limit_mg = ran.session.cell.sources["msg"].powder.load_limit_mg
    assert 0.8 * limit_mg < max(brought_mg for _, _, brought_mg in scoops(ran)) < 1.1 * limit_mg


class Once(Other):
    """A plant whose second scoop brings far less than it should, and whose others do not."""

    scoops: ClassVar[int] = 0

    class Yield(OurScoopYield):
        def collect(self, lifted_mg: float, there_mg: float, rng: Generator) -> float:
            Once.scoops += lifted_mg > 1000.0  # a plant is tried with less
            kept_mg = (0.3 if Once.scoops == 2 else 1.0) * super().collect(lifted_mg, there_mg, rng)
            Once.brought_mg.append(kept_mg)
            return kept_mg

    def __init__(self) -> None:
        super().__init__()
        Once.scoops = 0

    def scoop(self, powder: Powder) -> OurScoopYield:
        return self.Yield(powder)


@pytest.mark.slow
def test_what_one_poor_scoop_missed_does_not_come_with_a_full_load_besides(tmp_path: Path) -> None:
    recipe = RECIPE.replace("MASS", "2900 mg") + "on_failure: {otherwise: flag}\n"
    ran = dry_run(tmp_path, recipe, plant=f"{__name__}:Once", controller="adaptive")
    brought_mg = [mass_mg for _, _, mass_mg in scoops(ran)]
    limit_mg = ran.session.cell.sources["beads"].powder.load_limit_mg
    assert brought_mg[1] < limit_mg / 2
    assert brought_mg[2] < limit_mg
    assert ran.session.world is not None
    assert ran.session.world.masses_mg["spilled"] < 10.0
