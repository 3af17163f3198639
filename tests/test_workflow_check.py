"""The static check of workflows: every wire, every name, every device, before anything runs."""

import random
from typing import Any, Literal

import pytest
from conftest import REPOSITORY
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from scuhand_bt.lab import Lab
from scuhand_bt.problems import Problems, SourceError
from scuhand_bt.skill import (
    Condition,
    Container,
    Degrees,
    Dose,
    Milligrams,
    Powder,
    Ratio,
    Seconds,
    Skill,
    Source,
    Steps,
)
from scuhand_bt.tree.check import check_workflows
from scuhand_bt.tree.grammar import read_workflow
from scuhand_bt.tree.library import Library
from scuhand_bt.yaml_source import parse


class Base(Skill[None]):
    """For the tests: does nothing."""

    def run(self, cell: Any) -> Steps[None]:
        return
        yield


class Weigh(Skill[Milligrams]):
    """Give a mass."""

    devices = ("balance",)

    def run(self, cell: Any) -> Steps[float]:
        return 1.0
        yield


class Fill(Skill[Dose]):
    """Give a dose."""

    devices = ("hand", "balance")
    mass_mg: Milligrams
    tolerance_mg: Milligrams = 2.0

    def run(self, cell: Any) -> Steps[Dose]:
        raise NotImplementedError
        yield


class Maybe(Skill[Dose | None]):
    """Give a dose, or nothing."""

    def run(self, cell: Any) -> Steps[Dose | None]:
        return None
        yield


class Move(Base):
    """Command the arm."""

    devices = ("arm",)


class Swing(Base):
    """Command the changer, in the zone that the cell describes."""

    devices = ("changer",)
    zones = ("pan",)


class Over(Base):
    """Command the hand in the same zone."""

    devices = ("hand",)
    zones = ("pan",)


class Beside(Base):
    """Command the changer in a zone that the cell does not describe."""

    devices = ("changer",)
    zones = ("bench",)


class Anywhere(Base):
    """Command the changer in no zone."""

    devices = ("changer",)


class Go(Base):
    """Take one value of every type."""

    mass_mg: Milligrams = 0.0
    duration_s: Seconds = 0.0
    angle_deg: Degrees = 0.0
    share_ratio: Ratio = 0.0
    count: int = 0
    factor: float = 0.0
    word: str = ""
    flag: bool = False
    mode: Literal["fast", "slow"] = "fast"
    powder: Powder | None = None
    source: Source | None = None
    container: Container | None = None
    steps: tuple[int, ...] = ()


class Calm(Condition):
    """A condition."""

    def check(self, cell: Any) -> None:
        pass


SKILLS = {
    "weigh": Weigh,
    "fill": Fill,
    "maybe": Maybe,
    "move": Move,
    "swing": Swing,
    "over": Over,
    "beside": Beside,
    "anywhere": Anywhere,
    "go": Go,
    "calm": Calm,
}


def said(starter: Lab, tree: str, head: str = "", **others: str) -> list[str]:
    """Problems of a tree that begins in line 2, column 7 (after one more line for a `head`)."""
    texts = {"main": f"workflow: main\n{head}tree: {tree}\n", **others}
    problems = Problems()
    workflows = {name: read_workflow(parse(text, f"{name}.yaml", "w"), name, problems) for name, text in texts.items()}
    library = Library(SKILLS, {k: w for k, w in workflows.items() if w}, starter.library.powders, zones=("pan",))
    if "main" in library.workflows:
        check_workflows(library, ["main"], problems)
    return [f"{p.mark.line}:{p.mark.column}: {p.message}" for p in SourceError(problems.found).problems]


