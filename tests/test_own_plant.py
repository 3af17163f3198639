"""A bed and a yield of one's own, in a file that `--plant` names: a dry run goes by them and by nothing of ours."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest
from running import Ran, dry_run

from scuhand_bt.lab import load_lab, starter_lab
from scuhand_bt.sim.plant import Plant, PlantError, load_plant

RECIPE = """
recipe: own
workflow: scoop_and_dispense
defaults: {source: beads, container: alumina_crucible, tolerance: 5 mg}
sources: {beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 20 g}}
samples: [{id: a, mass: 300 mg}]
"""
PORTION_MG = 3000.0


class Portions:
    """A bed of which each scoop lifts one portion, whatever the stroke; it keeps how many it has given."""

    def __init__(self, *_: object) -> None:
        self.kept, self._has_given = 0, False

    def move(
        self, apex_mm: Any, axis: Any, rim_mm: float, in_mortar_mg: float, in_cone_mg: float
    ) -> tuple[float, float]:
        if self._has_given:
            return 0.0, 0.0
        self._has_given = True
        self.kept += 1
        return min(in_mortar_mg, PORTION_MG), 0.0

    def leave(self) -> None:
        self._has_given = False


class Of:
    """Of what is lifted, this share stays in the cone, with no chance in it."""

    brought_mg: ClassVar[list[float]] = []

    def __init__(self, share: float) -> None:
        self._share = share

    def collect(self, lifted_mg: float, there_mg: float, rng: Any) -> float:
        self.brought_mg.append(self._share * lifted_mg)
        return self.brought_mg[-1]


class Half:
    bed = Portions

    def scoop(self, powder: object) -> Of:
        return Of(0.5)


class Nothing(Half):
    def scoop(self, powder: object) -> Of:
        return Of(0.0)


def ran_on(tmp_path: Path, plant: str) -> Ran:
    return dry_run(tmp_path, RECIPE, plant=f"{__name__}:{plant}", controller="adaptive")


def test_a_dry_run_scoops_by_the_bed_and_the_yield_that_the_plant_has(tmp_path: Path) -> None:
    Of.brought_mg.clear()
    ran = ran_on(tmp_path, "Half")
    assert [sample.verdict for sample in ran.result.samples] == ["in tolerance"]
    assert Of.brought_mg[-1] == PORTION_MG / 2
    world = ran.session.world
    assert world is not None
    assert sum(world.masses_mg.values()) == pytest.approx(20_000.0)


class Sloppy(Portions):
    """Of what there is, each scoop throws some over the edge."""

    def move(
        self, apex_mm: Any, axis: Any, rim_mm: float, in_mortar_mg: float, in_cone_mg: float
    ) -> tuple[float, float]:
        gained_mg, _ = super().move(apex_mm, axis, rim_mm, in_mortar_mg, in_cone_mg)
        return gained_mg, 200.0 if gained_mg and not while_tried(in_mortar_mg) else 0.0


class BedThatSpills(Half):
    bed = Sloppy


class Crumbling(Portions):
    """What stands at the edge falls over it as soon as the cone is out."""

    def leave(self) -> float:
        has_given, self._has_given = self._has_given, False
        return 100.0 * has_given


class BedThatCrumbles(Half):
    bed = Crumbling


def test_what_falls_over_the_edge_as_the_cone_leaves_is_spilled_though_none_comes_again(tmp_path: Path) -> None:
    ran = ran_on(tmp_path, "BedThatCrumbles")
    (notice,) = ran.session.notices
    assert notice.startswith("In the simulation 100.0 mg of powder were spilled")


def test_what_a_dry_run_has_spilled_is_told_although_its_doses_are_right(tmp_path: Path) -> None:
    ran = ran_on(tmp_path, "BedThatSpills")
    assert [sample.verdict for sample in ran.result.samples] == ["in tolerance"]
    (notice,) = ran.session.notices
    assert notice.startswith("In the simulation 200.0 mg of powder were spilled")
    assert ran_on(tmp_path, "Half").session.notices == []


@pytest.mark.slow
def test_where_no_scoop_brings_anything_the_sample_fails_and_the_mortar_keeps_all_it_held(tmp_path: Path) -> None:
    ran = ran_on(tmp_path, "Nothing")
    assert [sample.code for sample in ran.result.samples] == ["scoop.nothing"]
    world = ran.session.world
    assert world is not None
    assert world.masses_mg["source:beads"] == pytest.approx(20_000.0, abs=1.0)


def while_tried(in_mortar_mg: float) -> bool:
    return in_mortar_mg < 20_000.0


class NoPair(Portions):
    def move(self, apex_mm: Any, axis: Any, rim_mm: float, in_mortar_mg: float, in_cone_mg: float) -> Any:
        return (0.0, 0.0) if while_tried(in_mortar_mg) else 0.0


class Leaves(Portions):
    def move(self, apex_mm: Any, axis: Any, rim_mm: float, in_mortar_mg: float, in_cone_mg: float) -> Any:
        if not while_tried(in_mortar_mg):
            raise SystemExit(0)
        return 0.0, 0.0


class Stays(Portions):
    _is_tried = True

    def leave(self) -> None:
        if not self._is_tried:
            raise KeyError("way out")

    def move(
        self, apex_mm: Any, axis: Any, rim_mm: float, in_mortar_mg: float, in_cone_mg: float
    ) -> tuple[float, float]:
        self._is_tried = while_tried(in_mortar_mg)
        return 0.0, 0.0


class NoMass(Of):
    def collect(self, lifted_mg: float, there_mg: float, rng: Any) -> Any:
        return 0.0 if there_mg == 1000.0 else None


class BedOfNoPair(Half):
    bed = NoPair


class BedThatExits(Half):
    bed = Leaves


class BedThatStays(Half):
    bed = Stays


class YieldOfNoMass(Half):
    def scoop(self, powder: object) -> Of:
        return NoMass(0.5)


@pytest.mark.parametrize(
    ("plant", "told"),
    [
        ("BedOfNoPair", "TypeError in bed"),
        ("BedThatExits", "SystemExit in bed"),
        ("BedThatStays", "KeyError in bed: 'way out'"),
        ("YieldOfNoMass", "TypeError in scoop"),
    ],
)
def test_a_bed_or_a_yield_that_breaks_in_a_run_ends_it_with_a_fault_that_names_the_plant(
    tmp_path: Path, plant: str, told: str
) -> None:
    ran = ran_on(tmp_path, plant)
    assert ran.result.exit_code == 3
    assert f"{plant}: {told}" in ran.result.reason


def test_a_plant_whose_file_exits_as_it_is_read_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "exits_when_read.py").write_text("raise SystemExit(0)\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(PlantError, match=r"module 'exits_when_read' cannot be imported: SystemExit: 0"):
        load_plant("exits_when_read:Own")


class Forgetful(Portions):
    def __init__(self, *_: object) -> None:
        super().__init__()
        del self.kept

    def move(self, *_: object) -> tuple[float, float]:
        return 0.0, 0.0


class Unwritable(Portions):
    def __init__(self, *_: object) -> None:
        super().__init__()
        self.kept: Any = np.zeros(3)


@pytest.mark.parametrize("bed", [Forgetful, Unwritable])
def test_a_bed_whose_state_cannot_be_written_is_refused_before_a_run_which_could_not_be_resumed(
    bed: type[Portions],
) -> None:
    lab = load_lab(starter_lab())
    plant = Plant(SimpleNamespace(bed=bed), "mine:Own")
    powder, mortar = lab.library.powders["glass_beads"], lab.library.mortars["agate_mortar"]
    with pytest.raises(PlantError, match=r"mine:Own: 'kept' of bed\(agate_mortar, glass_beads, 50\)"):
        plant.probe(powder, lab.cell.balance, mortar)


def test_a_plant_is_tried_with_a_mortar_that_is_wider_than_any_cone() -> None:
    lab = load_lab(starter_lab())
    wide = {"bore_mm": 220.0, "depth_mm": 80.0, "height_mm": 90.0, "outer_diameter_mm": 230.0}
    mortar = lab.library.mortars["agate_mortar"].model_copy(update=wide)
    Plant(None, "mine:Own").probe(lab.library.powders["glass_beads"], lab.cell.balance, mortar)
