"""A workflow that does not dose what its sample asks is refused before anything moves, where that is written."""

from collections.abc import Sequence

import pytest
from conftest import Desk, LabFolder

from scuhand_bt.problems import Problem
from scuhand_bt.run.checking import check

RECIPE = """\
recipe: asked
workflow: mine
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 20 g}
  msg: {station: mortar_bay_2, container: small_agate_mortar, powder: monosodium_glutamate, amount: 8 g}
samples:
"""
INPUTS = "source: Source, container: Container, mass: Mass, tolerance: Mass"
FILL = "fill: {source: $source, container: $container, mass: $mass, tolerance: $tolerance}"
PLACE = "place_container: {container: $container}"
NOTHING = "1:1: sample 'a' asks for 50 mg, but 'mine' doses nothing into its container; let it dispense $mass there"
SAMPLE = "id: a, source: beads, container: xrd_holder, mass: 50 mg, tolerance: 2 mg"


def into(container: str, mass: str, source: str = "source") -> str:
    return FILL.replace("$container", f"${container}").replace("$mass", mass).replace("$source", f"${source}")


def said(
    desk: Desk, lab: LabFolder, *steps: str, inputs: str = INPUTS, samples: tuple[str, ...] = (SAMPLE,)
) -> list[str]:
    """The problems of samples whose workflow is these steps, the first of them in line 5, column 7."""
    tree = "\n".join(f"    - {step}" for step in steps)
    lab.write("trees/mine.yaml", f"workflow: mine\ninputs: {{{inputs}}}\ntree:\n  sequence:\n{tree}\n")
    desk.lab = lab.load()
    return desk.problems(RECIPE + "".join(f"  - {{{sample}}}\n" for sample in samples))


@pytest.mark.parametrize(
    "steps",
    [
        [PLACE, FILL],
        [PLACE, "timeout: {duration: 1 h, child: {" + FILL + "}}"],
        # what comes before the asked mass into the same container counts towards it
        [PLACE, FILL.replace("$mass", "20 mg"), FILL],
        [PLACE, "repeat: {times: 2, child: {" + FILL.replace("$mass", "20 mg") + "}}", "optional: {" + FILL + "}"],
        [PLACE, FILL.replace("$tolerance", "1 %")],
        [PLACE, FILL.replace("$tolerance", "20 mg"), FILL],
        # told only in the run
        [PLACE, "tare: {as: gross}", FILL.replace("$mass", "$gross")],
        # on some way it is as asked
        [PLACE, "fallback: [{" + FILL.replace("$mass", "25 mg") + "}, {" + FILL + "}]"],
        [PLACE, "fallback: [{" + FILL + "}, {" + FILL.replace("$mass", "25 mg") + "}]"],
        [PLACE, FILL, "optional: {" + FILL.replace("$mass", "60 mg") + "}"],
        ["fallback: [{sequence: [{" + PLACE + "}, {discard: }]}, {dispense: {mass: $mass, tolerance: $tolerance}}]"],
    ],
)
def test_a_workflow_that_can_dose_what_is_asked_is_not_refused(
    desk: Desk, lab_folder: LabFolder, steps: list[str]
) -> None:
    assert said(desk, lab_folder, *steps) == []


@pytest.mark.parametrize(
    ("steps", "expected"),
    [
        (
            [PLACE, FILL.replace("$mass", "25 mg")],
            ["6:60: sample 'a' asks for 50 mg, but no dose has that mass; this one has 25 mg; write $mass"],
        ),
        (
            [PLACE, "fallback: [{park: }, {" + FILL.replace("$mass", "25 mg") + "}]"],
            ["6:82: sample 'a' asks for 50 mg, but no dose has that mass; this one has 25 mg; write $mass"],
        ),
        (
            [PLACE, FILL, FILL.replace("$mass", "60 mg")],
            ["7:60: sample 'a' asks for 50 mg, but no dose has that mass; this one has 60 mg; write $mass"],
        ),
        (
            [PLACE, "scoop: {source: $source}"],
            [NOTHING],
        ),
        (
            [PLACE, FILL.replace("$tolerance", "5 mg")],
            ["6:78: sample 'a' asks for a tolerance of 2 mg, but this dose has one of 5 mg; write $tolerance"],
        ),
        (
            [PLACE, FILL.replace("$tolerance", "10 %")],
            ["6:78: sample 'a' asks for a tolerance of 2 mg, but this dose has one of 5 mg; write $tolerance"],
        ),
        (
            [PLACE, "scoop: {source: $source}", "dispense: {mass: $mass, tolerance: $mass}"],
            ["7:42: sample 'a' asks for a tolerance of 2 mg, but this dose has one of 50 mg; write $tolerance"],
        ),
    ],
)
def test_another_mass_and_a_wider_tolerance_are_refused_where_they_are_written(
    desk: Desk, lab_folder: LabFolder, steps: list[str], expected: list[str]
) -> None:
    assert said(desk, lab_folder, *steps) == expected


