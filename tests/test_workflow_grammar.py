"""The grammar of workflow files: what is read, and what is said of what cannot be."""

import random

import pytest
from conftest import REPOSITORY, problems_of
from hypothesis import given
from hypothesis import strategies as st

from scuhand_bt.problems import Problems, SourceError
from scuhand_bt.tree.grammar import read_workflow
from scuhand_bt.tree.workflow import Branch, Call, Decorator, Workflow, walk
from scuhand_bt.yaml_source import parse


def read(text: str, stem: str = "w") -> tuple[Workflow | None, list[str]]:
    problems = Problems()
    try:
        workflow = read_workflow(parse(text, "w.yaml", "a workflow"), stem, problems)
    except SourceError as error:
        return None, [str(problem) for problem in error.problems]
    return workflow, [f"{p.mark.line}:{p.mark.column}: {p.message}" for p in problems.found]


def said_of_tree(tree: str) -> list[str]:
    """Problems of a tree whose first character stands in line 2, column 7."""
    return read(f"workflow: w\ntree: {tree}\n")[1]


def test_every_composite_and_decorator_is_read() -> None:
    workflow, problems = read(
        """
workflow: w
summary: All of them.
inputs: {mass: Mass, n: {type: Integer, default: 3}}
result: $dose.error
tree:
  sequence:
    - fallback: [{a: }, {b: {x: $mass}}]
    - parallel: [{a: }, {b: }]
    - while: {guards: [{c: }], child: {a: }}
    - retry: {attempts: $n, on: [hand.cone_empty], child: {a: }}
    - retry: {attempts: 2, on: hand.cone_empty, child: {a: }}
    - timeout: {duration: 5 min, child: {a: }}
    - repeat: {times: 3, child: {a: }}
    - invert: {a: }
    - optional: {child: {d: {y: 5 mg, as: dose}}}
"""
    )
    assert problems == []
    assert workflow is not None
    kinds = [node.kind for node in walk(workflow.tree) if isinstance(node, Branch | Decorator)]
    assert kinds[1:] == ["fallback", "parallel", "while", "retry", "retry", "timeout", "repeat", "invert", "optional"]
    (last,) = [node for node in walk(workflow.tree) if isinstance(node, Call) and node.name == "d"]
    assert (last.result, list(last.arguments)) == ("dose", ["y"])
    assert str(workflow.result) == "$dose.error"


@pytest.mark.parametrize(
    ("tree", "said"),
    [
        ("{sequence: []}", "2:18: 'sequence' has an empty list; it takes a list of at least one node ('- …')"),
        ("{fallback: }", "'fallback' has nothing; it takes a list of at least one node"),
        ("{sequence: {a: }}", "2:18: 'sequence' has a mapping (key: value)"),
        ("{sequence: [park]}", "2:19: 'park' is not a node; write 'park:' (with the colon)"),
        ("{sequence: [{a: , b: }]}", "2:19: expected a node of the tree, found a mapping (key: value)"),
        ("{sequence: [{a: , b: }]}", "a node has one key; here are 2 keys"),
        ("{retry: {child: {a: }}}", "2:8: 'retry' needs 'attempts'"),
        ("{retry: {attempts: 3}}", "2:8: 'retry' needs 'child'; one node"),
        ("{retry: {attempts: 3, child: {a: }, codes: [x]}}", "unknown key 'codes'; known: attempts, child, on"),
        ("{retry: {attempts: 3, on: [], child: {a: }}}", "2:33: an empty list is not a failure code"),
        ("{retry: {attempts: 3, on: [{a: b}], child: {a: }}}", "is not a failure code; such as [hand.cone_empty]"),
        ("{retry: 3}", "2:15: 'retry' has '3'; it takes the keys attempts, on, child"),
        ("{timeout: {child: {a: }}}", "2:8: 'timeout' needs 'duration'"),
        ("{repeat: {child: {a: }}}", "2:8: 'repeat' needs 'times'"),
        ("{while: {child: {a: }}}", "2:8: 'while' needs 'guards'; a list of conditions"),
        ("{while: {guards: [], child: {a: }}}", "'guards' has an empty list"),
        ("{while: {guards: [{invert: {a: }}], child: {a: }}}", "'invert' cannot be a guard; a guard is a condition"),
        ("{invert: }", "2:16: expected a node of the tree, found nothing"),
        ("{optional: {a: , b: }}", "here are 2 keys"),
        ("{a: 5}", "2:11: 'a' has '5'; write its parameters: {name: value, …}"),
        ("{a: [1]}", "2:11: 'a' has a list"),
        ("{a: {x: $}}", "2:15: '$' cannot be calculated: '$' cannot be read; write $name, $name.attribute"),
        ("{a: {x: $b..c}}", "'$b..c' cannot be calculated: '..c' cannot be read"),
        ("{a: {as: $b}}", "2:16: 'as' must be a name, not '$b'; write a name for the result, without $"),
        ("{a: {as: [b]}}", "'as' must be a name, not a list"),
    ],
)
def test_what_is_no_tree_is_said_in_its_place(tree: str, said: str) -> None:
    problems = said_of_tree(tree)
    assert any(said in problem for problem in problems), problems


