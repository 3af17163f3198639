"""Samples by the formula of their product: what is weighed in, how exactly, and what a recipe may say."""

import math
import re

import numpy as np
import pytest
from atomic_weights import BA, CO, CU, FE, LA, LI, ZR, C, H, N, O, P, Y
from conftest import REPOSITORY, Desk, LabFolder
from running import make_lab

from scuhand_bt.recipe.sample import Sample
from scuhand_bt.recipe.stoichiometry import reached

POWDER = """
{name}:
  formula: {formula}
  bulk_density: 1.2 g/cm^3
  repose: 35 deg
  wall_friction: 24 deg
  load_limit: 4 g
"""
POWDERS = {
    "lanthana": "La2O3",
    "zirconia": "ZrO2",
    "yttria": "Y2O3",
    "barium_carbonate": "BaCO3",
    "copper_oxide": "CuO",
    "iron_oxalate": "FeC2O4·2H2O",
    "phosphate": "(NH4)H2PO4",
    "lithium_hydroxide": "LiOH·H2O",
}
FILL = "- fill: {source: $source, container: $container, mass: $mass, tolerance: $tolerance}"
OTHERWISE = {
    "halved": ("mass: $mass,", "mass: 0.5 * $mass,"),
    "coarse": ("tolerance: $tolerance}", "tolerance: 2 * $tolerance}"),
    "one_tolerance": ("tolerance: $tolerance}", "tolerance: max($tolerances)}"),
    "one_alone": (FILL, f"- if: {{when: $source.name == $first.name, then: {{{FILL[2:]}}}}}"),
    "salted": ("    - park:", "    - fill: {source: $salt, container: $container, mass: 100 mg}\n    - park:"),
}
"""Workflows that dose otherwise than they are asked: what of `weigh_in` is other."""
BAYS = ("mortar_bay", "mortar_bay_2", "mortar_bay_3")


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Desk:
    """The starter lab with a third mortar, and powders for ceramics."""
    folder = LabFolder(make_lab(tmp_path_factory.mktemp("ceramics") / "lab"))
    powders = (folder.folder / "robot/powders.yaml").read_text(encoding="utf-8")
    more = "".join(POWDER.format(name=name, formula=formula) for name, formula in POWDERS.items())
    folder.write("robot/powders.yaml", powders + more)
    bay = "  mortar_bay_3: {kind: mortar, position: [330 mm, 240 mm, 0 mm]}\n"
    folder.replace("robot/cell.yaml", "  balance:      {", f"{bay}  balance:      {{")
    for name, (old, new) in OTHERWISE.items():
        text = (folder.folder / "trees/weigh_in.yaml").read_text(encoding="utf-8").replace("weigh_in", name)
        assert old in text
        if name == "salted":
            text = text.replace("inputs:\n", "inputs:\n  salt: Source\n")
        folder.write(f"trees/{name}.yaml", text.replace(old, new))
    return Desk(folder.folder, folder.load())


def recipe_of(
    *powders: str, product: str, chosen: str, amount: str = "2 g", tolerance: str = "2 %", more: str = ""
) -> str:
    """A recipe of one sample: `powders` are "NAME, purity: 99 %, …"."""
    sources = "".join(
        f"  s{n}: {{station: {bay}, container: small_agate_mortar, amount: 9 g, powder: {powder}}}\n"
        for n, (bay, powder) in enumerate(zip(BAYS, powders, strict=False), 1)
    )
    compose = f"{{product: {product}, amount: {amount}, tolerance: {tolerance}, from: [{chosen}]{more}}}"
    samples = f"samples:\n  - {{id: a, container: alumina_crucible, compose: {compose}}}\n"
    return f"recipe: one\nworkflow: weigh_in\nsources:\n{sources}{samples}"


def masses(sample: Sample) -> dict[str, float]:
    return {
        source.powder.name: mass for source, mass in zip(sample.inputs["sources"], sample.inputs["masses"], strict=True)
    }


