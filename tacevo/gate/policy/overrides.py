"""Names of `nn.Module` that a text redefines, in a class or on an object.

A network that answers `parameters()`, `train()` or `state_dict()` itself can misreport its size and ignore its mode.
"""

import ast
from collections.abc import Iterable, Iterator

from tacevo.gate.names import Comprehension, bound_by
from tacevo.gate.policy.problems import Problem
from tacevo.records import Reason
from tacevo.sandbox import attributes


def overrides(node: ast.AST) -> Iterator[Problem]:
    """Find the names in `attributes.MODULE_NAMES` that one node binds; its children are visited separately.

    A class is searched for what its body binds: methods, variables in every form of assignment, imports, classes.
    Variables of a method may have any name, and so may names outside classes. Attributes are searched for writes and
    deletions everywhere.
    """
    match node:
        case ast.ClassDef():
            for part in _class_scope(node.body):
                yield from _problems_of_class(part)
        case ast.Attribute(attr=name, ctx=ast.Store() | ast.Del()):
            yield from _problems_of_name(node, name)
        case ast.Call(func=ast.Name(id="setattr" | "delattr"), args=[_, ast.Constant(value=str(name)), *_]):
            yield from _problems_of_name(node, name)
        case ast.Call(func=ast.Name(id="type"), args=[_, _, *_]):
            detail = "type may not be called to make a class; write a class statement"
            yield Problem.at(Reason.redefines_module, node, detail)


def _problems_of_class(part: ast.AST) -> Iterator[Problem]:
    if name := bound_by(part):
        yield from _problems_of_name(part, name)
        is_own = name in attributes.SPECIAL_BINDINGS or isinstance(part, ast.FunctionDef)
        if attributes.is_special(name) and not is_own:
            yield Problem.at(Reason.forbidden_construct, part, f"special name {name} may not be assigned in a class")


def _problems_of_name(node: ast.AST, name: str) -> Iterator[Problem]:
    if name in attributes.MODULE_NAMES:
        detail = f"{name} is a name of nn.Module and may not be defined or assigned; choose another name"
        yield Problem.at(Reason.redefines_module, node, detail)


def _class_scope(nodes: Iterable[ast.AST]) -> Iterator[ast.AST]:
    """Walk what runs in a class's own scope: no body of a function, no nested class, no comprehension."""
    for node in nodes:
        yield node
        match node:
            case ast.FunctionDef():
                yield from _class_scope([*node.decorator_list, node.args, *filter(None, [node.returns])])
            case ast.Lambda():
                yield from _class_scope([node.args])
            case ast.ClassDef():
                yield from _class_scope([*node.decorator_list, *node.bases])
            case _ if not isinstance(node, Comprehension):
                yield from _class_scope(ast.iter_child_nodes(node))