@pytest.mark.parametrize(
    "tree",
    [
        "{sequence: [{weigh: {as: m}}, {fill: {mass: $m}}]}",
        "{sequence: [{parallel: [{swing: }, {move: }]}, {parallel: [{beside: }, {weigh: }]}]}",
        "{sequence: [{fill: {mass: 50 mg, tolerance: 1 %, as: d}}, {go: {mass: $d.error, factor: $d.pulses}}]}",
        "{go: {mass: 5 g, duration: 2 h, angle: 3 deg, share: 5 %, count: 3, factor: 1.5, word: hi, flag: yes}}",
        "{go: {mode: slow, powder: glass_beads, source: ~, steps: [1, 2]}}",
        "{fallback: [{weigh: {as: m}}, {weigh: {as: m}}]}",
        "{sequence: [{fallback: [{weigh: {as: m}}, {weigh: {as: m}}]}, {fill: {mass: $m}}]}",
        "{sequence: [{parallel: [{weigh: {as: m}}, {move: }]}, {fill: {mass: $m}}]}",
        "{parallel: [{sequence: [{weigh: {as: m}}, {if: {when: $m > 1 g, then: {weigh: }}}]}, {move: }]}",
        "{sequence: [{weigh: {as: m}}, {parallel: [{if: {when: $m > 1 g, then: {weigh: {as: n}}}}, {move: }]}]}",
        "{sequence: [{retry: {attempts: 3, child: {weigh: {as: m}}}}, {fill: {mass: $m}}]}",
        "{while: {guards: [{calm: }], child: {move: }}}",
        "{retry: {attempts: 2, on: [hand.cone_empty, workflow.timeout], child: {move: }}}",
    ],
)
def test_what_fits_together_has_no_problem(starter: Lab, tree: str) -> None:
    assert said(starter, tree) == []


@pytest.mark.parametrize(
    ("tree", "expected"),
    [
        ("{mov: }", "2:8: unknown skill or workflow 'mov'"),
        ("{mov: }", "did you mean 'move'?"),
        ("{fill: {mas: 5 mg}}", "2:15: 'fill' has no parameter 'mas'; it takes mass, tolerance; did you mean 'mass'?"),
        ("{fill: }", "2:8: 'fill' needs 'mass' (Mass)"),
        ("{fill: {mass: 5 mm}}", "2:21: 'mass' takes a Mass: 'mm' is a unit of length, not of mass"),
        ("{fill: {mass: 5}}", "'5' has no unit"),
        ("{fill: {mass: 5 mg, tolerance: 0 %}}", "'0 %' is not a tolerance"),
        ("{go: {tolerance: 1 %}}", "'go' has no parameter 'tolerance'"),
        ("{go: {count: 1.5}}", "'count' takes a Integer"),
        ("{go: {factor: nan}}", "'factor' takes a Number"),
        ("{go: {flag: perhaps}}", "'flag' takes a Flag"),
        ("{go: {mode: medium}}", "'mode' takes a Text"),
        ("{go: {powder: glass_bead}}", "did you mean 'glass_beads'?"),
        ("{go: {source: mortar}}", "cannot be a Source; wire it from an input, as $source"),
        ("{go: {mass: $m}}", "2:19: unknown value '$m'"),
        ("{sequence: [{weigh: {as: mass}}, {go: {mass: $mas}}]}", "did you mean '$mass'?"),
        ("{sequence: [{weigh: {as: m}}, {go: {duration: $m}}]}", "'duration' takes a Duration, but $m is a Mass"),
        ("{sequence: [{fill: {mass: 1 g, as: d}}, {go: {mass: $d}}]}", "'mass' takes a Mass, but $d is a Dose"),
        ("{sequence: [{fill: {mass: 1 g, as: d}}, {go: {mass: $d.eror}}]}", "a Dose has no attribute 'eror'"),
        ("{sequence: [{fill: {mass: 1 g, as: d}}, {go: {mass: $d.error.x}}]}", "a Mass has no attribute 'x'"),
        (
            "{sequence: [{maybe: {as: d}}, {go: {mass: $d.error}}]}",
            "$d.error reads 'error' of a value that may be nothing",
        ),
        ("{sequence: [{go: {mass: $m}}, {weigh: {as: m}}]}", "unknown value '$m'"),
        ("{sequence: [{optional: {weigh: {as: m}}}, {go: {mass: $m}}]}", "'$m' may have no value here"),
        ("{sequence: [{fallback: [{weigh: {as: m}}, {move: }]}, {go: {mass: $m}}]}", "'$m' may have no value here"),
        ("{fallback: [{weigh: {as: m}}, {go: {mass: $m}}]}", "'$m' may have no value here"),
        ("{move: {as: m}}", "2:19: 'move' has no result to keep as 'm'"),
        (
            "{sequence: [{weigh: {as: m}}, {fill: {mass: 1 g, as: m}}]}",
            "'m' is already a Mass, and cannot become a Dose",
        ),
        ("{retry: {attempts: 0, child: {move: }}}", "2:26: 'attempts' is 0; more than 0"),
        ("{retry: {attempts: two, child: {move: }}}", "'attempts' takes a Integer"),
        ("{repeat: {times: -1, child: {move: }}}", "'times' is -1; more than 0"),
        ("{timeout: {duration: 5 mg, child: {move: }}}", "'duration' takes a Duration"),
        ("{timeout: {duration: 0 s, child: {move: }}}", "'duration' is 0; more than 0"),
        ("{retry: {attempts: 2, on: [hand.cone_emty], child: {move: }}}", "did you mean 'hand.cone_empty'?"),
        (
            "{while: {guards: [{move: }], child: {move: }}}",
            "'move' is not a condition, and cannot be a guard; known: calm",
        ),
        ("{parallel: [{move: }, {move: }]}", "2:30: children 1 and 2 of 'parallel' both command the arm"),
        ("{parallel: [{swing: }, {over: }]}", "2:31: children 1 and 2 of 'parallel' both move in the zone 'pan'"),
        ("{parallel: [{beside: }, {move: }]}", "2:20: this moves in the zone 'bench' while the arm moves"),
        (
            "{parallel: [{move: }, {optional: {child: {anywhere: }}}]}",
            "2:30: 'anywhere' commands the changer while the arm moves, but leases no zone",
        ),
        ("{parallel: [{weigh: }, {retry: {attempts: 2, child: {fill: {mass: 1 g}}}}]}", "both command the balance"),
        (
            "{parallel: [{weigh: {as: m}}, {optional: {child: {weigh: {as: m}}}}]}",
            "2:69: children 1 and 2 of 'parallel' both set '$m'",
        ),
        (
            "{sequence: [{weigh: {as: m}}, {parallel: [{if: {when: $m > 1 g, then: {move: }}}, {weigh: {as: m}}]}]}",
            "2:61: child 1 of 'parallel' reads '$m', which child 2 sets; which comes first is not known",
        ),
        (
            "{sequence: [{weigh: {as: m}}, {parallel: [{weigh: {as: m}}, {if: {when: $m > 1 g, then: {move: }}}]}]}",
            "child 2 of 'parallel' reads '$m', which child 1 sets",
        ),
    ],
)
def test_what_does_not_fit_is_said_in_its_place(starter: Lab, tree: str, expected: str) -> None:
    problems = said(starter, tree)
    assert any(expected in problem for problem in problems), problems


