"""What is wrong in a skill's file and would only come up in the middle of a run, found in its text by `ast`.

What its names stand for is in `names.py`; what cannot be followed is taken for right.
"""

import ast
import builtins
import inspect
import os
import sys
import types
import typing
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import PydanticSchemaGenerationError, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo

from scuhand_bt import skill as sdk
from scuhand_bt.cell.cell import Cell
from scuhand_bt.cell.leased import of_arm
from scuhand_bt.cell_spec import DEVICES
from scuhand_bt.failures import SkillFailed
from scuhand_bt.problems import Mark, Problems
from scuhand_bt.skill import Condition, Skill
from scuhand_bt.skill_files.calls import all_of, come_to, unguarded, within, yields
from scuhand_bt.skill_files.facts import Syntax
from scuhand_bt.skill_files.names import CLOCKS, Function, Names, bound_in, fields_of, has_member

EXITS = (sys.exit, os._exit, *(getattr(builtins, name, sys.exit) for name in ("exit", "quit")))
"""What ends the whole program."""
RESUMING = "settle"
"""The method that has the arm and the balance, too: by them an interrupted action is taken up."""


def check_source(skill: type[Skill[Any]], syntax: Syntax, module: types.ModuleType, file: str) -> Problems:
    """All that can be told of a skill by the text of its file."""
    problems = Problems()
    body = next(node for node in syntax.tree.body if isinstance(node, ast.ClassDef) and node.name == skill.__name__)
    _check_names(syntax, module, problems, file)
    _check_functions(syntax, module, set(skill.sees()), problems, file, skill, body)
    _check_body(skill, body, problems, file)
    return problems


def check_shared(syntax: Syntax, module: types.ModuleType, file: str) -> Problems:
    """The same of a file that skills share: which devices are leased is its callers' to say."""
    problems = Problems()
    _check_names(syntax, module, problems, file)
    _check_functions(syntax, module, None, problems, file)
    return problems


def _check_names(syntax: Syntax, module: types.ModuleType, problems: Problems, file: str) -> None:
    """Names that nothing in the file gives a value, each told once."""
    known = set(vars(module)) | bound_in(syntax)
    for node in syntax.nodes:
        if isinstance(node, ast.Name) and node.id not in known and not hasattr(builtins, node.id):
            remedy = f"from {sdk.__name__} import {node.id}" if node.id in sdk.__all__ else ""
            what, names = f"'{node.id}' has no value here", [name for name in known if not name.startswith("__")]
            problems.add(_mark(file, node), what, remedy, unknown=node.id, known=names, code="skill-unknown-name")
            known.add(node.id)


def _check_functions(
    syntax: Syntax,
    module: types.ModuleType,
    leased: set[str] | None,
    problems: Problems,
    file: str,
    skill: type[Skill[Any]] | None = None,
    body: ast.ClassDef | None = None,
) -> None:
    functions = [node for node in syntax.nodes if isinstance(node, Function)]
    generators = {function.name for function in functions if yields(function)}
    reached = come_to(syntax.tree, body) if body is not None else {}
    for function in functions:
        own = leased if leased is None else leased | ({"arm", "balance"} if function.name == RESUMING else set())
        of_skill = skill if body is not None and function in body.body and _has_self(function) else None
        _FunctionCheck(function, vars(module), generators, own, problems, file, of_skill, reached.get(function)).check()


