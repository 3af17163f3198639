"""How much of each powder makes a product, how exactly each must be dosed, and what was made (docs/compose.md).

For n mol of a product, powder j is needed as n_j = n ν_j (1 + x_j) mol of its formula, with the excess x_j. ν solves A
ν = b exactly, in rationals, over the balanced elements: A_ej are the atoms of e in a formula unit of j, b_e those in
the product.

    m_j = n_j M_j / (p_j (1 - w_j))          M molar mass, p purity, w water
    c_e = S N_e / Σ N,   N_e = Σ_j A_ej n_j  atoms per formula unit of the product; S is the sum of those asked for
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
    """A powder as it is weighed in: formula, assay and excess."""

    name: str
    formula: Formula
    assay: float
    """Mass fraction of the formula: p (1 - w)."""
    assay_uncertainty: float
    """Relative standard uncertainty of `assay`."""
    excess: float = 0.0


@dataclass(frozen=True)
class Imbalance:
    """Why a set of formulas makes no product. `number` is the index of the formula to blame, None for the product."""

    code: str
    what: str
    remedy: str
    number: int | None = None


def balanced(product: Formula, formulas: Sequence[Formula], ignored: Sequence[str]) -> list[Fraction] | list[Imbalance]:
    """How many of each formula make one of the product, ignored elements left out; or everything that prevents it."""
    elements = [element for element in product.counts if element not in ignored]
    if not elements:
        what = f"all of {product.text} is ignored: nothing is left to balance"
        return [Imbalance("unbalanced", what, "ignore less")]
    if wrong := [*_foreign(product, formulas, elements, ignored), *_missing(product, formulas, elements)]:
        return wrong
    rows = [[one.counts.get(e, Fraction(0)) for one in formulas] + [product.counts[e]] for e in elements]
    pivots = _reduce(rows)
    if len(formulas) in pivots:  # a row reads 0 = 1
        what = f"no amounts of {_listed(formulas)} make {product.text}"
        return [Imbalance("unbalanced", what, "add a powder that brings the rest, or correct a count")]
    if free := [j for j in range(len(formulas)) if j not in pivots]:
        also = [formulas[pivots[i]] for i in range(len(pivots)) if rows[i][free[0]] != 0]
        one = formulas[free[0]]
        why = f"{one.text} is named twice" if one in also else f"{_listed(also)} can replace {one.text}"
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
            remedy = f"use another powder; if it leaves, ignore {', '.join(others)}"
            found.append(Imbalance("foreign-element", what, remedy, number))
        elif not any(element in one.counts for element in elements):
            what = f"{one.text} brings no element that is balanced"
            found.append(Imbalance("foreign-element", what, "leave it out, or ignore fewer elements", number))
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
    """Gauss-Jordan elimination in place, exactly. Returns the columns of the pivots."""
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
    """The doses for `amount_mg` of a product, the smallest first. `amounts` of the lots make one formula unit of it.

    Raises ValueError if the uncertainty of the assays alone uses up the tolerance.
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
    """R: if each dose is within R of its mass, each element is within the tolerance t, uncertainties included.

        R = min over e of (t - k A_e) / (Σ_j K_ej + k A_e),   A_e² = Σ_j (K_ej u_j)²
        K_ej = max |w_ej - (1 ± t) v_j|

    w_ej is the share of j in the atoms of e, v_j its share in all atoms (`atoms`: by element, then by powder). u_j is
    the relative standard uncertainty of its assay, k the coverage factor. R is never more than t. Raises ValueError
    where it is not positive.
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
    """The composition that was reached. `doses`: by lot, mass and standard uncertainty [mg] of all that the container
    holds.

    The verdict is "not known" unless these are exactly the composition's lots.

        u²(c_e) = (Σ_j |G_ej| n_j u(m_j) / m_j)² + Σ_j (G_ej n_j u_j)²
        G_ej = (S A_ej - c_e A_j) / Σ N,   A_j = Σ_e A_ej

    Errors of assays are independent. Those of doses are added linearly: the doses were adjusted to the container's
    total gain, so they are correlated, and the correlation was not kept.
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
    """Amount of each element [mmol], by powder."""
    elements = dict.fromkeys(element for powder in powders for element in powder.counts)
    return {
        element: [powder.counts.get(element, 0.0) * masses_mg[powder.lot] / powder.mg_per_mmol for powder in powders]
        for element in elements
    }


def _rounded_down(mass_mg: float) -> float:
    """To 0.01 mg, the last digit that people are shown."""
    return math.floor(100.0 * mass_mg) / 100.0
