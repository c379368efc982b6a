"""The static policy: what a candidate's syntax tree may contain.

Courtesy, not the wall: it answers in a millisecond, with a message that a person (or the next prompt) can act on.
Text that hides its intent can pass it; the sandbox confines the candidate.
"""

import ast
import io
import re
import tokenize
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial

from tacevo.gate.names import bound_by
from tacevo.gate.policy import allowed
from tacevo.gate.policy.overrides import overrides
from tacevo.gate.policy.problems import Problem, parse
from tacevo.gate.policy.weight_changes import weight_changes
from tacevo.records import Contract, Reason, Rejection, Stage
from tacevo.sandbox import attributes

#: Deepest nesting of the syntax tree; honest networks stay below 30, and the compiler's own stack ends near 1000.
DEEPEST = 100
#: PEP 263: a comment in the first two lines that names the encoding of a file.
_COOKIE = re.compile(r"[ \t\f]*#.*?coding[:=][ \t]*([-\w.]+)")
#: A field of `str.format` that walks to a special attribute, e.g. `{0.__class__}`.
_TEMPLATE = re.compile(r"\{[^{}]*\.__")
#: Sets of classes or modules are ordered by memory addresses, so an equal source would give another network.
_UNORDERED = "the order of sets differs between processes; use a list, a tuple or a dict"
_WRAPS = "functools.wraps"
_WRAPS_ONLY = "wraps may only decorate a function, as @wraps(f), because it writes attributes by their names"
_name_at = partial(Problem.at, Reason.forbidden_name)
_construct_at = partial(Problem.at, Reason.forbidden_construct)

#: Syntax that is refused wherever it stands, with the message.
_REFUSED: Mapping[type[ast.AST], str] = {
    ast.SetComp: f"a set may not be used: {_UNORDERED}",
    **dict.fromkeys(
        (ast.AsyncFunctionDef, ast.Await, ast.AsyncFor, ast.AsyncWith), "async code may not be used in a network"
    ),
    ast.MatchClass: "a class pattern may not be used, because it reads attributes; use isinstance",
}


def rejection_of(source: str, contract: Contract) -> Rejection | None:
    """Check source text, as `extract` returned it, against the policy.

    Return None where the text may go on to the probe, else a rejection at stage `policy` that names the line.
    """
    tree = parse(source)
    problem = tree if isinstance(tree, Problem) else _first_problem(source, tree, contract)
    if problem is None:
        return None
    return Rejection(stage=Stage.policy, reason=problem.reason, detail=problem.detail)


def _first_problem(source: str, tree: ast.Module, contract: Contract) -> Problem | None:
    """Find the first breach in the order of the lines."""
    by_depth = list(_by_depth(tree))
    if by_depth[-1][1] > DEEPEST:
        return Problem(Reason.too_complex, f"expected expressions nested at most {DEEPEST} deep; got more")
    nodes = [node for node, _ in by_depth]
    scope = _scope(nodes)
    problems = [
        *_problems_of_text(source),
        *(problem for node in nodes for problem in overrides(node)),
        *(problem for node in nodes for problem in _problems_of(node, scope)),
        *weight_changes(nodes, scope.imported),
    ]
    classes = {node.name for node in tree.body if isinstance(node, ast.ClassDef)}
    if not problems and contract.class_name not in classes:
        return Problem(Reason.no_class, f"expected a class {contract.class_name} at the top level; got none")
    return min(problems, key=lambda problem: problem.line, default=None)


def _by_depth(tree: ast.Module) -> Iterator[tuple[ast.AST, int]]:
    """Walk a tree breadth first with each node's depth, without recursion; stops below the deepest allowed."""
    waiting: deque[tuple[ast.AST, int]] = deque([(tree, 0)])
    while waiting:
        node, depth = waiting.popleft()
        yield node, depth
        if depth <= DEEPEST:
            waiting.extend((child, depth + 1) for child in ast.iter_child_nodes(node))