def _check_body(skill: type[Skill[Any]], body: ast.ClassDef, problems: Problems, file: str) -> None:
    methods = {node.name: node for node in body.body if isinstance(node, Function)}
    wanted = {"run": ("self", "cell"), RESUMING: ("self", "cell"), "check": ("self", "cell")}
    for name, parameters in {**wanted, "forecast": ("cls", "inputs", "cell")}.items():
        method = methods.get(name)
        if method is None or (name == "check" and not issubclass(skill, Condition)):
            continue
        given = [argument.arg for argument in (*method.args.posonlyargs, *method.args.args)]
        needed = len(given) - len(method.args.defaults)
        if method.args.vararg is None and not needed <= len(parameters) <= len(given):
            what = (
                f"'{name}' takes {', '.join(given) or 'nothing'}; the engine calls it with the {len(parameters) - 1} "
            )
            what += f"value{'s' if len(parameters) > 2 else ''} {', '.join(parameters[1:])}"
            problems.add(_mark(file, method), what, f"def {name}({', '.join(parameters)})", code="skill-signature")
    if "forecast" in methods and not isinstance(inspect.getattr_static(skill, "forecast"), classmethod):
        problems.add(
            _mark(file, methods["forecast"]), "'forecast' is not a class method", "@classmethod", code="skill-signature"
        )
    for node in within(methods["check"]) if issubclass(skill, Condition) and "check" in methods else ():
        if isinstance(node, ast.Yield | ast.YieldFrom) or (isinstance(node, ast.Return) and _gives_a_value(node)):
            what = "a condition holds whenever its `check` returns: any value that it returns or yields is ignored"
            remedy = "write `raise SkillFailed(code, why)` where it does not hold"
            problems.add(_mark(file, node), what, remedy, code="skill-condition")
    run = methods.get("run")
    if run is not None and not yields(run) and not _returns_a_call(run):
        what = "'run' is not a generator: without a `yield` it cannot be waited for or halted"
        problems.add(
            _mark(file, run), what, "write `yield from pause(cell, …)`, or `yield from ()`", code="skill-generator"
        )
    interrupted = typing.get_args(typing.get_args(Skill.__annotations__["interrupted"])[0])
    for node in body.body:
        target = _target(node)
        if target == "interrupted" and skill.interrupted not in interrupted:
            what = f"'interrupted' cannot be {skill.interrupted!r}"
            problems.add(_mark(file, node), what, " or ".join(map(repr, interrupted)), code="skill-interrupted")
        info = skill.model_fields.get(target) if target is not None else None
        if info is not None and (why := _why_no_default(info)) is not None:
            what = f"the default of '{target}', {info.default!r}, is not of its type: {why}"
            problems.add(_mark(file, node), what, "write a value of that type", code="skill-default")
        is_float = info is not None and float in (info.annotation, *typing.get_args(info.annotation))
        if info is not None and is_float and not any(hasattr(m, "dimension") for m in info.metadata):
            what = f"'{target}' is a bare float: a workflow can neither show nor check its unit"
            remedy = "use Milligrams, Seconds, Millimetres, …, or Ratio for a share"
            problems.warn(_mark(file, node), what, remedy, code="skill-unit")


