"""`compose`: a sample given by the formula of its product, instead of by masses (docs/compose.md).

    compose: {product: LiCoO2, amount: 2 g, tolerance: 1 %, from: [Li2CO3 (excess 5 %), Co3O4]}

It yields the workflow inputs `sources`, `masses` and `tolerances`, and `first` (the first source) if the workflow has
that input. The workflow must also take a `container`. A sample's own keys override those of `defaults`; a bare formula
is the product.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import Field

from scuhand_bt.device_specs.balance import BalanceSpec
from scuhand_bt.formula import Formula, FormulaText, is_element, parse_formula
from scuhand_bt.problems import Mark, Problems, shorten
from scuhand_bt.quantity import RATIO, Milligrams, Ratio, format_mass, parse
from scuhand_bt.recipe.composition import Composition
from scuhand_bt.recipe.stoichiometry import Imbalance, Lot, balanced, composed
from scuhand_bt.specs import Assay, Positive, Source, Spec
from scuhand_bt.tree.workflow import Workflow
from scuhand_bt.validation import validate
from scuhand_bt.yaml_source import Entries, Items, Node, Scalar, describe

COMPOSE = "compose"
TAKEN = {"sources": "[Source]", "masses": "[Mass]", "tolerances": "[Mass]"}
"""The inputs that `compose` sets, and the types that the workflow must declare for them."""
CONTAINER, FIRST = "container", "first"
IGNORED = ("C", "H", "N", "O")
"""Elements exchanged with the atmosphere, which are not balanced unless the recipe says otherwise."""
MOST_EXCESS, LEAST_EXCESS = 1.0, -0.5
_EXCESS = re.compile(r"(?P<name>.+?)\s*\(\s*excess\s+(?P<excess>[^()]+?)\s*\)")


class ComposeText(Spec):
    """`compose` as a recipe writes it."""

    product: FormulaText
    """Its formula, such as Li6.5La3Zr1.5Ta0.5O12."""
    amount_mg: Annotated[Milligrams, Positive]
    """Mass of the stoichiometric product; an excess is added to it."""
    powders: Annotated[tuple[str, ...], Field(alias="from", min_length=1)]
    """For each powder its formula, its name or that of a source, with an optional `(excess 10 %)`."""
    tolerance_ratio: Annotated[Ratio, Field(gt=0, lt=1)]
    """Largest deviation of each element, relative to what the formula asks for."""
    ignore: tuple[str, ...] = IGNORED
    """Elements that are not balanced."""


@dataclass(frozen=True)
class Composed:
    """The result of `compose`: inputs for the workflow, and the composition to reach."""

    inputs: Mapping[str, Any]
    composition: Composition

    @property
    def sources(self) -> tuple[Source, ...]:
        return self.inputs["sources"]  # type: ignore[no-any-return]


def takes_composed(workflow: Workflow) -> bool:
    """Whether a workflow has the inputs that `compose` sets."""
    types = {name: declared.type.name for name, declared in workflow.inputs.items()}
    return all(types.get(name) == wanted for name, wanted in {**TAKEN, CONTAINER: "Container"}.items())


def check_by_hand(workflow: Workflow, inputs: Mapping[str, Any], given: Mapping[str, Node], problems: Problems) -> None:
    """Check `sources` and `first` where they are written by hand for a workflow that could also be composed for.

    `first` must be the first of `sources`, as no sheet is swapped before it. No source may be listed twice: a dose
    counts what the container already holds of its lot.
    """
    first, sources = inputs.get(FIRST), inputs.get("sources")
    if not (takes_composed(workflow) and isinstance(first, Source) and sources):
        return
    if first.name != sources[0].name:
        what = f"'{FIRST}' is '{first.name}', but 'sources' begins with '{sources[0].name}'"
        problems.add(given[FIRST].mark, what, f"{FIRST}: {sources[0].name}", code="bad-value")
    listed, names = given["sources"], [source.name for source in sources]
    for number, name in enumerate(names):
        if name in names[:number]:
            mark = listed.items[number].mark if isinstance(listed, Items) else listed.mark
            what = f"'{name}' is in 'sources' twice"
            problems.add(mark, what, "name it once, with its total mass", code="bad-value")


@dataclass(frozen=True)
class Composer:
    """Composes samples from a recipe's sources. `source_marks` also names the sources that could not be read."""

    sources: Mapping[str, Source]
    source_marks: Mapping[str, Mark]
    balance: BalanceSpec
    problems: Problems

    def of_sample(self, entry: Entries, defaults: Entries, workflow: Workflow) -> tuple[set[str], Composed | None]:
        """The names of the inputs that `compose` sets for this sample, and what it yields.

        The set is empty if the sample is not composed. The result is None if something is wrong, which is then
        reported.
        """
        own, shared = entry.get(COMPOSE), defaults.get(COMPOSE)
        if not takes_composed(workflow):
            if own is not None and workflow.is_whole:
                inputs = ", ".join(f"{name}: {wanted}" for name, wanted in TAKEN.items())
                what = f"the workflow '{workflow.name}' cannot be used with '{COMPOSE}'"
                remedy = f"use one with the inputs {CONTAINER}: Container, {inputs}"
                self.problems.add(entry.keys[COMPOSE], what, remedy, code="not-composing")
            return set(), None
        if own is None and shared is None:
            return set(), None
        has_first = FIRST in workflow.inputs and workflow.inputs[FIRST].type.name == "Source"
        made = {*TAKEN, FIRST} if has_first else set(TAKEN)
        for key in made & entry.keys.keys():
            what = f"'{key}' is already set by '{COMPOSE}'"
            self.problems.add(
                entry.keys[key], what, "leave it out, or write the sample without `compose`", code="composed-input"
            )
        parts = [self._entries(node) for node in (shared, own) if node is not None]
        whole = [part for part in parts if part is not None]
        if len(whole) < len(parts):
            return made, None
        keys = {key: mark for part in whole for key, mark in part.keys.items()}
        values = {key: value for part in whole for key, value in part.values.items()}
        return made, self._composed(Entries(whole[-1].mark, keys, values))

    def _entries(self, node: Node) -> Entries | None:
        if isinstance(node, Scalar) and node.text:
            return Entries(node.mark, {"product": node.mark}, {"product": node})
        if isinstance(node, Entries):
            return node
        what = f"'{COMPOSE}' must be a composition, not {describe(node)}"
        self.problems.add(node.mark, what, "{product: …, amount: …, tolerance: …, from: […]}", code="wrong-shape")
        return None

    def _composed(self, node: Entries) -> Composed | None:
        """What the sample is composed of; None if something is wrong, which is then reported."""
        text = validate(ComposeText, node, self.problems)
        items = node.get("from")
        is_sound = text is not None and self._check_ignored(text, node)
        chosen = [self._chosen(item) for item in items] if isinstance(items, Items) else []
        if text is None or not is_sound or not isinstance(items, Items) or None in chosen:
            return None
        found = [one for one in chosen if one is not None]
        product, formulas = parse_formula(text.product), [lot.formula for _, lot in found]
        amounts = balanced(product, formulas, text.ignore)
        wrong = [one for one in amounts if isinstance(one, Imbalance)]
        for one in wrong:
            at = node.values["product"] if one.number is None else items.items[one.number]
            self.problems.add(at.mark, one.what, one.remedy, code=one.code)
        if wrong:
            return None
        shares = [one for one in amounts if not isinstance(one, Imbalance)]
        lots = [lot for _, lot in found]
        try:
            made = composed(product, text.amount_mg, lots, shares, text.ignore, text.tolerance_ratio)
        except ValueError as error:
            remedy = (
                "allow a wider tolerance, or give the source the uncertainty of a better assay (`purity_uncertainty`)"
            )
            self.problems.add(node.values["tolerance"].mark, str(error), remedy, code="uncertain-assay")
            return None
        if not self._is_told(made, node.values["tolerance"].mark):
            return None
        by_lot = {source.sheet_key: source for source, _ in found}
        sources = tuple(by_lot[powder.lot] for powder in made.powders)
        masses, tolerances = ([p.target_mg for p in made.powders], [p.tolerance_mg for p in made.powders])
        values = {"sources": sources, "masses": tuple(masses), "tolerances": tuple(tolerances), FIRST: sources[0]}
        return Composed(values, made)

    def _check_ignored(self, text: ComposeText, node: Entries) -> bool:
        unknown = [number for number, symbol in enumerate(text.ignore) if not is_element(symbol)]
        listed = node.get("ignore")
        for number in unknown:
            mark = listed.items[number].mark if isinstance(listed, Items) else node.mark
            what = f"there is no element '{shorten(text.ignore[number])}'"
            self.problems.add(mark, what, "write symbols, such as [O, C]", code="bad-formula")
        return not unknown

    def _is_told(self, made: Composition, mark: Mark) -> bool:
        """Whether the balance's readability suffices for the tolerances of all doses."""
        least_mg = self.balance.least_tolerance_mg
        narrow = min(made.powders, key=lambda powder: powder.tolerance_mg)
        if narrow.tolerance_mg >= least_mg:
            return True
        needs = f"{format_mass(narrow.target_mg)} of {narrow.formula} within {narrow.tolerance_mg:g} mg"
        untold = f"which is too fine for a readability of {self.balance.readability_mg:g} mg"
        what = f"a tolerance of {100.0 * made.tolerance:g} % of each element needs {needs}, {untold}"
        remedy = f"at least {least_mg:g} mg is possible: allow a wider tolerance, or make a larger amount"
        self.problems.add(mark, what, remedy, code="fine-tolerance")
        return False

    def _chosen(self, item: Node) -> tuple[Source, Lot] | None:
        """The source and lot that one entry of `from` means; None if that is wrong, which is then reported."""
        text = item.text if isinstance(item, Scalar) else None
        if not text:
            return None  # already reported
        with_excess = _EXCESS.fullmatch(text.strip())
        name, excess = (with_excess["name"], self._excess(with_excess["excess"], item)) if with_excess else (text, 0.0)
        if with_excess is None and re.search(r"\bexcess\b", text):
            what = f"the excess in {describe(item)} cannot be read"
            self.problems.add(item.mark, what, "write it as Li2CO3 (excess 10 %)", code="bad-excess")
            return None
        source = self._source(name.strip(), item.mark)
        if source is None or excess is None:
            return None
        powder, place = source.powder, self.source_marks[source.name]
        if powder.formula is None:
            what = f"'{powder.name}' has no formula"
            self.problems.add(item.mark, what, "add `formula: …` to it in robot/powders.yaml", code="no-formula")
            return None
        if source.purity_ratio is None:
            what = f"'purity' of '{source.name}' is missing: a composed sample needs it"
            self.problems.add(place, what, "write what its certificate says, such as purity: 99.5 %", code="no-purity")
            return None
        share, uncertainty = assay_of(source, source.purity_ratio)
        return source, Lot(source.sheet_key, parse_formula(powder.formula), share, uncertainty, excess)

    def _excess(self, text: str, item: Node) -> float | None:
        try:
            excess = parse(text, RATIO)
        except ValueError as error:
            self.problems.add(item.mark, f"the excess of {describe(item)}: {error}", code="bad-excess")
            return None
        if LEAST_EXCESS <= excess <= MOST_EXCESS:
            return excess
        allowed = f"{100.0 * LEAST_EXCESS:g} % to {100.0 * MOST_EXCESS:g} %"
        self.problems.add(item.mark, f"an excess of {100.0 * excess:g} % is not possible", allowed, code="bad-excess")
        return None

    def _source(self, name: str, mark: Mark) -> Source | None:
        """The one source that is meant, by its own name, its powder's name or its powder's formula."""
        if name in self.source_marks:
            return self.sources.get(name)  # None if the source itself is wrong, which is already reported
        found = [source for source in self.sources.values() if source.powder.name == name]
        if not found:
            try:
                formula = parse_formula(name)
            except ValueError as error:
                what = f"'{shorten(name)}' is not a source, not the powder of a source, and not a formula: {error}"
                self.problems.add(mark, what, unknown=name, known=self._known(), code="bad-formula")
                return None
            found = [source for source in self.sources.values() if _is_of(source, formula)]
        if len(found) == 1:
            return found[0]
        if found:
            what = f"several sources hold '{name}'"
            names = " or ".join(f"'{source.name}'" for source in found)
            self.problems.add(mark, what, f"write which: {names}", code="several-sources")
        elif len(self.sources) == len(self.source_marks):  # else a source that is already reported may be meant
            silent = sorted({one.powder.name for one in self.sources.values() if one.powder.formula is None})
            what = f"no source holds {shorten(name)}"
            what += f", as far as is known: {', '.join(silent)} in robot/powders.yaml has no formula" if silent else ""
            self.problems.add(mark, what, unknown=name, known=self._known(), code="no-source")
        return None

    def _known(self) -> Sequence[str]:
        return [source.powder.formula or name for name, source in self.sources.items()]


def assay_of(lot: Assay, purity: float) -> tuple[float, float]:
    """The mass fraction of the formula in a lot, p (1 - w), and its relative standard uncertainty.

    Without stated uncertainties, purity is taken as uniform within ± (1 - p), and water within ± w.
    """
    u_purity, u_water = lot.purity_uncertainty_ratio, lot.water_uncertainty_ratio
    u_purity = (1.0 - purity) / math.sqrt(3.0) if u_purity is None else u_purity
    u_water = lot.water_ratio / math.sqrt(3.0) if u_water is None else u_water
    dry = 1.0 - lot.water_ratio
    return purity * dry, math.hypot(u_purity / purity, u_water / dry)


def _is_of(source: Source, formula: Formula) -> bool:
    """Whether a source's powder has this formula, however it is written."""
    mine = source.powder.formula
    return mine is not None and dict(parse_formula(mine).counts) == dict(formula.counts)
