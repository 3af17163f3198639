"""A new cell led to its first dose, step by step: what is found is kept with its date and its person."""

from typing import TYPE_CHECKING

from scuhand_bt.fronts import front

if TYPE_CHECKING:
    from scuhand_bt.commissioning.guide import carry_out, on_twins
    from scuhand_bt.commissioning.record import Record
    from scuhand_bt.commissioning.step import Left, NotFound, Site
    from scuhand_bt.commissioning.steps import STEPS, changed, commissioned, next_step
else:
    __getattr__, __dir__ = front(
        __name__,
        {
            "commissioning.guide": "carry_out on_twins",
            "commissioning.record": "Record",
            "commissioning.step": "Left NotFound Site",
            "commissioning.steps": "STEPS changed commissioned next_step",
        },
    )

__all__ = [
    "STEPS",
    "Left",
    "NotFound",
    "Record",
    "Site",
    "carry_out",
    "changed",
    "commissioned",
    "next_step",
    "on_twins",
]
