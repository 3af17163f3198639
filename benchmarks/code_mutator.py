"""Mutants of Python code: each is the file with one thing changed that a test should notice.

A bound moved by one (`<` for `<=`) or turned round, another operator, a number or a truth value changed, an operand
of `and` and `or` left out, a condition negated, nothing returned, a call, `raise`, `break` or `continue` left out,
`min` for `max`. Annotations, decorators, texts and what f-strings show are left alone.
"""

import ast
import builtins
import copy
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field, replace

COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
    ast.BitOr: ast.BitAnd,
    ast.BitAnd: ast.BitOr,
    ast.BitXor: ast.BitAnd,
}
FUNCTIONS = {"min": "max", "max": "min", "all": "any", "any": "all"}


@dataclass(frozen=True)
class CodeMutant:
    """One change; `source` is the whole file with it."""

    function: str
    """Qualified name, or that of the constant; empty elsewhere at the module's level."""
    line: int
    before: str
    after: str
    source: str = field(repr=False)
    number: int = 1
    """Counts the same change within one function."""

    @property
    def name(self) -> str:
        """Stays the same while the function does, wherever it stands in the file."""
        times = f" ({self.number})" if self.number > 1 else ""
        return f"{self.function or 'module'}: {self.before} -> {self.after}{times}"


def mutants_of(source: str, functions: Collection[str] = ()) -> list[CodeMutant]:
    """All mutants of a file, or of these in it: functions, constants, `Class.method`, `Class` for all of one."""
    seen, found = Counter[str](), []
    for function, node, after in _Sites(source).changes():
        if functions and not any(f"{function}.".startswith(f"{name}.") for name in functions):
            continue
        mutant = CodeMutant(function, node.lineno, *_told(source, node, after), _spliced(source, node, after))
        seen[mutant.name] += 1
        found.append(replace(mutant, number=seen[mutant.name]))
    return found


def _told(source: str, node: ast.expr | ast.stmt, after: str) -> tuple[str, str]:
    before = ast.unparse(node)
    if before.isidentifier() or isinstance(node, ast.Constant):  # says nothing without its line
        line = source.splitlines()[node.lineno - 1].strip()
        return f"{before} in `{line}`", after
    return before, after


def _spliced(source: str, node: ast.expr | ast.stmt, after: str) -> str:
    """The source with the node's text replaced; columns count bytes."""
    lines = source.encode().splitlines(keepends=True)
    assert node.end_lineno is not None
    first, last = node.lineno - 1, node.end_lineno - 1
    text = f"({after})" if isinstance(node, ast.expr) and not isinstance(node, ast.Name) else after
    head, tail = lines[first][: node.col_offset], lines[last][node.end_col_offset :]
    return b"".join([*lines[:first], head + text.encode() + tail, *lines[last + 1 :]]).decode()


class _Sites:
    """Where something can be changed, and to what."""

    def __init__(self, source: str) -> None:
        self._tree = ast.parse(source)

    def changes(self) -> Iterator[tuple[str, ast.expr | ast.stmt, str]]:
        yield from self._within(self._tree, "")

    def _within(self, node: ast.AST, function: str) -> Iterator[tuple[str, ast.expr | ast.stmt, str]]:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            function = f"{function}.{node.name}".lstrip(".")
        if isinstance(node, ast.Assign) and not function and isinstance(node.targets[0], ast.Name):
            function = node.targets[0].id  # a constant
        for after in _alternatives(node):
            assert isinstance(node, ast.expr | ast.stmt)
            yield function, node, after
        for child in _children(node):
            yield from self._within(child, function)
            if _is_condition(child, node):
                assert isinstance(child, ast.expr)
                yield function, child, f"not ({ast.unparse(child)})"


def _children(node: ast.AST) -> Iterator[ast.AST]:
    skipped: set[int] = set()
    if isinstance(node, ast.JoinedStr):
        return
    if isinstance(node, ast.AnnAssign | ast.arg) and node.annotation is not None:
        skipped.add(id(node.annotation))
    if isinstance(node, ast.FunctionDef):
        skipped |= {id(node.returns), *map(id, node.decorator_list)}
    if isinstance(node, ast.ClassDef):
        skipped |= {*map(id, node.decorator_list), *map(id, node.bases)}
    if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
        return
    for child in ast.iter_child_nodes(node):
        if id(child) not in skipped:
            yield child


def _is_condition(node: ast.AST, parent: ast.AST) -> bool:
    """A condition that no other change turns round."""
    if isinstance(node, ast.Compare | ast.BoolOp) or (isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not)):
        return False
    if isinstance(parent, ast.If | ast.While | ast.IfExp):
        return node is parent.test and not isinstance(node, ast.Constant)
    return isinstance(parent, ast.comprehension) and node in parent.ifs


def _alternatives(node: ast.AST) -> Iterator[str]:
    match node:
        case ast.Compare():
            for place, op in enumerate(node.ops):
                for other in COMPARISONS[type(op)]:
                    yield _changed(node, ops=[*node.ops[:place], other(), *node.ops[place + 1 :]])
        case ast.BinOp() | ast.AugAssign() if type(node.op) in OPERATORS and not _is_type(node):
            yield _changed(node, op=OPERATORS[type(node.op)]())
        case ast.BoolOp():
            for place in range(len(node.values)):
                rest = [*node.values[:place], *node.values[place + 1 :]]
                yield _changed(node, values=rest) if len(rest) > 1 else ast.unparse(rest[0])
        case ast.UnaryOp(op=ast.Not()) | ast.UnaryOp(op=ast.USub(), operand=ast.Name() | ast.Attribute() | ast.Call()):
            yield ast.unparse(node.operand)
        case ast.Constant(value=bool()):
            yield str(not node.value)
        case ast.Constant(value=int()):
            yield str(node.value + 1)
        case ast.Constant(value=float()):
            yield from (repr(2.0 * node.value), repr(node.value / 2.0)) if node.value else ("1.0",)
        case ast.Constant(value=bytes()):
            yield repr(node.value + b"!")
        case ast.Name(id=name) if name in FUNCTIONS:
            yield FUNCTIONS[name]
        case ast.Return(value=ast.expr()) if not isinstance(node.value, ast.Constant):
            yield "return None"
        case ast.Expr(value=ast.Call()) | ast.Raise() | ast.Break() | ast.Continue() | ast.Delete():
            yield "pass"


def _changed(node: ast.AST, **fields: object) -> str:
    other = copy.copy(node)
    for name, value in fields.items():
        setattr(other, name, value)
    return ast.unparse(other)


def _is_type(node: ast.BinOp | ast.AugAssign) -> bool:
    """`int | None` is no arithmetic."""
    if not isinstance(node.op, ast.BitOr) or isinstance(node, ast.AugAssign):
        return False
    parts = [part for part in ast.walk(node) if isinstance(part, ast.Name | ast.Constant)]
    return all(
        part.value is None if isinstance(part, ast.Constant) else part.id[0].isupper() or hasattr(builtins, part.id)
        for part in parts
    )