def _problems_of_text(source: str) -> Iterator[Problem]:
    """Find what the syntax tree does not show: encodings, and identifiers that Python folds to others (NFKC)."""
    for number, line in enumerate(source.split("\n")[:2], start=1):
        cookie = _COOKIE.match(line)
        if cookie and cookie[1].lower().replace("_", "-") not in ("utf-8", "utf8", "ascii", "us-ascii"):
            yield _construct_at(number, f"expected UTF-8 text; got the encoding {cookie[1]}")
    try:
        for token in tokenize.generate_tokens(io.StringIO(source).readline):
            if token.type in (tokenize.NAME, tokenize.ERRORTOKEN) and not token.string.isascii():
                yield _construct_at(token.start[0], f"expected identifiers in ASCII; got {token.string!r}")
    except (tokenize.TokenError, SyntaxError) as error:
        yield Problem(Reason.syntax, f"the text cannot be split into tokens: {error.args[0]}")


@dataclass(frozen=True, slots=True)
class _Scope:
    """The names of a text and their meaning. One scope is enough: honest networks do not reuse a module's name."""

    #: Names bound to modules, with the modules' dotted paths.
    modules: Mapping[str, str]
    #: Every name that an import binds.
    imported: frozenset[str]
    #: Every name that the text gives to something of its own: variables, arguments, functions and classes.
    defined: frozenset[str]
    #: Ids of the nodes of which an attribute is taken, and of those that are called.
    bases: frozenset[int]
    called: frozenset[int]
    #: Ids of the attributes that are special to Python and may be read.
    special: frozenset[int]
    #: Ids of the sets that something is looked up in, and of the decorators that `functools.wraps` makes.
    looked_up: frozenset[int]
    decorators: frozenset[int]
    #: Names that an import binds to `functools.wraps`.
    wraps: frozenset[str]


def _scope(nodes: list[ast.AST]) -> _Scope:
    """Collect what a text imports and how its expressions are used."""
    imports = [node for node in nodes if isinstance(node, ast.Import | ast.ImportFrom)]
    bindings = [binding for node in imports for binding in _bindings(node)]
    modules = {name: path for name, path in bindings if allowed.is_module(path)}
    return _Scope(
        modules={**modules, **allowed.PROVIDED},
        imported=frozenset([*allowed.PROVIDED, *(name for name, _ in bindings)]),
        defined=frozenset(name for node in nodes if (name := _defined(node))),
        bases=frozenset(id(node.value) for node in nodes if isinstance(node, ast.Attribute)),
        called=frozenset(id(node.func) for node in nodes if isinstance(node, ast.Call)),
        special=frozenset(map(id, _readable_special(nodes))),
        looked_up=_looked_up(nodes),
        decorators=frozenset(map(id, _decorators_of_one_argument(nodes))),
        wraps=frozenset(name for name, path in bindings if path == _WRAPS),
    )


def _decorators_of_one_argument(nodes: list[ast.AST]) -> Iterator[ast.expr]:
    """Yield what decorators of functions call with one argument, which is not unpacked."""
    for decorator in (made for node in nodes if isinstance(node, ast.FunctionDef) for made in node.decorator_list):
        match decorator:
            case ast.Call(func=function, args=[argument], keywords=[]) if not isinstance(argument, ast.Starred):
                yield function


def _readable_special(nodes: list[ast.AST]) -> Iterator[ast.expr]:
    """Yield the special attributes that can lead to nothing but what they are written for.

    These are the name of a class, methods of `self` and `super()`, and a base's constructor that is given `self`. A
    method of anything else could be called with another object in the place of its own: a container of parameters would
    look up any name in it.
    """
    for node in nodes:
        match node:
            case ast.Attribute(value=ast.Attribute(attr="__class__") as kind, attr="__name__"):
                yield from (node, kind)
            case ast.Attribute(attr="__name__"):
                yield node
            case ast.Attribute(value=ast.Name(id="self") | ast.Call(func=ast.Name(id="super"))):
                yield node
            case ast.Call(func=ast.Attribute(attr="__init__") as function, args=[ast.Name(id="self"), *_]):
                yield function


