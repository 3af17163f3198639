"""The example passes what the engine's own balances pass."""

import pytest

from scuhand_bt.testing.conformance import balance_conforms


@pytest.mark.real_time
def test_a_radwag_balance_conforms() -> None:
    balance_conforms("scuhand_radwag:RADWAG")
