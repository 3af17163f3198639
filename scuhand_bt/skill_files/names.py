"""What the names in a function of a skill's file stand for.

They are followed by their annotations, from `cell` on: `cell.hand.pulse(…)` is `Hand.pulse`, which returns `Steps`
and so does nothing without `yield from`.
"""

import ast
import builtins
import collections.abc
import importlib
import inspect
import types
import typing
from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import BaseModel

from scuhand_bt.cell.cell import Cell
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.clock import Wake
from scuhand_bt.failures import SkillFailed
from scuhand_bt.skill import Skill
from scuhand_bt.skill_files.facts import Syntax

Function = ast.FunctionDef | ast.AsyncFunctionDef
CLOCKS = {
    "time": ("sleep", "time", "time_ns", "monotonic", "monotonic_ns", "perf_counter", "perf_counter_ns"),
    "asyncio": ("sleep",),
    "datetime": ("now", "utcnow", "today"),
}
"""What tells the computer's time, or waits by it: functions of a module, or of its classes."""


def bound_in(syntax: Syntax) -> set[str]:
    """All that is given a value somewhere in a file, wherever that holds."""
    found: set[str] = set()
    for node in syntax.nodes:
        match node:
            case ast.Name(id=name, ctx=ast.Store() | ast.Del()) | ast.arg(arg=name):
                found.add(name)
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
                found.add(name)
            case ast.alias(name=name, asname=other):
                found.add(other or name.partition(".")[0])
            case ast.ExceptHandler(name=str(name)) | ast.MatchAs(name=str(name)) | ast.MatchStar(name=str(name)):
                found.add(name)
            case ast.MatchMapping(rest=str(name)):
                found.add(name)
    return found


class Names:
    """Those of one function: of its module, of its parameters, and what it names itself once it is followed."""

    def __init__(
        self,
        function: Function,
        names: Mapping[str, Any],
        generators: set[str],
        skill: type[Skill[Any]] | None,
    ) -> None:
        self._function = function
        self._names = names
        self._generators = generators
        self._skill = skill
        self._local = dict(self._parameters())

    def _parameters(self) -> Iterator[tuple[str, Any]]:
        arguments = self._function.args
        if self._skill is not None:
            yield arguments.args[0].arg, self._skill
        for argument in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs):
            said = ast.unparse(argument.annotation) if argument.annotation is not None else ""
            if said == "CellSpec" or (argument.arg == "cell" and self._function.name == "forecast"):
                yield argument.arg, CellSpec
            elif said == "Cell" or (argument.arg == "cell" and not said):
                yield argument.arg, Cell

    def follow(self, node: ast.AST) -> None:
        """`hand = cell.hand` and `a, b = cell.a, cell.b` are followed; a name that is given twice is not."""
        if isinstance(node, ast.Import | ast.ImportFrom):
            self._import(node)
        if not isinstance(node, ast.Assign) or len(node.targets) != 1:
            return
        target, value = node.targets[0], node.value
        pairs = [(target, value)]
        if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple) and len(target.elts) == len(value.elts):
            pairs = list(zip(target.elts, value.elts, strict=True))
        for name, given in pairs:
            if isinstance(name, ast.Name):
                self._local[name.id] = None if name.id in self._local else self.type_of(given)

    def _import(self, node: ast.Import | ast.ImportFrom) -> None:
        """A clock that only this function imports."""
        for name in node.names:
            module = name.name if isinstance(node, ast.Import) else node.module
            if module in CLOCKS:
                found = importlib.import_module(module)
                given = found if isinstance(node, ast.Import) else getattr(found, name.name, None)
                self._names = {**self._names, name.asname or name.name: given}

    def function_of(self, called: ast.expr) -> tuple[types.FunctionType | None, tuple[None, ...]]:
        """A function of ours that is called, and what it is given beside: a method its object."""
        function = self.object_of(called)
        own: tuple[None, ...] = ()
        if function is SkillFailed:
            function, own = SkillFailed.__init__, (None,)
        if function is None and isinstance(called, ast.Attribute):
            owner = self.type_of(called.value)
            is_method = owner is not None and called.attr not in fields_of(owner)
            function, own = inspect.getattr_static(owner, called.attr, None) if is_method else None, (None,)
        is_ours = isinstance(function, types.FunctionType) and function.__module__.startswith("scuhand_bt.")
        return (function, own) if is_ours else (None, ())

    def object_of(self, node: ast.expr) -> Any:
        """What a name of the module, or an attribute of one, or of a class of it, stands for."""
        if isinstance(node, ast.Name):
            return None if node.id in self._local else self._names.get(node.id, getattr(builtins, node.id, None))
        if isinstance(node, ast.Attribute) and isinstance(owner := self.object_of(node.value), types.ModuleType | type):
            return getattr(owner, node.attr, None)
        return None

    def is_steps(self, call: ast.Call) -> bool:
        """Whether what is called only gives steps, which are still to be waited for."""
        function = call.func
        if isinstance(function, ast.Attribute) and isinstance(function.value, ast.Name) and function.value.id == "self":
            return function.attr in self._generators
        if isinstance(function, ast.Name) and function.id in self._generators:
            return True
        returned = self._returned(function)
        return typing.get_origin(returned) is collections.abc.Generator

    def _returned(self, function: ast.expr) -> Any:
        called = self.object_of(function)
        if called is None and isinstance(function, ast.Attribute):
            owner = self.type_of(function.value)
            called = inspect.getattr_static(owner, function.attr, None) if owner is not None else None
        return _hints(called).get("return") if isinstance(called, types.FunctionType) else None

    def type_of(self, node: ast.expr) -> type | None:
        """The class of an expression, by annotations; None where it cannot be told."""
        if isinstance(node, ast.Name):
            return self._local.get(node.id)
        if isinstance(node, ast.Attribute):
            owner = self.type_of(node.value)
            return _class(_member_type(owner, node.attr)) if owner is not None else None
        if isinstance(node, ast.Call):
            return _class(self._returned(node.func))
        return None


def has_member(owner: type, name: str) -> bool:
    """Whether a class, or what it is annotated to have, has it."""
    return hasattr(owner, name) or name in fields_of(owner)


def fields_of(owner: type) -> set[str]:
    """What a class is annotated to have."""
    return {name for cls in owner.__mro__ for name in getattr(cls, "__annotations__", {})}


def _member_type(owner: type, name: str) -> Any:
    if issubclass(owner, BaseModel) and name in owner.model_fields:
        return owner.model_fields[name].annotation
    member = inspect.getattr_static(owner, name, None)
    if isinstance(member, property):
        return _hints(member.fget).get("return")
    for cls in owner.__mro__:
        said = getattr(cls, "__annotations__", {}).get(name)
        if said is not None:
            return said if not isinstance(said, str) else _named(said, cls)
    return None


def _named(said: str, cls: type) -> Any:
    return vars(inspect.getmodule(cls)).get(said.strip("\"'"))


def _hints(function: Any) -> Mapping[str, Any]:
    try:
        return typing.get_type_hints(function)
    except (NameError, TypeError):  # a name that is imported for type checkers only
        return {}


def _class(annotation: Any) -> type | None:
    """One of the engine's classes; of `X | None` the class X, as nobody reads an attribute of nothing."""
    members = [member for member in typing.get_args(annotation) if member is not type(None)]
    if isinstance(annotation, types.UnionType) and len(members) == 1:
        annotation = members[0]
    is_ours = isinstance(annotation, type) and annotation.__module__.startswith("scuhand_bt.")
    return annotation if is_ours and annotation is not Wake else None