class _FunctionCheck:
    """One function of a skill's file."""

    def __init__(
        self,
        function: Function,
        names: Mapping[str, Any],
        generators: set[str],
        leased: set[str] | None,
        problems: Problems,
        file: str,
        skill: type[Skill[Any]] | None,
        caller: str | None,
    ) -> None:
        self._function = function
        self._names = Names(function, names, generators, skill)
        self._leased = leased
        self._problems = problems
        self._file = file
        self._skill = skill
        self._caller = caller
        """By what the engine comes to it, "" for itself; None where it does not, or what is raised here is caught."""

    def check(self) -> None:
        nodes = list(within(self._function))
        for node in nodes:
            self._names.follow(node)
        for node in nodes:
            if isinstance(node, ast.Attribute):
                self._check_member(node)
            elif isinstance(node, ast.Yield):
                self._check_yield(node, nodes)
            elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call) and self._names.is_steps(node.value):
                what = f"`{ast.unparse(node.value.func)}(…)` does nothing unless it is waited for"
                self._add(node, what, f"`yield from {ast.unparse(node.value.func)}(…)`", "skill-not-waited")
            elif isinstance(node, ast.Try):
                self._check_finally(node)
                self._check_halt(node)
            elif isinstance(node, ast.While):
                self._check_end(node)
            elif isinstance(node, ast.Raise) and node.exc is not None:
                self._check_raised(node, node.exc)
            elif isinstance(node, ast.Call):
                self._check_clock(node)
                if any(self._names.object_of(node.func) is one for one in EXITS):
                    self._warn_of_fault(node, f"`{ast.unparse(node.func)}` is called here")
                self._check_device(node)
                self._check_arguments(node)

    def _add(self, node: ast.AST, what: str, remedy: str, code: str, **names: Any) -> None:
        self._problems.add(_mark(self._file, node), what, remedy, code=code, **names)

    def _check_member(self, node: ast.Attribute) -> None:
        owner = self._names.type_of(node.value)
        if owner is None:
            return
        if not has_member(owner, node.attr):
            known = [name for name in dir(owner) if not name.startswith(("_", "model_"))]
            known += [name for name in fields_of(owner) if name not in known]
            if self._skill is not None and owner is self._skill:
                known = [*owner.model_fields, *(name for name in vars(owner) if not name.startswith("_"))]
            what = f"a {owner.__name__} has no '{node.attr}'"
            self._add(node, what, "", "skill-unknown-member", unknown=node.attr, known=known)
        elif owner is self._skill and isinstance(node.ctx, ast.Store) and node.attr in self._skill.model_fields:
            what = f"`{ast.unparse(node)}` is set, but a skill's parameters cannot change"
            self._add(node, what, "use a name of its own, without `self.`", "skill-set")
        elif owner is Cell:
            device = node.attr if node.attr in DEVICES else "arm" if of_arm(node.attr) else None
            if device is not None and self._leased is not None and device not in self._leased:
                what = f"the {device} is used here, but 'devices' does not lease it"
                self._add(node, what, f'devices = (…, "{device}")', "skill-lease")

    def _check_device(self, node: ast.Call) -> None:
        """`cell.device("air")`, of a further device of the cell."""
        called, named = node.func, node.args[0] if len(node.args) == 1 else None
        if not (
            isinstance(called, ast.Attribute) and called.attr == "device" and self._names.type_of(called.value) is Cell
        ):
            return
        name = named.value if isinstance(named, ast.Constant) and isinstance(named.value, str) else None
        if name is not None and self._leased is not None and name not in self._leased:
            what = f"the {name} is used here, but 'devices' does not lease it"
            self._add(node, what, f'devices = (…, "{name}")', "skill-lease")

    def _check_yield(self, node: ast.Yield, nodes: list[ast.AST]) -> None:
        value = node.value
        if value is None:
            if not _is_never_reached(node, self._function):
                what = "this yields nothing, but a skill must yield a `Wake`, which says when it goes on"
                self._add(
                    node, what, "`yield from pause(cell, 1.0)`, `yield Wake(cell.clock.now_s + 1.0)`", "skill-yield"
                )
        elif isinstance(value, ast.Call) and self._names.is_steps(value):
            call = ast.unparse(value.func)
            self._add(
                node,
                f"this yields `{call}(…)` as a whole, not each of its steps",
                f"`yield from {call}(…)`",
                "skill-yield",
            )
        elif not isinstance(value, ast.Call | ast.Name | ast.Attribute | ast.Subscript | ast.IfExp | ast.Await):
            what = f"this yields `{ast.unparse(value)}`, but a skill must yield a `Wake`, which says when it goes on"
            self._add(node, what, f"`yield from pause(cell, {ast.unparse(value)})`", "skill-yield")

    def _check_finally(self, node: ast.Try) -> None:
        for statement in node.finalbody:
            for inner in (statement, *within(statement)):
                if isinstance(inner, ast.Yield | ast.YieldFrom):
                    what = "this waits in `finally`, where a halted skill may only send safe commands"
                    self._add(inner, what, "send what makes it safe; the engine waits until it is", "skill-finally")

    def _check_halt(self, node: ast.Try) -> None:
        """A skill is halted by an exception where it waits: whoever catches that goes on."""
        if not any(isinstance(inner, ast.Yield | ast.YieldFrom) for part in node.body for inner in all_of(part)):
            return
        for handler in node.handlers:
            caught = handler.type.elts if isinstance(handler.type, ast.Tuple) else [handler.type]
            is_any = any(one is None or self._names.object_of(one) in (BaseException, GeneratorExit) for one in caught)
            if is_any and not any(isinstance(inner, ast.Raise) for part in handler.body for inner in all_of(part)):
                what = "this also catches what halts the skill"
                self._add(
                    handler, what, "use `finally:` for what must be done anyway, or `except SkillFailed:`", "skill-halt"
                )

    def _check_end(self, node: ast.While) -> None:
        """A loop without end that never waits."""
        is_endless = isinstance(node.test, ast.Constant) and bool(node.test.value)
        goes_on = (ast.Yield, ast.YieldFrom, ast.Await, ast.Break, ast.Return, ast.Raise)
        if is_endless and not any(isinstance(inner, goes_on) for part in node.body for inner in all_of(part)):
            what = "this loop never ends and never waits: everything else would stand still"
            self._add(node, what, "write `yield from pause(cell, …)` in it, or `break`", "skill-endless")

    def _check_raised(self, node: ast.Raise, raised: ast.expr) -> None:
        """What the engine calls may fail by SkillFailed alone; what is caught in it is its own business."""
        kind = self._names.object_of(raised.func if isinstance(raised, ast.Call) else raised)
        is_fault = isinstance(kind, type) and issubclass(kind, BaseException) and not issubclass(kind, SkillFailed)
        if is_fault and self._caller is not None and any(inner is node for inner in unguarded(self._function)):
            uncaught = f", and not caught where '{self._caller}' calls it" if self._caller else ""
            self._warn_of_fault(node, f"`{kind.__name__}` is raised here{uncaught}")

    def _warn_of_fault(self, node: ast.AST, what: str) -> None:
        what += ": that is a fault of the skill, and the whole run ends"
        self._problems.warn(_mark(self._file, node), what, "`raise SkillFailed(code, why)`", code="skill-fault")

    def _check_arguments(self, node: ast.Call) -> None:
        """What a method of a device, or a function of the SDK, is called with."""
        function, own = self._names.function_of(node.func)
        is_told = not any(isinstance(one, ast.Starred) for one in node.args) and all(one.arg for one in node.keywords)
        if function is None or not is_told:
            return
        try:
            inspect.signature(function).bind(*own, *node.args, **{str(one.arg): one.value for one in node.keywords})
        except TypeError as error:
            takes = [str(one) for one in list(inspect.signature(function).parameters.values())[len(own) :]]
            what = f"`{ast.unparse(node.func)}` is called with other values than it takes: {error}"
            self._add(node, what, f"it takes ({', '.join(takes)})", "skill-arguments")

    def _check_clock(self, node: ast.Call) -> None:
        called = self._names.object_of(node.func)
        home = getattr(called, "__module__", None) or getattr(getattr(called, "__self__", None), "__module__", None)
        for module, functions in CLOCKS.items():
            if home == module and called.__name__ in functions:
                what = (
                    f"`{ast.unparse(node.func)}` uses the computer's time, not the run's: everything else stands still"
                )
                if called.__name__ != "sleep":
                    what = f"`{ast.unparse(node.func)}` uses the computer's time, not the run's"
                remedy = "`yield from pause(cell, …)`" if called.__name__ == "sleep" else "`cell.clock.now_s`"
                self._add(node, what, remedy, "skill-clock")


