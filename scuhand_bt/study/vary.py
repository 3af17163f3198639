"""What a study varies: figures of the recipe and its lab, over ranges or lists, by an experimental design.

design: latin_hypercube      # or sobol, or grid
draws: 64                    # grid: steps of each range; sobol: a power of two
vary:
  powders.glass_beads.simulation.flow_coefficient: {from: 50, to: 100}
  recipe.samples.0.mass: {from: 20 mg, to: 60 mg}
  recipe.controller: [paper, adaptive]
"""

import itertools
import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from pydantic import Discriminator, Field, Tag, ValidationInfo, field_validator, model_validator
from scipy.stats import qmc, sobol_indices, spearmanr

from scuhand_bt.lab import load_lab
from scuhand_bt.problems import Problem, Problems, SourceError
from scuhand_bt.quantity import ANGLE, DENSITY, DURATION, LENGTH, MASS, RATIO, SPEED, VOLUME, parse
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.specs import Spec
from scuhand_bt.study.change import Changes, changed, file_of, with_value
from scuhand_bt.study.trial import Setup
from scuhand_bt.validation import validate
from scuhand_bt.yaml_source import Entries, load

_NUMBER = re.compile(r"([+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?)(.*)", re.DOTALL)


class Between(Spec):
    """A range between two numbers of the same unit, or without one."""

    from_: Annotated[str, Field(alias="from")]
    to: str

    @model_validator(mode="after")
    def _is_a_range(self) -> "Between":
        low, high = _NUMBER.fullmatch(self.from_.strip()), _NUMBER.fullmatch(self.to.strip())
        if (
            low is None
            or high is None
            or low[2].strip() != high[2].strip()
            or not 0.0 < float(high[1]) - float(low[1]) < math.inf
        ):
            raise ValueError(
                "a range goes from a smaller to a larger number of the same unit, such as {from: 20 mg, to: 60 mg}"
            )
        return self

    def at(self, share: float) -> str:
        """The value at a share (0 to 1) of the range."""
        low, high = _NUMBER.fullmatch(self.from_.strip()), _NUMBER.fullmatch(self.to.strip())
        assert low is not None
        assert high is not None
        return f"{float(low[1]) + share * (float(high[1]) - float(low[1])):.9g}{low[2]}"


_UNITS = (MASS, DURATION, LENGTH, ANGLE, VOLUME, DENSITY, SPEED, RATIO)
MOST_DRAWS = 65_536

Given: TypeAlias = Annotated[
    Annotated[Between, Tag("a range")] | Annotated[list[str], Field(min_length=1), Tag("a list")],
    Discriminator(
        lambda given: {list: "a list", dict: "a range"}.get(type(given)),
        custom_error_type="no_values",
        custom_error_message="a range, such as {from: 20 mg, to: 60 mg}, or a list of values, such as [20 mg, 60 mg]",
    ),
]


class Vary(Spec):
    """What is varied, and by which design."""

    design: Literal["latin_hypercube", "sobol", "grid"] = "latin_hypercube"
    draws: Annotated[int, Field(gt=0, le=MOST_DRAWS)] = 64
    vary: dict[str, Given]

    @field_validator("vary")
    @classmethod
    def _names_a_place(cls, vary: dict[str, Given]) -> dict[str, Given]:
        if not vary:
            raise ValueError("at least one place, such as {cell.balance.readability: [0.1 mg, 1 mg]}")
        return vary

    @field_validator("draws")
    @classmethod
    def _is_for_the_design(cls, draws: int, others: ValidationInfo) -> int:
        if others.data.get("design") == "sobol" and draws & (draws - 1):
            raise ValueError("a sobol design needs a power of two")
        return draws

    def changes(self, seed: int = 0) -> list[Changes]:
        """The draws, each with a value for every place; the same for the same seed.

        For `sobol` these are (d + 2) n draws of d places: the matrices A and B, and A with each column of B in turn
        (Saltelli et al., Comput. Phys. Commun. 181, 259, 2010; in the order of scipy.stats.sobol_indices).
        """
        if self.design == "grid":
            steps = [self._steps(given) for given in self.vary.values()]
            return [tuple(zip(self.vary, values, strict=True)) for values in itertools.product(*steps)]
        places = len(self.vary)
        if self.design == "latin_hypercube":
            shares = qmc.LatinHypercube(places, rng=np.random.default_rng(seed)).random(self.draws)
        else:
            both = qmc.Sobol(2 * places, rng=np.random.default_rng(seed)).random(self.draws)
            first, second = both[:, :places], both[:, places:]
            mixed = [np.where(np.arange(places) == place, second, first) for place in range(places)]
            shares = np.concatenate([first, second, *mixed])
        return [self._at(row) for row in shares]

    @property
    def points(self) -> int:
        """Number of points of a grid."""
        return math.prod(len(given) if isinstance(given, list) else self.draws for given in self.vary.values())

    def _steps(self, given: Between | list[str]) -> list[str]:
        return given if isinstance(given, list) else [given.at(share) for share in np.linspace(0.0, 1.0, self.draws)]

    def _at(self, shares: Any) -> Changes:
        return tuple(
            (place, given.at(share) if isinstance(given, Between) else given[int(share * len(given))])
            for (place, given), share in zip(self.vary.items(), shares, strict=True)
        )

    def ends(self) -> list[Changes]:
        """Both ends of each range and each item of each list, with everything else as written."""
        return [
            ((place, value),)
            for place, given in self.vary.items()
            for value in (given if isinstance(given, list) else (given.at(0.0), given.at(1.0)))
        ]

    def indices(self, figures: Sequence[float]) -> Mapping[str, tuple[float, float]]:
        """First-order and total Sobol indices of a figure by place, from its values for the draws of `sobol`."""
        values, places = np.asarray(figures, dtype=float).reshape(-1, self.draws), len(self.vary)
        if np.ptp(values) == 0.0:
            return dict.fromkeys(self.vary, (0.0, 0.0))
        if places == 1:
            return dict.fromkeys(self.vary, (1.0, 1.0))
        found = sobol_indices(
            func={"f_A": values[:1], "f_B": values[1:2], "f_AB": values[2:].reshape(places, 1, self.draws)},
            n=self.draws,
        )
        return {
            place: (float(first), float(total))
            for place, first, total in zip(
                self.vary, np.ravel(found.first_order), np.ravel(found.total_order), strict=True
            )
        }


