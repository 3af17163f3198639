"""A lab with a workflow and a recipe of its own, both small and sound: what is written wrong in them then is found."""

from pathlib import Path

RECIPE = """\
recipe: one
workflow: mine
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 5 g}
samples:
  - {id: a, source: beads, container: xrd_holder, mass: 50 mg}
"""
TREE = """\
workflow: mine
inputs: {source: Source, container: Container, mass: Mass}
tree:
  sequence:
    - place_container: {container: $container}
    - tare:
    - fill: {source: $source, container: $container, mass: $mass}
    - park:
"""


def write_own(lab: Path) -> None:
    """Write both into a lab: `recipes/one.yaml`, `trees/mine.yaml`."""
    (lab / "recipes" / "one.yaml").write_text(RECIPE, encoding="utf-8")
    (lab / "trees" / "mine.yaml").write_text(TREE, encoding="utf-8")
