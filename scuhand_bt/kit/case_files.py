"""Test files: `trees/NAME.test.yaml` says how a lab's workflows are tested, on simulated devices.

test: scoop_and_dispense
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 5 g}
inputs: {source: beads, container: xrd_holder, mass: 50 mg}
cases:
  - name: it scoops again when the cone is empty
    substitute: [{at: "**/dispense", call: 1, fails: hand.cone_empty}]
    expect: {times: {scoop: 1, dispense: 2}}
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, TypeAdapter, ValidationError

from scuhand_bt.kit.rehearsed import leaves_of
from scuhand_bt.lab import TEST_SUFFIX, Lab
from scuhand_bt.problems import Mark, Problems, SourceError, shorten
from scuhand_bt.quantity import Seconds
from scuhand_bt.recipe.plan import Plan, make_plan
from scuhand_bt.recipe.recipe import recipe_of
from scuhand_bt.sim.fault_rules import FaultFile, faults_of
from scuhand_bt.skill import Skill
from scuhand_bt.specs import Spec
from scuhand_bt.tree.substitutes import Substitution
from scuhand_bt.tree.wires import in_words, of_field
from scuhand_bt.validation import validate
from scuhand_bt.yaml_source import Entries, Items, Node, Scalar, describe, from_plain, load, plain

KEYS = ("test", "summary", "sources", "inputs", "cases")
CASE_KEYS = ("name", "inputs", "seed", "substitute", "faults", "expect", "trace")
SAMPLE = "test"
"""The id of the one sample."""
SUCCESS = "success"


class Substituted(Spec):
    """One entry of `substitute`."""

    at: str
    """The place in the tree: `*` within one part of it, `**` any parts."""
    call: Annotated[int | None, Field(ge=1)] = None
    """Only the nth call of this place."""
    takes_s: Annotated[Seconds, Field(ge=0)] = 0.0
    """How long it takes before."""
    fails: str | None = None
    """The code that it fails with."""


class Expectation(Spec):
    """What must come of a case; what is left out may be as it is."""

    outcome: str = SUCCESS
    """`success`, or the code of the failure."""
    verdict: str | None = None
    """Of the sample's dose."""
    calls: tuple[str, ...] | None = None
    """The skills that are called, all of them in their order."""
    times: dict[str, int] = Field(default_factory=dict)
    """How often a skill is called; 0 for one that must not be."""
    values: dict[str, Any] = Field(default_factory=dict)
    """Of the last result of a skill, `skill` or `skill.attribute`: a value, or {about, within}."""
    recorded: dict[str, Any] = Field(default_factory=dict)
    """What stands in the sample's row, by name, in the row's unit: a value, or {about, within}."""


@dataclass(frozen=True)
class Case:
    """One test."""

    mark: Mark
    name: str
    plan: Plan
    substitutes: tuple[Substitution, ...]
    faults: FaultFile | None
    seed: int
    expect: Expectation
    trace: Path | None
    """The golden trace, if it has one."""


@dataclass(frozen=True)
class TestFile:
    """The tests of one workflow."""

    __test__ = False

    path: Path
    workflow: str
    cases: tuple[Case, ...]


def read_test_file(path: Path, lab: Lab) -> TestFile:
    """Read a test file; SourceError with all that is wrong in it, and in what it uses."""
    problems = Problems()
    root = load(path, "a test of a workflow")
    read = _Reader(path, lab, problems).read(root)
    problems.raise_any()
    assert read is not None
    return read


def case_of(workflow: str, values: Mapping[str, Any], lab: Lab) -> Case:
    """A test given in Python, by the keys of a file; SourceError with all that is wrong in it."""
    given = {key: value for key, value in values.items() if value not in (None, (), [])}
    shared = {"test": workflow, **({"sources": given.pop("sources")} if "sources" in given else {})}
    root = from_plain({**shared, "cases": [{"name": workflow, **given}]}, "test")
    problems = Problems()
    read = _Reader(Path("test"), lab, problems).read(root)
    problems.raise_any()
    assert read is not None
    return read.cases[0]