def _looked_up(nodes: list[ast.AST]) -> frozenset[int]:
    """Collect the sets in which something is only looked up, which needs no order: after `in`, or by their one name."""
    names: dict[str, list[ast.AST]] = {}  # what is loaded by a name or attribute
    asked: set[int] = set()
    for node in nodes:
        match node:
            case ast.Compare(ops=ops, comparators=operands):
                pairs = zip(ops, operands, strict=True)
                asked |= {id(operand) for operation, operand in pairs if isinstance(operation, ast.In | ast.NotIn)}
            case ast.Name(id=name, ctx=ast.Load()) | ast.Attribute(attr=name, ctx=ast.Load()):
                names.setdefault(name, []).append(node)
    for node in nodes:
        match node:
            case ast.Assign(targets=[ast.Name(id=name) | ast.Attribute(attr=name)], value=ast.Set() as value):
                if all(id(use) in asked for use in names.get(name, ())):
                    asked.add(id(value))
    return frozenset(asked)


def _defined(node: ast.AST) -> str | None:
    """Return the name that a node binds, except by an import; None where it binds none."""
    if isinstance(node, ast.arg):
        return node.arg
    return None if isinstance(node, ast.alias) else bound_by(node)


def _bindings(node: ast.Import | ast.ImportFrom) -> list[tuple[str, str]]:
    """List the names that an import binds, each with the dotted path of what it binds it to."""
    if isinstance(node, ast.ImportFrom):
        module = "." * node.level + (node.module or "")
        return [(alias.asname or alias.name, f"{module}.{alias.name}") for alias in node.names]
    tops = [(alias.name.split(".")[0], alias) for alias in node.names]
    return [(alias.asname, alias.name) if alias.asname else (top, top) for top, alias in tops]


def _problems_of(node: ast.AST, scope: _Scope) -> Iterator[Problem]:
    """Find the breaches at one node; its children are visited on their own."""
    match node:
        case ast.Import() | ast.ImportFrom():
            yield from _problems_of_import(node, scope)
        case ast.Name():
            yield from _problems_of_name(node, scope)
        case ast.Attribute():
            yield from _problems_of_attribute(node, scope)
        case ast.Call():
            yield from _problems_of_call(node, scope)
        case ast.Constant(value=str(text)) if _TEMPLATE.search(text):
            yield _name_at(node, "a format template may not read special attributes")
        case ast.FunctionDef(name=name):
            if attributes.is_special(name) and name not in attributes.SPECIAL_METHODS:
                methods = ", ".join(sorted(attributes.SPECIAL_METHODS))
                yield _construct_at(node, f"special method {name} may not be defined; allowed are {methods}")
            yield from _problems_of_binding(node, name, scope)
        case ast.ClassDef(name=name):
            if node.keywords:
                yield _construct_at(node, f"class {name} may have base classes only; remove the keywords")
            yield from _problems_of_binding(node, name, scope)
        case ast.arg() | ast.ExceptHandler() | ast.MatchAs() | ast.MatchStar() | ast.MatchMapping():
            yield from _problems_of_binding(node, _defined(node) or "", scope)
        case ast.Set() if id(node) not in scope.looked_up:
            yield _construct_at(node, f"a set may be looked up in, and not used: {_UNORDERED}")
        case _ if type(node) in _REFUSED:
            yield _construct_at(node, _REFUSED[type(node)])


def _problems_of_import(node: ast.Import | ast.ImportFrom, scope: _Scope) -> Iterator[Problem]:
    """Find imports that are not on the allow-list."""
    for alias, (name, path) in zip(node.names, _bindings(node), strict=True):
        wanted = alias.name if isinstance(node, ast.Import) else path
        module, _, last = path.rpartition(".")
        is_member = isinstance(node, ast.ImportFrom) and allowed.is_module(module) and allowed.is_allowed(module, last)
        if not (is_member or allowed.is_module(wanted)):
            detail = f"{wanted} may not be imported; allowed is what networks need from {allowed.IMPORTABLE}"
            yield Problem.at(Reason.forbidden_import, node, detail)
        elif scope.modules.get(name, path) != path:
            yield _construct_at(node, f"{name} already means {scope.modules[name]}; import {path} under another name")


