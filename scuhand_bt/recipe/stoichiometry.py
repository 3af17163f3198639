"""How much of which powder makes a product, how exactly each is to be dosed, and what was made (docs/compose.md).

A sample of n mol of a product takes n_j = n ν_j (1 + x_j) of the formula of powder j. ν solves A ν = b over the
elements that are balanced, exactly, in rationals: A_ej atoms of e in a formula of j, b_e in the product; x_j excess.

    m_j = n_j M_j / (p_j (1 - w_j))          M molar mass, p purity, w water
    c_e = S N_e / Σ N,   N_e = Σ_j A_ej n_j  atoms per formula of the product; S as many as are asked
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

from scuhand_bt.dosing.verdict import COVERAGE, judge
from scuhand_bt.formula import Formula
from scuhand_bt.recipe.composition import ComposedPowder, Composition, CompositionVerdict, ElementShare


@dataclass(frozen=True)
class Lot:
    """A powder as it is weighed in: its formula, its assay, and how much more of it there is to be."""

    name: str
    formula: Formula
    assay: float
    """Share of the formula in its mass: p (1 - w)."""
    assay_uncertainty: float
    """Standard uncertainty, relative."""
    excess: float = 0.0


@dataclass(frozen=True)
class Imbalance:
    """Why a set of formulas makes no product; `number` is the formula that is to blame, None for the product."""

    code: str
    what: str
    remedy: str
    number: int | None = None


def balanced(product: Formula, formulas: Sequence[Formula], ignored: Sequence[str]) -> list[Fraction] | list[Imbalance]:
    """So many of each formula make one of the product, without what is ignored; or all that is in the way."""
    elements = [element for element in product.counts if element not in ignored]
    if not elements:
        what = f"all of {product.text} is ignored: nothing is left to balance"
        return [Imbalance("unbalanced", what, "ignore less")]
    if wrong := [*_foreign(product, formulas, elements, ignored), *_missing(product, formulas, elements)]:
        return wrong
    rows = [[one.counts.get(e, Fraction(0)) for one in formulas] + [product.counts[e]] for e in elements]
    pivots = _reduce(rows)
    if len(formulas) in pivots:  # a row that says 0 = 1
        what = f"no amounts of {_listed(formulas)} come to {product.text}"
        return [Imbalance("unbalanced", what, "add what brings the rest, or correct a count")]
    if free := [j for j in range(len(formulas)) if j not in pivots]:
        also = [formulas[pivots[i]] for i in range(len(pivots)) if rows[i][free[0]] != 0]
        one = formulas[free[0]]
        why = f"{one.text} stands there twice" if one in also else f"{one.text} brings no more than {_listed(also)}"
        what = f"there are several ways to make {product.text}: {why}"
        return [Imbalance("ambiguous-precursors", what, "leave one of them out", free[0])]
    found = [row[-1] for row in rows[: len(formulas)]]
    return [_negative(formulas[j], found[j], j) for j in range(len(found)) if found[j] <= 0] or found


def _foreign(
    product: Formula, formulas: Sequence[Formula], elements: Sequence[str], ignored: Sequence[str]
) -> list[Imbalance]:
    found = []
    for number, one in enumerate(formulas):
        others = [element for element in one.counts if element not in product.counts and element not in ignored]
        if others:
            what = f"{one.text} brings {', '.join(others)}, which {product.text} does not have"
            remedy = f"another powder; if it leaves, ignore {', '.join(others)}"
            found.append(Imbalance("foreign-element", what, remedy, number))
        elif not any(element in one.counts for element in elements):
            what = f"{one.text} brings nothing that is balanced"
            found.append(Imbalance("foreign-element", what, "leave it out, or ignore less", number))
    return found


def _missing(product: Formula, formulas: Sequence[Formula], elements: Sequence[str]) -> list[Imbalance]:
    missing = [element for element in elements if not any(element in one.counts for one in formulas)]
    if not missing:
        return []
    what = f"none of {_listed(formulas)} brings {', '.join(missing)} of {product.text}"
    return [Imbalance("missing-element", what, f"name a powder with {' and '.join(missing)}")]


def _negative(one: Formula, amount: Fraction, number: int) -> Imbalance:
    if amount == 0:
        return Imbalance("negative-amount", f"nothing of {one.text} is needed", "leave it out", number)
    what = f"{-float(amount):.4g} of {one.text} would have to be taken away"
    return Imbalance("negative-amount", what, "the other powders bring too much of what it has", number)


def _listed(formulas: Sequence[Formula]) -> str:
    return " and ".join(one.text for one in formulas)


def _reduce(rows: list[list[Fraction]]) -> list[int]:
    """Gauss and Jordan, in place and exactly; the columns of the pivots."""
    pivots: list[int] = []
    for column in range(len(rows[0])):
        found = next((i for i in range(len(pivots), len(rows)) if rows[i][column] != 0), None)
        if found is None:
            continue
        at = len(pivots)
        rows[at], rows[found] = rows[found], rows[at]
        rows[at] = [value / rows[at][column] for value in rows[at]]
        for i in range(len(rows)):
            if i != at and (factor := rows[i][column]) != 0:
                rows[i] = [value - factor * pivot for value, pivot in zip(rows[i], rows[at], strict=True)]
        pivots.append(column)
        if len(pivots) == len(rows):
            break
    return pivots


def composed(
    product: Formula,
    amount_mg: float,
    lots: Sequence[Lot],
    amounts: Sequence[Fraction],
    ignored: Sequence[str],
    tolerance: float,
) -> Composition:
    """The doses for so much of a product, the smallest first; `amounts` of the lots make one formula of it.

    Raises ValueError where the assays alone leave nothing of the tolerance to the doses.
    """
    elements = [element for element in product.counts if element not in ignored]
    product_mmol = amount_mg / product.molar_mass_g_per_mol
    powders = []
    for lot, amount in zip(lots, amounts, strict=True):
        mg_per_mmol = lot.formula.molar_mass_g_per_mol / lot.assay
        powders.append(
            ComposedPowder(
                lot=lot.name,
                formula=lot.formula.text,
                target_mg=product_mmol * float(amount) * (1.0 + lot.excess) * mg_per_mmol,
                tolerance_mg=0.0,
                mg_per_mmol=mg_per_mmol,
                assay_uncertainty=lot.assay_uncertainty,
                counts={e: float(lot.formula.counts[e]) for e in elements if e in lot.formula.counts},
            )
        )
    powders.sort(key=lambda powder: powder.target_mg)
    atoms = _atoms(powders, {powder.lot: powder.target_mg for powder in powders})
    share = relative_tolerance(atoms, [powder.assay_uncertainty for powder in powders], tolerance)
    return Composition(
        product=product.text,
        tolerance=tolerance,
        powders=tuple(
            powder.model_copy(update={"tolerance_mg": _rounded_down(share * powder.target_mg)}) for powder in powders
        ),
        elements=tuple(ElementShare(element=e, asked=sum(atoms[e]) / product_mmol) for e in elements),
    )


def relative_tolerance(atoms: Mapping[str, Sequence[float]], assay: Sequence[float], tolerance: float) -> float:
    """R: when each dose is within R of its mass, each element is within the tolerance t, uncertainties included.

        R = min over e of (t - k A_e) / (Σ_j K_ej + k A_e),   A_e² = Σ_j (K_ej u_j)²
        K_ej = max |w_ej - (1 ± t) v_j|

    w_ej is the share of j in the atoms of e, v_j in all atoms (`atoms`: of each element, by powder), u_j the relative
    standard uncertainty of its assay, k the coverage. R is never more than t. Raises ValueError where it is not
    positive.
    """
    whole = sum(map(sum, atoms.values()))
    shares = [sum(column) / whole for column in zip(*atoms.values(), strict=True)]
    least = tolerance
    for element, of_powders in atoms.items():
        gains = [
            max(abs(n / sum(of_powders) - (1.0 + sign * tolerance) * share) for sign in (-1.0, 1.0))
            for n, share in zip(of_powders, shares, strict=True)
        ]
        unknown = COVERAGE * math.hypot(*(gain * u for gain, u in zip(gains, assay, strict=True)))
        if unknown >= tolerance:
            raise ValueError(f"by the powders' assays alone, {element} is known to ± {100.0 * unknown:.2f} %")
        least = min(least, (tolerance - unknown) / (sum(gains) + unknown))
    return least


def reached(composition: Composition, doses: Mapping[str, tuple[float, float]], *, is_closed: bool) -> Composition:
    """What it came to: `doses` are mass and standard uncertainty (mg) by lot, of all that the container holds.

    Not known where that is not each of its lots, and no other.

    u²(c_e) = (Σ_j |G_ej| n_j u(m_j) / m_j)² + Σ_j (G_ej n_j u_j)²,   G_ej = (S A_ej - c_e A_j) / Σ N,   A_j = Σ_e A_ej

    Errors of assays are independent. Those of the doses add up: adjusted to what all of the container has gained, they
    are off against each other, and by as much as that nobody has kept.
    """
    powders = composition.powders
    is_whole = doses.keys() == {powder.lot for powder in powders}
    atoms = _atoms(powders, {lot: mass_mg for lot, (mass_mg, _) in doses.items()}) if is_whole else {}
    whole = sum(map(sum, atoms.values()))
    if whole <= 0.0:
        unknown = [one.model_copy(update={"reached": None, "uncertainty": None}) for one in composition.elements]
        return composition.model_copy(update={"elements": tuple(unknown), "verdict": "not known"})
    asked = sum(one.asked for one in composition.elements)
    elements = []
    for one in composition.elements:
        count = asked * sum(atoms[one.element]) / whole
        of_doses, of_assays = 0.0, []
        for powder in powders:
            mass_mg, u_mg = doses[powder.lot]
            gain = (asked * powder.counts.get(one.element, 0.0) - count * sum(powder.counts.values())) / whole
            of_doses += abs(gain) * u_mg / powder.mg_per_mmol
            of_assays.append(gain * mass_mg * powder.assay_uncertainty / powder.mg_per_mmol)
        elements.append(one.model_copy(update={"reached": count, "uncertainty": math.hypot(of_doses, *of_assays)}))
    verdict = _verdict(elements, composition.tolerance, is_closed=is_closed)
    return composition.model_copy(update={"elements": tuple(elements), "verdict": verdict})


def _verdict(elements: Sequence[ElementShare], tolerance: float, *, is_closed: bool) -> CompositionVerdict:
    for one in elements:
        assert one.reached is not None
        assert one.uncertainty is not None
        if judge(one.asked, tolerance * one.asked, one.reached, one.uncertainty) != "in tolerance":
            return "out of tolerance"
    return "in tolerance" if is_closed else "open"


def _atoms(powders: Sequence[ComposedPowder], masses_mg: Mapping[str, float]) -> dict[str, list[float]]:
    """mmol of each element, by powder."""
    elements = dict.fromkeys(element for powder in powders for element in powder.counts)
    return {
        element: [powder.counts.get(element, 0.0) * masses_mg[powder.lot] / powder.mg_per_mmol for powder in powders]
        for element in elements
    }


def _rounded_down(mass_mg: float) -> float:
    """To 0.01 mg, as people read it."""
    return math.floor(100.0 * mass_mg) / 100.0
