"""What samples dose is told alike of each, though those that are alike are followed once."""

import pytest
from conftest import LabFolder

from scuhand_bt.problems import Problems, SourceError
from scuhand_bt.recipe import flows
from scuhand_bt.recipe.flow import flow_of
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.report.doses import asked_cells, asked_mg

RECIPE = """recipe: mixtures
workflow: {workflow}
order: as_written
sources:
  beads: {{station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 30 g}}
  msg:   {{station: mortar_bay_2, container: agate_mortar, powder: monosodium_glutamate, amount: 30 g}}
defaults: {{first: beads, second: msg, container: alumina_crucible, tolerance: 5 mg}}
samples:
{samples}
"""
SAMPLES = (
    *("mass: 400 mg, ratio: 50 %", "mass: 400 mg, ratio: 50 %", "mass: 300 mg, ratio: 50 %"),
    *("mass: 400 mg, ratio: 25 %", "mass: 400 mg, ratio: 50 %, tolerance: 1 %"),
    *("mass: 400 mg, ratio: 50 %, first: msg, second: beads", "mass: 400 mg, ratio: 50 %, container: vial_11mm"),
    *("mass: 50 mg, workflow: aliquots, source: beads, containers: [xrd_holder, xrd_holder]",) * 2,
)
BY_ID = """workflow: by_id
inputs: {first: Source, second: Source, container: Container, mass: Mass, tolerance: {type: Mass, default: 5 mg}}
tree:
  sequence:
    - place_container: {container: $container}
    - tare:
    - pick: {first: $first, second: $second, container: $container, mass: $mass}
    - park:
"""
PICK = """workflow: pick
inputs: {first: Source, second: Source, container: Container, mass: Mass}
tree:
  switch:
    value: $container.id
    cases:
      s1: {fill: {source: $first, container: $container, mass: $mass}}
      s2: {fill: {source: $second, container: $container, mass: $mass}}
"""


def written(*samples: str, workflow: str = "mix_at_ratio") -> str:
    lines = "\n".join(f"  - {{id: s{number}, {sample}}}" for number, sample in enumerate(samples, 1))
    return RECIPE.format(workflow=workflow, samples=lines)


def test_each_sample_doses_what_its_workflow_would_alone(lab_folder: LabFolder) -> None:
    lab = lab_folder.load()
    samples = load_recipe(lab_folder.write("r.yaml", written(*SAMPLES)), lab).samples
    assert [{pour.container for pour in sample.flow.pours} for sample in samples[-2:]] == [
        {f"{sample.id}/{number}" for number in (1, 2)} for sample in samples[-2:]
    ]
    for sample in samples:
        assert sample.flow == flow_of(sample.workflow, sample.inputs, lab.library, Problems()), sample.id


