"""Reads a chemist's recipe, expands it to samples, and checks it before anything moves (docs/recipes.md)."""

import hashlib
import json
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from scuhand_bt.failures import Code
from scuhand_bt.lab import Lab, read_mount
from scuhand_bt.problems import Mark, Problems, SourceError, shorten
from scuhand_bt.recipe.asked import check_asked
from scuhand_bt.recipe.demand import check_demand
from scuhand_bt.recipe.identity import ALLOWED as ID_ALLOWED
from scuhand_bt.recipe.identity import wrong_id
from scuhand_bt.recipe.leftover import TO, check_unmixed, with_leftover
from scuhand_bt.recipe.order import ORDERS
from scuhand_bt.recipe.sample import Sample, check_reach
from scuhand_bt.recipe.samples import SamplesReader
from scuhand_bt.recipe.sources import REFILL, SourcesReader
from scuhand_bt.specs import Source
from scuhand_bt.tree.check import check_workflows
from scuhand_bt.yaml_source import Entries, Node, Scalar, describe, from_plain, parse, read_text

Action = Literal["flag", "skip_sample", "redo", "ask", "stop"]
ACTIONS: Mapping[str, str] = {
    "flag": "keep the dose, mark it, and go on with the next sample",
    "skip_sample": "leave the sample undone and go on with the next one",
    "redo": "do the sample once more in a new container, then flag it",
    "ask": "ask the operator to choose one of the others",
    "stop": "stop the batch",
}
DEFAULT_ON_FAILURE: Mapping[str, Action] = {
    Code.DOSE_OVERSHOOT: "flag",
    Code.DOSE_NOT_REACHED: "flag",
    "otherwise": "stop",
}
OVERSHOOT_LIMIT = 2
"""One overshoot is chance; after two in a row, balance, valve or powder have probably changed."""
RECIPE_KEYS = (
    *("recipe", "summary", "workflow", "controller", "order", "sources", "defaults", "samples"),
    *("leftover", "on_failure", "overshoot_limit"),
)


RecipeGiven = Path | Mapping[str, Any]
"""The path of a recipe's file, or a dict with the same content."""
GIVEN = "given.yaml"
"""The file name in messages about a recipe given as a dict; no such file exists."""


@dataclass(frozen=True)
class Recipe:
    """A checked recipe with all its samples, in the order of the text."""

    path: Path
    text: str
    name: str
    order: str
    controller: str | None
    sources: Mapping[str, Source]
    samples: tuple[Sample, ...]
    on_failure: Mapping[str, Action]
    overshoot_limit: int
    """How many overshoots in a row stop the batch; 0 for no limit."""
    marks: Mapping[str, Mark]
    """Places of values that later checks report, by key: `sources.NAME`, `sources.NAME.amount`, `samples.ID.KEY`,
    `on_failure.CODE`, `leftover`."""

    @property
    def hash(self) -> str:
        """SHA-256 of the recipe's text and its expanded samples."""
        digest = hashlib.sha256(self.text.encode())
        for sample in self.samples:
            digest.update(repr((sample.id, sample.workflow, sorted(map(str, sample.inputs.items())))).encode())
        return digest.hexdigest()

    @property
    def redone(self) -> list[str]:
        """The failure codes after which a sample is, or may be, done once more (`redo` or `ask`)."""
        return [code for code, action in self.on_failure.items() if action in ("redo", "ask")]

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
    """The recipe that a run has recorded: its file as it is now, or the dict."""
    if path.name == GIVEN:
        with suppress(ValueError):
            given: Mapping[str, Any] = json.loads(text)
            return given
    return path


def read_recipe(given: RecipeGiven, lab: Lab, problems: Problems) -> Recipe | None:
    """As `load_recipe`, but reports into `problems` and returns what could be read. SourceError only if it is no
    YAML.
    """
    if isinstance(given, Mapping):
        path, text = lab.folder / "recipes" / GIVEN, json.dumps(given, default=str)
        return recipe_of(from_plain(given, "recipe"), path, text, lab, problems)
    text = read_text(given, "a recipe")
    return recipe_of(parse(text, str(given), "a recipe"), given, text, lab, problems)