def read_vary(path: Path, recipe: Path, lab: Path) -> Vary:
    """Read such a file and check it against what it varies. Raises SourceError with every mistake found."""
    problems = Problems()
    root = load(path, "a file of what to vary")
    vary = validate(Vary, root, problems, "a mapping such as {vary: {cell.balance.readability: [0.1 mg, 1 mg]}}")
    if vary is not None and vary.design == "grid" and (many := vary.points) > MOST_DRAWS:
        problems.add(root.mark, f"a grid of {many} points", f"at most {MOST_DRAWS}: fewer `draws`, or another design")
    places = root.get("vary") if isinstance(root, Entries) else None
    for place, mark in places.keys.items() if isinstance(places, Entries) else ():
        try:
            with_value(file_of(place, recipe, lab).read_text(encoding="utf-8"), place, "")
        except SourceError as error:
            for problem in error.problems:
                problems.add(mark, f"'{place}': {problem.message}")
    problems.raise_any()
    assert vary is not None
    return vary


def ends_of(draws: Sequence[Setup]) -> list[Setup]:
    """The draws with the least and the greatest number of each place, and one with each of its names."""
    values = [dict(draw.changes) for draw in draws]
    ends: dict[Setup, None] = {}
    for place in values[0]:
        of_place = [str(one[place]) for one in values]
        numbers = _numbers(of_place)
        first = {name: of_place.index(name) for name in dict.fromkeys(of_place)} if numbers is None else {}
        found = first.values() if numbers is None else (int(np.argmin(numbers)), int(np.argmax(numbers)))
        ends |= dict.fromkeys(draws[number] for number in found)
    return list(ends)


def check_setups(setups: Sequence[Setup]) -> None:
    """Plan each setup. Raises SourceError with everything that is wrong with them.

    Without this, a study would end only when it comes to the wrong one, and its trials could not be reused after the
    file is corrected.
    """
    problems: list[Problem] = []
    for setup in setups:
        try:
            with changed(setup.recipe, setup.lab, setup.changes) as (recipe, folder):
                lab = load_lab(folder)
                make_plan(load_recipe(recipe, lab), lab)
        except SourceError as error:
            problems += error.problems
    if problems:
        raise SourceError(problems)


def goes_with(draws: Sequence[Setup], figures: Sequence[float]) -> Mapping[str, float]:
    """Spearman's rank correlation of a figure with each numeric place; 0 if one of them is constant."""
    found: dict[str, float] = {}
    for place in dict(draws[0].changes) if draws else ():
        values = _numbers([str(dict(draw.changes)[place]) for draw in draws])
        if values is not None:
            is_flat = np.ptp(values) == 0.0 or np.ptp(figures) == 0.0
            found[place] = 0.0 if is_flat else float(spearmanr(values, figures).statistic)
    return found


def means_of(draws: Sequence[Setup], figures: Sequence[float]) -> Mapping[str, Mapping[str, float]]:
    """The mean of a figure for each value of each place that has names."""
    found: dict[str, dict[str, float]] = {}
    for place in dict(draws[0].changes) if draws else ():
        names = [str(dict(draw.changes)[place]) for draw in draws]
        if _numbers(names) is None:
            came: dict[str, list[float]] = {}
            for name, figure in zip(names, figures, strict=True):
                came.setdefault(name, []).append(figure)
            found[place] = {name: sum(of) / len(of) for name, of in came.items()}
    return found


def _numbers(texts: Sequence[str]) -> list[float] | None:
    """The values as numbers of one unit; None if they are not."""
    found = [_NUMBER.fullmatch(text.strip()) for text in texts]
    if len({match and match[2].strip() for match in found}) == 1:
        return [float(match[1]) for match in found if match is not None] or None
    for unit in _UNITS:
        with suppress(ValueError):
            return [parse(text, unit) for text in texts]
    return None