def _problems_of_name(node: ast.Name, scope: _Scope) -> Iterator[Problem]:
    """Find forbidden built-ins and special names, and modules that are used as values or rebound."""
    name = node.id
    if not isinstance(node.ctx, ast.Load):
        yield from _problems_of_binding(node, name, scope)
    elif name in scope.wraps and id(node) not in scope.decorators:
        yield _construct_at(node, _WRAPS_ONLY)
    elif name in attributes.BUILTINS or (attributes.is_special(name) and name not in attributes.SPECIAL_NAMES):
        yield _name_at(node, f"{name} may not be used in a network")
    elif name in allowed.UNSTABLE and name not in scope.defined:
        detail = "memory addresses differ between processes" if name == "id" else _UNORDERED
        yield _construct_at(node, f"{name} may not be used: {detail}")
    elif name in attributes.ATTRIBUTE_FUNCTIONS and id(node) not in scope.called:
        yield _name_at(node, f"{name} may only be called, not passed as a value")
    elif name in scope.modules and id(node) not in scope.bases:
        yield _name_at(node, f"module {name} may not be used as a value; use {name}.NAME")


def _problems_of_binding(node: ast.AST, name: str, scope: _Scope) -> Iterator[Problem]:
    """Find names of modules, and `super`, that are bound to something else."""
    if name == "super":
        yield _construct_at(node, "super may not be bound to something else; choose another name")
    if name in scope.modules:
        yield _construct_at(node, f"{name} is the module {scope.modules[name]}; choose another name")


def _problems_of_attribute(node: ast.Attribute, scope: _Scope) -> Iterator[Problem]:
    """Find attributes that lead out of the network, and changes to what was imported."""
    yield from _problems_of_attribute_name(node, node.attr)
    if attributes.is_special(node.attr) and isinstance(node.ctx, ast.Load) and id(node) not in scope.special:
        yield _name_at(node, f"{node.attr} may only be read of self and of super()")
    if node.attr.startswith("_") and not attributes.is_special(node.attr) and _root(node) in scope.imported:
        yield _name_at(node, f"{ast.unparse(node)} may not be used, because it is private and was imported")
    if not isinstance(node.ctx, ast.Load) and _root(node) in scope.imported:
        yield _construct_at(node, f"{ast.unparse(node)} may not be changed, because it was imported")
    module = _module_of(node.value, scope)
    if module is None:
        return
    path = f"{module}.{node.attr}"
    if allowed.is_module(path):
        if id(node) not in scope.bases:
            yield _name_at(node, f"module {path} may not be used as a value; use {path}.NAME")
    elif path == _WRAPS and id(node) not in scope.decorators:
        yield _construct_at(node, _WRAPS_ONLY)
    elif not allowed.is_allowed(module, node.attr):
        yield _name_at(node, f"{path} may not be used; it is not on the list of allowed names in {module}")


def _problems_of_attribute_name(node: ast.AST, name: str) -> Iterator[Problem]:
    """Find attribute names that are forbidden on every object."""
    if attributes.is_refused(name):
        yield _name_at(node, f"attribute {name} may not be used in a network")


def _problems_of_call(node: ast.Call, scope: _Scope) -> Iterator[Problem]:
    """Find calls of `input`, which may be the name of an argument, and attributes that are named by a string."""
    function = node.func.id if isinstance(node.func, ast.Name) else ""
    if function == "input":
        yield _name_at(node, "input may not be called in a network")
    if function in ("setattr", "delattr") and node.args and _root(node.args[0]) in scope.imported:
        yield _construct_at(node, f"{function} may not change what was imported")
    match node.args:
        case [_, ast.Constant(value=str(name)), *_] if function in attributes.ATTRIBUTE_FUNCTIONS:
            yield from _problems_of_attribute_name(node, name)


def _module_of(node: ast.AST, scope: _Scope) -> str | None:
    """Find the module that an expression such as `torch.nn` means; None where it means something else."""
    if isinstance(node, ast.Name):
        return scope.modules.get(node.id)
    if isinstance(node, ast.Attribute):
        base = _module_of(node.value, scope)
        path = f"{base}.{node.attr}"
        return path if base is not None and allowed.is_module(path) else None
    return None


def _root(node: ast.AST) -> str | None:
    """Find the name that a chain of attributes and subscripts begins with."""
    while isinstance(node, ast.Attribute | ast.Subscript):
        node = node.value
    return node.id if isinstance(node, ast.Name) else None
