"""YAML whose every value knows file, line and column, and errors that say where and what to do.

A file becomes a tree of `Node`s. Scalars stay text: the *field* a value is for decides what it means,
never its spelling (`id: 007` is "007", `on:` is a key, `no` is a word). `Problems` collects everything
that is wrong, so that a user sees all of it at once.
"""

import difflib
import typing
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

try:
    from yaml import CSafeLoader as _Loader
except ImportError:  # PyYAML built without libyaml
    from yaml import SafeLoader as _Loader  # type: ignore[assignment]

MAX_BYTES = 2_000_000
"""A recipe of 10 000 samples is below 1 MB; beyond this a file is not what it is taken for."""
MAX_NODES = 400_000
MAX_DEPTH = 60
LONGEST_MESSAGE = 500
LONGEST_NAME = 80
"""Nothing longer is anyone's misspelling of a name."""

M = TypeVar("M", bound=BaseModel)


@dataclass(frozen=True, slots=True)
class Mark:
    """A place in a file; line and column count from 1. Line 0 is no file: an option of the command line."""

    file: str
    line: int = 1
    column: int = 1

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column}" if self.line else self.file


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong, where, and what would be right."""

    mark: Mark
    message: str

    def __str__(self) -> str:
        return f"{self.mark}: {self.message}"


class SourceError(Exception):
    """Bad input: all problems found, in the order of the files."""

    def __init__(self, problems: Sequence[Problem]) -> None:
        self.problems = sorted(dict.fromkeys(problems), key=lambda p: (p.mark.file, p.mark.line, p.mark.column))
        super().__init__("\n".join(map(str, self.problems)))


@dataclass
class Problems:
    """Collects problems; `raise_any` ends a stage that found some."""

    found: list[Problem] = field(default_factory=list)

    def add(self, mark: Mark, what: str, allowed: str = "", unknown: str = "", known: Iterable[str] = ()) -> None:
        """Note a problem: what is wrong; what is allowed; and, for an `unknown` name, the nearest known."""
        parts = [shorten(what, LONGEST_MESSAGE)]
        known = sorted(known)
        if allowed or known:
            parts.append(allowed or "known: " + (", ".join(known[:30]) + (", …" if len(known) > 30 else "")))
        if nearest := _nearest(unknown, tuple(known)):
            parts.append(f"did you mean '{nearest}'?")
        self.found.append(Problem(mark, _one_line("; ".join(parts))))

    def raise_any(self) -> None:
        if self.found:
            raise SourceError(self.found)


@cache
def _nearest(unknown: str, known: tuple[str, ...]) -> str | None:
    """The known name that was probably meant; whoever writes `Mass` or `pellet-die` meant `mass`, `pellet_die`."""
    if not 0 < len(unknown) <= LONGEST_NAME:
        return None
    plain = {_plain_spelling(name): name for name in reversed(known) if len(name) <= LONGEST_NAME}
    found = difflib.get_close_matches(_plain_spelling(unknown), plain, 1, 0.6)
    return plain[found[0]] if found else None


def _plain_spelling(name: str) -> str:
    return name.lower().replace("-", "_").replace(" ", "_")


@dataclass(slots=True, eq=False)
class Node:
    """A value of a file and where it begins."""

    mark: Mark


@dataclass(slots=True, eq=False)
class Scalar(Node):
    """Text; None for an empty value, `~` or `null`."""

    text: str | None


@dataclass(slots=True, eq=False)
class Items(Node):
    """A list."""

    items: list[Node]

    def __iter__(self) -> Iterator[Node]:
        return iter(self.items)


@dataclass(slots=True, eq=False)
class Entries(Node):
    """A mapping, in the order of the file."""

    keys: dict[str, Mark]
    values: dict[str, Node]

    def get(self, key: str) -> Node | None:
        return self.values.get(key)

    def without(self, *names: str) -> "Entries":
        """The same mapping less some keys."""
        return Entries(
            self.mark,
            {k: m for k, m in self.keys.items() if k not in names},
            {k: v for k, v in self.values.items() if k not in names},
        )


def describe(node: Node) -> str:
    """What a node is, in a user's words."""
    if isinstance(node, Items):
        return "a list" if node.items else "an empty list"
    if isinstance(node, Entries):
        return "a mapping (key: value)" if node.values else "an empty mapping"
    assert isinstance(node, Scalar)
    return "nothing" if node.text is None else f"'{shorten(node.text)}'"


