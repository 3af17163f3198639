"""What a workflow's values come to is told before the run: masses at their bounds, rounds, ways."""

from typing import Any

import pytest
from conftest import Desk, LabFolder

from scuhand_bt.recipe.plan import make_plan

MIX = """\
workflow: mix
inputs:
  first: Source
  second: Source
  into: Container
  mass: Mass
  share: Ratio
result: $b
tree:
  sequence:
    - place_container: {container: $into}
    - tare:
    - fill: {source: $first, container: $into, mass: $mass, tolerance: 2 mg, as: a}
    - change_powder: {source: $first}
    - fill: {source: $second, container: $into, mass: $share * $a.dispensed, tolerance: 1 %, as: b}
    - record: {share: $b.dispensed / $a.dispensed}
    - return_leftover: {source: $second}
    - park:
"""
SOURCES = """\
recipe: r
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 5 g}
  msg: {station: mortar_bay_2, container: agate_mortar, powder: monosodium_glutamate, amount: %s}
"""


def of_lab(lab: LabFolder, trees: dict[str, str]) -> Desk:
    for name, text in trees.items():
        lab.write(f"trees/{name}.yaml", text)
    assert lab.problems() == []
    return Desk(lab.folder / "recipes", lab.load())


def test_powder_for_a_mass_that_is_known_only_at_run_time_is_planned_at_its_bound(lab_folder: LabFolder) -> None:
    desk = of_lab(lab_folder, {"mix": MIX})
    sample = "workflow: mix\nsamples:\n"
    sample += "  - {id: x, first: beads, second: msg, into: alumina_crucible, mass: 1 g, share: 50 %}\n"
    (mixed,) = desk.load(SOURCES % "5 g" + sample).samples
    assert [(take.source.name, take.mass_mg) for take in mixed.takes] == [("beads", 1000.0), ("msg", 501.0)]
    assert mixed.last_source is not None
    assert mixed.last_source.name == "msg"
    said = desk.problems(SOURCES % "510 mg" + sample)  # 20 mg are lost with a scoop
    short = "'msg' holds 510.0 mg of monosodium_glutamate, but its 1 sample needs 521.0 mg with losses"
    assert said == [f"4:3: {short}; begin with at least 521.0 mg"]


def test_room_for_a_mass_that_is_known_only_at_run_time_is_checked_at_its_bound(lab_folder: LabFolder) -> None:
    desk = of_lab(lab_folder, {"mix": MIX})
    sample = "workflow: mix\nsamples: [{id: x, first: beads, second: msg, into: xrd_holder, mass: 100 mg, share: %s}]\n"
    assert desk.problems(SOURCES % "5 g" + sample % "106 %") == []
    (said,) = desk.problems(SOURCES % "5 g" + sample % "115 %")
    assert "100.0 mg of glass_beads and 117.3 mg of monosodium_glutamate (0.20 cm³) do not fit" in said


def test_what_makes_up_a_total_is_planned_at_what_the_first_dose_leaves_of_it(lab_folder: LabFolder) -> None:
    desk = of_lab(lab_folder, {"mix": MIX.replace("$share * $a.dispensed", "$share * $mass - $a.dispensed")})
    sample = "workflow: mix\nsamples:\n"
    sample += "  - {id: x, first: beads, second: msg, into: alumina_crucible, mass: 1 g, share: %s}\n"
    (mixed,) = desk.load(SOURCES % "522 mg" + sample % "150 %").samples
    assert [(take.source.name, take.mass_mg) for take in mixed.takes] == [("beads", 1000.0), ("msg", 502.0)]
    said = desk.problems(SOURCES % "5 g" + sample % "90 %")
    assert said == ["7:70: the mass taken from 'msg' is -98 mg; more than 0"]


ANY = """\
workflow: any
inputs: {source: Source, into: Container, mass: Mass, spare: {type: [Container], default: []}}
tree:
  sequence:
    - place_container: {container: $into}
    - tare:
    - weigh: {as: weighed}
    - fill: {source: $source, container: $into, mass: MASS}
    - return_leftover: {source: $source}
    - park:
"""


