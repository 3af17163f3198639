"""Checks that a workflow doses what its sample asks for: its `mass`, within its `tolerance`, into its container.

A sample is refused if no path through its workflow (`recipe/flow.py`) doses that. It gets a warning if a later dose of
the same lot into the same container may replace the asked one. What only the run can know is reported then (`not as
asked`, run/outcome.py).
"""

import math
from collections.abc import Iterator, Mapping, Sequence

from scuhand_bt.problems import Mark, Problems
from scuhand_bt.quantity import counted
from scuhand_bt.recipe.pour import Pour
from scuhand_bt.recipe.sample import Ask, Sample
from scuhand_bt.tree.library import Library


def check_asked(samples: Sequence[Sample], library: Library, problems: Problems) -> None:
    """Report every place where a checked workflow doses something else than its samples ask for.

    Samples with the same mistake at the same place share one problem.
    """
    wrong, added = dict[tuple[Mark, str], dict[str, str]](), dict[tuple[Mark, str], dict[str, str]]()
    for sample in samples:
        for mark, what, fix in _wrong(sample, library):
            wrong.setdefault((mark, fix), {}).setdefault(sample.id, what)
        for mark, what, fix in _added(sample):
            added.setdefault((mark, fix), {}).setdefault(sample.id, what)
    for (mark, fix), said in wrong.items():
        problems.add(mark, _of_all(said), fix, code="not-asked")
    for (mark, fix), said in added.items():
        problems.warn(mark, _of_all(said), fix, code="lot-twice")


def _of_all(said: Mapping[str, str]) -> str:
    more = f" (and {counted(len(said) - 1, 'more sample')} like it)" if len(said) > 1 else ""
    return next(iter(said.values())) + more


def _wrong(sample: Sample, library: Library) -> Iterator[tuple[Mark, str, str]]:
    """Where a sample's workflow doses something else than it asks for: the place, what is wrong, and the remedy."""
    for ask in sample.asks:
        yield from _wrong_of(ask, _aims(ask, sample), sample, library)
    if sample.composition is not None:
        lots = {powder.lot for powder in sample.composition.powders}
        for aim in _into(sample):
            if aim.lot is not None and aim.lot not in lots:
                what = f"this doses '{aim.lot}' into the container of sample '{sample.id}', whose composition has none"
                yield aim.mass_mark, what, "add it to `from`, or dose it into another container"


def _into(sample: Sample) -> list[Pour]:
    """The doses that may be the last of their place, into containers that the sample's mass may be for."""
    return [aim for aim in sample.flow.last if aim.container is None or sample.is_dosed_into(aim.container)]


def _aims(ask: Ask, sample: Sample) -> list[Pour]:
    return [aim for aim in _into(sample) if ask.lot is None or aim.lot in (None, ask.lot)]


def _wrong_of(ask: Ask, aims: Sequence[Pour], sample: Sample, library: Library) -> Iterator[tuple[Mark, str, str]]:
    workflow, of_lot = library.workflows[sample.workflow], f" of {ask.lot}" if ask.lot is not None else ""
    asks = f"sample '{sample.id}' asks for"
    if not aims:
        what = f"{asks} {ask.mass_mg:g} mg{of_lot}, but '{workflow.name}' doses nothing into its container"
        yield (
            workflow.mark,
            what,
            "let it dispense $mass there" if ask.lot is None else "dispense each of $masses there",
        )
    asked = [aim for aim in aims if aim.mass_mg is None or ask.is_for(aim.mass_mg, aim.lot)]
    for aim in () if asked else aims:
        what = f"{asks} {ask.mass_mg:g} mg{of_lot}, but no dose has that mass; this one has {aim.mass_mg:g} mg"
        yield aim.mass_mark, what, "write $mass" if ask.lot is None else "write each of $masses"
    narrow = {aim.place for aim in asked if not _is_wider(aim, ask)}
    for aim in asked:
        if aim.place not in narrow:
            what = f"{asks} a tolerance of {ask.tolerance_mg:g} mg, but this dose has one of {aim.tolerance_mg:g} mg"
            yield aim.tolerance_mark, what, "write $tolerance" if ask.lot is None else "write each of $tolerances"


def _added(sample: Sample) -> Iterator[tuple[Mark, str, str]]:
    """Doses of a mass known only to the run, after the asked one and of the same lot and container."""
    for ask in sample.asks:
        aims = _aims(ask, sample)
        if any(aim.mass_mg is not None and ask.is_for(aim.mass_mg, aim.lot) for aim in aims):
            continue
        for aim in (aim for aim in aims if aim.mass_mg is None and None not in aim.place):
            before = [pour for pour in sample.flow.pours if pour.place == aim.place and pour.mass_mg is not None]
            if any(ask.is_for(pour.mass_mg or 0.0, pour.lot) for pour in before):
                what = f"sample '{sample.id}' asks for {ask.mass_mg:g} mg of {aim.lot}, but this later dose puts the "
                what += "same lot into the same container: it only adds what is missing to its own mass"
                yield aim.mass_mark, what, "take another lot for one of them, or another container"


def _is_wider(aim: Pour, ask: Ask) -> bool:
    """Whether a dose of the asked mass has a wider tolerance than asked."""
    if aim.mass_mg is None or aim.tolerance_mg is None or ask.tolerance_mg is None:
        return False
    return aim.tolerance_mg > ask.tolerance_mg and not math.isclose(aim.tolerance_mg, ask.tolerance_mg)
