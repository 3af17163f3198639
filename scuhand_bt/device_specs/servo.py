"""What is said of a servo, whosever it is."""

from typing import Annotated, Literal

from pydantic import BeforeValidator

Direction = Annotated[Literal[1, -1], BeforeValidator(lambda value: {"1": 1, "-1": -1}.get(value, value))]
"""Which way a servo turns; YAML's scalars are text."""
