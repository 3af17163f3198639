"""Recipes: what a chemist writes, read, expanded to samples, and checked before anything moves."""

import hashlib
import json
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, Literal

from scuhand_bt.failures import Code
from scuhand_bt.lab import Lab, read_mount
from scuhand_bt.problems import Mark, Problems, SourceError, shorten
from scuhand_bt.recipe.asked import check_asked
from scuhand_bt.recipe.compose import COMPOSE, Composer, takes_composed
from scuhand_bt.recipe.expansion import MAX_SAMPLES, expand
from scuhand_bt.recipe.flow import Flow, flow_of
from scuhand_bt.recipe.identity import ALLOWED as ID_ALLOWED
from scuhand_bt.recipe.identity import Ids, wrong_id
from scuhand_bt.recipe.leftover import with_leftover
from scuhand_bt.recipe.order import ORDERS
from scuhand_bt.recipe.sample import Sample, check_demand, check_reach, check_sample
from scuhand_bt.recipe.sources import REFILL, SourcesReader
from scuhand_bt.specs import Container, Powder, Source
from scuhand_bt.tree.build import bound_inputs
from scuhand_bt.tree.check import check_workflows
from scuhand_bt.tree.grammar import RECIPE_WORDS
from scuhand_bt.tree.library import Percent, literal
from scuhand_bt.tree.wires import WireType
from scuhand_bt.tree.workflow import Workflow
from scuhand_bt.yaml_source import Entries, Items, Node, Scalar, describe, from_plain, parse, read_text

Action = Literal["flag", "skip_sample", "redo", "ask", "stop"]
ACTIONS: Mapping[str, str] = {
    "flag": "keep the dose, mark it, and go on with the next sample",
    "skip_sample": "leave the sample undone and go on with the next one",
    "redo": "do the sample once more in a new container, then flag it",
    "ask": "ask the operator which of the others it shall be",
    "stop": "stop the batch",
}
DEFAULT_ON_FAILURE: Mapping[str, Action] = {
    Code.DOSE_OVERSHOOT: "flag",
    Code.DOSE_NOT_REACHED: "flag",
    "otherwise": "stop",
}
OVERSHOOT_LIMIT = 2
"""One overshoot is chance; two in a row are a balance, a valve or a powder that is not what it was."""
MISPLACED = {
    **dict.fromkeys(
        ("recipe", "workflow", "controller", "order", "leftover", "on_failure"), "it stands at the top of the recipe"
    ),
    **dict.fromkeys(("id", "repeat", "table"), "each sample has its own"),
}
"""Keys that are sometimes looked for under `defaults`, and where they stand."""
RECIPE_KEYS = (
    *("recipe", "summary", "workflow", "controller", "order", "sources", "defaults", "samples"),
    *("leftover", "on_failure", "overshoot_limit"),
)


RecipeGiven = Path | Mapping[str, Any]
"""The file of a recipe, or a dict of what would stand in one."""
GIVEN = "given.yaml"
"""What the file of a recipe that is a dict is called, which there is not."""


@dataclass(frozen=True)
class Recipe:
    """A checked recipe with all its samples, in the order they are written."""

    path: Path
    text: str
    name: str
    order: str
    controller: str | None
    sources: Mapping[str, Source]
    samples: tuple[Sample, ...]
    on_failure: Mapping[str, Action]
    overshoot_limit: int
    """So many samples in a row that overshot stop the batch; 0: none does."""
    marks: Mapping[str, Mark]
    """Where what is questioned later stands, by its keys: `sources.NAME`, `sources.NAME.amount`, `samples.ID.KEY`,
    `on_failure.CODE`."""

    @property
    def hash(self) -> str:
        """SHA-256 of the recipe's text and of its expanded samples."""
        digest = hashlib.sha256(self.text.encode())
        for sample in self.samples:
            digest.update(repr((sample.id, sample.workflow, sorted(map(str, sample.inputs.items())))).encode())
        return digest.hexdigest()

    def action_for(self, code: str) -> Action:
        """What to do with a sample that failed with this code."""
        return self.on_failure.get(code, self.on_failure["otherwise"])


