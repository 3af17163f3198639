"""A recipe of one source, what the inventory says of its powder, and an operator who answers."""

from scuhand_bt.clock import Steps
from scuhand_bt.lab_state.inventory import StockEntry

RECIPE = """\
recipe: one
workflow: fill_xrd_holder
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 5 g, lot: L7}
defaults: {source: beads, container: xrd_holder, tolerance: 5 mg}
samples: [{id: a, mass: 50 mg}, {id: b, mass: 60 mg}]
"""
AMOUNT, SOURCE = "4:86", "4:3"


def powder(mass_mg: float, lot: str = "L7", name: str = "glass_beads") -> StockEntry:
    return StockEntry("station", "mortar_bay", name, lot, mass_mg)


class Answering:
    """An operator who gives these answers."""

    def __init__(self, *answers: str) -> None:
        self.answers = list(answers)
        self.asked: list[tuple[str, tuple[str, ...]]] = []

    def expect(self) -> None:
        """Who answers is there anyway."""

    def dismiss(self) -> None:
        """And stays."""

    def ask(self, question: str, choices: tuple[str, ...]) -> Steps[str]:
        self.asked.append((question, choices))
        return self.answers.pop(0)
        yield