class _Reader:
    def __init__(self, path: Path, lab: Lab, problems: Problems) -> None:
        self._path = path
        self._lab = lab
        self._problems = problems

    def read(self, root: Node) -> TestFile | None:
        problems = self._problems
        if not isinstance(root, Entries):
            what = f"expected a test, found {describe(root)}"
            problems.add(root.mark, what, "a test is a mapping with the key 'test'", code="wrong-shape")
            return None
        self._only(root, KEYS)
        workflow, cases = root.get("test"), root.get("cases")
        name = workflow.text if isinstance(workflow, Scalar) else None
        if name is None or name not in self._lab.library.workflows:
            known = self._lab.library.workflows
            mark = workflow.mark if workflow else root.mark
            problems.add(mark, f"unknown workflow '{shorten(name or '')}'", unknown=name or "", known=known)
            return None
        if not isinstance(cases, Items) or not cases.items:
            problems.add(cases.mark if cases else root.mark, "'cases' names no test", "- {name: …, expect: {…}}")
            return None
        read = [self._case(case, name, root) for case in cases.items]
        return TestFile(self._path, name, tuple(case for case in read if case is not None))

    def _only(self, node: Entries, known: Sequence[str]) -> None:
        for key, mark in node.keys.items():
            if key not in known:
                self._problems.add(mark, f"unknown key '{shorten(key)}'", unknown=key, known=known, code="unknown-key")

    def _case(self, node: Node, workflow: str, root: Entries) -> Case | None:
        problems, before = self._problems, len(self._problems.found)
        name_node = node.get("name") if isinstance(node, Entries) else None
        if not isinstance(node, Entries) or not isinstance(name_node, Scalar) or not name_node.text:
            problems.add(node.mark, "a test has a 'name': the sentence that it proves", "- {name: …, expect: {…}}")
            return None
        self._only(node, CASE_KEYS)
        plan = self._plan(node, workflow, root)
        substitutes = tuple(self._substitutes(node.get("substitute"), workflow))
        faults = self._faults(node.get("faults"))
        expect_node = node.get("expect")
        expect = validate(Expectation, expect_node, problems) if expect_node is not None else Expectation()
        if expect is not None and isinstance(expect_node, Entries):
            self._check(expect, expect_node)
        seed = node.get("seed")
        if isinstance(seed, Scalar) and not (seed.text or "").isdigit():
            problems.add(seed.mark, f"'seed' cannot be {describe(seed)}", "a whole number, such as 1", code="bad-value")
        trace = node.get("trace")
        golden = self._path.with_name(trace.text) if isinstance(trace, Scalar) and trace.text else None
        if len(problems.found) > before or plan is None or expect is None:
            return None
        number = int(seed.text or "0") if isinstance(seed, Scalar) else 0
        return Case(node.mark, name_node.text, plan, substitutes, faults, number, expect, golden)

    def _plan(self, node: Entries, workflow: str, root: Entries) -> Plan | None:
        """A recipe of one sample, made of the inputs of the file and those of the case."""
        sample = Entries(node.mark, {"id": node.mark}, {"id": Scalar(node.mark, SAMPLE)})
        for given in (root.get("inputs"), node.get("inputs")):
            if isinstance(given, Entries):
                sample.keys.update(given.keys)
                sample.values.update(given.values)
            elif given is not None:
                self._problems.add(given.mark, f"'inputs' must be a mapping, not {describe(given)}", code="wrong-shape")
        policy = Entries(node.mark, {"otherwise": node.mark}, {"otherwise": Scalar(node.mark, "flag")})
        parts: dict[str, Node] = {
            "workflow": Scalar(root.values["test"].mark, workflow),
            "samples": Items(node.mark, [sample]),
            "on_failure": policy,
            **({"sources": root.values["sources"]} if "sources" in root.values else {}),
        }
        recipe_root = Entries(root.mark, {key: part.mark for key, part in parts.items()}, parts)
        of_recipe = Problems()
        recipe = recipe_of(recipe_root, self._path.with_name("test"), "", self._lab, of_recipe)
        self._problems.found += of_recipe.errors
        if recipe is None or of_recipe.errors:
            return None
        try:
            return make_plan(recipe, self._lab)
        except SourceError as error:
            self._problems.found += error.problems
            return None

    def _substitutes(self, node: Node | None, workflow: str) -> Sequence[Substitution]:
        if node is None:
            return []
        if not isinstance(node, Items):
            self._problems.add(node.mark, f"'substitute' must be a list, not {describe(node)}", "- {at: …, fails: …}")
            return []
        found = [self._substitution(item, workflow) for item in node.items]
        return [one for one in found if one is not None]

    def _substitution(self, node: Node, workflow: str) -> Substitution | None:
        problems, library = self._problems, self._lab.library
        gives = node.get("gives") if isinstance(node, Entries) else None
        rule = validate(Substituted, node.without("gives") if isinstance(node, Entries) else node, problems)
        if rule is None or not isinstance(node, Entries):
            return None
        if rule.fails is not None and rule.fails not in library.failures():
            mark, known = node.values["fails"].mark, library.failures()
            problems.add(mark, f"unknown failure code '{shorten(rule.fails)}'", unknown=rule.fails, known=known)
        if rule.fails is not None and gives is not None:
            problems.add(gives.mark, "it either fails or gives a result", "write one of 'fails' and 'gives'")
        made = Substitution(node.mark, rule.at, rule.call, rule.takes_s, rule.fails, gives is not None)
        leaves = leaves_of(self._lab, workflow)
        at = [leaf for leaf in leaves if made.fits(leaf)]
        if not at:
            near = ", ".join(sorted({f"**/{leaf.rsplit('/', 1)[1]}" for leaf in leaves}))
            problems.add(node.values["at"].mark, f"no skill of '{workflow}' is at '{shorten(rule.at)}'", near)
        elif gives is not None:
            made.result = self._result(gives, library.skills[at[0].rsplit("/", 1)[1]])
        return made

    def _result(self, node: Node, skill: type[Skill[Any]]) -> Any:
        """A result as YAML has it: quantities with their units, attributes without."""
        wire = of_field(skill.result_type())
        try:
            given = plain(node)
            if wire.is_class and isinstance(given, dict):
                attributes = wire.attributes()
                fields = {attributes[key][0]: attributes[key][1].read(value) for key, value in given.items()}
                return TypeAdapter(skill.result_type()).validate_python(fields, by_name=True, by_alias=False)
            return None if given is None else wire.read(given)
        except ValidationError as error:
            self._problems.add(node.mark, f"no {wire.name}: {in_words(error)}", code="bad-value")
        except KeyError as error:
            self._problems.add(
                node.mark, f"a {wire.name} has no {error}", unknown=str(error.args[0]), known=wire.attributes()
            )
        except ValueError as error:
            self._problems.add(node.mark, f"no {wire.name}: {error}", code="bad-value")
        return None

    def _faults(self, node: Node | None) -> FaultFile | None:
        if node is None:
            return None
        root = Entries(node.mark, {"faults": node.mark}, {"faults": node})
        return faults_of(root, "", self._problems)

    def _check(self, expect: Expectation, node: Entries) -> None:
        """The names that it expects something of must be those of the lab."""
        library, problems = self._lab.library, self._problems
        if expect.outcome != SUCCESS and expect.outcome not in library.failures():
            mark, known = node.values["outcome"].mark, [SUCCESS, *library.failures()]
            problems.add(mark, f"unknown outcome '{shorten(expect.outcome)}'", unknown=expect.outcome, known=known)
        named = [*(expect.calls or ()), *expect.times, *(name.split(".")[0] for name in expect.values)]
        for name in named:
            if name not in library.skills:
                problems.add(node.mark, f"unknown skill '{shorten(name)}'", unknown=name, known=library.skills)
        for name, wanted in expect.values.items():
            self._check_value(name, wanted, node.values["values"].mark)

    def _check_value(self, name: str, wanted: Any, mark: Mark) -> None:
        skill, *parts = name.split(".")
        if skill not in self._lab.library.skills:
            return
        wire = of_field(self._lab.library.skills[skill].result_type())
        for part in parts:
            if part not in wire.attributes():
                what = f"a {wire.name} has no attribute '{shorten(part)}'"
                self._problems.add(mark, what, unknown=part, known=wire.attributes())
                return
            wire = wire.attributes()[part][1]
        given = [wanted.get("about"), wanted.get("within")] if isinstance(wanted, dict) else [wanted]
        for value in given:
            try:
                wire.read(value)
            except ValueError as error:
                self._problems.add(mark, f"'{name}' is a {wire.name}: {error}", code="bad-value")


def find_test_files(where: Path) -> list[Path]:
    """The test files of a folder, or the one that is named."""
    return sorted(where.glob(f"*{TEST_SUFFIX}")) if where.is_dir() else [where]
