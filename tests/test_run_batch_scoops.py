"""Batches that scoop: beyond one load, to a mortar's last per cent, from wide and deep bowls."""

from pathlib import Path

import pytest
from running import dry_run, make_lab

from scuhand_bt.journal.reader import read


def test_a_dose_beyond_one_load_is_scooped_again_and_adds_up_to_one_target(tmp_path: Path) -> None:
    recipe = """
recipe: large
workflow: scoop_and_dispense
samples: [{id: a, source: beads, container: alumina_crucible, mass: 7 g, tolerance: 50 mg}]
"""
    dose = dry_run(tmp_path, recipe).sample("a")
    assert dose.verdict == "in tolerance"
    assert dose.scoops == 3, "the first one is half a load, as nobody knows yet what scoops bring"
    assert dose.true_mg == pytest.approx(7000, abs=52)


DRAIN = """
workflow: drain
inputs: {source: Source}
tree:
  retry:
    attempts: 12
    child:
      sequence:
        - scoop: {source: $source}
        - discard:
        - invert: {wait: {duration: 1 s}}
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("source", "left", "spilled"),
    [("beads", 0.01, 0.001), ("msg", 0.02, 0.001)],
    ids=["beads", "msg, small mortar"],
)
def test_several_scoops_empty_a_mortar_to_its_last_per_cent(
    tmp_path: Path, source: str, left: float, spilled: float
) -> None:
    lab = make_lab(tmp_path / "lab", trees__drain=DRAIN)
    recipe = f"recipe: r\nworkflow: drain\nsamples: [{{id: a, source: {source}}}]\non_failure: {{otherwise: flag}}\n"
    ran = dry_run(tmp_path, recipe, lab=lab)
    world = ran.session.world
    assert world is not None
    amount_mg = ran.session.cell.sources[source].amount_mg
    assert world.masses_mg[f"source:{source}"] < left * amount_mg
    assert world.masses_mg["spilled"] < spilled * amount_mg
    scoops = [event["payload"]["expected_mg"] for event in read(ran.journal, "event") if event["kind"] == "scoop"]
    assert len(scoops) <= 10
    assert max(scoops) <= ran.session.cell.sources[source].powder.load_limit_mg


@pytest.mark.slow
@pytest.mark.parametrize(
    ("bore", "depth", "height", "outer"), [(110, 50, 62, 130), (120, 40, 52, 140), (95, 40, 52, 120)]
)
def test_a_wide_and_deep_bowl_is_scooped_with_a_rim_that_the_arm_can_swing_in_it(
    tmp_path: Path, bore: int, depth: int, height: int, outer: int
) -> None:
    """With the widest that goes in the swing ended halfway, or the arm was in the wall in every direction."""
    lab = make_lab(tmp_path / "lab")
    kinds = lab / "robot" / "containers.yaml"
    bowl = f"  bowl: {{bore: {bore} mm, depth: {depth} mm, height: {height} mm, outer_diameter: {outer} mm}}\n"
    kinds.write_text(kinds.read_text() + bowl)
    text = BOWL + "".join(f"  - {{id: s{n}, mass: 1 g}}\n" for n in range(9))
    ran = dry_run(tmp_path, text, lab=lab, controller="adaptive")
    assert {sample.verdict for sample in ran.result.samples} == {"in tolerance"}
    scoops = [row["payload"] for row in read(ran.journal, "event") if row["kind"] == "scooped"]
    assert len(scoops) <= 5


BOWL = """
recipe: bowl
workflow: scoop_and_dispense
sources:
  beads: {station: mortar_bay, container: bowl, powder: glass_beads, amount: 12 g}
defaults: {source: beads, container: alumina_crucible, tolerance: 5 mg}
samples:
"""


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 9, 11])
def test_a_scoop_that_brought_less_than_expected_is_scooped_again_and_not_taken_for_a_bridge(
    tmp_path: Path, seed: int
) -> None:
    recipe = """
recipe: large
workflow: fill_crucible
sources:
  beads: {station: mortar_bay, container: small_agate_mortar, powder: glass_beads, amount: 12 g}
samples: [{id: a, source: beads, container: alumina_crucible, mass: 11 g, tolerance: 1 %}]
"""
    ran = dry_run(tmp_path, recipe, seed=seed, controller="adaptive")
    assert (ran.sample("a").verdict, ran.sample("a").code) == ("in tolerance", None)
