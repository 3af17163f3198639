"""What an entry of a journal is, and what a skill may write: a shipped kind, or a lab's own."""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, JsonValue, TypeAdapter, ValidationError

from scuhand_bt.problems import shorten


def readable(text: str) -> str:
    """A text from outside (a path, an answer) may hold what UTF-8 cannot: that is written as an escape."""
    return text if text.isascii() else text.encode("utf-8", "backslashreplace").decode()


Text = Annotated[str, BeforeValidator(lambda text: readable(text) if isinstance(text, str) else text)]


class Values(BaseModel):
    """A part of an entry."""

    model_config = ConfigDict(frozen=True, extra="ignore", ser_json_inf_nan="strings")


class Event(Values):
    """An entry of the journal."""

    KIND: ClassVar[str]
    SHAPE: ClassVar[int] = 1
    """The version of the kind's payload: one more when a reader of before would misread it. Written from 2 on."""

    def entry(self) -> tuple[str, str]:
        """Kind and payload (JSON), as the journal keeps them."""
        payload = self.model_dump_json(exclude_unset=True)
        return self.KIND, payload if self.SHAPE == 1 else json.dumps({**json.loads(payload), "shape": self.SHAPE})


class SkillEvent(Event):
    """An entry that a skill may write."""


NOTE_PREFIX = "lab."
NOTE_KIND = r"lab(\.[a-z][a-z0-9_]*)+"
_JSON: TypeAdapter[dict[str, JsonValue]] = TypeAdapter(dict[str, JsonValue], config=ConfigDict(allow_inf_nan=False))


@dataclass(frozen=True)
class Note:
    """An entry of a kind that a lab's skill invents: `lab.` and a name, with any JSON as `values`.

    Raises ValueError for a kind without the prefix, and for values that are no JSON.
    """

    kind: str
    values: Mapping[str, JsonValue]

    def __post_init__(self) -> None:
        if not isinstance(self.kind, str) or not re.fullmatch(NOTE_KIND, self.kind):
            name = (
                re.sub(r"[^a-z0-9_.]+", "_", str(self.kind).lower().removeprefix(NOTE_PREFIX)).strip("_.") or "sieved"
            )
            example = f'`cell.record.note("{NOTE_PREFIX}{name}", {{…}})`'
            raise ValueError(f"{self.kind!r} is not a kind that a lab may write: write {example}")
        try:
            _JSON.validate_python(self.values, strict=True)
        except ValidationError as error:
            wrong = error.errors(include_url=False)[0]
            raise ValueError(
                f"{shorten(repr(wrong['input']))} among the values of {self.kind!r} is not JSON: write finite numbers, "
                "texts, True, False, None, and lists and dicts (with texts as keys) of these"
            ) from None

    def entry(self) -> tuple[str, str]:
        """Kind and payload (JSON), as the journal keeps them."""
        return self.kind, _JSON.dump_json(dict(self.values)).decode()
