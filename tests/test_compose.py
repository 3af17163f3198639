"""Samples by the formula of their product: what is weighed in, how exactly, and what was made."""

import itertools
import json
import math
import re
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import REPOSITORY, Call, Desk, LabFolder
from hypothesis import given
from hypothesis import strategies as st
from running import Watching, make_lab, shared_planner

from scuhand_bt.dashboard.page_state import Page
from scuhand_bt.dosing.bracket import Drift, Gross, Net, close
from scuhand_bt.dosing.verdict import judge
from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.formula import parse_formula
from scuhand_bt.journal.follow import Follower
from scuhand_bt.journal.reader import read
from scuhand_bt.lab import load_lab, starter_lab
from scuhand_bt.recipe.composition import ComposedPowder, Composition, ElementShare
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.recipe.sample import Sample
from scuhand_bt.recipe.stoichiometry import Imbalance, Lot, balanced, composed, reached, relative_tolerance
from scuhand_bt.run.options import Options
from scuhand_bt.run.outcome import BatchResult
from scuhand_bt.run.resume import Resumable, checked_history, find_run, resumable
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun

# Standard atomic weights, abridged to five figures (IUPAC, 2021), typed from its table.
H, C, N, O, LI, P, FE = 1.008, 12.011, 14.007, 15.999, 6.94, 30.974, 55.845  # noqa: E741
CO, CU, Y, ZR, BA, LA = 58.933, 63.546, 88.906, 91.224, 137.33, 138.91
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


# --- the balance of masses

POOL = ("Li", "La", "Zr", "Cu")
COUNT = st.integers(0, 4)


@st.composite
def sets(draw: st.DrawFn) -> tuple[list[str], list[Fraction]]:
    """Formulas of a few elements with oxygen, and how much of each there is to be."""
    size = draw(st.integers(1, 4))
    rows = [[draw(COUNT) for _ in POOL[: draw(st.integers(1, 4))]] for _ in range(size)]
    texts = ["".join(f"{e}{c}" for e, c in zip(POOL, row, strict=False) if c) + "O2" for row in rows]
    return texts, [Fraction(draw(st.integers(1, 60)), draw(st.sampled_from([1, 2, 4, 5, 10]))) for _ in range(size)]


def product_of(texts: Sequence[str], amounts: Sequence[Fraction]) -> str:
    """The formula of what they come to."""
    counts = {
        e: sum(n * parse_formula(text).counts.get(e, Fraction(0)) for text, n in zip(texts, amounts, strict=True))
        for e in POOL
    }
    return "".join(f"{e}{_decimal(count)}" for e, count in counts.items() if count) + "O"


def _decimal(count: Fraction | int) -> str:
    return f"{float(count):.6f}".rstrip("0").rstrip(".")


@given(
    sets(), st.lists(st.floats(0.5, 1.0), min_size=4, max_size=4), st.lists(st.floats(0.0, 0.3), min_size=4, max_size=4)
)
def test_the_elements_that_go_in_are_those_of_the_product(
    case: tuple[list[str], list[Fraction]], assays: list[float], excesses: list[float]
) -> None:
    texts, amounts = case
    product, formulas = parse_formula(product_of(texts, amounts)), [parse_formula(text) for text in texts]
    atoms = np.array([[float(one.counts.get(e, 0)) for one in formulas] for e in POOL])
    found = balanced(product, formulas, ["O"])
    if any(isinstance(one, Imbalance) for one in found):
        assert np.linalg.matrix_rank(atoms) < len(texts), found
        return
    assert found == amounts, "and no other amounts of them make it"
    lots = [Lot(f"{n}", f, a, 0.0, x) for n, (f, a, x) in enumerate(zip(formulas, assays, excesses, strict=False))]
    made = composed(product, 1000.0, lots, amounts, ["O"], 0.01)
    masses_mg = {powder.lot: powder.target_mg for powder in made.powders}
    mmol = [masses_mg[lot.name] * lot.assay / lot.formula.molar_mass_g_per_mol / (1 + lot.excess) for lot in lots]
    product_mmol = 1000.0 / product.molar_mass_g_per_mol
    wanted = [product_mmol * float(product.counts.get(e, 0)) for e in POOL]
    assert atoms @ mmol == pytest.approx(wanted, rel=1e-9)
    assert [powder.target_mg for powder in made.powders] == sorted(masses_mg.values())
    rows = {
        one.element: [p.counts.get(one.element, 0.0) * p.target_mg / p.mg_per_mmol for p in made.powders]
        for one in made.elements
    }
    share = relative_tolerance(rows, [0.0] * len(lots), 0.01)
    assert all(-1e-9 < share * p.target_mg - p.tolerance_mg < 0.01 + 1e-9 for p in made.powders), "rounded down"


