"""Workflows in the tools of the field: BehaviorTree.CPP loads and ticks them, and they come back as they were."""

import re
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml
from conftest import REPOSITORY, Call, LabFolder

from scuhand_bt.lab import Lab
from scuhand_bt.problems import Problems, SourceError
from scuhand_bt.tree.btxml import from_xml, to_xml
from scuhand_bt.tree.check import check_workflows
from scuhand_bt.tree.drawing import drawn
from scuhand_bt.tree.grammar import read_workflow
from scuhand_bt.tree.workflow import Argument, Branch, Choice, Decorator, TreeNode, Workflow, walk
from scuhand_bt.tree.workflow import Call as GrammarCall
from scuhand_bt.yaml_source import Node, parse, plain

SHIPPED = sorted(path.stem for path in (REPOSITORY / "trees").glob("*.yaml") if ".test" not in path.name)
OF_CPP = {"Sequence", "Fallback", "Parallel", "ReactiveSequence", "RetryUntilSuccessful", "Repeat", "Timeout"}
OF_CPP |= {"Inverter", "ForceSuccess", "SubTree", "LoopString", "IfThenElse", "ScriptCondition", "Switch2"}
OF_CPP |= {"AlwaysSuccess", "AlwaysFailure"}


def said(argument: Argument) -> Any:
    return plain(argument) if isinstance(argument, Node) else str(argument)


def shape(node: TreeNode) -> Any:
    """All of a tree but its places."""
    if isinstance(node, Branch):
        return node.kind, list(node.codes), [shape(child) for child in node.children]
    if isinstance(node, Choice):
        return node.kind, said(node.argument), [(case.label, shape(case.child)) for case in node.cases]
    given = {key: said(argument) for key, argument in node.arguments.items()}
    if isinstance(node, Decorator):
        return node.kind, given, list(node.codes), [shape(guard) for guard in node.guards], shape(node.child)
    return node.name, given, node.result


def whole(workflow: Workflow) -> Any:
    inputs = {i.name: (i.type.name, i.default and plain(i.default)) for i in workflow.inputs.values()}
    return workflow.name, workflow.summary, inputs, str(workflow.result), shape(workflow.tree)


def read_back(xml: str) -> dict[str, Workflow]:
    problems = Problems()
    found = {
        name: read_workflow(parse(text, f"{name}.yaml", "a workflow"), name, problems)
        for name, text in from_xml(xml, "x.xml").items()
    }
    problems.raise_any()
    return {name: workflow for name, workflow in found.items() if workflow is not None}


@pytest.mark.parametrize("name", SHIPPED)
def test_a_workflow_comes_back_as_it_was_with_all_that_it_calls(starter: Lab, name: str) -> None:
    back = read_back(to_xml(starter.library, name))
    assert name in back
    for each, workflow in back.items():
        assert whole(workflow) == whole(starter.library.workflows[each])


EVERYTHING = """\
workflow: everything
summary: All kinds of nodes, <and> "signs".
inputs:
  source: Source
  weight: Mass
  times: {type: Integer, default: 2}
  wait: {type: Duration, default: 3 s}
  holders: [Container]
  masses: {type: [Mass], default: [20 mg, 50 mg]}
result: 0.5 * $gross + $weight
tree:
  sequence:
    - fallback: [{cone_holds: {powder: $source.powder, at_least: 5 mg}}, {discard: }]
    - parallel: [{park: }, {tare: {as: gross}}]
    - while: {guards: [{cone_holds: {powder: glass_beads}}], child: {shake: {duration: $wait}}}
    - retry: {attempts: $times, on: [hand.no_flow, device.lost], child: {shake: {duration: 1.5 s}}}
    - retry: {attempts: 3, child: {park: }}
    - repeat: {times: 2, child: {wait: {duration: $wait}}}
    - timeout: {duration: 2 min, child: {invert: {cone_holds: {powder: glass_beads}}}}
    - optional: {after_failure: {source: $source}}
    - fallback: {on: [hand.no_flow], children: [{shake: {duration: 0.5 * $wait}}, {discard: }]}
    - if: {when: $gross > 2 * $weight, then: {shake: }}
    - if: {when: $gross > 2 * $weight, then: {shake: }, else: {park: }}
    - switch: {value: $source.powder.name, cases: {glass_beads: {shake: }, sand: {park: }}}
    - switch: {value: $times + 1, cases: {"2": {shake: }, "3": {park: }}, otherwise: {tare: }}
    - for_each: {items: {holder: $holders, mass: $masses}, child: {place_container: {container: $holder}}}
    - repeat: {times: $times + 1, child: {listed: {masses: [1 mg, 2 mg]}}}
    - record: {gross: $gross, half: 0.5 * $gross, note: as weighed}
"""
LISTED = """\
workflow: listed
inputs: {masses: [Mass]}
tree: {for_each: {items: {mass: $masses}, child: {wait: {duration: 1 s}}}}
"""


