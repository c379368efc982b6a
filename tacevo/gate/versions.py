"""Versions of the class in an answer: which blocks have one, how much of it, and what stands behind the chosen one."""

import ast
import re
from collections.abc import Collection, Iterator, Sequence, Set
from dataclasses import dataclass
from typing import Self

from tacevo.gate.blocks import BlockParser, CodeBlock, blocks_of, trimmed
from tacevo.gate.joining import ParsedCode, class_statements
from tacevo.gate.likeness import meaning
from tacevo.gate.lines import FOREIGN, is_all_code, lines_of, names, plain, states_network, undecorated
from tacevo.gate.names import names_of
from tacevo.gate.policy.problems import Problem
from tacevo.records import Reason
from tacevo.sandbox.attributes import MODULE_NAMES

#: The names of layers that a text imports by name, and those of losses, which are not layers.
_LAYER = re.compile(
    r"Conv|Linear|Bilinear|Sequential|Module|Parameter|(?:Batch|Layer|Group)Norm|\w*(?:Pool|ReLU|GELU|SiLU)"
)
_LOSS = re.compile(r"loss$|entropy|kl_div", re.IGNORECASE)
#: A comment in the place of code, and one that is such a comment where the code is missing.
_ELLIPSIS = re.compile(r"[ \t]*#+[ \t]*[(\[\uff08]?(?:\.{3}|\u2026)")
_MAY_STAND_FOR_CODE = re.compile(
    r"[ \t]*#.*(?:(?:\.{3}|\u2026)[)\]\uff09]?[ \t]*$|\b(?:same|unchanged|existing|remaining|rest|omitted|keep)\b"
    "|\\bas (?:above|before)\\b|\u4e0d\u53d8|\u5176\u4f59|\u7701\u7565)",  # "unchanged", "the rest", "omitted"
    re.IGNORECASE,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Known:
    """The text that is not another version where it stands beside the chosen one."""

    #: The chosen version.
    tree: ast.Module
    #: The name of its class in the answer, if it is another one.
    was: str
    #: The `lines_of` it and of the networks that the model was given.
    lines: Set[str]
    #: The `statements_of` the same.
    statements: Set[str]
    #: The meaning of the bodies of their classes.
    bodies: Set[object]

    @classmethod
    def of(cls, codes: Sequence[ParsedCode], *, written: str, was: str) -> Self:
        """Collect what is known of the chosen version, the first code, as it is written, and of given networks."""
        nodes = [node for code in codes for node in ast.walk(code.tree)]
        return cls(
            tree=codes[0].tree,
            was=was,
            lines=lines_of("\n".join([written, *(code.text for code in codes)])),
            statements=frozenset().union(*(statements_of(code.tree) for code in codes)),
            bodies={meaning(node.body) for node in nodes if isinstance(node, ast.ClassDef)},
        )

    def has(self, node: ast.ClassDef) -> bool:
        """Return whether a class has nothing of its own: a copy if it is whole, else parts of what is known."""
        methods = {item.name for item in node.body if isinstance(item, ast.FunctionDef)}
        is_whole = _completeness_of_class(node, ast.Module([], [])) == 2 and not _lacks_parts(node)
        if {"__init__", "forward"} <= methods and is_whole:
            return meaning(node.body) in self.bodies
        return statements_of(node) <= self.statements


def has_class(block: CodeBlock, name: str, known: Set[str] = frozenset()) -> bool:
    """Return whether a block states the class.

    A class with `call` or `__call__` in place of `forward` is one of another framework, as if it were another language.
    Text that does not parse states the class with a statement of it at its end, or with statements of a network below
    it that are not `known`, the `lines_of` other versions: an outline and a copy with remarks state nothing.
    """
    if isinstance(block.parsed, ast.Module):
        return not all(map(_is_foreign, class_statements(block.parsed, name)))
    text = plain(block.text)
    statement = rf"^([ \t]*)class[ \t]+{re.escape(name)}\b(.*)(?:\n[ \t]*)*(?:(?<=:)\Z|\n\1[ \t]+\S)"
    found = re.search(statement, text, re.MULTILINE)
    if found is None or FOREIGN.search(found[2]):
        return False
    below = text[found.start() :]
    return found.end() == len(text) or states_network(below, name, known, methods=True) or is_all_code(below)


def completeness(block: CodeBlock, name: str) -> int:
    """Tell a version of the class from an excerpt.

    Returns:
        0 where `forward` is missing, and no base may define it, or where a comment stands for code between other
        statements; 1 where something is left out: by `...`, by a comment instead of a body, or by a `forward` that
        computes nothing; else 2, also where the text does not parse.
    """
    if isinstance(block.parsed, Problem):
        header = rf"^([ \t]*)(?:def[ \t]+forward|class[ \t]+{re.escape(name)})\b.*(?:\n[ \t]*)*"
        comments = r"\n[ \t]*#.*(?:\n[ \t]*(?:#.*)?)*(?=\n|\Z)(?!\n\1[ \t])"
        return 1 if re.search(header + comments, block.text, re.MULTILINE) else 2
    tree = block.parsed
    nodes = class_statements(tree, name)
    return max(0 if _is_shortened(node, block.text) else _completeness_of_class(node, tree) for node in nodes)


def _is_shortened(node: ast.ClassDef, text: str) -> bool:
    """Return whether comments stand for code of a class: they begin with `...`, or say so where a part is missing."""
    strings = (part for part in ast.walk(node) if isinstance(part, ast.Constant) and isinstance(part.value, str))
    quoted = {line for part in strings for line in range(part.lineno + 1, (part.end_lineno or part.lineno) + 1)}
    lines = text.split("\n")
    end = node.end_lineno or node.lineno
    while end < len(lines) and re.match(r"[ \t]+#|[ \t]*$", lines[end]):  # behind its last statement
        end += 1
    numbers = [number for number in range(node.lineno + 1, end + 1) if number not in quoted]
    for number in numbers:
        goes_on = lines[number - 2].lstrip().startswith("#")  # "# It is", "# ... a sentence over two lines."
        if _ELLIPSIS.match(lines[number - 1]) and not goes_on:
            return True
    return any(_MAY_STAND_FOR_CODE.match(lines[number - 1]) for number in numbers) and _lacks_parts(node)


def _lacks_parts(node: ast.ClassDef) -> bool:
    """Return whether the methods of a class use a part of `self` that neither they nor a base may have made."""
    nodes = list(ast.walk(node))
    parts = [part for part in nodes if isinstance(part, ast.Attribute) and _is_name(part.value, "self")]
    used = {part.attr for part in parts if isinstance(part.ctx, ast.Load)}
    made = {part.attr for part in parts if isinstance(part.ctx, ast.Store)} | names_of(node.body).bound
    made |= {part.value for part in nodes if isinstance(part, ast.Constant) and isinstance(part.value, str)}
    return not _bases(node) - {"Module"} and bool(used - made - MODULE_NAMES - {"training"})


def _completeness_of_class(node: ast.ClassDef, tree: ast.Module) -> int:
    forward = [item for item in node.body if isinstance(item, ast.FunctionDef) and item.name == "forward"]
    if not (forward or _bases(node) - {"Module"} or _assigns_forward(tree, node)):
        return 0
    is_stub = any(all(map(_computes_nothing, function.body)) for function in forward)
    return 1 if is_stub or any(map(_is_left_out, ast.walk(node))) else 2


def _assigns_forward(tree: ast.Module, node: ast.ClassDef) -> bool:
    """Return whether a class has `forward` by another statement than its own `def`: `forward = run`, for example."""
    if "forward" in names_of(node.body).bound:
        return True
    return any(_sets_forward(part, "self") for part in ast.walk(node)) or any(
        _sets_forward(part, node.name) for statement in tree.body for part in ast.walk(statement)
    )


def _sets_forward(node: ast.AST, owner: str) -> bool:
    match node:
        case ast.Attribute(value=ast.Name(id=name), attr="forward", ctx=ast.Store()):
            return name == owner
        case ast.Call(func=ast.Name(id="setattr"), args=[ast.Name(id=name), ast.Constant(value="forward"), _]):
            return name == owner
    return False


def _is_foreign(node: ast.ClassDef) -> bool:
    """Return whether a class is one of another framework than torch."""
    bound = names_of(node.body).bound
    return "forward" not in bound and bool(bound & {"call", "__call__"})


def _bases(node: ast.ClassDef) -> set[str]:
    return {base.attr if isinstance(base, ast.Attribute) else getattr(base, "id", "") for base in node.bases}


def _computes_nothing(node: ast.stmt) -> bool:
    """Return whether a statement may stand for a body that is left out."""
    match node:
        case ast.Pass() | ast.Raise() | ast.Expr(value=ast.Constant()) | ast.Return(value=None | ast.Constant()):
            return True
        case ast.Assign(value=ast.Constant(value=value)):
            return value is ...
    return False


def _is_left_out(node: ast.AST) -> bool:
    """Return whether a node is the statement `...`."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and node.value.value is ...


def later_version(text: str, chosen: Known, name: str, parser: BlockParser) -> Problem | None:
    """Find what shows that the model went on to another version of the class, in a form that cannot be used.

    A version that could be used would have been chosen. This one does not parse, has code left out, is numbered, a diff
    or a text of a program, has another name, or does not stand at the top level. What has nothing of its own is no
    version: an excerpt of the chosen one, words about it, a test, a wrapper around it, another language.

    The text is what stands behind the chosen version.

    Raises:
        TooComplexError: reading it takes too much work.
    """
    text = plain(text)
    if not names(text, name):
        return None
    bound = names_of(chosen.tree.body).bound - {name} | {chosen.was}
    lines = text.split("\n")
    for block in blocks_of(text, parser):
        nodes = list(ast.walk(block.parsed)) if isinstance(block.parsed, ast.Module) else []
        nodes += [part for node in nodes for part in _nodes_of_string(node, name, parser)]
        for node in nodes:
            if found := _found_in(node, name, bound, chosen):
                return Problem(Reason.no_class, f"expected the last version of class {name} whole; got {found}")
        if any(isinstance(node, ast.ClassDef) for node in nodes):
            lines[block.start : block.end] = [""] * (block.end - block.start)
    text = undecorated("\n".join(lines), name)
    named = re.findall(rf"^[ \t]*{re.escape(name)}[ \t]*=[ \t]*(\w+|(?:torch\.)?nn\.\w+\(.*)$", text, re.MULTILINE)
    if states_network(text, name, chosen.lines) or any(other not in bound | {name} for other in named):
        return Problem(Reason.no_class, f"expected class {name} in Python; got a later version in another form")
    return None


def _nodes_of_string(node: ast.AST, name: str, parser: BlockParser) -> Iterator[ast.AST]:
    """Yield the nodes of a string that is Python and states the class."""
    match node:
        case ast.Constant(value=str(text)) if re.search(rf"\bclass[ \t]+{re.escape(name)}\b.*\n", text):
            parsed = parser.parse(trimmed(text))
            if isinstance(parsed, ast.Module):
                yield from ast.walk(parsed)


def _found_in(node: ast.AST, name: str, bound: Collection[str], chosen: Known) -> str:
    """Say which later version a node states; empty where it states none."""
    found = ""
    match node:
        case ast.ClassDef() if node.name == name:
            if not _is_foreign(node) and not chosen.has(node):
                found = "one in part, or not at the top level"
        case ast.ClassDef() if names(node.name, name) and node.name not in bound:
            if _is_network(node, name) and not chosen.has(node):
                found = f"one named {node.name}"
        case ast.FunctionDef() if node.name == name:
            found = "a function of that name"
        case ast.Assign(value=value) | ast.AnnAssign(value=ast.expr() as value):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            if any(_is_name(it, name) for it in targets) and _is_network_value(value, name, bound):
                found = "another one that is given its name"
        case ast.Constant(value=str(words)) if name in words and states_network(words, name, chosen.lines):
            found = "one in a string"
    return found


def _is_name(node: ast.expr, name: str) -> bool:
    return isinstance(node, ast.Name) and node.id == name


def _is_network_value(value: ast.expr, name: str, bound: Collection[str]) -> bool:
    """Return whether the class's name is given to another network: not to a constant, nor to what is made of it."""
    match value:
        case ast.Name(id=other):
            return other != name and other not in bound
        case ast.Call() | ast.Lambda() | ast.Attribute():
            return not any(isinstance(part, ast.expr) and _is_name(part, name) for part in ast.walk(value))
    return False


def _is_network(node: ast.ClassDef, name: str) -> bool:
    """Return whether a class of another name may stand for the network: it turns one thing into another, by itself.

    A test, settings and a data set have no `forward`; a loss takes more than one thing; what calls the class, or a
    network that it is given, wraps it.
    """
    inside = [part for statement in node.body for part in ast.walk(statement)]
    if any(isinstance(part, ast.Name) and part.id == name and not _is_of_super(part, inside) for part in inside):
        return False
    forward = [item for item in node.body if isinstance(item, ast.FunctionDef) and item.name == "forward"]
    if name in _bases(node):
        return bool(forward) or makes_layers(inside)
    if any(len(item.args.args) - len(item.args.defaults) > 2 for item in forward) or _is_given_a_network(node):
        return False
    return "forward" in names_of(node.body).bound and makes_layers(inside)


def _is_given_a_network(node: ast.ClassDef) -> bool:
    """Return whether a class keeps an argument without a default as it is, and calls it as a layer."""
    inside = list(ast.walk(node))
    arguments = {
        argument.arg
        for item in node.body
        if isinstance(item, ast.FunctionDef) and item.name == "__init__"
        for argument in item.args.args[1 : len(item.args.args) - len(item.args.defaults)]
    }
    kept: set[str] = set()
    for part in inside:
        match part:
            case ast.Assign(
                targets=[ast.Attribute(value=ast.Name(id="self"), attr=attribute)], value=ast.Name(id=value)
            ):
                kept |= {attribute} if value in arguments else set()
    calls = [part.func for part in inside if isinstance(part, ast.Call) and isinstance(part.func, ast.Attribute)]
    return any(_is_name(call.value, "self") and call.attr in kept for call in calls)


def _is_of_super(node: ast.Name, inside: Collection[ast.AST]) -> bool:
    calls = (part for part in inside if isinstance(part, ast.Call) and _is_name(part.func, "super"))
    return any(argument is node for call in calls for argument in call.args)


def makes_layers(inside: Collection[ast.AST]) -> bool:
    """Return whether code makes layers or calls the functions of torch: what a wrapper leaves to another class."""
    for part in inside:
        match part:
            case ast.Call(func=ast.Attribute(value=ast.Name(id="nn" | "F") | ast.Attribute(attr="nn"), attr=layer)):
                if not _LOSS.search(layer):
                    return True
            case ast.Call(func=ast.Name(id=layer)) if _LAYER.match(layer):
                return True
    return False


def statements_of(tree: ast.AST) -> set[str]:
    """Collect what the statements of a text compute, without those that stand for code that is left out.

    What stands alone in the body of a class computes nothing, as the words of an outline.
    """
    parts: list[ast.AST] = []
    silent: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef):
            silent |= {id(item) for item in node.body if _is_of_outline(item)}
        if isinstance(node, ast.FunctionDef | ast.ClassDef) or not isinstance(node, ast.stmt) or id(node) in silent:
            continue
        if hasattr(node, "body"):
            parts += [part for part in ast.iter_child_nodes(node) if isinstance(part, ast.expr)]
        elif not _computes_nothing(node):
            parts.append(node)
    return set(map(ast.dump, parts))


def _is_of_outline(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) or (isinstance(node, ast.AnnAssign) and node.value is None)
