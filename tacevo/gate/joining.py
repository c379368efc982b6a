"""Joining the block of an answer that has the class with the blocks that have what it lacks."""

import ast
import builtins
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from tacevo.gate.names import Names, names_of
from tacevo.gate.policy.allowed import PROVIDED

#: The nodes that Python takes words for that are not code: `python`, `Sure,`, `net.py`, `Two-stage`, `Version-2`; a
#: label such as `[PYTHON]` or `{code:python}`; the first line of a here-document, `cat > net.py <<'END'`.
_WORDS = (
    *(ast.Name, ast.Attribute, ast.Constant, ast.BinOp, ast.UnaryOp, ast.BoolOp, ast.Compare),
    *(ast.Tuple, ast.List, ast.Set, ast.Dict),
)
_SIGNS = (ast.operator, ast.unaryop, ast.boolop, ast.cmpop, ast.expr_context)
_BUILTINS = frozenset(dir(builtins))


class ParsedCode(NamedTuple):
    """Text that parses, and its tree."""

    text: str
    tree: ast.Module


def parts_of_network(chosen: ParsedCode, others: Sequence[ParsedCode], name: str) -> tuple[list[str], list[int]]:
    """Join a block with those that have what it lacks.

    The others are in the order of the answer. Of another version of the class only the rest counts.

    Returns:
        The texts that the block lacks and its own, in the order to run them, without words that are not code; and the
        indices of those that it lacks.
    """
    dropped = [[*_words(code.tree), *class_statements(code.tree, name)] for code in others]
    names = [names_of(_kept(code.tree, gone)) for code, gone in zip(others, dropped, strict=True)]
    lacked = _lacked(names_of(chosen.tree.body), names, name) if names else []
    texts = [*(without(others[index], dropped[index]) for index in lacked), without(chosen, _words(chosen.tree))]
    return texts, lacked


def _lacked(own: Names, others: Sequence[Names], name: str) -> list[int]:
    """Return the indices of the blocks that bind at their top level what a block lacks, or what these lack.

    A block that uses the class as soon as it runs is an example of its use.
    """
    having: dict[str, list[int]] = {}
    for index, names in enumerate(others):
        for bound in names.bound - PROVIDED.keys() if name not in names.used_at_once else ():
            having.setdefault(bound, []).append(index)
    taken: set[int] = set()
    known = {*having, *PROVIDED, *_BUILTINS, "annotations"}
    waiting = [*own.lacked, "annotations"]  # from __future__: it changes how the rest is read
    for lacked in waiting:  # grows while it is walked; each name is looked up once
        if lacked not in known:
            waiting.append("*")  # an import of everything may bring it
            known |= {lacked, "*"}
        new = set(having.pop(lacked, ())) - taken
        taken |= new
        waiting += [other for index in new for other in others[index].lacked]
    return sorted(taken)


def future_first(code: ParsedCode) -> str:
    """Return a text with its imports from `__future__` before everything else, where Python wants them."""
    futures = [node for node in code.tree.body if isinstance(node, ast.ImportFrom) and node.module == "__future__"]
    lines = dict.fromkeys(map(ast.unparse, futures))
    return "\n".join([*lines, without(code, futures)])


def class_statements(tree: ast.Module, name: str) -> list[ast.ClassDef]:
    """List the statements at the top level of a text that define the class."""
    return [node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == name]


def _words(tree: ast.Module) -> list[ast.stmt]:
    """List the statements at the top level that consist of names: they do nothing, or fail."""
    return [node for node in tree.body if _is_words(node)]


def _is_words(node: ast.stmt) -> bool:
    match node:
        case ast.Expr(value=ast.Call(func=ast.List())):  # a link: [net.py](net.py)
            return True
        case ast.Expr(value=words) | ast.AnnAssign(target=ast.Name(), annotation=words, value=None):
            kinds = {type(part) for part in ast.walk(words)}
            return ast.Name in kinds and all(issubclass(kind, _WORDS + _SIGNS) for kind in kinds)
    return False


def _kept(tree: ast.Module, dropped: Iterable[ast.stmt]) -> list[ast.stmt]:
    gone = {id(node) for node in dropped}
    return [node for node in tree.body if id(node) not in gone]


def without(code: ParsedCode, dropped: Sequence[ast.stmt]) -> str:
    """Drop the lines of a text on which nothing else stands than these statements, and blank lines around the rest."""
    gone = {line for node in dropped for line in _lines_of(node)}
    gone -= {line for node in _kept(code.tree, dropped) for line in _lines_of(node)}
    kept = [line for number, line in enumerate(code.text.split("\n"), start=1) if number not in gone]
    return "\n".join(kept).strip("\n")


def _lines_of(node: ast.stmt) -> range:
    first = min([node.lineno, *(decorator.lineno for decorator in getattr(node, "decorator_list", ()))])
    return range(first, (node.end_lineno or first) + 1)
