"""A skill that asks a person without having said so: no plan foresees it."""

QUIET = """\
from scuhand_bt.skill import Cell, Skill, Steps


class Quiet(Skill[None]):
    \"\"\"Ask without having said so.\"\"\"

    def run(self, cell: Cell) -> Steps[None]:
        yield from cell.operator.ask("Press the button")
"""
