"""YAML with positions: every value's place, and a located sentence for all that is no plain YAML."""

import os
import time
from pathlib import Path

import pytest
from conftest import problems_of
from hypothesis import given
from hypothesis import strategies as st

from scuhand_bt.problems import Mark
from scuhand_bt.yaml_source import Entries, Items, load, parse, plain


def said_of(text: str) -> str:
    (problem,) = problems_of(lambda: parse(text, "file.yaml", "a recipe"))
    return problem


def test_every_value_knows_its_line_and_column() -> None:
    root = parse("a: 1\nb:\n  - {c: xyz}\n", "file.yaml", "a recipe")
    assert isinstance(root, Entries)
    assert root.keys["b"] == Mark("file.yaml", 2, 1)
    items = root.values["b"]
    assert isinstance(items, Items)
    (entry,) = items
    assert isinstance(entry, Entries)
    assert entry.values["c"].mark == Mark("file.yaml", 3, 9)


def test_scalars_stay_text_whatever_they_look_like() -> None:
    text = "{id: 007, on: no, time: 12:30, empty: , tilde: ~, quoted: '', day: 2024-01-01}"
    assert plain(parse(text, "f", "w")) == {
        "id": "007",
        "on": "no",
        "time": "12:30",
        "empty": None,
        "tilde": None,
        "quoted": "",
        "day": "2024-01-01",
    }


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a:\n\t- b\n", "2:1: is not valid YAML: a tab; YAML is indented with spaces"),
        ("a: 'x\nb: 1\n", "1:4: is not valid YAML: a quote is not closed"),
        ("a: {b: 1\nc: 2\n", "2:2: is not valid YAML: a '}' or a ',' is missing"),
        ("a: b: c", "1:5: is not valid YAML: one ':' too many; check the indentation, or quote the text"),
        ("a: 1\nb: x\x07\n", "2:5: is not valid YAML: control characters are not allowed"),
        ("a: é\x00", "1:5: is not valid YAML: control characters are not allowed"),
        ("a: 1\na: 2\n", "2:1: the key 'a' is here a second time"),
        ("a: 1\n---\nb: 2\n", "2:1: a second document begins here; one file holds one document"),
        ("a: *b\n", "1:4: the alias *b has no anchor &b before it"),
        ("a: &b [*b]\n", "1:8: the alias *b is inside its own anchor"),
        ("a: !!python/object:os.system x", "is not accepted; write plain values"),
        ("? [a]\n: b\n", "1:3: a key must be one word"),
        ("# nothing\n", "1:1: is empty; expected a recipe"),
    ],
)
def test_what_is_no_plain_yaml_is_said_with_its_place(text: str, said: str) -> None:
    assert said in said_of(text)


@pytest.mark.parametrize(
    "text",
    [
        "[" * 1_000_000,
        "{a: " * 300_000,
        "- " * 100_000,
        "- &a0 [x]\n" + "".join(f"- &a{i} [*a{i - 1}]\n" for i in range(1, 900)),
        "a0: &a0 [x, x, x]\n" + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 40)),
        "x" + " x" * 900_000 + ": [",
    ],
    ids=["lists", "mappings", "dashes", "aliases in depth", "aliases in number", "a long key"],
)
def test_bombs_are_refused_at_once(text: str) -> None:
    began_s = time.process_time()
    said = said_of(text)
    assert time.process_time() - began_s < 1.0
    assert len(said) < 200


def test_an_alias_stands_for_its_anchor() -> None:
    assert plain(parse("a: &x {b: 1}\nc: *x\n", "f", "w")) == {"a": {"b": "1"}, "c": {"b": "1"}}


def test_files_that_are_no_yaml_files_get_one_line(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    contents = {
        "empty": b"",
        "blank": b" \n\n",
        "latin": b"a: 1\nb: \xe9\n",
        "utf16": "a: 1".encode("utf-16"),
        "binary": bytes(range(256)),
        "big": b"x" * 10_000_000,
    }
    for name, content in contents.items():
        (tmp_path / name).write_bytes(content)
    said = {
        name: problems_of(lambda name=name: load(tmp_path / name, "a recipe"))
        for name in (*contents, "folder", "pipe", "missing", "n" * 300, "nul\0", "empty/x")
    }
    assert all(len(problems) == 1 for problems in said.values()), said
    assert said["latin"] == ["2:4: is not UTF-8 text; save it as UTF-8 (Excel: 'CSV UTF-8')"]
    assert "directory" in said["folder"][0]
    assert "does not exist" in said["missing"][0]


def test_a_byte_order_mark_is_no_part_of_the_text(tmp_path: Path) -> None:
    (tmp_path / "f").write_bytes(b"\xef\xbb\xbfa: 1\n")
    assert plain(load(tmp_path / "f", "a recipe")) == {"a": "1"}


@given(st.text(alphabet=st.sampled_from("ab:-{}[],&*!|>'\"#%@`? \n\t~\u2028é\x07"), max_size=60))
def test_any_text_is_nodes_or_one_located_problem(text: str) -> None:
    found = problems_of(lambda: plain(parse(text, "f", "a recipe")))
    assert len(found) <= 1
    assert "\n" not in "".join(found)
