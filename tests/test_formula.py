"""Formulas are read as they are written, and what could be read in two ways is not."""

import re
from decimal import Decimal
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st
from molmass import Formula as OfMolmass

from scuhand_bt.formula import parse_formula

# Standard atomic weights, abridged to five figures (IUPAC, 2021), typed from its table.
WEIGHTS = {"H": 1.008, "C": 12.011, "N": 14.007, "O": 15.999, "Li": 6.94, "La": 138.91, "Zr": 91.224, "Fe": 55.845}


@pytest.mark.parametrize(
    ("text", "counts"),
    [
        ("Li7La3Zr2O12", {"Li": "7", "La": "3", "Zr": "2", "O": "12"}),
        ("Li6.5La3Zr1.5Ta0.5O12", {"Li": "13/2", "La": "3", "Zr": "3/2", "Ta": "1/2", "O": "12"}),
        ("YBa2Cu3O6.9", {"Y": "1", "Ba": "2", "Cu": "3", "O": "69/10"}),
        ("(NH4)2HPO4", {"N": "2", "H": "9", "P": "1", "O": "4"}),
        ("K4[Fe(CN)6]", {"K": "4", "Fe": "1", "C": "6", "N": "6"}),
        ("La(NO3)3·6H2O", {"La": "1", "N": "3", "O": "15", "H": "12"}),
        ("La(NO3)3 * 6H2O", {"La": "1", "N": "3", "O": "15", "H": "12"}),
        ("CaSO4·0.5H2O", {"Ca": "1", "S": "1", "O": "9/2", "H": "1"}),
        ("2MgO·SiO2", {"Mg": "2", "O": "4", "Si": "1"}),
        ("Li₂CO₃", {"Li": "2", "C": "1", "O": "3"}),
        ("Li0.5H2O", {"Li": "1/2", "H": "2", "O": "1"}),
        ("MgO4.5(H2O)", {"Mg": "1", "O": "11/2", "H": "2"}),
        ("Co", {"Co": "1"}),
        ("CO", {"C": "1", "O": "1"}),
    ],
)
def test_a_formula_is_its_counts_exactly(text: str, counts: dict[str, str]) -> None:
    assert parse_formula(text).counts == {element: Fraction(count) for element, count in counts.items()}


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("CuSO4.5H2O", "write 4·5H2O, or 4.5(H2O)"),
        ("La(NO3)3.6H2O", "write 3·6H2O"),
        ("NiCl2.6NH3", "2·6NH3"),
        ("CuSO4.H2O", "write '·' before a second formula"),
        ("YBa2Cu3O7-x", "x must be a number"),
        ("Na+", "no charges"),
        ("Lx2O", "no element 'Lx'"),
        ("D2O", "no element 'D'"),
        ("lico2", "a capital"),
        ("Li.5O", "is not a count"),
        ("Li0", "is not a count"),
        ("Li0.00", "is not a count"),
        ("Li2.5.5", "is not a count"),
        ("(LiO", "a ')' is missing"),
        ("[LiO)", "too many, or it closes another kind"),
        ("LiO)2", "too many"),
        ("Li()2", "empty"),
        ("Li2O·", "one side of a dot"),
        ("3", "one side of a dot"),
        ("", "it is empty"),
        ("Li " + "O" * 100, "longer than"),
    ],
)
def test_what_is_no_formula_is_refused_with_what_to_write(text: str, why: str) -> None:
    with pytest.raises(ValueError, match=re.escape(why)):
        parse_formula(text)


def test_molar_masses_are_those_of_the_iupacs_table() -> None:
    llzo = 7 * WEIGHTS["Li"] + 3 * WEIGHTS["La"] + 2 * WEIGHTS["Zr"] + 12 * WEIGHTS["O"]
    oxalate = WEIGHTS["Fe"] + 2 * WEIGHTS["C"] + 6 * WEIGHTS["O"] + 4 * WEIGHTS["H"]
    assert parse_formula("Li7La3Zr2O12").molar_mass_g_per_mol == pytest.approx(llzo, rel=5e-5)
    assert parse_formula("FeC2O4·2H2O").molar_mass_g_per_mol == pytest.approx(oxalate, rel=5e-5)


SYMBOLS = st.sampled_from(["H", "C", "O", "Li", "La", "Zr", "Co", "S", "P", "Ba"])


@st.composite
def groups(draw: st.DrawFn, depth: int = 2) -> str:
    """Elements and brackets with whole counts: what molmass reads, too."""
    parts = []
    for _ in range(draw(st.integers(1, 3))):
        is_group = depth > 0 and draw(st.booleans())
        inner = f"({draw(groups(depth - 1))})" if is_group else draw(SYMBOLS)
        count = draw(st.integers(1, 12))
        parts.append(inner + (str(count) if count > 1 else ""))
    return "".join(parts)


@given(groups())
def test_with_whole_counts_a_formula_is_what_molmass_reads(text: str) -> None:
    theirs = OfMolmass(text, parse_groups=False)
    assert parse_formula(text).counts == {one.symbol: one.count for one in theirs.composition().values()}
    assert parse_formula(text).molar_mass_g_per_mol == pytest.approx(theirs.mass, rel=1e-9)


@given(groups(), st.integers(1, 40))
def test_a_count_with_decimals_is_as_many_parts_of_the_whole(text: str, tenths: int) -> None:
    whole = parse_formula(f"({text}){tenths}").counts
    part = parse_formula(f"({text}){Decimal(tenths) / 10}").counts
    assert {element: 10 * count for element, count in part.items()} == whole
