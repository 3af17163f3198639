"""Small batches, a plant that gives far too much, and a safe end."""

from running import Ran

ONE_DOSE = """
recipe: one
workflow: scoop_and_dispense
samples: [{id: a, source: beads, container: pellet_die_13mm, mass: 500 mg, tolerance: 10 mg}]
"""


def assert_safe(ran: Ran) -> None:
    cell = ran.session.cell
    assert cell.hand.opening_mm == 0.0
    assert cell.hand.vibration == 0.0
    assert cell.arm.is_stopped
    assert cell.hand.is_stopped


class Gusher:
    """A plant whose every opening gives far too much."""

    class Flow:
        def step(self, dt_s: float, opening_mm: float, vibration: float, in_cone_mg: float, rng: object) -> float:
            return min(in_cone_mg, 40_000 * dt_s) if opening_mm > 0 else 0.0

    def flow(self, powder: object) -> "Gusher.Flow":
        return self.Flow()


TWO_DOSES = """
recipe: two
workflow: scoop_and_dispense
defaults: {source: beads, container: pellet_die_13mm, mass: 100 mg}
samples: [{id: a}, {id: b}]
on_failure: {dose.overshoot: %s, hand.no_flow: %s, otherwise: stop}
overshoot_limit: 0
"""
