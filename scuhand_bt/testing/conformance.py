"""What every driver has to pass, the engine's own and anybody else's, against its twin.

    def test_my_balance_conforms() -> None:
        conforms("balance", "my_package.radwag:RADWAG")

It raises AssertionError with what is wrong, and runs in real time, some seconds.
"""

from typing import Any

from scuhand_bt.testing.of_balances import balance_conforms
from scuhand_bt.testing.of_instruments import changer_conforms, scanner_conforms, sensor_conforms, switch_conforms
from scuhand_bt.testing.of_watchers import watcher_conforms


def conforms(kind: str, driver: str, **options: Any) -> None:
    """All that a driver of this kind, by its name in robot/cell.yaml, has to do; with these `options`.

    ValueError for an arm or a hand: `scuhand_bt.testing.of_motion` takes them connected, wherever they are.
    """
    match kind:
        case "balance":
            balance_conforms(driver)
        case "sensor":
            sensor_conforms(driver, options)
        case "scanner":
            scanner_conforms(driver, options)
        case "ioniser" | "capper":
            switch_conforms(kind, driver, options)
        case "changer":
            changer_conforms(driver, options)
        case "watcher":
            watcher_conforms(driver, options)
        case _:
            raise ValueError(f"a driver of kind '{kind}' is checked by scuhand_bt.testing.of_motion")
