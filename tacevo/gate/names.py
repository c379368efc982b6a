"""The meaning of the names of a text: which ones it binds at its top level, and which ones it lacks."""

import ast
from collections.abc import Iterable
from dataclasses import dataclass

_Function = ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda
Comprehension = ast.ListComp | ast.SetComp | ast.DictComp | ast.GeneratorExp


@dataclass(frozen=True, slots=True)
class Names:
    """The names of a text."""

    #: The names that it binds at its top level: imports, classes, functions, and variables in any form of assignment.
    bound: frozenset[str]
    #: The names that it uses somewhere but does not bind where Python would look for them.
    lacked: frozenset[str]
    #: The names that it uses at its top level, so as soon as it runs.
    used_at_once: frozenset[str]


@dataclass(frozen=True, slots=True)
class _Scope:
    """A part of a text that has variables of its own."""

    #: The nodes that run in it; the list grows while it is walked.
    nodes: list[ast.AST]
    bound: set[str]
    used: set[str]
    #: The function around it, whose variables it sees; None at the top level and in its classes.
    around: "_Scope | None"
    #: Whether the functions in it see its variables.
    is_function: bool


def names_of(statements: Iterable[ast.stmt]) -> Names:
    """Find out what the names of a text mean."""
    top = _Scope([*statements], set(), set(), None, is_function=False)
    scopes = [top]
    for scope in scopes:  # grows while it is walked
        for node in scope.nodes:
            _note(node, scope)
            inside = _inside(node)
            own = {id(part) for part in inside}
            scope.nodes.extend(part for part in ast.iter_child_nodes(node) if id(part) not in own)
            if inside:
                around = scope if scope.is_function else scope.around
                scopes.append(_Scope(inside, _arguments(node), set(), around, not isinstance(node, ast.ClassDef)))
    used = {name for scope in scopes for name in scope.used if not _is_variable(name, scope)}
    return Names(frozenset(top.bound), frozenset(used - top.bound), frozenset(top.used))


def bound_by(node: ast.AST) -> str | None:
    """Return the name that a node binds in its scope or deletes from it; None where it does neither."""
    match node:
        case ast.Name(id=name, ctx=ast.Store() | ast.Del()):
            return name
        case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
            return name
        case ast.ExceptHandler(name=name) | ast.MatchAs(name=name) | ast.MatchStar(name=name):
            return name
        case ast.MatchMapping(rest=name):
            return name
        case ast.alias(name=path, asname=name):
            return name or path.split(".")[0]
    return None


def _note(node: ast.AST, scope: _Scope) -> None:
    """Note the name that a node uses or binds in its scope."""
    bound = bound_by(node)
    if bound is not None:
        scope.bound.add(bound)
    elif isinstance(node, ast.Name):
        scope.used.add(node.id)


def _inside(node: ast.AST) -> list[ast.AST]:
    """Return the parts of a node that run in a scope of its own: no default, no decorator, no annotation, no base."""
    match node:
        case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.ClassDef():
            return [*node.body]
        case ast.Lambda():
            return [node.body]
        case _ if isinstance(node, Comprehension):
            return [*ast.iter_child_nodes(node)]
    return []


def _arguments(node: ast.AST) -> set[str]:
    if not isinstance(node, _Function):
        return set()
    return {part.arg for part in ast.iter_child_nodes(node.args) if isinstance(part, ast.arg)}


def _is_variable(name: str, scope: _Scope) -> bool:
    """Return whether a name that a scope uses is its own, or one of a function around it, and not of the top level."""
    around: _Scope | None = scope
    while around is not None:  # without recursion: a text may nest thousands of lambdas
        if name in around.bound:
            return True
        around = around.around
    return False