@pytest.mark.parametrize("step", [FILL, "dispense: {mass: $mass, tolerance: $tolerance}"])
def test_a_tolerance_that_is_not_passed_on_is_the_callees_own_and_refused_at_the_call(
    desk: Desk, lab_folder: LabFolder, step: str
) -> None:
    tight = SAMPLE.replace("tolerance: 2 mg", "tolerance: 1 mg")
    (problem,) = said(desk, lab_folder, PLACE, step.replace(", tolerance: $tolerance", ""), samples=(tight,))
    assert problem == "6:7: sample 'a' asks for a tolerance of 1 mg, but this dose has one of 2 mg; write $tolerance"


CHOOSE = """
from scuhand_bt.skill import Cell, Container, Skill, Steps


class Choose(Skill[Container]):
    \"\"\"Choose a container.\"\"\"

    one: Container
    other: Container

    def run(self, cell: Cell) -> Steps[Container]:
        yield from ()
        return self.one
"""


def test_what_only_the_run_can_tell_is_not_refused(desk: Desk, lab_folder: LabFolder) -> None:
    tight = SAMPLE.replace("tolerance: 2 mg", "tolerance: 1 mg")
    steps = (PLACE, "tare: {as: gross}", FILL.replace("$tolerance", "$gross"))
    assert said(desk, lab_folder, *steps, samples=(tight,)) == []
    lab_folder.write("skills/choose.py", CHOOSE)
    inputs, sample = f"waste: Container, {INPUTS}", f"{SAMPLE}, waste: xrd_holder"
    steps = ("choose: {one: $container, other: $waste, as: chosen}", into("chosen", "$mass"), into("chosen", "5 mg"))
    assert said(desk, lab_folder, *steps, inputs=inputs, samples=(sample,)) == []
    assert said(desk, lab_folder, steps[0], steps[2], inputs=inputs, samples=(sample,)) != []


def test_the_place_is_that_of_the_literal_whatever_workflows_it_goes_through(desk: Desk, lab_folder: LabFolder) -> None:
    inner = "workflow: inner\ninputs: {s: Source, c: Container, much: Mass, near: {type: Mass, default: 1 mg}}\ntree:\n"
    inner += "  fill: {source: $s, container: $c, mass: $much, tolerance: $near}\n"
    lab_folder.write("trees/inner.yaml", inner)
    call = "inner: {s: $source, c: $container, much: $mass}"
    assert said(desk, lab_folder, PLACE, call) == []
    (problem,) = said(desk, lab_folder, PLACE, call.replace("$mass", "25 mg"))
    assert problem.startswith("6:48: sample 'a' asks for 50 mg, but no dose has that mass")
    (problem,) = said(desk, lab_folder, PLACE, call.replace("}", ", near: 3 mg}"))
    assert problem.startswith("6:61: sample 'a' asks for a tolerance of 2 mg, but this dose has one of 3 mg")
    lab_folder.write("trees/inner.yaml", inner.replace("mass: $much", "mass: $s.amount"))
    found = said(desk, lab_folder, PLACE, call)
    assert "does not fit into 'xrd_holder'" in found[-1]
    problem = found[0]
    assert problem.startswith("4:43: sample 'a' asks for 50 mg, but no dose has that mass; this one has 20000 mg")


def test_a_result_cannot_take_the_name_of_an_input(desk: Desk, lab_folder: LabFolder) -> None:
    assert said(desk, lab_folder, PLACE, "tare: {as: mass}", FILL) == [
        "6:18: 'mass' is an input of this workflow, which cannot be set again; give the result another name"
    ]


