"""Which cases of a test the daily suite takes."""

import pytest


def first_daily(first: object, *others: object) -> list[object]:
    """Cases for `parametrize`: the first is run daily, the others with the slow suite."""

    def slow(case: object) -> object:
        return pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.slow)

    return [first, *(slow(case) for case in others)]
