"""Tables of samples as spreadsheets write them."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scuhand_bt.problems import Mark, Problems
from scuhand_bt.recipe.table import read_table
from scuhand_bt.yaml_source import plain

ASKED = Mark("recipe.yaml", 7, 3)


def read(path: Path, content: str | bytes) -> tuple[list[dict[str, str]], list[str]]:
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    problems = Problems()
    rows = read_table(path, ASKED, problems)
    return [plain(row) for row in rows], [f"{p.mark.line}:{p.mark.column}: {p.message}" for p in problems.found]


ROWS = [{"id": "a", "mass": "50 mg"}, {"id": "b", "mass": "1.5 mg"}]


@pytest.mark.parametrize(
    "content",
    [
        "id,mass\na,50 mg\nb,1.5 mg\n",
        "id;mass\na;50 mg\nb;1,5 mg\n",
        "id\tmass\na\t50 mg\nb\t1,5 mg",
        "\ufeffid;mass\r\na;50 mg\r\nb;1,5 mg\r\n",
        '"id";"mass"\n"a";"50 mg"\n"b";"1,5 mg"\n',
        "id;mass [mg]\na;50\nb;1,5\n",
        "id;mass (mg)\n a ; 50 \n\n;;\nb;1.5 mg;\n",
        "\n\nid;mass\na;50 mg\n\nb;1.5 mg\n\n",
        "id;mass;\na;50 mg;\nb;1.5 mg;\n",
        "id;mass\ra;50 mg\rb;1,5 mg\r",
    ],
    ids=["comma", "semicolon", "tab", "Excel", "quoted", "unit", "blanks", "empty lines", "trailing", "old Mac"],
)
def test_a_table_reads_the_same_however_it_was_saved(tmp_path: Path, content: str) -> None:
    assert read(tmp_path / "t.csv", content) == (ROWS, [])


def test_a_unit_in_a_cell_goes_before_the_columns(tmp_path: Path) -> None:
    rows, _ = read(tmp_path / "t.csv", "id,mass [mg]\na,0.5 g\nb,5e2\n")
    assert [row["mass"] for row in rows] == ["0.5 g", "5e2 mg"]


@pytest.mark.parametrize(
    ("cells", "mass", "decimal"), [(("50,5", "1.000"), "1.000", ","), (("50.5", "1,000"), "1,000", ".")]
)
def test_what_may_be_a_thousand_or_one_is_not_guessed(
    tmp_path: Path, cells: tuple[str, str], mass: str, decimal: str
) -> None:
    rows, said = read(tmp_path / "t.csv", "id;mass [mg]\n1,5;{}\nb;{}\n".format(*cells))
    assert [row.get("mass") for row in rows] == ["50.5 mg", None]
    why = f"'{mass}' could mean thousands: this table's other numbers have '{decimal}' before decimals"
    assert said == [f"3:3: {why}; write it without a thousands separator"]


@pytest.mark.parametrize("cells", [("50,5", "0.125"), ("1.250", "1.000"), ("1.250", "1,000"), ("1,5", "1,000")])
def test_decimals_that_cannot_be_thousands_are_read_as_such(tmp_path: Path, cells: tuple[str, str]) -> None:
    rows, said = read(tmp_path / "t.csv", "id;mass [g]\na;{}\nb;{}\n".format(*cells))
    assert [row["mass"] for row in rows] == [f"{cell.replace(',', '.')} g" for cell in cells]
    assert said == []


def test_a_large_or_small_number_as_excel_shows_it_is_read_with_its_decimal_comma(tmp_path: Path) -> None:
    rows, said = read(tmp_path / "t.csv", "id;mass [g]\na;5,00E-02\nb;1,25E+00 g\n")
    assert (rows, said) == ([{"id": "a", "mass": "5.00E-02 g"}, {"id": "b", "mass": "1.25E+00 g"}], [])


def test_an_id_is_never_read_as_a_number(tmp_path: Path) -> None:
    rows, _ = read(tmp_path / "t.csv", "id;mass [mg]\n1,5;50,5\n")
    assert rows == [{"id": "1,5", "mass": "50.5 mg"}], "told by another name nobody would find it"


def test_a_table_whose_header_is_wrong_has_no_rows_that_could_lack_something(tmp_path: Path) -> None:
    assert read(tmp_path / "t.csv", "id;mass g\na;50\nb;60\n")[0] == []


def test_every_cell_knows_its_line_and_column(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text('id;note;mass\n\na;"x;""y""\nz";5 mg\nbb;5" dish;6 mg\n')
    rows = read_table(path, ASKED, Problems())
    places = [(row.values["mass"].mark.line, row.values["mass"].mark.column) for row in rows]
    assert places == [(4, 4), (5, 12)]
    assert rows[0].values["note"].mark == Mark(str(path), 3, 3)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("id,mass,id\na,1 mg,b\n", "1:9: the column 'id' is here a second time"),
        (
            "id,5 mg\na,1 mg\n",
            "1:4: '5 mg' is not a column name; write a name such as id, container, mass or mass [mg]",
        ),
        ("id,mass\na,1 mg,what\n", "2:8: 'what' is beyond the last column; the header has 2"),
        ("id,mass\n", "1:1: has no rows below its header"),
        (";;\n", "1:1: has no rows below its header"),
        ('id,mass\na,"1 mg\nb,2 mg\n', "2:1: is not valid CSV: unexpected end of data"),
        (b"id;mass\n\xe9;1 mg\n", "2:1: is not UTF-8 text; save it as UTF-8 (Excel: 'CSV UTF-8')"),
        ("id;mass\n".encode("utf-16"), "1:1: is not UTF-8 text; save it as UTF-8 (Excel: 'CSV UTF-8')"),
        ("id,mass\na," + "x" * 200_000, "2:1: is not valid CSV: field larger than field limit (131072)"),
    ],
)
def test_what_is_wrong_with_a_table_is_said_with_its_place(tmp_path: Path, content: str | bytes, said: str) -> None:
    assert said in read(tmp_path / "t.csv", content)[1]


def test_a_file_that_cannot_be_read_is_reported_where_it_is_asked_for(tmp_path: Path) -> None:
    for name in ("missing.csv", ".", "n" * 300, "nul\0"):
        problems = Problems()
        assert read_table(tmp_path / name, ASKED, problems) == []
        assert [problem.mark for problem in problems.found] == [ASKED]


def test_odd_line_separators_within_a_cell_are_no_line_ends(tmp_path: Path) -> None:
    rows, problems = read(tmp_path / "t.csv", "id,note\na,x\u2028y\x0bz\nb,w\n")
    assert problems == []
    assert [row["id"] for row in rows] == ["a", "b"]


def test_a_header_of_blanks_does_not_take_for_ever(tmp_path: Path) -> None:
    _, problems = read(tmp_path / "t.csv", "mass [" + " " * 100_000 + "\n1\n")
    assert problems


@given(st.text(alphabet='a1;,\t "\r\n\x00é', max_size=60))
def test_any_text_is_rows_or_located_problems(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    path = tmp_path_factory.getbasetemp() / "any.csv"
    rows, problems = read(path, "id;mass\n" + text)
    assert rows or problems
