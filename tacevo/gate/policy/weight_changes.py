"""The changes that a text makes to weights, or to a module's mode, after construction; constructors may do all of it.

After construction runs what `forward` reaches by name: the methods and functions that it names, and all that these
name. A function that only a constructor names initialises. Text can hide a name; the probe sees what a pass changes.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Collection, Generator, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import chain
from typing import Self

from tacevo.gate.policy.problems import Problem
from tacevo.records import Reason
from tacevo.sandbox.attributes import MODES, WEIGHTS, is_special

#: Attributes that may not be used while the network runs, each with the reason.
_ATTRIBUTES: Mapping[str, Reason] = {
    **dict.fromkeys(WEIGHTS, Reason.changes_its_weights),
    **dict.fromkeys(MODES, Reason.changes_its_mode),
}

#: Names of the parameters of torch's own layers.
_LAYER_PARAMETER = re.compile(r"(in_proj_)?(weight|bias)(_(ih|hh)\w*)?")
_PARAMETER_CLASSES = ("Parameter", "ParameterList", "ParameterDict")
_CONSTRUCTORS = ("__init__", "__post_init__")
_Function = ast.FunctionDef | ast.Lambda


def weight_changes(nodes: list[ast.AST], imported: Collection[str]) -> Iterator[Problem]:
    """Find uses of `.data`, `.grad`, modes and in-place operations on parameters after construction.

    The nodes are all of a text; what is imported are the names that are not its own, such as `torch` and `nn`.
    """
    attributes = frozenset(name for node in nodes for name in _made_parameters(node))
    for function in _running(nodes):
        names = _Names(imported, attributes, frozenset())
        yield from _problems_in(_body(function), names)


def _problems_in(statements: Iterable[ast.stmt], names: _Names) -> Generator[Problem, None, _Names]:
    """Find what statements change, in their order; return what the names mean behind them.

    A variable that is set to something else, such as `weight - weight.mean()`, is a parameter no longer. Behind a
    branch or a loop it is one where it was one before or may have become one; a loop begins with all of these.
    """
    for statement in statements:
        blocks = _blocks(statement)
        own = list(_own([statement], outside=blocks))
        again = chain(own, _own(chain.from_iterable(blocks))) if isinstance(statement, ast.For | ast.While) else own
        names = names.adding(alias for node in again for alias in _aliases(node, names))
        for node in own:
            yield from _problems_of(node, names)
        names = replace(names, variables=names.variables - frozenset(_others(statement, names)))
        after = frozenset[str]() if isinstance(statement, ast.With) else names.variables
        for block in blocks:
            inside = yield from _problems_in(block, names.adding(after))
            after |= inside.variables
        names = replace(names, variables=after)
    return names


def _blocks(statement: ast.stmt) -> list[list[ast.stmt]]:
    """Return the statements inside a statement, list by list; none of a function or class."""
    if isinstance(statement, ast.FunctionDef | ast.ClassDef):
        return []
    parts = [statement, *getattr(statement, "handlers", ()), *getattr(statement, "cases", ())]
    return [getattr(part, name) for part in parts for name in ("body", "orelse", "finalbody") if hasattr(part, name)]


def _others(statement: ast.stmt, names: _Names) -> Iterator[str]:
    """Yield the variables that a statement sets to something that is not a parameter."""
    match statement:
        case ast.Assign(targets=targets, value=value) if not names.hold(value):
            yield from (target.id for target in targets if isinstance(target, ast.Name))


@dataclass(frozen=True, slots=True)
class _Names:
    """The meaning of names in one function."""

    imported: Collection[str]
    #: Attributes that the text makes parameters.
    attributes: frozenset[str]
    #: Variables that are one at this place, or that loop over a list of them.
    variables: frozenset[str]

    def adding(self, variables: Iterable[str]) -> Self:
        """Return the same with more variables."""
        return replace(self, variables=self.variables.union(variables))

    def are_imported(self, node: ast.expr) -> bool:
        """Return whether an expression such as `nn.init` begins with an imported name."""
        while isinstance(node, ast.Attribute):
            node = node.value
        return isinstance(node, ast.Name) and node.id in self.imported

    def hold(self, node: ast.AST | None) -> bool:
        """Return whether an expression is a parameter, or shares the memory of one.

        An element or a slice of a tensor shares its memory. An index by a tensor or a list makes a copy, and a variable
        may be one; so these are left to the probe.
        """
        match node:
            case ast.Name(id=name):
                return name in self.variables
            case ast.Attribute(attr=name):
                return name in self.attributes or _LAYER_PARAMETER.fullmatch(name) is not None
            case ast.Subscript(value=value, slice=index):
                return _is_fixed(index) and self.hold(value)
            case ast.Call(func=ast.Attribute(value=value, attr="detach")):
                return self.hold(value)
        return False


def _problems_of(node: ast.AST, names: _Names) -> Iterator[Problem]:
    """Find what one node of a running function does to weights or modes."""
    match node:
        case ast.Attribute(attr=name) if name in _ATTRIBUTES:
            yield _problem_of_attribute(node, name)
        case ast.Call(func=ast.Name(id="getattr" | "setattr"), args=[_, ast.Constant(value=str(name)), *_]):
            if name in _ATTRIBUTES:
                yield _problem_of_attribute(node, name)
        case ast.AugAssign(target=target) if names.hold(target):
            yield _problem_of_change(node, target)
        case ast.Subscript(value=value, ctx=ast.Store()) if names.hold(value):  # for every index: nothing is copied
            yield _problem_of_change(node, node)
    if isinstance(node, ast.Call):
        for changed in _changed(node, names):
            if names.hold(changed):
                yield _problem_of_change(node, changed)


def _changed(call: ast.Call, names: _Names) -> Iterator[ast.expr]:
    """Yield what a call changes, if its name ends as in-place operations do, and the tensors that it writes to."""
    name = _called(call)
    if name.endswith("_") and not is_special(name):
        match call.func:
            case ast.Attribute(value=owner) if not names.are_imported(owner):
                yield owner
            case _:  # a function, such as nn.init.zeros_
                yield from call.args[:1]
    yield from (word.value for word in call.keywords if word.arg in ("out", "tensor"))


def _is_fixed(index: ast.expr) -> bool:
    """Return whether an index is written out: numbers, slices, `...`, `None`, or a tuple of them."""
    match index:
        case ast.Constant() | ast.Slice() | ast.UnaryOp(operand=ast.Constant()):
            return True
        case ast.Tuple(elts=parts):
            return all(map(_is_fixed, parts))
    return False


def _problem_of_attribute(node: ast.AST, name: str) -> Problem:
    what = "switches modes" if _ATTRIBUTES[name] is Reason.changes_its_mode else "reaches weights and gradients"
    return Problem.at(_ATTRIBUTES[name], node, f"{name} may not be used after construction; only the trainer {what}")


def _problem_of_change(node: ast.AST, changed: ast.expr) -> Problem:
    detail = f"weight {ast.unparse(changed)} may not be changed after construction; initialise it in the constructor"
    return Problem.at(Reason.changes_its_weights, node, detail)


def _made_parameters(node: ast.AST) -> Iterator[str]:
    """Yield the attributes that a node of a text makes parameters."""
    match node:
        case ast.Assign(targets=targets, value=value) if _makes_parameters(value):
            yield from (target.attr for target in targets if isinstance(target, ast.Attribute))
        case ast.AnnAssign(target=ast.Attribute(attr=name), value=value) if value and _makes_parameters(value):
            yield name
        case ast.Call(func=ast.Attribute(attr="register_parameter"), args=[ast.Constant(value=str(name)), *_]):
            yield name


def _makes_parameters(value: ast.expr) -> bool:
    return isinstance(value, ast.Call) and _called(value) in _PARAMETER_CLASSES


def _aliases(node: ast.AST, names: _Names) -> Iterator[str]:
    """Yield the variables that a node sets to a parameter, or that loop over parameters."""
    match node:
        case ast.Assign(targets=targets, value=value) if names.hold(value):
            yield from (target.id for target in targets if isinstance(target, ast.Name))
        case ast.NamedExpr(target=ast.Name(id=name), value=value) if names.hold(value):
            yield name
        case ast.For(target=target, iter=source) | ast.comprehension(target=target, iter=source):
            calls = [part for part in ast.walk(source) if isinstance(part, ast.Call)]
            if names.hold(source) or any(_called(call) in ("parameters", "named_parameters") for call in calls):
                yield from (part.id for part in ast.walk(target) if isinstance(part, ast.Name))


def _running(nodes: list[ast.AST]) -> Iterator[_Function]:
    """Yield the functions that run after construction."""
    named: dict[str, list[ast.AST]] = {}
    for name, function in chain.from_iterable(map(_named, nodes)):
        named.setdefault(name, []).append(function)
    known = {id(function) for function in chain(*named.values(), *map(_applied, nodes))}
    named[""] = [node for node in nodes if isinstance(node, ast.Lambda) and id(node) not in known]
    reached = ["", "forward", *filter(is_special, named)]
    seen = {*reached}
    walked: set[int] = set()  # ids of functions, each of which may have thousands of names
    for name in reached:  # grows while it is walked
        for function in named.get(name, ()):
            if id(function) in walked:
                continue
            walked.add(id(function))
            if isinstance(function, _Function):
                yield function
            new = _mentions(_own(_body(function)) if isinstance(function, _Function) else [function]) - seen
            seen |= new
            reached += sorted(new)


def _named(node: ast.AST) -> Iterator[tuple[str, ast.AST]]:
    """Yield the function that a node defines, or what it assigns to other names, each with the name."""
    match node:
        case ast.FunctionDef(name=name) if name not in _CONSTRUCTORS:
            yield name, node
        case ast.Assign(targets=targets, value=ast.Lambda() | ast.Name() | ast.Attribute() as value):
            for target in targets:
                if isinstance(target, ast.Name | ast.Attribute):
                    yield (target.id if isinstance(target, ast.Name) else target.attr), value


def _applied(node: ast.AST) -> list[ast.Lambda]:
    """Return the lambdas that `apply` is called with: it calls them at once, on each module."""
    match node:
        case ast.Call(func=ast.Attribute(attr="apply"), args=args):
            return [part for part in args if isinstance(part, ast.Lambda)]
    return []


def _mentions(nodes: Iterable[ast.AST]) -> set[str]:
    """Collect the names, attributes and words that could name a function."""
    names = set()
    for node in nodes:
        match node:
            case ast.Name(id=name) | ast.Attribute(attr=name) | ast.Constant(value=str(name)):
                names.add(name)
    return names


def _body(function: _Function) -> list[ast.stmt]:
    return function.body if isinstance(function, ast.FunctionDef) else [ast.Expr(function.body)]


def _own(statements: Iterable[ast.stmt], *, outside: Iterable[Iterable[ast.stmt]] = ()) -> Iterator[ast.AST]:
    """Walk statements, without those outside, and of the functions inside only those that are called at once."""
    left_out = {id(statement) for block in outside for statement in block}
    waiting: list[ast.AST] = [*statements]
    for node in waiting:  # grows while it is walked
        waiting += [applied.body for applied in _applied(node)]
        if not isinstance(node, _Function):
            yield node
            waiting += [child for child in ast.iter_child_nodes(node) if id(child) not in left_out]


def _called(call: ast.Call) -> str:
    """Return the last name of what is called; empty where it has none."""
    match call.func:
        case ast.Name(id=name) | ast.Attribute(attr=name):
            return name
    return ""