def _has_self(function: Function) -> bool:
    return bool(function.args.args) and not function.decorator_list


def _why_no_default(info: FieldInfo) -> str | None:
    """Why a parameter's default is none of its values; pydantic takes any."""
    if info.is_required() or info.default is None or info.default_factory is not None:
        return None
    try:
        kind: Any = Annotated[(info.annotation, *info.metadata)] if info.metadata else info.annotation
        TypeAdapter(kind).validate_python(info.default, strict=True)
    except ValidationError as error:
        return str(error.errors(include_url=False)[0]["msg"])
    except PydanticSchemaGenerationError:  # a type of the lab's own
        pass
    return None


def _gives_a_value(node: ast.Return) -> bool:
    """Of a call it is not known."""
    return not (node.value is None or isinstance(node.value, ast.Call) or ast.unparse(node.value) == "None")


def _returns_a_call(function: Function) -> bool:
    return any(isinstance(node, ast.Return) and isinstance(node.value, ast.Call) for node in within(function))


def _is_never_reached(node: ast.Yield, function: Function) -> bool:
    """A `yield` behind a `return` or a `raise` only makes a generator of the function."""
    for block in (part for part in (function, *within(function)) if hasattr(part, "body")):
        ended = False
        for statement in block.body if isinstance(block.body, list) else ():
            if ended and any(inner is node for inner in ast.walk(statement)):
                return True
            ended = ended or isinstance(statement, ast.Return | ast.Raise)
    return False


def _target(node: ast.stmt) -> str | None:
    target = (
        node.targets[0] if isinstance(node, ast.Assign) else node.target if isinstance(node, ast.AnnAssign) else None
    )
    return target.id if isinstance(target, ast.Name) else None


def _mark(file: str, node: ast.AST) -> Mark:
    return Mark(file, node.lineno, node.col_offset + 1)  # type: ignore[attr-defined]
