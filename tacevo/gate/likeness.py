"""Networks compared by what they compute: without comments, docstrings, layout and what the sandbox provides."""

import ast
from collections.abc import Mapping
from functools import lru_cache

from tacevo.gate.names import names_of
from tacevo.gate.policy.allowed import PROVIDED
from tacevo.gate.policy.problems import Problem, parse

#: Fields of a node that do not change what it computes.
_SILENT = {"ctx", "kind", "type_comment"}


@lru_cache(maxsize=1024)  # the tables and figures of a run ask for the same
def is_same_network(source: str, other: str) -> bool:
    """Return whether two sources are one network, written with other comments, docstrings, order or layout."""
    if source == other:
        return True
    trees = [parse(text) for text in (source, other)]
    try:
        first, second = (None if isinstance(tree, Problem) else definitions(tree) for tree in trees)
    except RecursionError:  # nested too deeply to be compared
        return False
    return first is not None and first == second


def repeats(tree: ast.Module, given: ast.Module, name: str) -> bool:
    """Return whether a text states the class as a given network does, and nothing that it shares with it differs.

    It may leave out what the given network has beside the class, as a model does that quotes the class alone.
    """
    own, known = definitions(tree), definitions(given)
    shared = {key for key in own if key in known and not key.startswith("#")}
    return name in shared and all(own[key] == known[key] for key in shared)


def definitions(tree: ast.Module) -> Mapping[str, object]:
    """Return what each name at the top level of a text is bound to, in a form that can be compared.

    Names that the sandbox provides, and that are imported as it does, are left out. Statements that bind no name have
    the keys `#0`, `#1` and so on.

    Raises:
        RecursionError: the text is nested too deeply.
    """
    found: dict[str, object] = {}
    silent = 0
    for statement in tree.body:
        if _says_nothing(statement):
            continue
        if isinstance(statement, ast.Import | ast.ImportFrom):
            found |= _imported(statement)
            continue
        means = meaning(statement)
        bound = names_of([statement]).bound
        for name in bound:
            found[name] = (found[name], means) if name in found else means
        if not bound:
            found[f"#{silent}"] = means
            silent += 1
    return found


def _imported(statement: ast.Import | ast.ImportFrom) -> dict[str, object]:
    """Return the names that an import binds, with the path of each."""
    found: dict[str, object] = {}
    for alias in statement.names:
        if isinstance(statement, ast.ImportFrom):
            name, path = alias.asname or alias.name, f"{'.' * statement.level}{statement.module or ''}.{alias.name}"
        else:
            top = alias.name.split(".")[0]
            name, path = (alias.asname, alias.name) if alias.asname else (top, top)
        if PROVIDED.get(name) != path:
            found[name] = path
    return found


def meaning(node: object) -> object:
    """Return a tree, or a list of trees, as nested tuples that can be compared and hashed, without docstrings."""
    if isinstance(node, list):
        return tuple(meaning(item) for item in node if not _says_nothing(item))
    if isinstance(node, ast.AST):
        fields = (getattr(node, field, None) for field in node._fields if field not in _SILENT)
        return (type(node).__name__, *map(meaning, fields))
    return repr(node)


def _says_nothing(node: object) -> bool:
    """Return whether a node is a docstring, or another string that stands alone, or `pass`."""
    match node:
        case ast.Pass() | ast.Expr(value=ast.Constant(value=str())):
            return True
    return False
