"""The balances: one grammar for each vendor's dialect, one driver for all of them."""

from scuhand_bt.devices.balances import and_standard, mt_sics, sbi, shimadzu
from scuhand_bt.devices.balances.driver import SerialBalance
from scuhand_bt.devices.balances.frames import Dialect

DIALECTS: dict[str, Dialect] = {
    "and": and_standard.DIALECT,
    "mt_sics": mt_sics.DIALECT,
    "sbi": sbi.DIALECT,
    "shimadzu": shimadzu.DIALECT,
}
"""The dialects by the name that `driver:` of the balance has in robot/cell.yaml."""


__all__ = ["DIALECTS", "Dialect", "SerialBalance"]
