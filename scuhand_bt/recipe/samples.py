"""Reads the samples of a recipe and checks them against their workflows and the lab."""

from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any

from scuhand_bt.lab import Lab
from scuhand_bt.problems import Mark, Problems, nearest, shorten
from scuhand_bt.recipe.compose import COMPOSE, Composer, check_by_hand, takes_composed
from scuhand_bt.recipe.expansion import MAX_SAMPLES, expand
from scuhand_bt.recipe.flows import Flows
from scuhand_bt.recipe.identity import ALLOWED as ID_ALLOWED
from scuhand_bt.recipe.identity import Ids, wrong_id
from scuhand_bt.recipe.pour import Flow
from scuhand_bt.recipe.sample import Sample, check_sample
from scuhand_bt.specs import Container, Powder, Source
from scuhand_bt.tree.build import bound_inputs
from scuhand_bt.tree.check import check_workflows
from scuhand_bt.tree.grammar import RECIPE_WORDS
from scuhand_bt.tree.library import Percent, literal
from scuhand_bt.tree.wires import WireType
from scuhand_bt.tree.workflow import Workflow
from scuhand_bt.yaml_source import Entries, Items, Node, Scalar, describe

MISPLACED = {
    **dict.fromkeys(
        ("recipe", "workflow", "controller", "order", "leftover", "on_failure"), "write it at the top of the recipe"
    ),
    **dict.fromkeys(("id", "repeat", "table"), "each sample has its own"),
}
"""Keys that people put under `defaults` by mistake, and where they belong."""


