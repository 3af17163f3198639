"""The elements that go in are those of the product, and doses in tolerance make it: for any powders."""

import itertools
from collections.abc import Sequence
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scuhand_bt.dosing.bracket import Drift, Gross, Net, close
from scuhand_bt.dosing.verdict import judge
from scuhand_bt.formula import parse_formula
from scuhand_bt.recipe.composition import ComposedPowder, Composition, ElementShare
from scuhand_bt.recipe.stoichiometry import Imbalance, Lot, balanced, composed, reached, relative_tolerance

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
