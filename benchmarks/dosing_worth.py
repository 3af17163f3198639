"""What each tuned constant is worth: two columns of the table of constants in docs/dosing-constants.md.

Of a variant of `dosing_constants.yaml` all cells of its world are taken together and held against the law as it is. A
difference is told where it exceeds two standard deviations of what chance makes of two sets of doses (each cell's
spread, counts as Poisson's); among this many about one in twenty does so by chance.
"""

import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence

AS_IT_IS, AGAIN = "as it is", "as it is, other seeds"
DEVIATIONS = 2.0
COLUMNS = ("shipped", "randomised")
CELLS = 6
"""Of the table: name, value, what it is, from, and the two columns."""
MODULE = re.compile(r"\b[a-z]+\.(?=[A-Z])")
NOISE, END = "<!-- noise -->", "<!-- end of noise -->"
Results = Mapping[str, Mapping[str, float]]
"""Figures of `benchmarks.dosing_ablation`, by 'world | plants | variant | powder or family | target'."""
Pair = tuple[Mapping[str, float], Mapping[str, float]]
"""A cell's figures as the law is, and with the variant."""


def pairs_of(results: Results, world: str, plants: str, text: str) -> list[Pair]:
    """Of each cell; none where the variant has not been measured."""
    start = f"{world} | {plants} | {text} | "
    return [
        (results[key.replace(start, f"{world} | {plants} | {AS_IT_IS} | ")], of)
        for key, of in results.items()
        if key.startswith(start)
    ]


def differences(pairs: Sequence[Pair]) -> Iterator[tuple[float, float, str]]:
    """Each difference, what it is by chance (its standard deviation), and in words."""
    doses = sum(of["doses"] for _, of in pairs)

    def counted(name: str, label: str) -> tuple[float, float, str]:
        before, after = (sum(pair[side][name] for pair in pairs) for side in (0, 1))
        return after - before, math.sqrt(after + before), f"{label} {after:g} instead of {before:g}"

    good = sum(after["true"] - before["true"] for before, after in pairs) / len(pairs)
    missed = sum(of["doses"] * (1.0 - of["true"] / 100.0) for pair in pairs for of in pair)
    yield good, 100.0 * math.sqrt(missed) / doses, f"success {good:+.1f} points"
    yield counted("over", "too much")
    yield counted("beyond_20mg", "> 20 mg")
    yield counted("out", "false 'in tolerance'")
    told = sum(after["reported"] - before["reported"] for before, after in pairs)
    untold = sum(of["doses"] - of["reported"] for pair in pairs for of in pair)
    yield told, math.sqrt(untold), f"reported good {100.0 * told / doses:+.1f} points"
    mean_mg = sum(after["mean_mg"] - before["mean_mg"] for before, after in pairs) / len(pairs)
    yield mean_mg, _chance(pairs, "sd_mg", None), f"mean error {mean_mg:+.2f} mg"
    slower = sum(math.log(after["mean_s"] / before["mean_s"]) for before, after in pairs) / len(pairs)
    yield slower, _chance(pairs, "sd_s", "mean_s"), f"time x {math.exp(slower):.2f}"


def _chance(pairs: Sequence[Pair], sd: str, of_mean: str | None) -> float:
    """Standard deviation of the mean over cells of two means' difference, or of their ratio's logarithm."""
    variances = [(of[sd] / (of[of_mean] if of_mean else 1.0)) ** 2 / of["doses"] for pair in pairs for of in pair]
    return math.sqrt(sum(variances)) / len(pairs)


def worth(pairs: Sequence[Pair]) -> str:
    """What the constant's absence does, as far as it is not chance."""
    if all(dict(before) == dict(after) for before, after in pairs):
        return "no dose differs"
    told = [words for found, chance, words in differences(pairs) if abs(found) > DEVIATIONS * max(chance, 1e-12)]
    return ", ".join(told) or "within noise"


def noise(results: Results, listed: Mapping[str, Sequence[str]]) -> str:
    """Of how many doses each figure is, and what two sets of seeds of the law as it is make of them."""
    parts = []
    for world, plants in itertools.product(listed, COLUMNS):
        pairs = pairs_of(results, world, plants, AGAIN)
        if pairs:
            figures = list(differences(pairs))
            told = ", ".join(words for found, _, words in figures if found) or "no difference"
            success, mean_mg, slower = (DEVIATIONS * figures[at][1] for at in (0, 5, 6))
            parts.append(
                f"* `{world}`, {plants}: {sum(of['doses'] for _, of in pairs):g} doses; noise is {success:.1f} points, "
                f"{mean_mg:.2f} mg and {100.0 * math.expm1(slower):.0f} % of the time; other seeds alone: {told}."
            )
    return "\n".join(parts)


def filled(page: str, results: Results, listed: Mapping[str, Sequence[str]]) -> str:
    """The page with the table's two columns, and the noise between its marks, as the results have them."""
    before, _, rest = page.partition(NOISE)
    _, _, after = rest.partition(END)
    rows = "\n".join(_row(line, results, listed) for line in before.split("\n"))
    return f"{rows}{NOISE}\n{noise(results, listed)}\n{END}{after}"


def _row(line: str, results: Results, listed: Mapping[str, Sequence[str]]) -> str:
    """A row of the table of constants with its worth; any other line as it is."""
    cells = [cell.strip() for cell in line.strip("|").split("|")]
    if not line.startswith("| `") or len(cells) != CELLS:
        return line
    cells[-2:] = [_told(cells[0], plants, results, listed) for plants in COLUMNS]
    return f"| {' | '.join(cells)} |"


def _worth_of(results: Results, world: str, plants: str, text: str) -> str:
    """With the doses that it was measured in, where those are fewer than the world's."""
    pairs, all_pairs = (pairs_of(results, world, plants, name) for name in (text, AS_IT_IS))
    if not pairs:
        return "not measured yet"
    doses = f" ({sum(of['doses'] for _, of in pairs):g} doses)" if len(pairs) < len(all_pairs) else ""
    return worth(pairs) + doses


def _told(names: str, plants: str, results: Results, listed: Mapping[str, Sequence[str]]) -> str:
    """One cell of a row: each variant that begins with one of its constants."""
    told = []
    for world, variants in listed.items():
        for text in variants:
            first = text.partition("=")[0].partition(".")[2]
            if f"`{first}`" in names:
                told.append(f"`{re.sub(MODULE, '', text)}`: {_worth_of(results, world, plants, text)}")
    return "; ".join(told)