def shorten(text: str, length: int = 40) -> str:
    """Text on one line, cut for a message."""
    return _one_line(text if len(text) <= length else text[: length - 1] + "…")


def _one_line(text: str) -> str:
    return "".join(c if c.isprintable() else " " if c.isspace() else "\N{REPLACEMENT CHARACTER}" for c in text)


def plain(node: Node) -> Any:
    """The node as lists, dicts, str and None."""
    if isinstance(node, Items):
        return [plain(item) for item in node.items]
    if isinstance(node, Entries):
        return {key: plain(value) for key, value in node.values.items()}
    assert isinstance(node, Scalar)
    return node.text


def read_text(path: Path, what: str, asked_at: Mark | None = None) -> str:
    """The text of a UTF-8 file (with or without BOM); SourceError in one line for anything else.

    A file that cannot be read at all is reported where another file asks for it (`asked_at`).
    """

    def refuse(message: str) -> SourceError:
        if asked_at is not None:
            return SourceError([Problem(asked_at, f"'{shorten(str(path), 120)}' {message}")])
        return SourceError([Problem(Mark(str(path)), message)])

    try:
        if path.is_dir():
            raise refuse(f"is a directory, not {what}")
        if path.is_fifo():
            raise refuse(f"is a pipe, not {what}; save it as a file")
        with path.open("rb") as file:
            raw = file.read(MAX_BYTES + 1)
    except FileNotFoundError:
        raise refuse(f"no such file; wanted {what}") from None
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise refuse(f"cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if len(raw) > MAX_BYTES:
        raise refuse(f"is larger than {MAX_BYTES // 1_000_000} MB, too large for {what}")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        column = error.start - raw.rfind(b"\n", 0, error.start)
        mark = Mark(str(path), line, column)
        raise SourceError([Problem(mark, "is not UTF-8 text; save it as UTF-8 (Excel: 'CSV UTF-8')")]) from None
    if not text.strip():
        raise refuse(f"is empty; wanted {what}")
    return text


def load(path: Path, what: str) -> Node:
    """Read a YAML file into nodes; SourceError with the place for anything that is no plain YAML."""
    return parse(read_text(path, what), str(path), what)


def parse(text: str, file: str, what: str) -> Node:
    """Parse one YAML document. See `load`."""
    reader = _Reader(file)
    try:
        for event in yaml.parse(text, Loader=_Loader):
            reader.take(event)
    except yaml.MarkedYAMLError as error:
        problem = error.problem or "not understood"
        is_open_quote = problem == "found unexpected end of stream"  # where it began says more than where the file ends
        where = (error.context_mark if is_open_quote else None) or error.problem_mark or error.context_mark
        mark = Mark(file, where.line + 1, where.column + 1) if where else Mark(file)
        problem = _YAML_PROBLEMS.get(problem, problem)
        if "'\\t'" in problem or "\t" in _line(text, mark.line)[: mark.column + 1]:
            problem = "a tab; YAML is indented with spaces"
        raise SourceError([Problem(mark, f"is no valid YAML: {problem}")]) from None
    except yaml.reader.ReaderError as error:
        before = text.encode()[: error.position].decode(errors="ignore")
        mark = Mark(file, before.count("\n") + 1, len(before) - before.rfind("\n"))
        raise SourceError([Problem(mark, f"is no valid YAML: {error.reason}")]) from None
    if reader.root is None:
        raise SourceError([Problem(Mark(file), f"is empty; wanted {what}")])
    return reader.root


_YAML_PROBLEMS = {
    "found unexpected end of stream": "a quote is not closed",
    "mapping values are not allowed in this context": "a ':' too many; look at the indentation, or quote the text",
    "did not find expected key": "no 'key: value' where one should be; look at the indentation",
    "did not find expected node content": "a bracket is not closed, or a value is missing",
    "did not find expected ',' or '}'": "a '}' or a ',' is missing",
    "did not find expected ',' or ']'": "a ']' or a ',' is missing",
}
"""What the parser says, in words that help."""


def _line(text: str, number: int) -> str:
    lines = text.splitlines()
    return lines[number - 1] if 0 < number <= len(lines) else ""


def validate(model: type[M], node: Node, problems: Problems, known: str = "", **extra: Any) -> M | None:
    """Make a model of a node; every error of the model becomes a located problem, and the result None.

    `extra` are fields that do not stand in the file (such as a name that is the entry's key).
    """
    if not isinstance(node, Entries):
        problems.add(node.mark, f"{describe(node)} stands where {known or 'a mapping (key: value)'} should be")
        return None
    found_before = len(problems.found)
    for key in extra:
        if key in node.keys:
            problems.add(node.keys[key], f"unknown key '{key}'", known=set(_keys_at(model, ())).difference(extra))
    try:
        made = model.model_validate({**plain(node), **extra}, by_alias=True, by_name=False)
        return made if len(problems.found) == found_before else None
    except ValidationError as error:
        for item in error.errors(include_url=False):
            _explain(model, node, item, problems)
        return None


def _explain(model: type[BaseModel], node: Node, error: Any, problems: Problems) -> None:
    mark, owner = node.mark, node
    for i, step in enumerate(error["loc"], start=1):
        if isinstance(owner, Entries) and step in owner.values:
            is_key_wrong = error["type"] == "extra_forbidden" and i == len(error["loc"])
            mark = owner.keys[step] if is_key_wrong else owner.values[step].mark
            if not is_key_wrong:
                owner = owner.values[step]
        elif isinstance(owner, Items) and isinstance(step, int) and step < len(owner.items):
            owner = owner.items[step]
            mark = owner.mark
    name = next((step for step in reversed(error["loc"]) if isinstance(step, str)), "")
    if error["type"] == "extra_forbidden":
        known = _keys_at(model, error["loc"][:-1])
        problems.add(mark, f"unknown key '{shorten(name)}'", unknown=name, known=known)
    elif error["type"] == "missing":
        problems.add(mark, f"'{name}' is missing")
    else:
        problems.add(mark, (f"'{shorten(name)}': " if name else "") + refusal(error))


def refusal(error: Any) -> str:
    """What pydantic has against a value (one of `ValidationError.errors()`), in a user's words."""
    if error["type"] == "quantity":
        return str(error["msg"])
    given, context = error["input"], error.get("ctx", {})
    shown = (
        f"'{shorten(str(given))}'" if isinstance(given, str | int | float) else "nothing" if given is None else "this"
    )
    why = _WHY.get(error["type"], "").format(**context) or error["msg"].removeprefix("Value error, ")
    return f"{shown} is not accepted; {why[:1].lower() + why[1:]}"


_WHY = {
    "missing": "it is missing",
    "greater_than": "more than {gt:.12g}",
    "greater_than_equal": "at least {ge:.12g}",
    "less_than": "less than {lt:.12g}",
    "less_than_equal": "at most {le:.12g}",
    **dict.fromkeys(("int_parsing", "int_type", "int_from_float", "int_parsing_size"), "a whole number, such as 3"),
    **dict.fromkeys(("float_parsing", "float_type", "finite_number"), "a plain number, such as 0.5"),
    **dict.fromkeys(("bool_parsing", "bool_type"), "yes or no"),
    "string_type": "a text",
    "string_pattern_mismatch": "text of the form {pattern}",
    "literal_error": "write {expected}",
    **dict.fromkeys(("list_type", "tuple_type"), "a list"),
    **dict.fromkeys(("dict_type", "model_type", "model_attributes_type"), "a mapping (key: value)"),
    "too_short": "a list of at least {min_length}",
    "too_long": "a list of at most {max_length}",
}
"""What would be accepted, by pydantic's types of errors."""


def _keys_at(model: type[BaseModel], path: Sequence[Any]) -> list[str]:
    """The keys that a model, or the model nested in it at `path`, accepts."""
    for step in path:
        for name, info in model.model_fields.items():
            if step in (name, info.alias):
                nested = (info.annotation, *typing.get_args(info.annotation))
                model = next((t for t in nested if isinstance(t, type) and issubclass(t, BaseModel)), model)
                break
    return [info.alias or name for name, info in model.model_fields.items()]


class _Reader:
    """Builds nodes from YAML events, without recursion and with bounds on depth and on aliases."""

    def __init__(self, file: str) -> None:
        self._file = file
        self._open: list[Items | Entries] = []
        self._pending_keys: list[Scalar | None] = []
        self._anchors: dict[str, Node] = {}
        # Of closed lists and mappings, aliases counted as what they stand for:
        self._sizes: dict[int, int] = {}
        self._heights: dict[int, int] = {}
        self._count = 0
        self.root: Node | None = None

    def take(self, event: yaml.Event) -> None:
        where = event.start_mark
        assert where is not None
        mark = Mark(self._file, where.line + 1, where.column + 1)
        if tag := getattr(event, "tag", None):
            self._refuse(mark, f"the tag '{shorten(tag)}' is not accepted; write plain values")
        if isinstance(event, yaml.ScalarEvent):
            is_null = event.implicit[0] and event.value in ("", "~", "null")
            self._place(Scalar(mark, None if is_null else event.value), event.anchor)
        elif isinstance(event, yaml.SequenceStartEvent):
            self._enter(Items(mark, []), event.anchor)
        elif isinstance(event, yaml.MappingStartEvent):
            self._enter(Entries(mark, {}, {}), event.anchor)
        elif isinstance(event, yaml.SequenceEndEvent | yaml.MappingEndEvent):
            self._pending_keys.pop()
            closed = self._open.pop()
            children = closed.items if isinstance(closed, Items) else closed.values.values()
            self._sizes[id(closed)] = 1 + sum(self._sizes.get(id(child), 1) for child in children)
            self._heights[id(closed)] = 1 + max((self._heights.get(id(child), 0) for child in children), default=0)
        elif isinstance(event, yaml.AliasEvent):
            target, name = self._anchors.get(event.anchor or ""), shorten(event.anchor or "")
            if target is None:
                self._refuse(mark, f"the alias *{name} has no anchor &{name} before it")
            if any(target is node for node in self._open):
                self._refuse(mark, f"the alias *{name} stands inside its own anchor")
            self._place(target, None)
        elif isinstance(event, yaml.DocumentStartEvent) and self.root is not None:
            self._refuse(mark, "a second document begins here; one file holds one document")

    def _enter(self, node: Items | Entries, anchor: str | None) -> None:
        self._place(node, anchor)
        self._open.append(node)
        self._pending_keys.append(None)

    def _place(self, node: Node, anchor: str | None) -> None:
        self._count += self._sizes.get(id(node), 1)
        if self._count > MAX_NODES:
            self._refuse(node.mark, "is too large once its aliases are expanded")
        if len(self._open) + self._heights.get(id(node), 1) > MAX_DEPTH:
            self._refuse(node.mark, f"is nested deeper than {MAX_DEPTH} levels")
        if anchor is not None:
            self._anchors[anchor] = node
        if not self._open:
            self.root = node
            return
        parent = self._open[-1]
        if isinstance(parent, Items):
            parent.items.append(node)
            return
        key = self._pending_keys[-1]
        if key is None:
            if not isinstance(node, Scalar) or node.text is None:
                self._refuse(node.mark, "a key must be one word")
            if node.text in parent.keys:
                self._refuse(node.mark, f"the key '{shorten(node.text)}' stands here a second time")
            self._pending_keys[-1] = node
            return
        assert key.text is not None
        parent.keys[key.text] = key.mark
        parent.values[key.text] = node
        self._pending_keys[-1] = None

    def _refuse(self, mark: Mark, message: str) -> NoReturn:
        raise SourceError([Problem(mark, message)])