def test_an_unknown_skill_is_not_followed_by_complaints_about_its_result(starter: Lab) -> None:
    assert len(said(starter, "{sequence: [{fil: {mass: 1 g, as: d}}, {go: {mass: $d.error}}]}")) == 1
    assert len(said(starter, "{sequence: [{move: {as: d}}, {go: {mass: $d}}]}")) == 1


def test_a_tolerance_in_percent_needs_a_mass_beside_it(starter: Lab) -> None:
    inner = "workflow: inner\ninputs: {tolerance: Mass}\ntree: {move: }\n"
    (problem,) = said(starter, "{inner: {tolerance: 1 %}}", inner=inner)
    assert problem.startswith("2:27: a tolerance in % needs a mass, but 'inner' is given no 'mass' here")
    (problem,) = said(starter, "{move: }", head="inputs: {tolerance: {type: Mass, default: 1 %}}\n")
    assert problem.startswith("2:43: a tolerance in % needs a mass, but this workflow has no input 'mass'")


def test_inputs_and_results_of_nested_workflows_are_checked(starter: Lab) -> None:
    inputs = "inputs: {m: Mass, n: {type: Integer, default: 2}}"
    inner = f"workflow: inner\n{inputs}\nresult: $d\ntree: {{fill: {{mass: $m, as: d}}}}\n"
    assert said(starter, "{sequence: [{inner: {m: 5 mg, as: d}}, {go: {mass: $d.dispensed}}]}", inner=inner) == []
    assert "'inner' needs 'm' (Mass)" in said(starter, "{inner: }", inner=inner)[0]
    assert "'n' takes a Integer" in said(starter, "{inner: {m: 1 g, n: x}}", inner=inner)[0]
    assert (
        "'m' takes a Mass, but $d is a Dose"
        in said(starter, "{sequence: [{inner: {m: 1 g, as: d}}, {inner: {m: $d}}]}", inner=inner)[0]
    )