def weighed_in(lab: Desk, *powders: str, product: str, chosen: str) -> dict[str, float]:
    return masses(lab.load(recipe_of(*powders, product=product, chosen=chosen)).samples[0])


# --- by hand: what literature's stoichiometries weigh


def test_llzo_with_ten_percent_of_lithium_more_is_weighed_in_as_by_hand(lab: Desk) -> None:
    pure = "purity: 100 %"
    text = recipe_of(
        f"lithium_carbonate, {pure}", f"lanthana, {pure}", f"zirconia, {pure}",
        product="Li7La3Zr2O12", chosen="Li2CO3 (excess 10 %), La2O3, ZrO2",
    )  # fmt: skip
    sample = lab.load(text).samples[0]
    n = 2000.0 / (7 * LI + 3 * LA + 2 * ZR + 12 * O)  # mmol
    by_hand = {
        "lithium_carbonate": n * 3.5 * 1.1 * (2 * LI + C + 3 * O),
        "lanthana": n * 1.5 * (2 * LA + 3 * O),
        "zirconia": n * 2 * (ZR + 2 * O),
    }
    assert masses(sample) == pytest.approx(by_hand, rel=1e-4)
    assert sum(by_hand.values()) == pytest.approx(2428, abs=1)
    assert sample.composition is not None
    asked = {one.element: one.asked for one in sample.composition.elements}
    assert asked == pytest.approx({"Li": 7.7, "La": 3.0, "Zr": 2.0}, rel=1e-12)


def test_ybco_is_weighed_in_as_by_hand(lab: Desk) -> None:
    found = weighed_in(
        lab, "yttria, purity: 99.9 %", "barium_carbonate, purity: 99.5 %", "copper_oxide, purity: 99.7 %",
        product="YBa2Cu3O6.9", chosen="CuO, BaCO3, Y2O3",
    )  # fmt: skip
    n = 2000.0 / (Y + 2 * BA + 3 * CU + 6.9 * O)
    by_hand = {
        "yttria": n * 0.5 * (2 * Y + 3 * O) / 0.999,
        "barium_carbonate": n * 2 * (BA + C + 3 * O) / 0.995,
        "copper_oxide": n * 3 * (CU + O) / 0.997,
    }
    assert found == pytest.approx(by_hand, rel=1e-4)


def test_lithium_iron_phosphate_from_wet_powders_is_weighed_in_as_by_hand(lab: Desk) -> None:
    dry = "purity: 99.9 %"
    found = weighed_in(
        lab, f"lithium_carbonate, {dry}, water: 0.5 %", f"iron_oxalate, {dry}", f"phosphate, {dry}, water: 1.2 %",
        product="LiFePO4", chosen="Li2CO3, FeC2O4·2H2O, NH4H2PO4",
    )  # fmt: skip
    n = 2000.0 / (LI + FE + P + 4 * O)
    by_hand = {
        "lithium_carbonate": n * 0.5 * (2 * LI + C + 3 * O) / (0.999 * 0.995),
        "iron_oxalate": n * (FE + 2 * C + 6 * O + 4 * H) / 0.999,
        "phosphate": n * (N + 6 * H + P + 4 * O) / (0.999 * 0.988),
    }
    assert found == pytest.approx(by_hand, rel=1e-4)


