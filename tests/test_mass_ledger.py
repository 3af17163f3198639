"""No powder is made, lost or mixed: over random recipes, workflows, seeds, and stops at random moments."""

import math
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from daily import first_daily
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from running import Ran, dry_run, make_lab

from scuhand_bt.journal.export import canonical
from scuhand_bt.lab import Lab
from scuhand_bt.sim.under_the_cone import Surroundings
from scuhand_bt.specs import Source

SOURCES = ("beads", "msg")
CONTAINERS = {"xrd_holder": 100, "pellet_die_13mm": 900, "alumina_crucible": 2500}
WORKFLOWS = ("scoop_and_dispense", "fill_xrd_holder", "fill_crucible", "odd")
ODD = """
workflow: odd
inputs: {source: Source, container: Container, mass: Mass, tolerance: {type: Mass, default: 3 mg}}
result: $dose
tree:
  sequence:
    - place_container: {container: $container}
    - tare:
    - parallel:
        - sequence: [{scoop: {source: $source}}, {shake: {duration: 1 s}}]
        - wait: {duration: 30 s}
    - move_over: {container: $container}
    - optional:
        child:
          timeout: {duration: 25 s, child: {dispense: {mass: $mass, tolerance: $tolerance}}}
    - while:
        guards: [{cone_holds: {powder: $source.powder}}]
        child: {dispense: {mass: $mass, tolerance: $tolerance, as: dose}}
    - fallback: [{invert: {wait: {duration: 1 s}}}, {discard: }]
    - park:
"""


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_lab(tmp_path_factory.mktemp("matter") / "lab", trees__odd=ODD)


def assert_conserved(ran: Ran) -> None:
    world = ran.session.world
    assert world is not None
    loaded_mg = sum(source.amount_mg for source in ran.session.plan.recipe.sources.values())
    assert math.fsum(world.masses_mg.values()) == pytest.approx(loaded_mg, abs=1e-6)
    assert min(world.masses_mg.values()) >= 0.0
    assert world.masses_mg["flight"] == 0.0
    assert world.masses_mg["spilled"] == 0.0


@st.composite
def recipes(draw: st.DrawFn) -> str:
    samples = []
    for number in range(draw(st.integers(1, 3))):
        container = draw(st.sampled_from(sorted(CONTAINERS)))
        mass_mg = draw(st.integers(20, CONTAINERS[container]))
        workflow, source = draw(st.sampled_from(WORKFLOWS)), draw(st.sampled_from(SOURCES))
        tolerance_mg = draw(st.sampled_from([2, 5, 15]))
        samples.append(
            f"  - {{id: s{number}, source: {source}, container: {container}, mass: {mass_mg} mg, "
            f"tolerance: {tolerance_mg} mg, workflow: {workflow}}}\n"
        )
    order = draw(st.sampled_from(["by_powder", "as_written"]))
    policy = draw(st.sampled_from(["flag", "skip_sample", "redo", "stop"]))
    return f"recipe: any\norder: {order}\nsamples:\n{''.join(samples)}on_failure: {{otherwise: {policy}}}\n"


@pytest.mark.slow
@given(recipe=recipes(), seed=st.integers(0, 10_000), stop_at=st.one_of(st.none(), st.integers(1, 400)))
@settings(
    max_examples=4,
    deadline=None,
    derandomize=True,
    phases=[Phase.explicit, Phase.generate],  # a run takes a second: no shrinking
    suppress_health_check=[HealthCheck.too_slow],
)
def test_matter_is_conserved_whatever_runs_and_whenever_it_is_stopped(
    lab: Path, recipe: str, seed: int, stop_at: int | None
) -> None:
    with TemporaryDirectory() as folder:
        ran = dry_run(Path(folder), recipe, lab=lab, seed=seed, stop_at=stop_at)
        assert_conserved(ran)
        assert ran.session.cell.hand.opening_mm == 0.0
        assert all(sample.verdict for sample in ran.result.samples)
        for sample in ran.result.samples:
            if sample.verdict == "in tolerance" and sample.target_mg is not None:
                assert sample.true_mg == pytest.approx(sample.target_mg, abs=(sample.tolerance_mg or 0) + 1.5)
        assert canonical(ran.journal)


@pytest.mark.parametrize("seed", first_daily(0, 1, 2))
def test_a_batch_ends_for_every_seed_with_a_verdict_for_every_dose(tmp_path: Path, seed: int) -> None:
    recipe = """
recipe: seeds
workflow: fill_xrd_holder
defaults: {container: xrd_holder, mass: 30 mg}
samples: [{id: a, source: beads}, {id: b, source: msg}]
on_failure: {otherwise: flag}
"""
    ran = dry_run(tmp_path, recipe, seed=seed)
    assert ran.result.exit_code in (0, 1)
    assert all(sample.verdict in ("in tolerance", "under", "over") for sample in ran.result.samples)
    assert_conserved(ran)


@pytest.mark.parametrize(("of", "place"), [("beads", "source:beads"), (None, "source:beads"), ("other", "returned")])
def test_what_falls_into_a_mortar_is_in_it_unless_it_is_of_another_lot(
    starter: Lab, of: str | None, place: str
) -> None:
    """Also out of a fresh sheet's cone that is still in its first scoop, and told to be of none."""
    beads = Source(
        name="beads",
        station="mortar_bay",
        mortar=starter.library.mortars["agate_mortar"],
        powder=starter.library.powders["glass_beads"],
        amount_mg=5000.0,
    )
    other = beads.model_copy(update={"name": "other", "station": "mortar_bay_2", "lot": "B"})
    around = Surroundings(starter.cell, {"beads": beads, "other": other})
    assert str(around.below(np.array([200.0, 240.0, 60.0]), 0.0, of)[0]) == place
