"""What a lab keeps from run to run: its inventory, what was learnt, who signs with a PIN, and the ledger of its runs.

Each is made for the folder that `OpenLab.state`, `PastRun.state` or `api.find_state` names, and reads it when asked.
What is entered of the inventory while a run has the cell (`take_cell`) would be overtaken by that run.
"""

from typing import TYPE_CHECKING

from scuhand_bt.fronts import front

if TYPE_CHECKING:
    from scuhand_bt.lab_state.beliefs import (
        BALANCE_BELIEVED_FOR,
        FLOW_BELIEVED_FOR,
        YIELD_BELIEVED_FOR,
        LabState,
        LearntYield,
        Taught,
    )
    from scuhand_bt.lab_state.inventory import Inventory, Stock, StockEntry, StockKind
    from scuhand_bt.lab_state.lab_db import user_name
    from scuhand_bt.lab_state.ledger import KEY_VARIABLE, Ledger, LedgerFound
    from scuhand_bt.lab_state.persons import Persons, person_name
    from scuhand_bt.lab_state.signing import NEEDED, new_key
    from scuhand_bt.run.holds import take_cell
    from scuhand_bt.specs import PowderBelief
else:
    __getattr__, __dir__ = front(
        __name__,
        {
            "lab_state.beliefs": (
                "BALANCE_BELIEVED_FOR FLOW_BELIEVED_FOR YIELD_BELIEVED_FOR LabState LearntYield Taught"
            ),
            "lab_state.inventory": "Inventory Stock StockEntry StockKind",
            "lab_state.lab_db": "user_name",
            "lab_state.ledger": "KEY_VARIABLE Ledger LedgerFound",
            "lab_state.persons": "Persons person_name",
            "lab_state.signing": "NEEDED new_key",
            "run.holds": "take_cell",
            "specs": "PowderBelief",
        },
    )

__all__ = [
    "BALANCE_BELIEVED_FOR",
    "FLOW_BELIEVED_FOR",
    "KEY_VARIABLE",
    "NEEDED",
    "YIELD_BELIEVED_FOR",
    "Inventory",
    "LabState",
    "LearntYield",
    "Ledger",
    "LedgerFound",
    "Persons",
    "PowderBelief",
    "Stock",
    "StockEntry",
    "StockKind",
    "Taught",
    "new_key",
    "person_name",
    "take_cell",
    "user_name",
]