@pytest.mark.parametrize(
    ("product", "formulas", "ignored", "codes"),
    [
        ("LiCoO2", ["Li2CO3"], "CO", ["missing-element"]),
        ("LiCoO2", ["LiCl", "Co3O4"], "CO", ["foreign-element"]),
        ("LiCoO2", ["LiCl", "C", "CuO"], "CO", [*["foreign-element"] * 3, "missing-element"]),
        ("LiCoO2", ["Li2CO3", "LiOH", "Co3O4"], "COH", ["ambiguous-precursors"]),
        ("Li7La3Zr2O12", ["Li2CO3", "La2Zr2O7"], "CO", ["unbalanced"]),
        ("Li7La2Zr3O12", ["Li2CO3", "La2Zr2O7", "La2O3"], "CO", ["negative-amount"]),
        ("Li7La2Zr2O12", ["Li2CO3", "La2Zr2O7", "La2O3"], "CO", ["negative-amount"]),
        ("CO2", ["CO"], "CO", ["unbalanced"]),
        ("LiCoO2", ["Li2O", "Co3O4"], "", ["unbalanced"]),
        ("LiCoO2", ["Li2O", "Co2O3"], "", []),
    ],
)  # fmt: skip
def test_sets_that_make_no_product_say_why(product: str, formulas: list[str], ignored: str, codes: list[str]) -> None:
    amounts = balanced(parse_formula(product), [parse_formula(one) for one in formulas], list(ignored))
    assert [one.code for one in amounts if isinstance(one, Imbalance)] == codes
    assert codes or amounts == [Fraction(1, 2)] * 2


# --- tolerances and uncertainties

ATOMS = st.floats(0.5, 50.0)


@st.composite
def matrices(draw: st.DrawFn) -> dict[str, list[float]]:
    """Atoms of each element by powder: each powder has one of its own, and may share others."""
    size = draw(st.integers(2, 4))
    own = {POOL[n]: [draw(ATOMS) if m == n else 0.0 for m in range(size)] for n in range(size)}
    shared = {"O": [draw(ATOMS) for _ in range(size)]} if draw(st.booleans()) else {}
    return own | shared


def composition_of(atoms: dict[str, list[float]], assay: Sequence[float], tolerance: float) -> Composition:
    """A composition of powders of which a mg is a mmol, each with a mass of 1000 mg."""
    share = relative_tolerance(atoms, assay, tolerance)
    powders = tuple(
        ComposedPowder(
            lot=f"p{n}", formula="", target_mg=1000.0, tolerance_mg=1000.0 * share, mg_per_mmol=1.0,
            assay_uncertainty=assay[n], counts={e: row[n] for e, row in atoms.items()},
        )
        for n in range(len(assay))
    )  # fmt: skip
    elements = tuple(ElementShare(element=e, asked=sum(row)) for e, row in atoms.items())
    return Composition(product="", tolerance=tolerance, powders=powders, elements=elements)


def worst(made: Composition, errors: Sequence[float]) -> float:
    """The largest relative error of an element, in tolerances, where doses are off by these, relative."""
    came = reached(made, {f"p{n}": (1000.0 * (1.0 + error), 0.0) for n, error in enumerate(errors)}, is_closed=True)
    return max(abs((one.reached or 0.0) / one.asked - 1.0) for one in came.elements) / made.tolerance


@given(matrices(), st.floats(0.002, 0.2))
def test_with_all_doses_at_the_ends_of_their_tolerances_no_element_is_beyond_its_own(
    atoms: dict[str, list[float]], tolerance: float
) -> None:
    size = len(next(iter(atoms.values())))
    made = composition_of(atoms, [0.0] * size, tolerance)
    share = made.powders[0].tolerance_mg / 1000.0
    corners = list(itertools.product((-share, share), repeat=size))
    farthest = max(worst(made, corner) for corner in corners)
    assert farthest <= 1.0 + 1e-9
    assert share == tolerance or farthest >= 1.0 - 2.5 * tolerance, "nor is more asked than has to be"


@given(matrices(), st.floats(0.01, 0.2), st.data())
def test_a_sample_whose_doses_are_in_tolerance_is_of_the_composition_asked(
    atoms: dict[str, list[float]], tolerance: float, data: st.DataObject
) -> None:
    size = len(next(iter(atoms.values())))
    assay = [data.draw(st.floats(0.0, tolerance / 8)) for _ in range(size)]
    made = composition_of(atoms, assay, tolerance)
    doses = {}
    for powder in made.powders:
        u_mg = data.draw(st.floats(0.0, powder.tolerance_mg / 2))
        most_mg = powder.tolerance_mg - 2 * u_mg
        error_mg = data.draw(st.sampled_from([-1.0, 1.0])) * most_mg * (1.0 - 1e-9)
        assert judge(1000.0, powder.tolerance_mg, 1000.0 + error_mg, u_mg) == "in tolerance"
        doses[powder.lot] = (1000.0 + error_mg, u_mg)
    assert reached(made, doses, is_closed=True).verdict == "in tolerance"


