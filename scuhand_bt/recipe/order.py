"""The order of a batch's samples, by the powder lots on the sheet before and after each.

by_powder         by the lot that each begins with, in the order of first mention
as_written        as the recipe says
fastest           with as few changes of the sheet between samples as there can be; by powder where that has as few
persons_together  the two longest stretches that need no person, samples of one lot each, first and last; all others
                  between them, so that whoever changes the sheets is needed only there, and as seldom as can be. The
                  longest comes first, where that needs no more changes. What takes no powder comes before them
"""

from collections import defaultdict, deque
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise

from scuhand_bt.recipe.sample import Sample

ORDERS = ("by_powder", "as_written", "fastest", "persons_together")


def in_order(order: str, samples: Sequence[Sample], duration_s: Callable[[Sample], float]) -> list[Sample]:
    """The samples in one of `ORDERS`; `duration_s` forecasts one."""
    if order == "as_written":
        return list(samples)
    if order == "fastest":
        # Of as many changes by powder: with the other one the changer might have to be filled once more.
        return min(_grouped(samples), _with_fewest_changes(samples), key=_changes)
    if order == "persons_together":
        return _with_persons_between(samples, duration_s)
    return _grouped(samples)


def fewest_changes(samples: Sequence[Sample]) -> int:
    """How often the sheet is changed between these samples in the order in which it is least often."""
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
    """How often the sheet is changed between them."""
    return sum(_last(one) != _first(next_one) for one, next_one in pairwise(one for one in samples if one.sources))


def _with_fewest_changes(
    samples: Sequence[Sample], before: Sequence[Sample] = (), after: Sequence[Sample] = ()
) -> list[Sample]:
    """Samples are the edges of a graph of lots; it is covered by as few trails as can be.

    Each trail goes on where the sheet is; a change leads from its end to the next one's start. With a change from each
    lot where more samples end than begin to one where more begin, every connected part has an Eulerian circuit, found
    by Hierholzer's algorithm (Mathematische Annalen 6, 30, 1873). What comes before and after them is one more edge,
    from after to before, behind which the whole begins;
    they have powder, as have the samples then.
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
    """All ways of the connected part of a lot, each taken once; begun behind a change of the sheet (None)."""
    found: list[Sample | None] = []
    taken: list[tuple[str, Sample | None]] = [(lot, None)]
    while taken:
        at = taken[-1][0]
        if ways[at]:
            taken.append(ways[at].popleft())
        else:
            found.append(taken.pop()[1])
    circuit = found[-2::-1]  # without the lot that it was begun at
    behind = max((number + 1 for number, one in enumerate(circuit) if one is None), default=0)
    return circuit[behind:] + circuit[:behind]