def test_samples_that_are_alike_are_followed_once(lab_folder: LabFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    followed = []
    monkeypatch.setattr(flows, "flow_of", lambda *given: (followed.append(given), flow_of(*given))[1])
    text = written(*("mass: 400 mg, ratio: 50 %", "mass: 300 mg, ratio: 50 %") * 20)
    assert len(load_recipe(lab_folder.write("r.yaml", text), lab_folder.load()).samples) == 40
    assert len(followed) == 2


def test_where_a_workflow_goes_by_the_containers_id_samples_are_not_alike(lab_folder: LabFolder) -> None:
    lab_folder.write("trees/by_id.yaml", BY_ID)
    lab_folder.write("trees/pick.yaml", PICK)
    text = written("mass: 100 mg", "mass: 100 mg", workflow="by_id")
    samples = load_recipe(lab_folder.write("r.yaml", text), lab_folder.load()).samples
    assert [[pour.source for pour in sample.flow.pours] for sample in samples] == [["beads"], ["msg"]]


UNFIT = (
    ("weigh_blank", "container: xrd_holder, wait: -5 s", "'duration' of 'wait': '-5' is not accepted; at least 0"),
    ("start_of_day", "weight: 0 g", "'weight' of 'check_weight': '0' is not accepted; more than 0"),
    ("start_of_day", "weight: 20 g, times: 0", "'times' of 'check_weight': '0' is not accepted; at least 1"),
    ("empty_mortar", "source: beads, scoops: 0", "'times' of 'repeat': '0' is not accepted; more than 0"),
)


@pytest.mark.parametrize(("workflow", "given", "said"), UNFIT)
def test_a_value_that_would_fail_where_it_is_used_is_found_where_the_recipe_has_it(
    lab_folder: LabFolder, workflow: str, given: str, said: str
) -> None:
    sources = "sources: {beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 6 g}}"
    sample = f"  - {{id: a, {given}}}"
    recipe = lab_folder.write("r.yaml", f"recipe: r\nworkflow: {workflow}\n{sources}\nsamples:\n{sample}\n")
    with pytest.raises(SourceError) as caught:
        load_recipe(recipe, lab_folder.load())
    (problem,) = (one for one in caught.value.problems if not one.is_warning)
    assert said in str(problem)
    assert (problem.mark.line, problem.mark.column) == (5, sample.rindex(":") + 3)


def test_a_value_that_is_worked_out_is_found_where_the_workflow_has_it(lab_folder: LabFolder) -> None:
    lab_folder.write(
        "trees/short.yaml",
        "workflow: short\ninputs: {container: Container, wait: Duration}\ntree:\n"
        "  weigh_blank: {container: $container, wait: $wait - 10 s}\n",
    )
    sample = "{id: a, container: xrd_holder, wait: WAIT}"
    text = f"recipe: r\nworkflow: short\nsamples: [{sample}]\n"
    load_recipe(lab_folder.write("r.yaml", text.replace("WAIT", "12 s")), lab_folder.load())
    with pytest.raises(SourceError, match=r"weigh_blank\.yaml:\d+:\d+: 'duration' of 'wait': '-5' is not accepted"):
        load_recipe(lab_folder.write("r.yaml", text.replace("WAIT", "5 s")), lab_folder.load())


def test_a_tolerance_below_nothing_is_the_recipes_fault_alone(lab_folder: LabFolder) -> None:
    text = written("mass: 400 mg, ratio: 50 %, tolerance: -1 mg")
    with pytest.raises(SourceError) as caught:
        load_recipe(lab_folder.write("r.yaml", text), lab_folder.load())
    assert {one.code for one in caught.value.problems if not one.is_warning} == {"fine-tolerance"}


HAND_GIVEN = """recipe: r
workflow: weigh_in
sources:
  li: {station: mortar_bay, container: agate_mortar, powder: lithium_carbonate, amount: 8 g}
  co: {station: mortar_bay_2, container: agate_mortar, powder: cobalt_oxide, amount: 15 g}
samples:
  - {id: a, container: alumina_crucible, sources: SOURCES, masses: MASSES, first: li,
     tolerances: TOLERANCES}
"""


@pytest.mark.parametrize(
    ("sources", "masses", "tolerances", "said"),
    [
        (
            *("[li, co]", "[400 mg, 800 mg]", "[10 mg, 0.05 mg]"),
            ["r.yaml:8:18: the tolerance 0.05 mg is too fine for a readability of 0.1 mg; at least 0.2 mg"],
        ),
        (
            *("[]", "[]", "[]"),
            [
                f"r.yaml:{at}: '{name}' is empty; the workflow 'weigh_in' needs at least one"
                for at, name in (("7:51", "sources"), ("7:63", "masses"), ("8:18", "tolerances"))
            ],
        ),
    ],
)
def test_lists_of_a_sample_are_held_to_what_its_own_values_are(
    lab_folder: LabFolder, sources: str, masses: str, tolerances: str, said: list[str]
) -> None:
    """No balance can tell such a tolerance, and of nothing a sample was 'good' without a dose: both were accepted."""
    text = HAND_GIVEN.replace("SOURCES", sources).replace("MASSES", masses).replace("TOLERANCES", tolerances)
    path = lab_folder.write("r.yaml", text)
    with pytest.raises(SourceError) as caught:
        load_recipe(path, lab_folder.load())
    wrong = [str(one) for one in caught.value.problems if not one.is_warning]
    assert [one.removeprefix(f"{path.parent}/") for one in wrong] == said


def test_masses_side_by_side_are_told_with_their_tolerances(lab_folder: LabFolder) -> None:
    text = HAND_GIVEN.replace("SOURCES", "[li, co]").replace("MASSES", "[400 mg, 800 mg]")
    path = lab_folder.write("r.yaml", text.replace("TOLERANCES", "[10 mg, 20 mg]"))
    (sample,) = load_recipe(path, lab_folder.load()).samples
    assert asked_cells(sample) == ("400.0 mg + 800.0 mg", "10 + 20 mg")
    path = lab_folder.write("r.yaml", text.replace("TOLERANCES", "[3.9996 mg, 12.3456 mg]"))
    (sample,) = load_recipe(path, lab_folder.load()).samples
    assert asked_cells(sample)[1] == "4 + 12.3 mg", "as people read them"
    assert asked_mg(sample) == ([400.0, 800.0], [3.9996, 12.3456])
