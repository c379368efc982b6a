"""Finds the places in what a candidate may name that look up, set or run a name which it could give them.

Begins with all names of the policy's allow-list, and goes on with what their Python code calls in the same libraries.
"""

import ast
import functools
import importlib
import inspect
import textwrap
from collections.abc import Iterator
from types import FunctionType, MethodType
from typing import Any

from tacevo.gate.policy.allowed import is_allowed
from tacevo.sandbox.attributes import MODULES

#: What reads, sets or runs by a name.
_LOOKING_UP = frozenset({"getattr", "setattr", "delattr", "hasattr"})
_RUNNING = frozenset(
    {"eval", "exec", "compile", "__import__", "import_module", "attrgetter", "methodcaller", "open", "vars", "globals"}
    | {"locals", "get_type_hints", "getattr_static", "_getframe"}
)
#: Dictionaries that hold what stands behind names.
_TABLES = frozenset({"__dict__", "__globals__", "modules"})
#: Where code is read.
_LIBRARIES = (
    *("torch.nn", "torch.functional", "torch._tensor", "torch._jit_internal", "torch.overrides", "torch.autograd"),
    *("torch.fft", "torch.utils._contextlib", "functools", "collections", "copy", "enum", "dataclasses", "typing"),
    *("abc", "types", "reprlib", "contextlib"),
)


def find_doors() -> dict[str, set[str]]:
    """Return the calls that were found, by module and name of the function in which they stand."""
    doors: dict[str, set[str]] = {}
    seen: set[int] = set()
    waiting = [*_named()]
    kept = []  # so that no id is used again
    while waiting:
        thing = waiting.pop()
        if id(thing) in seen:
            continue
        seen.add(id(thing))
        kept.append(thing)
        if isinstance(thing, type):
            if (thing.__module__ or "").startswith(_LIBRARIES):
                waiting += [part for kind in thing.__mro__ if kind is not object for part in vars(kind).values()]
                waiting.append(type(thing))
            continue
        for function in _functions(thing):
            if (function.__module__ or "").startswith(_LIBRARIES):
                tree = _tree(function)
                calls = {ast.unparse(node) for node in ast.walk(tree) if _is_door(node)}
                if calls:
                    doors.setdefault(f"{function.__module__}.{function.__qualname__}", set()).update(calls)
                waiting += _called(tree, function)
    return doors


def _named() -> Iterator[object]:
    """Return everything that a candidate's text may name."""
    for path in sorted(MODULES):
        module = importlib.import_module(path)
        yield from (getattr(module, name) for name in dir(module) if is_allowed(path, name))


def _functions(thing: Any) -> list[FunctionType]:
    """Return the Python functions that run when something is called, read or set."""
    if isinstance(thing, property):
        return [function for function in (thing.fget, thing.fset, thing.fdel) if isinstance(function, FunctionType)]
    if isinstance(thing, staticmethod | classmethod | MethodType):
        thing = thing.__func__
    if isinstance(thing, functools.partial):
        thing = thing.func
    thing = inspect.unwrap(thing) if callable(thing) else thing
    return [thing] if isinstance(thing, FunctionType) else []


def _tree(function: FunctionType) -> ast.Module:
    try:
        return ast.parse(textwrap.dedent(inspect.getsource(function)))
    except (OSError, SyntaxError, TypeError):  # made by text, or a lambda in the middle of a line
        return ast.Module([], [])


def _is_door(node: ast.AST) -> bool:
    match node:
        case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name), args=args):
            is_written_out = len(args) > 1 and isinstance(args[1], ast.Constant)
            return name in _RUNNING or (name in _LOOKING_UP and not is_written_out)
        case ast.Subscript(value=ast.Attribute(attr=name)):
            return name in _TABLES
    return False


def _called(tree: ast.Module, function: FunctionType) -> Iterator[object]:
    """Return what the names in a function mean, where they are functions or classes."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Load):
            try:
                meant = eval(compile(ast.Expression(node), "", "eval"), function.__globals__)
            except Exception:  # a variable of the function's, or what only runs inside it
                continue
            if isinstance(meant, FunctionType | MethodType | type) or hasattr(meant, "__wrapped__"):
                yield meant
