"""The text beside a copy of a network that the model was given: whether it shows that the copy is only quoted.

Any code does that which is neither an example of using the class nor a repetition of what was given: a fragment, a
diff, a command, data, statements that change the network. Nobody can say from it what the model meant to return.
"""

import ast
import html
import re
from collections.abc import Iterator, Sequence, Set

from tacevo.gate.blocks import BlockParser, is_code, trimmed
from tacevo.gate.fences import FenceKind, Part, parts_of
from tacevo.gate.lines import is_known, plain
from tacevo.gate.versions import Known, makes_layers, statements_of

#: Signs of an edit, and the beginning of JSON.
_EDIT = re.compile(
    r"[ \t]*(?:<{5,}|>{5,}|={5,}$|@@|\*{3}[ \t]*(?:Begin|End|Update|Add|Delete)\b|(?:---|\+\+\+)[ \t]+\S+[/.]\S"
    r"|[{\[][ \t]*[\"{])"
)
#: The mark before a line of code outside of fences: a sign of a diff, a quote, a number, a cell of a table.
_MARK = re.compile(r"[ \t]*(?:\|[ \t|\d`]*|(?:[-+>]+|\d+[.:)])[ \t]*)")
_TAG = re.compile(r"</?[a-z]+[^<>]*>", re.IGNORECASE)
#: The methods that an example calls of a network: they ask for none of its parts and change none.
_GIVES_ITSELF = frozenset({"eval", "train", "to", "cpu", "cuda", "half", "float", "double"})
_LISTS_ALL = frozenset({"parameters", "named_parameters", "buffers", "modules", "named_modules"})
_USES = _GIVES_ITSELF | _LISTS_ALL | {"forward", "state_dict", "load_state_dict", "zero_grad", "shape", "size"}
_NAMED = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
_STATES = (*_NAMED, ast.Lambda, ast.Return, ast.Delete)


def is_edited(text: str, copy: Known, name: str, parser: BlockParser) -> bool:
    """Return whether a text, all of an answer but the copy, has code that shows that the copy is no answer.

    Raises:
        TooComplexError: reading it takes too much work.
    """
    codes: list[str] = []
    for part in parts_of(plain(text).split("\n")):
        code = trimmed("\n".join(part.lines))
        if part.kind is FenceKind.other and not _is_repeated(part.lines, copy.lines):
            return True
        if part.kind is FenceKind.python:
            parsed = parser.parse(code)
            if isinstance(parsed, ast.Module):
                codes += [] if _repeats(parsed, copy) or _is_repeated(part.lines, copy.lines) else [code]
                continue
        if any(map(_EDIT.match, part.lines)):
            return True
        code = trimmed("\n".join(_code_of(part, copy.lines)))
        codes += [code] if code else []
    if not codes:
        return False
    parsed = parser.parse("\n".join(codes))
    return not (isinstance(parsed, ast.Module) and _is_use(parsed, name))


def _repeats(tree: ast.Module, copy: Known) -> bool:
    """Return whether all that code states and computes is in the copy; imports compute nothing."""
    nodes = list(ast.walk(tree))
    imports = {ast.dump(node) for node in nodes if isinstance(node, ast.Import | ast.ImportFrom)}
    named = {node.name for node in nodes if isinstance(node, _NAMED)}
    known = {node.name for node in ast.walk(copy.tree) if isinstance(node, _NAMED)}
    return named <= known and statements_of(tree) - imports <= copy.statements


def _is_repeated(lines: Sequence[str], known: Set[str]) -> bool:
    return all(is_known(line.strip(), known) for line in lines if line.strip())


def _code_of(part: Part, known: Set[str]) -> Iterator[str]:
    """Yield the lines that are code and were not given."""
    for line in part.lines:
        bare = html.unescape(_TAG.sub("", line)).rstrip().rstrip("`|, \t\u00a0")
        inner = _MARK.sub("", bare, count=1)
        if not any(is_known(f"{form.strip()}{end}", known) for form in (bare, inner) for end in ("", ",")):
            if is_code(bare):
                yield bare
            elif is_code(inner.lstrip()):
                yield inner


def _is_use(tree: ast.Module, name: str) -> bool:
    """Return whether code is an example of using the class: it makes a network, calls it and changes nothing."""
    nodes = list(ast.walk(tree))
    known = {name}
    for node in nodes:
        match node:
            case ast.Assign(targets=[ast.Name(id=target)], value=value) if _is_network(value, known):
                known.add(target)
    is_named = any(isinstance(node, ast.Name) and node.id == name for node in nodes)
    return is_named and not makes_layers(nodes) and not any(_is_change(node, known) for node in nodes)


def _is_network(node: ast.expr, known: Set[str]) -> bool:
    """Return whether an expression is the class, or a network of it."""
    match node:
        case ast.Name(id=name):
            return name in known
        case ast.Call(func=ast.Name(id=name)):
            return name in known
        case ast.Call(func=ast.Attribute(value=value, attr=method)):
            return method in _GIVES_ITSELF and _is_network(value, known)
    return False


def _is_change(node: ast.AST, known: Set[str]) -> bool:
    """Return whether a node may change a network, or is a part of one."""
    match node:
        case ast.Attribute(ctx=ast.Store() | ast.Del()) | ast.Subscript(ctx=ast.Store() | ast.Del()):
            return True
        case ast.Attribute(value=value, attr=attribute):
            is_in_place = attribute.endswith("_") and not attribute.startswith("__")
            return is_in_place or (_is_network(value, known) and attribute not in _USES)
        case ast.Name(id="setattr" | "self"):
            return True
    return isinstance(node, _STATES)