def test_what_the_assays_leave_uncertain_is_taken_from_the_doses() -> None:
    atoms = {"Li": [2.0, 0.0], "Co": [0.0, 3.0]}
    known, uncertain = (relative_tolerance(atoms, [u, 0.0], 0.01) for u in (0.0, 0.002))
    assert known == pytest.approx(0.01 / 1.21)  # Li: 1 - 0.99 x 0.4 of its own, 1.01 x 0.6 of the other
    assert uncertain == pytest.approx((0.01 - 0.004 * 0.604) / (1.21 + 0.004 * 0.604))  # 1 - 0.99 x 0.4
    with pytest.raises(ValueError, match=r"Li is known to ± 1\.\d\d %"):
        relative_tolerance(atoms, [0.009, 0.0], 0.01)


def test_what_says_nothing_of_a_composition_is_held_to_the_tolerance_itself() -> None:
    assert relative_tolerance({"Ti": [3.0]}, [0.0], 0.02) == 0.02


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


@pytest.mark.parametrize("u_mg", [(1.0, 1.0), (2.0, 0.3), (1.0, 1.0, 1.0), (0.2, 1.0, 3.0)])
def test_doses_that_were_adjusted_to_what_all_have_weighed_make_a_composition_no_surer_than_it_is(
    u_mg: tuple[float, ...],
) -> None:
    """Each dose is off by itself; the container tells what they are together, and each is corrected by its share."""
    size, digit_mg = len(u_mg), 1e-9
    made = composition_of({POOL[n]: [float(n == m) for m in range(size)] for n in range(size)}, [0.0] * size, 0.05)
    bare, later = Gross(0.0, 0.01, 0.0), Gross(0.0, 0.01, 60.0)
    loaded, lifted = Gross(5000.0, 0.01, 1.0), Gross(5000.0 + 1000.0 * size, 0.01, 59.0)
    rng = np.random.default_rng(7)
    drawn, told = [], []
    for _ in range(400):
        doses = [Net(rng.normal(1000.0, u), u) for u in u_mg]
        none = [Net(0.0, 0.0)] * size
        adjusted = close(doses, none, Drift(0.0, 0.0), bare, loaded, lifted, later, digit_mg).doses
        came = reached(made, {f"p{n}": (a.mass_mg, a.uncertainty_mg) for n, a in enumerate(adjusted)}, is_closed=True)
        drawn.append([one.reached for one in came.elements])
        told.append([one.uncertainty for one in came.elements])
    assert (np.min(told, axis=0) > 0.93 * np.std(drawn, axis=0)).all()


def test_a_powder_that_is_not_dosed_and_one_that_is_nobodys_make_a_composition_unknown() -> None:
    made = composition_of({"Li": [2.0, 0.0], "Co": [0.0, 3.0]}, [0.0, 0.0], 0.01)
    whole = {"p0": (1000.0, 0.1), "p1": (1000.0, 0.1)}
    known = reached(made, whole, is_closed=False)
    assert (known.verdict, [one.reached for one in known.elements]) == ("open", [2.0, 3.0])
    for doses in ({"p0": (1000.0, 0.1)}, {**whole, "sand": (5.0, 0.1)}, {}):
        came = reached(known, doses, is_closed=True)
        assert came.verdict == "not known"
        assert all(one.reached is None and one.uncertainty is None for one in came.elements)
    off = reached(made, {"p0": (1030.0, 0.1), "p1": (1000.0, 0.1)}, is_closed=True)
    assert off.verdict == "out of tolerance"


# --- runs


