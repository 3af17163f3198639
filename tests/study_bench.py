"""A recipe to study, an executor that runs its trials at once or others in their place, and a trial as made up."""

from collections.abc import Callable
from concurrent.futures import Executor, Future

from scuhand_bt.study.trial import SampleTrial, Setup, Trial

RECIPE = """recipe: two
workflow: fill_xrd_holder
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 5 g}
samples:
  - {id: a, source: beads, container: xrd_holder, mass: 50 mg}
  - {id: b, source: beads, container: xrd_holder, mass: 50 mg}
  - {id: c, source: beads, container: xrd_holder, mass: 30 mg}
"""
FLOW = "powders.glass_beads.simulation.flow_coefficient"


class Inline(Executor):
    """Runs what it is given at once, or this in its place, and counts it."""

    def __init__(self, instead: Callable[[Setup, int], Trial] | None = None) -> None:
        self.ran, self._instead = 0, instead

    def submit(self, fn, /, *arguments, **named):  # type: ignore[no-untyped-def]
        self.ran += 1
        future: Future[object] = Future()
        future.set_result((self._instead or fn)(*arguments, **named))
        return future


def fake(seed: int, duration_s: float, good: str) -> Trial:
    """A trial of the three samples of which these are good."""
    samples = tuple(
        SampleTrial(name, name in good, name in good, "in tolerance" if name in good else "over",
                    None if name in good else "dose.overshoot", 50.0, 50.0, 50.0, 10.0)
        for name in "abc"
    )  # fmt: skip
    scoops, left_mg = {"beads": 1 + seed % 2}, {"beads": {"kept": 100.0}}
    return Trial(seed, 0, duration_s, {"a": 0.0, "b": 100.0}, samples, scoops, {"beads": 200.0}, left_mg)