def recipe_of(root: Node, path: Path, text: str, lab: Lab, problems: Problems) -> Recipe | None:
    """As `read_recipe`, from a parsed text."""
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

    def read(self, root: Node) -> Recipe | None:
        if not isinstance(root, Entries):
            self.problems.add(
                root.mark,
                f"expected a recipe, found {describe(root)}",
                "a recipe is a mapping with the key 'recipe'",
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
                root.values["order"].mark, f"unknown order '{order}'", unknown=order, known=ORDERS, code="unknown-name"
            )
        controller = self._word(root, "controller")
        if controller is not None:
            self._check_controller(controller, root.values["controller"].mark)
        sources = SourcesReader(self.lab, self.problems, self.source_marks, self.marks).read(root.get("sources"))
        if (leftover := root.get("leftover")) is not None:
            self.marks["leftover"] = leftover.mark
        sources = with_leftover(sources, leftover, self.lab.cell, self.problems)
        reader = SamplesReader(self.lab, self.path.parent, self.problems, self.source_marks, self.marks)
        samples = reader.read(root, sources)
        needed = [
            i
            for workflow in reader.workflows.values()
            for i in workflow.inputs.values()
            if (i.type.item or i.type).python is Source
        ]
        if "sources" not in root.keys and needed:
            self.problems.add(
                root.mark, "'sources' is missing", "name: {station, container, powder, amount}", code="missing-key"
            )
        on_failure, limit = self._read_on_failure(root.get("on_failure")), self._read_overshoot_limit(root)
        check_workflows(self.lab.library, sorted(reader.workflows), self.problems)
        check_asked([s for s in samples if reader.is_sound(s.workflow)], self.lab.library, self.problems)
        may_refill = REFILL in self.lab.library.workflows
        check_demand(samples, sources, self.source_marks, self.problems, may_refill=may_refill)
        if self.lab.has_cell:
            try:
                mount = read_mount(self.lab)
            except SourceError as error:
                self.problems.found += error.problems
            else:
                check_reach(samples, sources, self.lab.cell, mount, self.source_marks, self.problems)
        if isinstance(leftover, Entries) and (vessel := leftover.get(TO)) is not None:
            check_unmixed((sources[name] for name in reader.used_sources & sources.keys()), vessel.mark, self.problems)
        self._check_unused(samples, reader.used_sources)
        whole = tuple(samples)
        return Recipe(self.path, self.text, name, order, controller, sources, whole, on_failure, limit, self.marks)

    def _name(self, root: Entries) -> str:
        name = self._word(root, "recipe") or self.path.stem
        if (wrong := wrong_id(name)) is not None:
            mark = root.values["recipe"].mark if "recipe" in root.values else root.mark
            what, allowed = wrong
            what = "is not a valid name for a recipe" if allowed == ID_ALLOWED else what
            self.problems.add(mark, f"'{shorten(name)}' {what}", allowed, code="bad-id")
        return name

    def _word(self, node: Entries, key: str) -> str | None:
        value = node.get(key)
        if value is None:
            return None
        if isinstance(value, Scalar) and value.text:
            return value.text
        self.problems.add(value.mark, f"'{key}' must be a text, not {describe(value)}", code="wrong-shape")
        return None

    def _check_controller(self, name: str, mark: Mark) -> None:
        from scuhand_bt.dosing import CONTROLLERS

        if name not in CONTROLLERS:
            self.problems.add(
                mark, f"unknown controller '{shorten(name)}'", unknown=name, known=CONTROLLERS, code="unknown-name"
            )

    def _check_unused(self, samples: Sequence[Sample], used: Collection[str]) -> None:
        """Warn of sources that no sample names."""
        for name, mark in self.source_marks.items():
            if samples and name not in used:
                what = f"no sample takes from '{name}'"
                self.problems.warn(mark, what, "remove it, or name it in a sample", code="unused-source")

    # --- the batch as a whole

    def _read_on_failure(self, node: Node | None) -> dict[str, Action]:
        policy = dict(DEFAULT_ON_FAILURE)
        if node is None:
            return policy
        if not isinstance(node, Entries):
            self.problems.add(
                node.mark,
                f"'on_failure' must be a mapping, not {describe(node)}",
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
                    f"{describe(value)} is not an action",
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
            what = f"'overshoot_limit' must be a number of samples, not '{shorten(text)}'"
            self.problems.add(
                root.values["overshoot_limit"].mark, what, "a whole number, or 0 for no limit", code="bad-value"
            )
            return OVERSHOOT_LIMIT
        return int(text)
