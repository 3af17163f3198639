"""Sizes of terminals, what is on one, and a batch to be shown."""

SIZES = [(80, 24), (120, 40), (200, 50)]
BATCH = """
recipe: five
workflow: fill_xrd_holder
defaults: {container: xrd_holder, source: beads}
samples: [{id: a, mass: 30 mg}, {id: b, mass: 30 mg}, {id: c, mass: 30 mg}]
"""


def unwrapped(lines: list[str]) -> str:
    return " ".join(" ".join(lines).split())