TWO = "source: Source, msg: Source, first: Container, second: Container, mass: Mass, salt: Mass, tolerance: Mass"
BOTH = (
    "id: a, source: beads, msg: msg, first: xrd_holder, second: xrd_holder, mass: 50 mg, salt: 30 mg, tolerance: 2 mg"
)


@pytest.mark.parametrize(
    "steps",
    [
        [into("first", "$mass"), into("first", "$salt", "msg")],
        [into("first", "$salt", "msg"), into("first", "$mass"), into("second", "$salt", "msg")],
        [into("first", "5 mg"), into("second", "$mass")],
        [into("second", "$mass"), into("first", "5 mg")],
    ],
)
def test_each_powder_and_each_container_may_have_a_mass_of_its_own(
    desk: Desk, lab_folder: LabFolder, steps: list[str]
) -> None:
    assert said(desk, lab_folder, *steps, inputs=TWO, samples=(BOTH,)) == []


@pytest.mark.parametrize("second", [into("second", "$salt"), into("first", "$salt", "msg")])
def test_parts_that_only_add_up_to_what_is_asked_are_refused(desk: Desk, lab_folder: LabFolder, second: str) -> None:
    found = said(desk, lab_folder, into("first", "20 mg"), second, inputs=TWO, samples=(BOTH,))
    assert [problem.split("; ")[1] for problem in found] == ["this one has 20 mg", "this one has 30 mg"]


def test_what_goes_into_another_container_than_the_samples_own_is_not_what_it_asks(
    desk: Desk, lab_folder: LabFolder
) -> None:
    inputs, sample = f"waste: Container, {INPUTS}", f"{SAMPLE}, waste: xrd_holder"
    assert said(desk, lab_folder, into("waste", "$mass"), inputs=inputs, samples=(sample,)) == [NOTHING]
    assert said(desk, lab_folder, into("waste", "5 mg"), FILL, inputs=inputs, samples=(sample,)) == []
    assert said(desk, lab_folder, "scoop: {source: $source}", "dispense: {mass: $mass}") == [NOTHING]


def test_a_sample_must_fit_into_its_own_container_whatever_else_is_named_before_it(
    desk: Desk, lab_folder: LabFolder
) -> None:
    inputs, sample = f"waste: Container, {INPUTS}", f"waste: alumina_crucible, {SAMPLE.replace('50 mg', '900 mg')}"
    (problem,) = said(desk, lab_folder, PLACE, FILL, inputs=inputs, samples=(sample,))
    assert "does not fit into 'xrd_holder'" in problem


def test_one_place_that_is_wrong_for_many_samples_is_said_once(desk: Desk, lab_folder: LabFolder) -> None:
    samples = tuple(SAMPLE.replace("id: a", f"id: {name}") for name in "abc")
    (problem,) = said(desk, lab_folder, PLACE, FILL.replace("$mass", "25 mg"), samples=samples)
    assert "no dose has that mass; this one has 25 mg (and 2 more samples like it); write $mass" in problem


MIX_TREE = """\
workflow: mix
inputs: {first: Source, second: Source, into: Container, mass: Mass, ratio: Ratio}
tree: {sequence: [
  fill: {source: $first, container: $into, mass: $mass, as: one},
  swap_sheet: ,
  fill: {source: $second, container: $into, mass: %s}]}
"""


@pytest.mark.parametrize(
    ("second", "mass", "found"),
    [
        ("beads", "$ratio * $one.dispensed", ["warning"]),
        ("beads", "2 * $ratio * $one.dispensed", ["warning"]),
        ("beads", "$ratio * $mass", ["warning", "error"]),
        ("beads", "2 * $ratio * $mass", ["warning"]),
        ("msg", "2 * $ratio * $one.dispensed", []),
    ],
)
def test_a_dose_that_is_asked_for_and_another_of_its_lot_behind_it_are_one(
    lab_folder: LabFolder, second: str, mass: str, found: list[str]
) -> None:
    """A mixture of a lot with itself overshot by all that was there, or had its second mass alone in its row."""
    lab_folder.write("trees/mix.yaml", MIX_TREE % mass)
    sample = "id: a, first: beads, into: alumina_crucible, mass: 50 mg, ratio: 50 %"
    recipe = lab_folder.write("recipes/r.yaml", f"{RECIPE.replace('mine', 'mix')}  - {{{sample}, second: {second}}}\n")
    problems = [
        one for one in check(lab_folder.load(), recipe, fast=True).problems if one.code in ("not-asked", "lot-twice")
    ]
    assert ["warning" if one.is_warning else "error" for one in problems] == found
    for one in problems:
        assert one.mark.line == 6
        if "dispensed" in mass:
            assert (
                "this later dose puts the same lot into the same container: it only adds what is missing" in one.message
            )


