"""Studies: many dry runs of one recipe, to predict what a plan comes to and what that depends on (docs/study.md)."""

from typing import TYPE_CHECKING

from scuhand_bt.fronts import front

if TYPE_CHECKING:
    from scuhand_bt.study.change import files_hash, modules_hash
    from scuhand_bt.study.night import Night, better_order, fates, in_words, read_night
    from scuhand_bt.study.odds import CELLS, FEWEST, RECKONED, Chance, Odds, Range, odds_of
    from scuhand_bt.study.optimise import diff, optimised
    from scuhand_bt.study.pool import all_trials, executor_of
    from scuhand_bt.study.stays import stays_in_words, stopped_in_words, unforeseen, unforeseen_in_words
    from scuhand_bt.study.store import Store, last_tried, open_store
    from scuhand_bt.study.table import TABLE_KINDS, write_table
    from scuhand_bt.study.trial import Setup, Task, Trial
    from scuhand_bt.study.vary import Vary, check_setups, ends_of, goes_with, means_of, read_vary
else:
    __getattr__, __dir__ = front(
        __name__,
        {
            "study.change": "files_hash modules_hash",
            "study.night": "Night better_order fates in_words read_night",
            "study.odds": "CELLS FEWEST RECKONED Chance Odds Range odds_of",
            "study.optimise": "diff optimised",
            "study.pool": "all_trials executor_of",
            "study.stays": "stays_in_words stopped_in_words unforeseen unforeseen_in_words",
            "study.store": "Store last_tried open_store",
            "study.table": "TABLE_KINDS write_table",
            "study.trial": "Setup Task Trial",
            "study.vary": "Vary check_setups ends_of goes_with means_of read_vary",
        },
    )

__all__ = [
    "CELLS",
    "FEWEST",
    "RECKONED",
    "TABLE_KINDS",
    "Chance",
    "Night",
    "Odds",
    "Range",
    "Setup",
    "Store",
    "Task",
    "Trial",
    "Vary",
    "all_trials",
    "better_order",
    "check_setups",
    "diff",
    "ends_of",
    "executor_of",
    "fates",
    "files_hash",
    "goes_with",
    "in_words",
    "last_tried",
    "means_of",
    "modules_hash",
    "odds_of",
    "open_store",
    "optimised",
    "read_night",
    "read_vary",
    "stays_in_words",
    "stopped_in_words",
    "unforeseen",
    "unforeseen_in_words",
    "write_table",
]