def test_the_uncertainty_of_a_composition_is_that_of_many_draws(lab: Desk) -> None:
    text = recipe_of(
        "lithium_carbonate, purity: 99.5 %, purity_uncertainty: 0.2 %, water: 1 %, water_uncertainty: 0.3 %",
        "lanthana, purity: 99.9 %", "zirconia, purity: 98 %",
        product="Li7La3Zr2O12", chosen="Li2CO3 (excess 10 %), La2O3, ZrO2", tolerance="6 %",
    )  # fmt: skip
    made = lab.load(text).samples[0].composition
    assert made is not None
    u_mg = {"lithium_carbonate": 4.0, "lanthana": 6.0, "zirconia": 2.0}
    came = reached(made, {p.lot: (p.target_mg + 3.0, u_mg[p.lot]) for p in made.powders}, is_closed=True)
    rng, size = np.random.default_rng(5), 200_000
    purity = {
        "lithium_carbonate": rng.normal(0.995, 0.002, size) * (1 - rng.normal(0.01, 0.003, size)),
        "lanthana": rng.normal(0.999, 0.001 / math.sqrt(3), size),
        "zirconia": rng.normal(0.98, 0.02 / math.sqrt(3), size),
    }
    weight = {"lithium_carbonate": 2 * LI + C + 3 * O, "lanthana": 2 * LA + 3 * O, "zirconia": ZR + 2 * O}
    per = {"lithium_carbonate": 2, "lanthana": 2, "zirconia": 1}
    mmol = {
        p.lot: rng.normal(p.target_mg + 3.0, u_mg[p.lot], size) * purity[p.lot] / weight[p.lot] * per[p.lot]
        for p in made.powders
    }
    whole = sum(mmol.values())
    for element, name in {"Li": "lithium_carbonate", "La": "lanthana", "Zr": "zirconia"}.items():
        drawn = 12.7 * mmol[name] / whole
        (one,) = (one for one in came.elements if one.element == element)
        assert one.reached == pytest.approx(drawn.mean(), rel=5e-4)
        assert 0.985 * drawn.std() < one.uncertainty < math.sqrt(3) * drawn.std(), "of independent doses it may be more"


# --- what a recipe may say


def test_the_smallest_mass_is_dosed_first_and_the_sheet_is_changed_between_powders_only(lab: Desk) -> None:
    text = recipe_of(
        "lanthana, purity: 99.9 %", "zirconia, purity: 99.9 %", "lithium_carbonate, purity: 99.9 %",
        product="Li7La3Zr2O12", chosen="La2O3, ZrO2, Li2CO3", amount="4 g",
    )  # fmt: skip
    sample = lab.load(text).samples[0]
    assert [source.powder.name for source in sample.sources] == ["zirconia", "lithium_carbonate", "lanthana"]
    assert [pour.mass_mg for pour in sample.flow.pours] == sorted(masses(sample).values())
    assert sample.inputs["first"].powder.name == "zirconia"


def test_a_sample_says_what_is_its_own_and_the_defaults_the_rest(lab: Desk) -> None:
    text = (REPOSITORY / "recipes/cathodes.yaml").read_text(encoding="utf-8")
    samples = lab.load(text).samples
    asked = [{one.element: one.asked for one in s.composition.elements} for s in samples if s.composition]
    assert asked == [pytest.approx({"Li": li, "Co": 1.0}) for li in (1.0, 1.05, 1.05)]
    n = 2000.0 / (LI + CO + 2 * O)
    assert samples[0].inputs["masses"][1] == pytest.approx(n * (3 * CO + 4 * O) / 3 / 0.997, rel=1e-4)
    rich, doped = (one.inputs["masses"] for one in samples[1:])
    assert rich[0] == pytest.approx(1.05 * samples[0].inputs["masses"][0])
    assert rich[1] == pytest.approx(samples[0].inputs["masses"][1]), "an excess comes to the amount"
    assert doped[1] < rich[1], "and what the formula has is part of it"


def test_a_table_may_have_a_column_of_products(lab: Desk) -> None:
    text = (REPOSITORY / "recipes/cathodes.yaml").read_text(encoding="utf-8")
    lab.write("products.csv", "id,compose\nx,LiCoO2\ny,Li1.1CoO2\n")
    text = text.split("samples:")[0] + "samples:\n  - {table: products.csv}\n"
    samples = lab.load(text).samples
    assert [one.composition.product for one in samples if one.composition] == ["LiCoO2", "Li1.1CoO2"]


