"""What is below a node of a skill's file, and which of its functions the engine comes to by the calls of that file."""

import ast
from collections.abc import Iterator, Mapping, Sequence

from scuhand_bt.skill_files.names import Function

BY_THE_ENGINE = ("run", "settle", "check")
"""The methods of a skill that the engine carries out, and that may fail by SkillFailed alone."""
_OF_ITS_OWN = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda, ast.ClassDef)
_PLAIN = {"staticmethod", "classmethod"}


def within(function: ast.AST) -> Iterator[ast.AST]:
    """All below a node, in the order of the file; not what is in functions of its own."""
    ahead = [*ast.iter_child_nodes(function)][::-1]
    while ahead:
        node = ahead.pop()
        if not isinstance(node, _OF_ITS_OWN):
            yield node
            ahead += [*ast.iter_child_nodes(node)][::-1]


def all_of(node: ast.AST) -> Iterator[ast.AST]:
    """A node, and all below it."""
    yield node
    yield from within(node)


def yields(function: Function) -> bool:
    """Whether it is a generator."""
    return any(isinstance(node, ast.Yield | ast.YieldFrom) for node in within(function))


def unguarded(function: Function) -> list[ast.AST]:
    """All of a function that stands in no `try` with handlers, and in no `suppress`: what is caught is its business."""
    nodes = list(within(function))
    caught = {id(inner) for node in nodes for part in _guarded_by(node) for inner in all_of(part)}
    return [node for node in nodes if id(node) not in caught]


def come_to(module: ast.Module, body: ast.ClassDef) -> Mapping[Function, str]:
    """The functions of a skill's file that the engine comes to, unguarded, and what calls each; "" for the engine.

    By the name of a function of the file, and by `self.name`; steps only where they are waited for.
    """
    methods = {node.name: node for node in body.body if isinstance(node, Function) and _is_plain(node)}
    functions = {node.name: node for node in module.body if isinstance(node, Function) and not node.decorator_list}
    found = {methods[name]: "" for name in BY_THE_ENGINE if name in methods}
    ahead = list(found)
    while ahead:
        caller = ahead.pop()
        nodes = unguarded(caller)
        own = {node.arg for node in ast.walk(caller.args) if isinstance(node, ast.arg)}
        own |= {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
        waited = {id(node.value) for node in nodes if isinstance(node, ast.YieldFrom)}
        for node in nodes:
            match node:
                case ast.Call(func=ast.Name(id=name)) if name not in own:
                    called = functions.get(name)
                case ast.Call(func=ast.Attribute(value=ast.Name(id="self"), attr=name)):
                    called = methods.get(name)
                case _:
                    continue
            if called is not None and called not in found and (id(node) in waited or not yields(called)):
                found[called] = caller.name
                ahead.append(called)
    return found


def _is_plain(method: Function) -> bool:
    return all(isinstance(one, ast.Name) and one.id in _PLAIN for one in method.decorator_list)


def _guarded_by(node: ast.AST) -> Sequence[ast.stmt]:
    """The statements whose exceptions it may catch."""
    if isinstance(node, ast.With):
        called = [one.context_expr.func for one in node.items if isinstance(one.context_expr, ast.Call)]
        return node.body if any(ast.unparse(one).rpartition(".")[2] == "suppress" for one in called) else ()
    return node.body if isinstance(node, ast.Try | ast.TryStar) and node.handlers else ()