def test_a_wrong_default_and_a_wrong_result_are_said(starter: Lab) -> None:
    assert "2:35: 'm' takes a Mass" in said(starter, "{move: }", head="inputs: {m: {type: Mass, default: 2 mm}}\n")[0]
    assert "2:9: unknown value '$d'" in said(starter, "{move: }", head="result: $d\n")[0]
    tree = "{optional: {weigh: {as: d}}}"
    assert "'$d' may have no value here" in said(starter, tree, head="result: $d\n")[0]


def test_workflows_must_not_call_each_other_in_a_circle(starter: Lab) -> None:
    assert "2:8: workflows call each other in a circle: main → main" in said(starter, "{main: }")[0]
    a = "workflow: a\ntree: {sequence: [{move: }, {main: }]}\n"
    (problem,) = said(starter, "{parallel: [{a: }]}", a=a)
    assert problem == "2:30: workflows call each other in a circle: main → a → main"


def test_workflows_that_double_each_other_are_refused_at_once(starter: Lab) -> None:
    others = {f"w{i}": f"workflow: w{i}\ntree: {{parallel: [{{w{i + 1}: }}, {{w{i + 1}: }}]}}\n" for i in range(40)}
    problems = said(starter, "{w0: }", w40="workflow: w40\ntree: {go: }\n", **others)
    assert "has more than 5000 nodes" in problems[0]


@pytest.mark.parametrize(
    ("one", "other", "is_told"),
    [
        ("record: {net: 1 g}", "deep: ", True),
        ("repeat: {times: 2, child: {record: {net: a}}}", "repeat: {times: 3, child: {deep: }}", True),
        ("repeat: {times: 2, child: {record: {net: a}}}", "deep: ", False),
        ("record: {gross: 1 g}", "deep: ", False),
    ],
)
def test_two_children_of_a_parallel_that_record_one_name_are_told(
    starter: Lab, one: str, other: str, is_told: bool
) -> None:
    """The sample's row has the value that came last, and which that was the run told by chance."""
    deep = "workflow: deep\ntree: {sequence: [{record: {net: b}}]}\n"
    problems = said(starter, f"{{parallel: [{{{one}}}, {{{other}}}]}}", deep=deep)
    told = [problem for problem in problems if "both record" in problem]
    assert len(told) == is_told
    assert all(
        problem.startswith("2:") and "children 1 and 2 of 'parallel' both record 'net'" in problem for problem in told
    )


def test_parallel_over_one_device_is_seen_through_nested_workflows(starter: Lab) -> None:
    deep = "workflow: deep\ntree: {invert: {move: }}\n"
    a = "workflow: a\ntree: {sequence: [{weigh: }, {deep: }]}\n"
    (problem,) = said(starter, "{parallel: [{move: }, {a: }]}", a=a, deep=deep)
    assert "children 1 and 2 of 'parallel' both command the arm" in problem


def test_all_problems_are_said_at_once(starter: Lab) -> None:
    problems = said(
        starter,
        "{sequence: [{mov: }, {fill: {mas: 1 g}}, {go: {mass: $x, count: y}}, {parallel: [{move: }, {move: }]}]}",
    )
    assert len(problems) == 6


def test_the_shipped_workflows_pass(starter: Lab) -> None:
    problems = Problems()
    check_workflows(starter.library, starter.library.workflows, problems)
    assert problems.found == []


BASE = (REPOSITORY / "trees" / "fill.yaml").read_text(encoding="utf-8")


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(st.integers(0, 10**9))
def test_any_mutated_workflow_passes_or_has_located_problems(starter: Lab, seed: int) -> None:
    chance = random.Random(seed)
    words = BASE.replace("\n", " \n ").split(" ")
    for _ in range(chance.randint(1, 3)):
        words[chance.randrange(len(words))] = chance.choice(
            ["x:", "$x", "$source", "$mass.a", "5 mg", "fill:", "park:", "1 %", "{}"]
        )
    problems = Problems()
    try:
        workflow = read_workflow(parse(" ".join(words), "fill.yaml", "w"), "fill", problems)
    except SourceError:
        return
    if workflow is not None:
        library = Library(
            starter.library.skills, {**starter.library.workflows, "fill": workflow}, starter.library.powders
        )
        check_workflows(library, ["fill", "fill_crucible"], problems)
