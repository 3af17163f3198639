"""The registry of all kinds of entries, and the way from an entry to its model."""

from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from scuhand_bt.events.catalogue import SKILL_EVENTS
from scuhand_bt.events.entry import Event
from scuhand_bt.journal.events import ENGINE_EVENTS

KINDS: Mapping[str, type[Event]] = {event.KIND: event for event in (*ENGINE_EVENTS, *SKILL_EVENTS)}
"""All kinds that this program writes, beside a lab's notes."""


class NewerShape(Exception):  # noqa: N818 - it says what was found
    """An entry of a shape that only a newer program knows."""


def parsed(kind: str, values: Mapping[str, Any]) -> Event | None:
    """An entry's payload as its model; None for a kind that is not of `KINDS` (a lab's, or a newer program's).

    Raises NewerShape, and ValueError for what no program wrote.
    """
    if (model := KINDS.get(kind)) is None:
        return None
    if (shape := values.get("shape", 1)) > model.SHAPE:
        raise NewerShape(f"'{kind}' of shape {shape}; this one reads up to {model.SHAPE}")
    try:
        return model.model_validate(values)
    except ValidationError as error:
        wrong = error.errors(include_url=False)[0]
        where = ".".join(map(str, wrong["loc"]))
        raise ValueError(f"'{kind}' has at '{where}': {wrong['msg'].lower()}") from None