@pytest.mark.parametrize("name", ["Li2CO3", "CLi2O3", "Li₂CO₃", "lithium_carbonate", "s1"])
def test_a_powder_is_named_by_its_formula_its_name_or_its_source(lab: Desk, name: str) -> None:
    text = recipe_of(
        "lithium_carbonate, purity: 99.9 %", "cobalt_oxide, purity: 99.9 %", product="LiCoO2", chosen=f"{name}, s2"
    )
    assert [source.name for source in lab.load(text).samples[0].sources] == ["s1", "s2"]


def test_an_element_that_is_not_ignored_is_balanced(lab: Desk) -> None:
    powders = ("lithium_hydroxide, purity: 100 %", "phosphate, purity: 100 %")
    text = recipe_of(*powders, product="Li3PO4", chosen="LiOH·H2O, NH4H2PO4", more=", ignore: [O, H]")
    assert lab.problems(text) == [
        "7:115: NH4H2PO4 brings N, which Li3PO4 does not have; use another powder; if it leaves, ignore N".replace(
            "NH4H2PO4", "(NH4)H2PO4"
        )
    ]
    assert masses(lab.load(text.replace("[O, H]", "[O, H, N]")).samples[0])


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ("Li2CO3, Co3O4", "Li2CO3, Co3O4, CuO", "no source holds CuO"),
        ("Li2CO3, Co3O4", "Li2CO3 (10 %), Co3O4", "not a formula"),
        ("Li2CO3, Co3O4", "Li2CO3 (excess), Co3O4", "cannot be read; write it as Li2CO3 (excess 10 %)"),
        ("Li2CO3, Co3O4", "Li2CO3 (excess 5), Co3O4", "has no unit"),
        ("Li2CO3, Co3O4", "Li2CO3 (excess 500 %), Co3O4", "-50 % to 100 %"),
        ("Li2CO3, Co3O4", "glass_beads, Co3O4", "is not a source, not the powder of a source"),
        ("2 %", "0.15 %", "is known to ± "),
        ("2 g", "20 mg", "which is too fine for a readability of 0.1 mg; at least 0.2 mg is possible"),
    ],
)
def test_what_cannot_be_composed_is_told_where_it_stands(lab: Desk, old: str, new: str, code: str) -> None:
    text = recipe_of(
        "lithium_carbonate, purity: 99.8 %", "cobalt_oxide, purity: 99.8 %", product="LiCoO2", chosen="Li2CO3, Co3O4"
    )
    (problem,) = lab.problems(text.replace(old, new, 1))
    line, column, message = problem.split(":", 2)
    assert code in message
    written = text.replace(old, new, 1).splitlines()[int(line) - 1][int(column) - 1 :]
    assert written.startswith((new.split(",")[0], new.rpartition(", ")[2], "2 %"))


@pytest.mark.parametrize(
    ("workflow", "what"),
    [
        (
            "halved",
            r"sample 'a' asks for 7\d\d\.\d+ mg of lithium_carbonate, but no dose has that mass; this one has 3",
        ),
        (
            "coarse",
            r"sample 'a' asks for a tolerance of \d+\.\d+ mg, but this dose has one of \d+\.\d+ mg; "
            r"write each of \$tolerances",
        ),
        ("one_tolerance", r"sample 'a' asks for a tolerance of 1\d\.\d+ mg, but this dose has one of 3\d\.\d+ mg"),
        ("one_alone", r"asks for 1\d+\.?\d* mg of cobalt_oxide, but 'one_alone' doses nothing into its container"),
        ("salted", r"this doses 'zirconia' into the container of sample 'a', whose composition has none"),
    ],
)
def test_a_workflow_that_doses_otherwise_than_a_composition_asks_is_refused(
    lab: Desk, workflow: str, what: str
) -> None:
    powders = [f"{name}, purity: 99.9 %" for name in ("lithium_carbonate", "cobalt_oxide", "zirconia")]
    text = recipe_of(*powders, product="LiCoO2", chosen="Li2CO3, Co3O4").replace("weigh_in", workflow)
    if workflow == "salted":
        text = text.replace("{id: a,", "{id: a, salt: s3,")
    told = lab.problems(text)
    assert any(re.search(what, problem) for problem in told), told
