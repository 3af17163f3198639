"""The order of a batch's samples, chosen by the powder lots that touch the sheet (docs/recipes.md, "The plan").

by_powder         grouped by the lot that each sample begins with, in the order of first mention
as_written        as in the recipe
fastest           with the fewest possible changes of the sheet; as `by_powder` if that has no more
persons_together  so that all changes of the sheet fall into one stretch of time
"""

from collections import defaultdict, deque
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise

from scuhand_bt.recipe.sample import Sample

ORDERS = ("by_powder", "as_written", "fastest", "persons_together")


def in_order(order: str, samples: Sequence[Sample], duration_s: Callable[[Sample], float]) -> list[Sample]:
    """The samples in one of `ORDERS`; `duration_s` forecasts how long a sample takes."""
    if order == "as_written":
        return list(samples)
    if order == "fastest":
        # With equally many changes, by powder: the other order might need one more filling of the changer.
        return min(_grouped(samples), _with_fewest_changes(samples), key=_changes)
    if order == "persons_together":
        return _with_persons_between(samples, duration_s)
    return _grouped(samples)


def fewest_changes(samples: Sequence[Sample]) -> int:
    """The least possible number of sheet changes between these samples."""
    return _changes(in_order("fastest", samples, lambda _: 0.0))


def _with_persons_between(samples: Sequence[Sample], duration_s: Callable[[Sample], float]) -> list[Sample]:
    alone: dict[str, list[Sample]] = defaultdict(list)
    for sample in samples:
        if len(lots := {source.sheet_key for source in sample.sources}) == 1:
            alone[lots.pop()].append(sample)
    longest = sorted(alone.values(), key=lambda group: -sum(map(duration_s, group)))
    first, last = [*longest, [], []][:2]
    at_ends = {id(sample) for sample in (*first, *last)}
    without_powder = [sample for sample in samples if not sample.sources]
    between = [sample for sample in samples if sample.sources and id(sample) not in at_ends]
    ways = [
        [*without_powder, *before, *middle, *after]
        for before, after in ((first, last), (last, first))
        for middle in (_grouped(between), _with_fewest_changes(between, before, after))
    ]
    return min(ways, key=_changes)


def _grouped(samples: Sequence[Sample]) -> list[Sample]:
    groups: dict[str, list[Sample]] = defaultdict(list)
    for sample in samples:
        groups[_first(sample)].append(sample)
    return [sample for group in groups.values() for sample in group]


def _first(sample: Sample) -> str:
    return sample.sources[0].sheet_key if sample.sources else ""


def _last(sample: Sample) -> str:
    return sample.last_source.sheet_key if sample.last_source is not None else ""


def _changes(samples: Sequence[Sample]) -> int:
    """The number of sheet changes in this order."""
    return sum(_last(one) != _first(next_one) for one, next_one in pairwise(one for one in samples if one.sources))


def _with_fewest_changes(
    samples: Sequence[Sample], before: Sequence[Sample] = (), after: Sequence[Sample] = ()
) -> list[Sample]:
    """Cover a graph whose nodes are lots and whose edges are samples with as few trails as possible.

    An edge leads from the lot that a sample begins with to the one that it ends with. Within a trail each sample
    begins with the lot that is on the sheet; between trails the sheet is changed. One added edge (a change) from each
    lot where more samples end than begin, to one where more begin, gives every connected part an Eulerian circuit,
    found by Hierholzer's algorithm (Mathematische Annalen 6, 30, 1873).

    `before` and `after` are samples at both ends of the batch: one edge from `after` to `before`, where the circuit is
    cut open. They must have powder, and so must the samples between them.
    """
    ways: dict[str, deque[tuple[str, Sample | None]]] = defaultdict(deque)
    more_ends: dict[str, int] = defaultdict(int)
    around = next(iter((*before, *after)), None)
    edges = [(_first(sample), _last(sample), sample) for sample in samples]
    if around is not None:
        edges.append((_first(after[0]) if after else "", _last(before[-1]) if before else "", around))
    for first, last, sample in edges:
        ways[first].append((last, sample))
        more_ends[first] -= 1
        more_ends[last] += 1
    ends = [lot for lot, more in more_ends.items() for _ in range(more)]
    begins = [lot for lot, more in more_ends.items() for _ in range(-more)]
    for end, begin in zip(ends, begins, strict=True):
        ways[end].append((begin, None))
    found = [one for lot in list(ways) for one in _circuit(lot, ways) if one is not None]
    behind = found.index(around) if around is not None else len(found)
    return found[behind + 1 :] + found[:behind]


def _circuit(lot: str, ways: Mapping[str, deque[tuple[str, Sample | None]]]) -> list[Sample | None]:
    """An Eulerian circuit of a lot's connected part, cut open after a change of the sheet (None) if it has one."""
    found: list[Sample | None] = []
    taken: list[tuple[str, Sample | None]] = [(lot, None)]
    while taken:
        at = taken[-1][0]
        if ways[at]:
            taken.append(ways[at].popleft())
        else:
            found.append(taken.pop()[1])
    circuit = found[-2::-1]  # without the entry that only marks the start
    behind = max((number + 1 for number, one in enumerate(circuit) if one is None), default=0)
    return circuit[behind:] + circuit[:behind]