def test_every_kind_of_node_comes_back(lab_folder: LabFolder) -> None:
    lab_folder.write("trees/everything.yaml", EVERYTHING)
    lab_folder.write("trees/listed.yaml", LISTED)
    library = lab_folder.load().library
    check_workflows(library, ["everything"], problems := Problems())
    problems.raise_any()
    xml = to_xml(library, "everything")
    back = read_back(xml)
    assert whole(back["everything"]) == whole(library.workflows["everything"])
    assert whole(back["listed"]) == whole(library.workflows["listed"])
    assert 'msec="120000"' in xml
    assert set(re.findall(r"<([A-Z]\w+)", xml)) >= OF_CPP - {"Fallback"}


@pytest.mark.parametrize("name", SHIPPED)
def test_every_attribute_of_a_leaf_is_a_port_of_its_model(starter: Lab, name: str) -> None:
    root = ElementTree.fromstring(to_xml(starter.library, name).encode())
    model = root.find("TreeNodesModel")
    assert model is not None
    ports = {one.get("ID"): {port.get("name") for port in one if port.tag.endswith("_port")} for one in model}
    nodes = [node for tree in root.iterfind("BehaviorTree") for node in tree.iter() if node is not tree]
    for node in nodes:
        if node.tag not in OF_CPP or node.tag == "SubTree":
            own = {key for key in node.attrib if key != "ID" and not key.startswith("_")}
            assert own <= ports[node.get("ID") or node.tag], node.tag
    assert {port.get("type") for port in model.iter("input_port")} <= {"std::string", "int", "double", "bool"}


@pytest.mark.parametrize("name", SHIPPED)
def test_behaviortree_cpp_loads_and_ticks_every_shipped_workflow(starter: Lab, name: str) -> None:
    bt = pytest.importorskip("behaviortreepy")
    root = ElementTree.fromstring(to_xml(starter.library, name).encode())
    ticked: list[str] = []
    factory = bt.BehaviorTreeFactory()
    for skill in (one.get("ID", "") for one in root.iterfind("TreeNodesModel/*") if one.tag != "SubTree"):
        # Its nodes from Python declare no ports: the attributes of leaves are held against the model above.
        for leaf in (node for node in root.iter(skill)):
            leaf.attrib.clear()

        def tick(*_: object, skill: str = skill) -> object:
            ticked.append(skill)
            return bt.NodeStatus.SUCCESS

        factory.register_simple_action(skill, tick)
    counts = ("num_cycles", "queue")
    for tree in root.iterfind("BehaviorTree"):
        for node in tree.iter():  # a count that only the wire has
            node.attrib.update({key: "1" for key, value in node.attrib.items() if key in counts and "{" in value})
    factory.register_behavior_tree_from_text(ElementTree.tostring(root, encoding="unicode"))
    assert name in factory.registered_behavior_trees()
    status = factory.create_tree(name).tick_while_running()
    assert status == bt.NodeStatus.SUCCESS
    called = [node.tag for node in root.iter() if node.tag not in OF_CPP]
    assert ticked
    assert set(ticked) <= set(called)


def test_a_file_that_is_no_tree_is_refused_in_a_line() -> None:
    for text, said in (
        ("<root>", "is not XML"),
        ("<!DOCTYPE x [<!ENTITY a 'b'>]><root/>", "which are not accepted"),
        ('<root><BehaviorTree ID="x"/></root>', "the tree 'x' has 0 children"),
        ('<root><BehaviorTree ID="x"><Inverter/></BehaviorTree></root>', "Inverter has 0 children"),
    ):
        with pytest.raises(SourceError, match=said):
            from_xml(text, "x.xml")


def test_the_command_writes_and_reads_the_file_and_draws_the_tree(command: Call, tmp_path: Any) -> None:
    xml = command("trees", "fill_crucible", "--bt-xml").stdout
    path = tmp_path / "x.xml"
    path.write_text(xml, encoding="utf-8")
    shown = command("trees", "--from-xml", path).stdout
    texts = dict(re.findall(r"# trees/(\w+)\.yaml\n(.*?)(?=# trees/|\Z)", shown, re.S))
    assert list(texts) == ["fill_crucible", "place_and_scoop", "fill"]
    assert yaml.safe_load(texts["fill"])["workflow"] == "fill"
    picture = command("trees", "fill_crucible", "--svg").stdout
    drawing = ElementTree.fromstring(picture.encode())
    said = ["".join(text.itertext()) for text in drawing.iter("{http://www.w3.org/2000/svg}text")]
    assert said[0] == "fill_crucible"
    assert "return_leftover source: $source, keep: unless_told" in said
    assert any(line.startswith("fill source: $source, container: $container") and "→ dose" in line for line in said)


@pytest.mark.parametrize("name", SHIPPED)
def test_the_picture_of_a_workflow_has_a_line_for_every_node(starter: Lab, name: str) -> None:
    workflow = starter.library.workflows[name]
    drawing = ElementTree.fromstring(drawn(workflow).encode())
    said = ["".join(text.itertext()) for text in drawing.iter("{http://www.w3.org/2000/svg}text")]
    words = [re.sub(r"^\W+ ", "", line).split(" ")[0] for line in said[1:] if not line.rstrip().endswith(":")]
    nodes = [node.name if isinstance(node, GrammarCall) else node.kind for node in walk(workflow.tree)]
    assert words == nodes