def load_recipe(given: RecipeGiven, lab: Lab) -> Recipe:
    """Read and check a recipe against a lab.

    Raises SourceError with every problem found, in the recipe, its tables and the workflows it uses.
    """
    problems = Problems()
    recipe = read_recipe(given, lab, problems)
    problems.raise_any()
    assert recipe is not None
    return recipe


def given_again(path: Path, text: str) -> RecipeGiven:
    """A recipe as it was given, by what a run has noted of it: its file as it is now, or the dict."""
    if path.name == GIVEN:
        with suppress(ValueError):
            given: Mapping[str, Any] = json.loads(text)
            return given
    return path


def read_recipe(given: RecipeGiven, lab: Lab, problems: Problems) -> Recipe | None:
    """As `load_recipe`; what is wrong is noted, and what could be read is given. SourceError for what is no YAML."""
    if isinstance(given, Mapping):
        path, text = lab.folder / "recipes" / GIVEN, json.dumps(given, default=str)
        return recipe_of(from_plain(given, "recipe"), path, text, lab, problems)
    text = read_text(given, "a recipe")
    return recipe_of(parse(text, str(given), "a recipe"), given, text, lab, problems)


def recipe_of(root: Node, path: Path, text: str, lab: Lab, problems: Problems) -> Recipe | None:
    """The same of what has been parsed."""
    return _Reader(lab, path, text, problems).read(root)