@dataclass
class SamplesReader:
    """Reads `samples`, relative to the recipe's `folder`. Fills `marks` with the places of their values."""

    lab: Lab
    folder: Path
    problems: Problems
    source_marks: Mapping[str, Mark]
    marks: dict[str, Mark]
    workflows: dict[str, Workflow] = field(default_factory=dict)
    """Those that the recipe names."""
    used_sources: set[str] = field(default_factory=set)
    """The names of sources that samples name or are composed of."""
    sound: dict[str, bool] = field(default_factory=dict)
    """By workflow: whether it has passed its check."""

    def __post_init__(self) -> None:
        self._flows = Flows(self.lab.library)

    def read(self, root: Entries, sources: Mapping[str, Source]) -> list[Sample]:
        """The recipe's samples, with all values that could be read. Mistakes are reported."""
        node = root.get("samples")
        if not isinstance(node, Items) or not node.items:
            what = (
                "'samples' is missing" if node is None else f"'samples' must be a list of samples, not {describe(node)}"
            )
            self.problems.add(
                node.mark if node else root.mark,
                what,
                "write a list: - {id: …, container: …, mass: …}",
                code="wrong-shape" if node else "missing-key",
            )
            return []
        defaults = root.get("defaults") or Entries(root.mark, {}, {})
        if not isinstance(defaults, Entries):
            self.problems.add(
                defaults.mark, f"'defaults' must be a mapping, not {describe(defaults)}", code="wrong-shape"
            )
            defaults = Entries(root.mark, {}, {})
        default_workflow = root.get("workflow")
        if default_workflow is not None:
            self._workflow(default_workflow)
        samples: list[Sample] = []
        ids = Ids()
        folder, lab = self.folder, self.lab.folder

        def list_inputs(entry: Entries) -> list[str]:
            named = entry.get("workflow") or default_workflow
            name = (named.text or "") if isinstance(named, Scalar) else ""
            workflow = self.lab.library.workflows.get(name)
            return [one.name for one in workflow.inputs.values() if one.type.item is not None] if workflow else []

        expanded = (one for item in node.items for one in expand(item, folder, lab, self.problems, list_inputs))
        entries = list(islice(expanded, MAX_SAMPLES + 1))
        if len(entries) > MAX_SAMPLES:
            self.problems.add(
                node.mark,
                f"the recipe has more than {MAX_SAMPLES} samples",
                "split it into several recipes",
                code="too-many-samples",
            )
            return []
        for entry in entries:
            sample = self._read_sample(entry, defaults, default_workflow, sources)
            if sample is None:
                continue
            samples.append(sample)
            if sample.id and (clash := ids.add(sample.id, entry.values["id"].mark)) is not None:
                self.problems.add(entry.values["id"].mark, *clash, code="duplicate-id")
        inputs = {name for workflow in self.workflows.values() for name in workflow.inputs}
        for key, mark in defaults.keys.items():
            if key in MISPLACED and key not in inputs:
                what = f"'{key}' cannot be a default: {MISPLACED[key]}"
                self.problems.add(mark, what, code="misplaced-default")
            elif key == COMPOSE and any(map(takes_composed, self.workflows.values())):
                continue
            elif self.workflows and key not in inputs and all(w.is_whole for w in self.workflows.values()):
                what = f"no workflow of this recipe has an input '{shorten(key)}'"
                self.problems.add(mark, what, unknown=key, known=inputs, code="unknown-input")
        return samples

    def _read_sample(
        self, entry: Entries, defaults: Entries, default_workflow: Node | None, sources: Mapping[str, Source]
    ) -> Sample | None:
        """The sample with all values that could be read; None without a workflow."""
        sample_id = self._sample_id(entry)
        workflow_node = entry.get("workflow") or default_workflow
        if workflow_node is None:
            self.problems.add(
                entry.mark, "'workflow' is missing", "name it for the recipe, or for this sample", code="missing-key"
            )
            return None
        workflow = self._workflow(workflow_node)
        if workflow is None:
            return None
        composer = Composer(sources, self.source_marks, self.lab.cell.balance, self.problems)
        made, composed = composer.of_sample(entry, defaults, workflow)
        if made:  # if composing has failed, any source may be meant
            self.used_sources |= {source.name for source in composed.sources} if composed else set(self.source_marks)
        given = {key: value for key, value in defaults.values.items() if key in workflow.inputs and key not in made}
        given.update(entry.without(*RECIPE_WORDS, *made).values)
        inputs: dict[str, Any] = {}
        for key, node in given.items():
            self.marks[f"samples.{sample_id}.{key}"] = node.mark
            declared = workflow.inputs.get(key)
            if declared is None and not workflow.is_whole:
                continue  # it may belong to the part of the workflow that could not be read
            if declared is None:
                self.problems.add(
                    entry.keys[key],
                    f"the workflow '{workflow.name}' has no input '{shorten(key)}'",
                    unknown=key,
                    known=[*workflow.inputs, *RECIPE_WORDS],
                    code="unknown-input",
                )
                continue
            # One container has its sample's id. Several need their own, with a "/", which no sample's id can have.
            several = sum((one.type.item or one.type).python is Container for one in workflow.inputs.values()) > 1
            container_id = f"{sample_id}/{declared.name}" if several else sample_id
            value = self._read_value(declared.name, declared.type, node, container_id, sources)
            if value == () and declared.default is None:
                needs = f"the workflow '{workflow.name}' needs at least one"
                self.problems.add(node.mark, f"'{key}' is empty", needs, code="bad-value")
            elif value is not None:
                inputs[key] = value
        for declared in workflow.inputs.values():
            is_told = declared.name in made or declared.name in entry.keys or declared.name in given
            if declared.default is None and not is_told:
                what = f"'{declared.name}' is missing"
                self.problems.add(
                    entry.mark,
                    what,
                    f"the workflow '{workflow.name}' needs it ({declared.type.name})",
                    code="missing-key",
                )
        if isinstance(inputs.get("tolerance"), Percent) and "mass" not in workflow.inputs:
            what = f"a tolerance in % needs a mass, but the workflow '{workflow.name}' has no input 'mass'"
            self.problems.add(given["tolerance"].mark, what, code="percent-of-nothing")
        check_by_hand(workflow, inputs, given, self.problems)
        if composed is not None:
            inputs |= {name: value for name, value in composed.inputs.items() if name in made}
            self.marks[f"samples.{sample_id}.{COMPOSE}"] = (entry.get(COMPOSE) or defaults.values[COMPOSE]).mark
        with suppress(ValueError):  # a wrong default, which the workflow's check reports
            inputs = bound_inputs(workflow, inputs, self.lab.library)
        flow = self._flow(workflow, inputs, sample_id)
        sample = Sample(entry.mark, sample_id, workflow.name, inputs, flow, composed.composition if composed else None)
        check_sample(sample, entry.values, defaults.values, self.lab.cell, self.problems)
        return sample

    def _flow(self, workflow: Workflow, inputs: Mapping[str, Any], sample_id: str) -> Flow:
        """What a sample's workflow doses; nothing if the workflow is wrong, which is reported elsewhere."""
        if not self.is_sound(workflow.name):
            return Flow()
        is_complete = all(key in inputs for key in workflow.inputs)  # what is missing is already reported
        noted = Problems()
        flow = self._flows.of(workflow.name, inputs, noted)
        if is_complete:
            of_sample = f"; sample '{sample_id}' has these"  # the workflow it points to may be right for other samples
            self.problems.found += [
                replace(one, message=one.message + of_sample) if one.code == "uneven-lists" else one
                for one in noted.found
            ]
        return flow

    def is_sound(self, name: str) -> bool:
        """Whether a workflow passes its check, so that its flow can be found."""
        if name not in self.sound:
            wrong = Problems()
            check_workflows(self.lab.library, [name], wrong)
            self.sound[name] = not wrong.found
        return self.sound[name]

    def _sample_id(self, entry: Entries) -> str:
        node = entry.get("id")
        if node is None:
            self.problems.add(entry.mark, "'id' is missing", "every sample has an id of its own", code="missing-key")
            return ""
        text = node.text if isinstance(node, Scalar) else None
        what, allowed = ("is not a valid id", ID_ALLOWED) if text is None else wrong_id(text) or ("", "")
        if text is None or what:
            self.problems.add(node.mark, f"{describe(node)} {what}", allowed, code="bad-id")
            return ""
        return text

    def _workflow(self, node: Node) -> Workflow | None:
        """The workflow of this name; for an unknown name the nearest, so that all else is checked too."""
        name = (node.text or "") if isinstance(node, Scalar) else ""
        workflows = self.lab.library.workflows
        if name not in workflows:
            if self.lab.library.broken.tell("workflow", name, self.problems):
                return None
            self.problems.add(
                node.mark, f"unknown workflow {describe(node)}", unknown=name, known=workflows, code="unknown-name"
            )
            meant = nearest(name, tuple(sorted(workflows)))
            if meant is None:
                return None
            name = meant
        self.workflows[name] = workflows[name]
        return workflows[name]

    def _read_value(
        self, key: str, wire: WireType, node: Node, container_id: str, sources: Mapping[str, Source]
    ) -> Any:
        library = self.lab.library
        if wire.item is not None and isinstance(node, Items):
            found = [
                self._read_value(key, wire.item, item, f"{container_id}/{number}", sources)
                for number, item in enumerate(node.items, 1)
            ]
            return tuple(found) if None not in found else None
        named: dict[type, tuple[Collection[str], str]] = {
            Source: (self.source_marks, "source"),
            Container: (library.containers, "container"),
        }
        python = wire.python
        if isinstance(python, type) and python in named:
            known, what = named[python]
            name = (node.text or "") if isinstance(node, Scalar) else ""
            if python is Source:
                self.used_sources.add(name)
            if name not in known:
                if library.broken.tell(what, name, self.problems):
                    return None
                self.problems.add(
                    node.mark, f"unknown {what} {describe(node)}", unknown=name, known=known, code="unknown-name"
                )
                return None
            if python is Source:
                return sources.get(name)  # None if the source itself is wrong, which is already reported
            return Container.model_construct(**{**library.containers[name].__dict__, "id": container_id})
        try:
            return literal(key, wire, node, library)
        except ValueError as error:
            name = (node.text or "") if isinstance(node, Scalar) else ""
            if not (python is Powder and library.broken.tell("powder", name, self.problems)):
                self.problems.add(node.mark, f"'{key}': {error}", code="bad-value")
            return None
