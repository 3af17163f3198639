"""YAML whose every value knows file, line and column, and errors that say where and what to do.

A file becomes a tree of `Node`s. Scalars stay text: the *field* a value is for decides what it means,
never its spelling (`id: 007` is "007", `on:` is a key, `no` is a word).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import yaml

from scuhand_bt.problems import Mark, Problem, SourceError, shorten

try:
    from yaml import CSafeLoader as _Loader
except ImportError:  # PyYAML built without libyaml
    from yaml import SafeLoader as _Loader  # type: ignore[assignment]

MAX_BYTES = 2_000_000
"""A recipe of 10 000 samples is below 1 MB; beyond this a file is not what it is taken for."""
MAX_NODES = 400_000
MAX_DEPTH = 60


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


def plain(node: Node) -> Any:
    """The node as lists, dicts, str and None."""
    if isinstance(node, Items):
        return [plain(item) for item in node.items]
    if isinstance(node, Entries):
        return {key: plain(value) for key, value in node.values.items()}
    assert isinstance(node, Scalar)
    return node.text


def from_plain(value: Any, name: str) -> Node:
    """Plain values as nodes: those of a recipe that was made by a program, which has a name and no lines."""
    mark = Mark(name, 0)
    if isinstance(value, Mapping):
        values = {str(key): from_plain(one, f"{name}.{key}") for key, one in value.items()}
        return Entries(mark, {key: node.mark for key, node in values.items()}, values)
    if isinstance(value, list | tuple):
        return Items(mark, [from_plain(one, f"{name}[{number}]") for number, one in enumerate(value)])
    text = {True: "yes", False: "no"}[value] if isinstance(value, bool) else None if value is None else str(value)
    return Scalar(mark, text)


def read_text(path: Path, what: str, asked_at: Mark | None = None) -> str:
    """The text of a UTF-8 file (with or without BOM); SourceError in one line for anything else.

    A file that cannot be read at all is reported where another file asks for it (`asked_at`).
    """

    def refuse(message: str) -> SourceError:
        if asked_at is not None:
            return SourceError([Problem(asked_at, f"'{shorten(str(path), 120)}' {message}", "unreadable")])
        return SourceError([Problem(Mark(str(path)), message, "unreadable")])

    try:
        if path.is_dir():
            raise refuse(f"is a directory, not {what}")
        if path.is_fifo():
            raise refuse(f"is a pipe, not {what}; save it as a file")
        with path.open("rb") as file:
            raw = file.read(MAX_BYTES + 1)
    except FileNotFoundError:
        raise refuse(f"does not exist; expected {what}") from None
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
        what = "is not UTF-8 text; save it as UTF-8 (Excel: 'CSV UTF-8')"
        raise SourceError([Problem(mark, what, "unreadable")]) from None
    if not text.strip():
        raise refuse(f"is empty; expected {what}")
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
        raise SourceError([Problem(mark, f"is not valid YAML: {problem}", "bad-yaml")]) from None
    except yaml.reader.ReaderError as error:
        before = text.encode()[: error.position].decode(errors="ignore")
        mark = Mark(file, before.count("\n") + 1, len(before) - before.rfind("\n"))
        raise SourceError([Problem(mark, f"is not valid YAML: {error.reason}", "bad-yaml")]) from None
    if reader.root is None:
        raise SourceError([Problem(Mark(file), f"is empty; expected {what}", "unreadable")])
    return reader.root


_YAML_PROBLEMS = {
    "found unexpected end of stream": "a quote is not closed",
    "mapping values are not allowed in this context": "one ':' too many; check the indentation, or quote the text",
    "could not find expected ':'": "a ':' is missing before this",
    "did not find expected key": "a 'key: value' is missing here; check the indentation",
    "did not find expected '-' indicator": "a '- ' is missing here; check the indentation",
    "did not find expected node content": "a bracket is not closed, or a value is missing",
    "did not find expected ',' or '}'": "a '}' or a ',' is missing",
    "did not find expected ',' or ']'": "a ']' or a ',' is missing",
}
"""What the parser says, in words that help."""


def _line(text: str, number: int) -> str:
    lines = text.splitlines()
    return lines[number - 1] if 0 < number <= len(lines) else ""


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
                self._refuse(mark, f"the alias *{name} is inside its own anchor")
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
            self._refuse(node.mark, "is too large when its aliases are expanded")
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
                self._refuse(node.mark, f"the key '{shorten(node.text)}' is here a second time")
            self._pending_keys[-1] = node
            return
        assert key.text is not None
        parent.keys[key.text] = key.mark
        parent.values[key.text] = node
        self._pending_keys[-1] = None

    def _refuse(self, mark: Mark, message: str) -> NoReturn:
        raise SourceError([Problem(mark, message, "bad-yaml")])