AGAIN = FILL.replace("$mass", "$gross")


def problems_of_two_containers(lab_folder: LabFolder, steps: list[str]) -> Sequence[Problem]:
    """What `check` says of a sample with containers `one`, placed and tared before these steps, and `other`."""
    tree = "\n".join(f"    - {step}" for step in (PLACE, "tare: {as: gross}", *steps)).replace("$container", "$one")
    inputs = f"{INPUTS.replace('container', 'one')}, other: Container"
    lab_folder.write("trees/mine.yaml", f"workflow: mine\ninputs: {{{inputs}}}\ntree:\n  sequence:\n{tree}\n")
    sample = f"{SAMPLE.replace('container:', 'one:')}, other: vial_11mm"
    recipe = lab_folder.write("recipes/r.yaml", f"{RECIPE}  - {{{sample}}}\n")
    return check(lab_folder.load(), recipe, fast=True).problems


@pytest.mark.parametrize(
    ("steps", "is_warned"),
    [
        ([AGAIN], False),
        ([FILL, AGAIN], True),
        ([AGAIN, FILL], False),
        (["fallback: [{" + FILL + "}, {" + AGAIN + "}]"], False),
        ([FILL, "optional: {" + AGAIN + "}"], False),
        (["if: {when: $gross > 1 g, then: {" + FILL + "}, else: {" + AGAIN + "}}"], False),
        ([FILL, AGAIN.replace("$container", "$other")], False),
        ([into("one", "$mass"), into("one", "60 mg"), into("other", "$gross")], False),
    ],
)
def test_only_a_dose_that_always_comes_behind_the_asked_one_is_warned_of(
    lab_folder: LabFolder, steps: list[str], is_warned: bool
) -> None:
    problems = problems_of_two_containers(lab_folder, steps)
    assert not [one for one in problems if not one.is_warning]
    assert [one.mark.line for one in problems if one.code == "lot-twice"] == ([8] if is_warned else [])


@pytest.mark.parametrize(
    ("steps", "lines"),
    [
        ([into("one", "$mass"), into("one", "$mass")], [8]),
        ([into("one", "$mass"), into("other", "$mass"), into("one", "$mass")], [9]),
        ([into("one", "20 mg"), into("one", "$mass")], []),
        ([into("one", "$mass").replace("$tolerance", "9 mg"), into("one", "$mass")], []),
        (["optional: {" + into("one", "$mass") + "}", into("one", "$mass")], []),
        (["fallback: [{" + into("one", "$mass") + "}, {" + into("one", "$mass") + "}]"], []),
        (["repeat: {times: 2, child: {" + into("one", "$mass") + "}}"], [7]),
        (["repeat: {times: 1, child: {" + into("one", "$mass") + "}}"], []),
        (["repeat: {times: 2, child: {optional: {" + into("one", "$mass") + "}}}"], []),
        (["repeat: {times: 2, child: {" + into("one", "min($gross, $mass)") + "}}", into("one", "$mass")], []),
    ],
)
def test_a_dose_whose_mass_is_there_already_is_warned_of(
    lab_folder: LabFolder, steps: list[str], lines: list[int]
) -> None:
    """Two powders in turns were dosed once each: of a lot a container has what its last dose says, in all."""
    problems = problems_of_two_containers(lab_folder, steps)
    assert [one.mark.line for one in problems if one.code == "lot-twice"] == lines


def test_a_sample_that_asks_no_mass_is_dosed_as_its_workflow_says(desk: Desk, lab_folder: LabFolder) -> None:
    steps = [PLACE, FILL.replace("$mass", "25 mg").replace("$tolerance", "9 mg")]
    inputs, sample = INPUTS.replace("mass: Mass, ", ""), SAMPLE.replace("mass: 50 mg, ", "")
    assert said(desk, lab_folder, *steps, inputs=inputs, samples=(sample,)) == []