@dataclass
class _Reader:
    lab: Lab
    path: Path
    text: str
    problems: Problems
    source_marks: dict[str, Mark] = field(default_factory=dict)
    marks: dict[str, Mark] = field(default_factory=dict)
    """See `Recipe.marks`."""
    workflows: dict[str, Workflow] = field(default_factory=dict)
    """Those that the recipe names."""
    used_sources: set[str] = field(default_factory=set)
    """Those that samples name, or are composed of."""
    sound: dict[str, bool] = field(default_factory=dict)
    """By workflow, whether it is."""

    def read(self, root: Node) -> Recipe | None:
        if not isinstance(root, Entries):
            self.problems.add(
                root.mark,
                f"{describe(root)} stands where a recipe should be",
                "it has the key 'recipe'",
                code="wrong-shape",
            )
            return None
        for key, mark in root.keys.items():
            if key not in RECIPE_KEYS:
                self.problems.add(
                    mark, f"unknown key '{shorten(key)}'", unknown=key, known=RECIPE_KEYS, code="unknown-key"
                )
        name = self._name(root)
        order = self._word(root, "order") or ORDERS[0]
        if order not in ORDERS:
            self.problems.add(
                root.values["order"].mark, f"'{order}' is no order", unknown=order, known=ORDERS, code="unknown-name"
            )
        controller = self._word(root, "controller")
        if controller is not None:
            self._check_controller(controller, root.values["controller"].mark)
        sources = SourcesReader(self.lab, self.problems, self.source_marks, self.marks).read(root.get("sources"))
        sources = with_leftover(sources, root.get("leftover"), self.lab.cell, self.problems)
        samples = self._read_samples(root, sources)
        needed = [
            i
            for workflow in self.workflows.values()
            for i in workflow.inputs.values()
            if (i.type.item or i.type).python is Source
        ]
        if "sources" not in root.keys and needed:
            self.problems.add(
                root.mark, "'sources' is missing", "name: {station, container, powder, amount}", code="missing-key"
            )
        on_failure, limit = self._read_on_failure(root.get("on_failure")), self._read_overshoot_limit(root)
        check_workflows(self.lab.library, sorted(self.workflows), self.problems)
        check_asked([s for s in samples if self._is_sound(s.workflow)], self.lab.library, self.problems)
        may_refill = REFILL in self.lab.library.workflows
        check_demand(samples, sources, self.source_marks, self.problems, may_refill=may_refill)
        if self.lab.has_cell:
            try:
                mount = read_mount(self.lab)
            except SourceError as error:
                self.problems.found += error.problems
            else:
                check_reach(samples, sources, self.lab.cell, mount, self.source_marks, self.problems)
        self._check_unused(samples)
        whole = tuple(samples)
        return Recipe(self.path, self.text, name, order, controller, sources, whole, on_failure, limit, self.marks)

    def _name(self, root: Entries) -> str:
        name = self._word(root, "recipe") or self.path.stem
        if (wrong := wrong_id(name)) is not None:
            mark = root.values["recipe"].mark if "recipe" in root.values else root.mark
            what, allowed = wrong
            what = "is no name for a recipe" if allowed == ID_ALLOWED else what
            self.problems.add(mark, f"'{shorten(name)}' {what}", allowed, code="bad-id")
        return name

    def _word(self, node: Entries, key: str) -> str | None:
        value = node.get(key)
        if value is None:
            return None
        if isinstance(value, Scalar) and value.text:
            return value.text
        self.problems.add(value.mark, f"'{key}': {describe(value)} is no text", code="wrong-shape")
        return None

    def _check_controller(self, name: str, mark: Mark) -> None:
        from scuhand_bt.dosing import CONTROLLERS

        if name not in CONTROLLERS:
            self.problems.add(
                mark, f"unknown controller '{shorten(name)}'", unknown=name, known=CONTROLLERS, code="unknown-name"
            )

    def _check_unused(self, samples: Sequence[Sample]) -> None:
        """Warn of sources that no sample names."""
        for name, mark in self.source_marks.items():
            if samples and name not in self.used_sources:
                what = f"no sample takes from '{name}'"
                self.problems.warn(mark, what, "take it away, or name it in a sample", code="unused-source")

    # --- samples

    def _read_samples(self, root: Entries, sources: Mapping[str, Source]) -> list[Sample]:
        node = root.get("samples")
        if not isinstance(node, Items) or not node.items:
            what = "'samples' is missing" if node is None else f"'samples': {describe(node)} names no sample"
            self.problems.add(
                node.mark if node else root.mark,
                what,
                "a list: - {id: …, container: …, mass: …}",
                code="wrong-shape" if node else "missing-key",
            )
            return []
        defaults = root.get("defaults") or Entries(root.mark, {}, {})
        if not isinstance(defaults, Entries):
            self.problems.add(defaults.mark, f"'defaults': {describe(defaults)} is no mapping", code="wrong-shape")
            defaults = Entries(root.mark, {}, {})
        default_workflow = root.get("workflow")
        if default_workflow is not None:
            self._workflow(default_workflow)
        samples: list[Sample] = []
        ids = Ids()
        folder, lab = self.path.parent, self.lab.folder

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
                f"these are more than {MAX_SAMPLES} samples",
                "split them into several recipes",
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
                what = f"'{key}' is no default: {MISPLACED[key]}"
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
        """The sample with all of its values that could be read; None without a workflow."""
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
        if made:  # where composing fails, nobody knows which
            self.used_sources |= {source.name for source in composed.sources} if composed else set(self.source_marks)
        given = {key: value for key, value in defaults.values.items() if key in workflow.inputs and key not in made}
        given.update(entry.without(*RECIPE_WORDS, *made).values)
        inputs: dict[str, Any] = {}
        for key, node in given.items():
            self.marks[f"samples.{sample_id}.{key}"] = node.mark
            declared = workflow.inputs.get(key)
            if declared is None and not workflow.is_whole:
                continue  # it may be what could not be read
            if declared is None:
                self.problems.add(
                    entry.keys[key],
                    f"the workflow '{workflow.name}' has no input '{shorten(key)}'",
                    unknown=key,
                    known=[*workflow.inputs, *RECIPE_WORDS],
                    code="unknown-input",
                )
                continue
            # One container is known by its sample's id; several need one each, and no sample can have an id like it.
            several = sum((one.type.item or one.type).python is Container for one in workflow.inputs.values()) > 1
            container_id = f"{sample_id}/{declared.name}" if several else sample_id
            value = self._read_value(declared.name, declared.type, node, container_id, sources)
            if value is not None:
                inputs[key] = value
        for declared in workflow.inputs.values():
            if declared.default is None and declared.name not in given and declared.name not in made:
                what = f"'{declared.name}' is missing"
                self.problems.add(
                    entry.mark,
                    what,
                    f"the workflow '{workflow.name}' needs it ({declared.type.name})",
                    code="missing-key",
                )
        if isinstance(inputs.get("tolerance"), Percent) and "mass" not in workflow.inputs:
            what = f"a tolerance in % is one of the mass, but the workflow '{workflow.name}' has no input 'mass'"
            self.problems.add(given["tolerance"].mark, what, code="percent-of-nothing")
        if composed is not None:
            inputs |= {name: value for name, value in composed.inputs.items() if name in made}
            self.marks[f"samples.{sample_id}.{COMPOSE}"] = (entry.get(COMPOSE) or defaults.values[COMPOSE]).mark
        with suppress(ValueError):  # a wrong default, which is reported where it stands
            inputs = bound_inputs(workflow, inputs, self.lab.library)
        flow = self._flow(workflow, inputs)
        sample = Sample(entry.mark, sample_id, workflow.name, inputs, flow, composed.composition if composed else None)
        check_sample(sample, entry.values, defaults.values, self.lab.cell, self.problems)
        return sample

    def _flow(self, workflow: Workflow, inputs: Mapping[str, Any]) -> Flow:
        """What a sample's workflow doses; by a wrong one, which is reported where it stands, nothing."""
        if not self._is_sound(workflow.name):
            return Flow()
        is_complete = all(key in inputs for key in workflow.inputs)  # else what lacks is reported where it stands
        return flow_of(workflow.name, inputs, self.lab.library, self.problems if is_complete else Problems())

    def _is_sound(self, name: str) -> bool:
        """Whether a workflow can be followed."""
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
        what, allowed = ("is no id", ID_ALLOWED) if text is None else wrong_id(text) or ("", "")
        if text is None or what:
            self.problems.add(node.mark, f"{describe(node)} {what}", allowed, code="bad-id")
            return ""
        return text

    def _workflow(self, node: Node) -> Workflow | None:
        name = (node.text or "") if isinstance(node, Scalar) else ""
        workflows = self.lab.library.workflows
        if name not in workflows:
            if self.lab.library.broken.tell("workflow", name, self.problems):
                return None
            self.problems.add(
                node.mark, f"unknown workflow {describe(node)}", unknown=name, known=workflows, code="unknown-name"
            )
            return None
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
                return sources.get(name)  # None for one that is wrong itself, and reported
            return Container.model_construct(**{**library.containers[name].__dict__, "id": container_id})
        try:
            return literal(key, wire, node, library)
        except ValueError as error:
            name = (node.text or "") if isinstance(node, Scalar) else ""
            if not (python is Powder and library.broken.tell("powder", name, self.problems)):
                self.problems.add(node.mark, f"'{key}': {error}", code="bad-value")
            return None

    # --- the batch as a whole

    def _read_on_failure(self, node: Node | None) -> dict[str, Action]:
        policy = dict(DEFAULT_ON_FAILURE)
        if node is None:
            return policy
        if not isinstance(node, Entries):
            self.problems.add(
                node.mark,
                f"'on_failure': {describe(node)} is no mapping",
                "{code: action, otherwise: …}",
                code="wrong-shape",
            )
            return policy
        codes = [*self.lab.library.failures(), "otherwise"]
        for code, value in node.values.items():
            action = value.text if isinstance(value, Scalar) else None
            if code not in codes:
                self.problems.add(
                    node.keys[code],
                    f"unknown failure code '{shorten(code)}'",
                    unknown=code,
                    known=codes,
                    code="unknown-code",
                )
            self.marks[f"on_failure.{code}"] = value.mark
            if action not in ACTIONS:
                self.problems.add(
                    value.mark,
                    f"{describe(value)} is no action",
                    unknown=action or "",
                    known=ACTIONS,
                    code="bad-action",
                )
            else:
                policy[code] = action  # type: ignore[assignment]
        return policy

    def _read_overshoot_limit(self, root: Entries) -> int:
        text = self._word(root, "overshoot_limit")
        if text is None:
            return OVERSHOOT_LIMIT
        if not (text.isascii() and text.isdigit() and len(text) <= 6):
            what = f"'overshoot_limit': '{shorten(text)}' is no number of samples"
            self.problems.add(root.values["overshoot_limit"].mark, what, "2, or 0 for no limit", code="bad-value")
            return OVERSHOOT_LIMIT
        return int(text)