@pytest.mark.parametrize(
    ("head", "said"),
    [
        ("workflow: other", "1:11: the workflow 'other' is in w.yaml; call it 'w'"),
        ("summary: x", "1:1: 'workflow' is missing"),
        ("workflow: w\ninput: {}", "2:1: unknown key 'input'; known: inputs, result, summary, tree, workflow"),
        ("workflow: w\ninputs: [Mass]", "2:9: 'inputs' must be a mapping, not a list; write {name: Type, …}"),
        ("workflow: w\ninputs: {m: mass}", "2:13: 'mass' is not a type"),
        ("workflow: w\ninputs: {m: mass}", "did you mean 'Mass'?"),
        ("workflow: w\ninputs: {m: {default: 2 mg}}", "nothing is not a type"),
        ("workflow: w\ninputs: {m: {type: Mass, defualt: 2 mg}}", "did you mean 'default'?"),
        ("workflow: w\ninputs: {2m: Mass}", "2:10: '2m' is not a valid name"),
        ("workflow: w\ninputs: {id: Text}", "2:10: 'id' cannot be an input"),
        ("workflow: w\ninputs: {as: Text}", "2:10: 'as' cannot be an input"),
        ("workflow: w\ninputs: {mass: Number}", "2:16: 'mass' must be a Mass, not a Number"),
        ("workflow: w\ninputs: {tolerance: {type: Ratio}}", "'tolerance' must be a Mass, not a Ratio"),
        ("workflow: w\nresult: dose", "2:9: 'result' must be a value of this workflow, not 'dose'; write $name"),
        ("workflow: [w]", "1:11: 'workflow' must be a text, not a list"),
    ],
)
def test_what_is_wrong_with_the_head_is_said_in_its_place(head: str, said: str) -> None:
    problems = read(f"{head}\ntree: {{a: }}\n")[1]
    assert any(said in problem for problem in problems), problems


def test_a_workflow_without_a_tree_or_of_another_kind_is_refused() -> None:
    assert read("workflow: w\n")[1] == [
        "1:1: 'tree' is missing; a workflow has the keys workflow, summary, inputs, result, tree"
    ]
    assert "expected a workflow, found a list" in read("[a]")[1][0]


def test_all_problems_of_a_file_are_said_at_once() -> None:
    problems = said_of_tree("{sequence: [park, {retry: {child: {a: 5}}}, {a: {x: $}}, {fallback: []}]}")
    assert len(problems) == 5


BASE = (REPOSITORY / "trees" / "fill.yaml").read_text(encoding="utf-8")


@given(st.integers(0, 10**9))
def test_any_mutated_workflow_is_read_or_has_located_problems(seed: int) -> None:
    chance = random.Random(seed)
    text = list(BASE)
    for _ in range(chance.randint(1, 6)):
        at = chance.randrange(len(text))
        what = chance.choice(
            ["", "x", "\n", " ", ":", "{", "}", "[", "]", "5", "-", "~", "$", ".", "as", "while:", "*a"]
        )
        text[at : at + chance.randint(0, 5)] = what
    workflow, problems = read("".join(text), "fill")
    assert workflow is not None or problems


def test_the_shipped_workflows_have_no_problem() -> None:
    for path in (path for path in (REPOSITORY / "trees").glob("*.yaml") if ".test" not in path.name):
        assert problems_of(lambda path=path: parse(path.read_text(encoding="utf-8"), path.name, "a workflow")) == []
        assert read(path.read_text(encoding="utf-8"), path.stem)[1] == []