def test_a_mass_without_a_bound_is_warned_of_and_one_with_a_bound_is_not(lab_folder: LabFolder, command: Any) -> None:
    recipe = SOURCES.replace(
        "  msg: {station: mortar_bay_2, container: agate_mortar, powder: monosodium_glutamate, amount: %s}\n", ""
    )
    recipe += "workflow: any\nsamples: [{id: x, source: beads, into: xrd_holder, mass: 50 mg}]\n"
    for mass, is_warned in (("$mass + $weighed.net", True), ("min($mass + $weighed.net, 80 mg)", False)):
        lab_folder.write(
            "trees/any.yaml", ANY.replace("MASS", f'"{mass}"').replace(", spare: {type: [Container], default: []}", "")
        )
        ended = command("check", lab_folder.write("recipes/r.yaml", recipe), "--fast", "--lab", lab_folder.folder)
        assert ended.returncode == 0, ended.stdout
        assert ("[unbounded-mass]" in ended.stdout) == is_warned, ended.stdout


LISTS = """\
workflow: lists
inputs:
  source: Source
  last: Container
  holders: [Container]
  masses: {type: [Mass], default: [20 mg, 30 mg]}
  big: {type: Mass, default: 0 mg}
tree:
  sequence:
    - for_each:
        items: {holder: $holders, mass: $masses}
        child:
          sequence:
            - park:
            - place_container: {container: $holder}
            - tare:
            - fill: {source: $source, container: $holder, mass: $mass}
    - if:
        when: $big > 0 mg
        then:
          fill: {source: $source, container: $last, mass: $big}
    - park:
"""


def test_rounds_and_ways_that_can_be_told_before_the_run_are_told(lab_folder: LabFolder) -> None:
    desk = of_lab(lab_folder, {"lists": LISTS})
    head = SOURCES % "5 g" + "workflow: lists\ndefaults: {source: beads, last: xrd_holder}\nsamples:\n"
    recipe = desk.load(
        head
        + "  - {id: a, holders: [xrd_holder, xrd_holder]}\n"
        + "  - {id: b, holders: [xrd_holder], masses: [40 mg], big: 70 mg}\n"
    )
    a, b = recipe.samples
    assert [one.id for one in a.all_containers] == ["a/last", "a/holders/1", "a/holders/2"]
    assert [(p.container, p.mass_mg) for p in a.flow.pours] == [("a/holders/1", 20.0), ("a/holders/2", 30.0)]
    assert [(p.container, p.mass_mg) for p in b.flow.pours] == [("b/holders/1", 40.0), ("b/last", 70.0)]
    plan = make_plan(recipe, desk.lab)
    assert plan.demands[0].needed_mg == pytest.approx(20 + 30 + 40 + 70 + 4 * 20)
    (said,) = desk.problems(head + "  - {id: a, holders: [xrd_holder], masses: [310 mg]}\n")
    assert "310.0 mg of glass_beads (0.21 cm³) does not fit into 'xrd_holder'" in said
    (said,) = desk.problems(head + "  - {id: a, holders: [xrd_holder]}\n")
    assert "the lists of 'for_each' differ in length: there are 1 of 'holder' and 2 of 'mass'" in said


def test_lists_of_lists_give_one_to_each_sample(lab_folder: LabFolder) -> None:
    desk = of_lab(lab_folder, {"lists": LISTS})
    samples = "defaults: {source: beads, last: xrd_holder, holders: [xrd_holder, xrd_holder]}\n"
    samples += "samples: [{id: [a, b], masses: [[1 mg, 2 mg], [5 mg, 6 mg]]}]\n"
    a, b = desk.load(SOURCES % "5 g" + "workflow: lists\n" + samples).samples
    assert (a.inputs["masses"], b.inputs["masses"]) == ((1.0, 2.0), (5.0, 6.0))
    assert [one.id for one in b.all_containers] == ["b/last", "b/holders/1", "b/holders/2"]
    single = samples.replace("[[1 mg, 2 mg], [5 mg, 6 mg]]", "5 mg").replace("[a, b]", "a")
    (said,) = desk.problems(SOURCES % "5 g" + "workflow: lists\n" + single)
    assert "'masses': '5 mg' is not a list; write [one, another]" in said


def test_a_powder_that_only_one_way_doses_is_refused_among_several(lab_folder: LabFolder) -> None:
    text = MIX.replace(
        "    - record:",
        "    - if: {when: $b.dispensed < 10 mg, then: {MORE}}\n    - record:",
    ).replace("MORE", "fill: {source: $first, container: $into, mass: $mass}")
    desk = of_lab(lab_folder, {"mix": text})
    sample = "workflow: mix\nsamples:\n"
    sample += "  - {id: x, first: beads, second: msg, into: alumina_crucible, mass: 1 g, share: 50 %}\n"
    (said,) = desk.problems(SOURCES % "5 g" + sample)
    assert (
        "which of glass_beads, monosodium_glutamate the sheet has touched after this 'if' is not known before the run"
        in said
    )