class StopInTheSecond(Watching):
    """Stops a run while it doses its second powder."""

    def ticked(self, root: Any) -> None:
        assert self.session is not None
        is_second = bool(self.session.journal.so_far.doses)
        self.ticks += is_second and self.session.cell.believed.dosing.target_mg is not None
        if self.ticks == 20:
            self.session.control.wish("stop_now")


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The journal of a dry run of one of the shipped samples that was stopped in its second dose, and resumed."""
    folder, lab = tmp_path_factory.mktemp("composed"), load_lab(starter_lab())
    head, samples = (REPOSITORY / "recipes/cathodes.yaml").read_text(encoding="utf-8").split("samples:\n")
    rich = next(line for line in samples.splitlines() if "lco-rich" in line)
    (folder / "rich.yaml").write_text(f"{head}samples:\n{rich}\n", encoding="utf-8")
    plan = make_plan(load_recipe(folder / "rich.yaml", lab), lab)
    options = Options(DryRun(1), None, folder / "runs")

    def go(watching: Watching, found: Resumable | None = None) -> BatchResult:
        watching.session = Session(plan, lab, options, shared_planner(plan, lab), resumes=found)
        try:
            return watching.session.run(watching)
        finally:
            watching.session.close()

    stopped = StopInTheSecond()
    assert go(stopped).exit_code == ExitCode.INTERRUPTED
    before = stopped.results[-1]
    assert (before.verdict, before.composition and before.composition.verdict) == ("interrupted", "not known")
    journal = find_run(folder / "runs", "last")
    ended = go(Watching(), resumable(journal, checked_history(journal), plan, lab, accept_changes=False))
    assert (ended.exit_code, ended.samples[0].is_good) == (ExitCode.OK, True)
    doses = [row["outcome"] for row in read(journal, "action") if row["skill"] == "dispense"]
    assert doses.count("done") == 2, "and the first is not done again"
    return journal


def test_every_face_of_a_run_tells_the_same_composition(ran: Path, command: Call, tmp_path: Path) -> None:
    exported = command("export", ran, "--json").stdout
    (sample,) = json.loads(exported)["samples"]
    elements = {one["element"]: one for one in sample["composition"]["elements"]}
    doses = {dose["lot"]: dose["dispensed_mg"] for dose in sample["doses"]}
    li = doses["lithium_carbonate/LC-17"] * 0.995 * 0.998 / (2 * LI + C + 3 * O) * 2
    co = doses["cobalt_oxide/CO-4"] * 0.997 / (3 * CO + 4 * O) * 3
    by_hand = {"Li": 2.05 * li / (li + co), "Co": 2.05 * co / (li + co)}
    assert {e: one["reached"] for e, one in elements.items()} == pytest.approx(by_hand, rel=1e-4)
    assert {e: one["asked"] for e, one in elements.items()} == {"Li": 1.05, "Co": 1.0}
    assert sample["composition"]["verdict"] == "in tolerance"
    cell = ", ".join(
        f"{e} {one['reached']:.4f} ± {one['uncertainty']:.4f} of {one['asked']:.4f}" for e, one in elements.items()
    )
    command("report", ran, "-o", tmp_path / "report.html")
    assert f"{cell}: in tolerance" in (tmp_path / "report.html").read_text(encoding="utf-8")
    rows = [line.split(",") for line in command("export", ran, "--csv").stdout.splitlines()]
    header = [name.strip('"') for name in rows[0]]
    written = [
        dict(zip(header, (cell.strip('"') for cell in row), strict=False)) for row in rows if '"composition"' in row
    ]
    assert {row["element"]: row["atoms_reached"] for row in written} == {
        e: f"{one['reached']:.4f}" for e, one in elements.items()
    }
    assert {(row["product"], row["verdict"], row["composition_tolerance"]) for row in written} == {
        ("LiCoO2", "in tolerance", "0.0150")
    }
    story = command("show", ran).stdout
    assert f"Li {elements['Li']['reached']:.4f}" in story


def test_a_page_tells_what_a_composed_sample_asks_for_before_and_while_it_is_dosed(ran: Path) -> None:
    begun = Page(Follower(ran, until_s=0.0)).news(is_held=True)
    assert begun["rows"][0]["what"] == "798.3 mg ± 10.3 mg from li + 1.6452 g ± 21.2 mg from co"
    dosed_s = next(row["time_s"] for row in read(ran, "entry") if row["kind"] == "dose")
    told = Page(Follower(ran, until_s=dosed_s)).news(is_held=True)
    of = "798.3 mg ± 10.3 mg of lithium_carbonate + 1.6452 g ± 21.2 mg of cobalt_oxide"
    assert told["job"]["about"] == f"lco-rich: {of} into lco-rich (alumina_crucible)"


def test_a_plan_tells_what_each_sample_is_made_of(command: Call) -> None:
    told = command("plan", "recipes/cathodes.yaml", "--trials", 0).stdout
    assert re.search(
        r"^lco-rich: LiCoO2 \(Li 1\.05 Co 1, each within 1\.5 %\): 798\.3 mg ± 10\.\d* mg of lithium", told, re.M
    )
    page = (REPOSITORY / "docs/compose.md").read_text(encoding="utf-8")
    shown = [line for line in page.splitlines() if re.match(r"lco\S*: LiCoO2 ", line)]
    assert len(shown) == 2
    assert [line for line in shown if line not in told] == [], "the page shows what the command says"
    values = json.loads(command("plan", "recipes/cathodes.yaml", "--trials", 0, "--json").stdout)
    (job,) = (job for job in values["jobs"] if job["sample"] == "lco")
    assert [powder["formula"] for powder in job["composition"]["powders"]] == ["Li2CO3", "Co3O4"]
