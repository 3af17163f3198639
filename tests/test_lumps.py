"""Powders that come in lumps: how often a dose can be in tolerance, said before it is tried."""

import numpy as np
import pytest
from conftest import Call, LabFolder

from scuhand_bt.dosing.verdict import chance_with_lumps

RECIPE = """recipe: lumpy
workflow: fill_crucible
sources:
  white: {station: mortar_bay, container: agate_mortar, powder: titanium_dioxide, amount: 10 g}
defaults: {source: white, container: alumina_crucible, mass: 60 mg}
samples:
  - {id: narrow, tolerance: 3 mg, repeat: 4}
  - {id: wide, tolerance: 10 mg}
"""


@pytest.mark.parametrize(("tolerance_mg", "lump_mg"), [(2.0, 3.5), (3.0, 3.5), (10.0, 3.5), (0.5, 3.5)])
def test_the_chance_is_that_of_drawn_lumps(tolerance_mg: float, lump_mg: float) -> None:
    rng = np.random.default_rng(3)
    masses_mg = rng.exponential(lump_mg, (20_000, 120)).cumsum(axis=1)
    first = (masses_mg > 60.0 - tolerance_mg).argmax(axis=1)
    ends_mg = np.take_along_axis(masses_mg, first[:, None], axis=1)[:, 0]
    assert chance_with_lumps(tolerance_mg, lump_mg) == pytest.approx((ends_mg < 60.0 + tolerance_mg).mean(), abs=0.01)
    assert chance_with_lumps(tolerance_mg, 0.0) == 1.0


def test_check_warns_once_of_a_tolerance_that_lumps_hardly_meet(lab_folder: LabFolder, command: Call) -> None:
    path = lab_folder.write("recipes/lumpy.yaml", RECIPE)
    said = command("check", path, "--fast")
    assert said.returncode == 0
    told = [line for line in (said.stdout + said.stderr).splitlines() if "lumps" in line]
    assert len(told) == 1
    assert "lumpy.yaml:7:29" in told[0]
    assert (
        "only about 80% of such samples can be in tolerance (± 3 mg): titanium_dioxide comes in lumps of about 3.5 mg"
        in told[0]
    )


@pytest.mark.parametrize(("tolerance_mg", "warned"), [(0.6, True), (1.0, False)])
def test_check_warns_of_what_lumps_and_the_guard_band_leave_together(
    lab_folder: LabFolder, command: Call, tolerance_mg: float, warned: bool
) -> None:
    """Lumps of 0.5 mg alone leave nine in ten within 0.6 mg; of a study's doses three in four were told so."""
    recipe = RECIPE.replace("titanium_dioxide", "monosodium_glutamate").replace("3 mg", f"{tolerance_mg} mg")
    said = command("check", lab_folder.write("recipes/fine.yaml", recipe), "--fast")
    assert ("comes in lumps of about 0.5 mg" in said.stdout) == warned
