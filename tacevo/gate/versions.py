"""Versions of the class in an answer: which blocks have one, how much of it, and what stands behind the chosen one."""

import ast
import re
from collections.abc import Collection, Iterator

from tacevo.gate.blocks import BlockParser, CodeBlock, blocks_of
from tacevo.gate.joining import class_statements
from tacevo.gate.names import names_of
from tacevo.gate.policy.problems import Problem
from tacevo.records import Reason

#: What quotes, numbers or marks a line of code: `>`, `>>>`, `|`, `+` of a diff, a number, a key of JSON.
_DECORATION = r"[ \t]*(?:>+|\||\+|\.\.\.(?= )|\d+[.:|)]?|[{\[]?[ \t]*(?:\"\w+\"[ \t]*:[ \t]*)?\"(?=class\b))"
#: The sign of a fence and its language, unless that is Python or a diff, which shows a part of a class.
_LANGUAGE = r"^([ \t]*(?:`{3,}|~{3,}))[ \t]*(?!(?:diff|patch|i?py\w*)\b)\w[^`\n]*$"
_HEADER = r"^[ \t]*(?:class|def)[ \t]+(\w+)[ \t]*[(:]|^[ \t]*self\.\w+[ \t]*="


def has_class(block: CodeBlock, name: str) -> bool:
    """Return whether a block states the class; in text that does not parse, a line below must be indented."""
    if isinstance(block.parsed, ast.Module):
        return bool(class_statements(block.parsed, name))
    statement = rf"^([ \t]*)class[ \t]+{re.escape(name)}\b.*(?:\n[ \t]*)*(?:(?<=:)\Z|\n\1[ \t]+\S)"
    return re.search(statement, block.text, re.MULTILINE) is not None


def completeness(block: CodeBlock, name: str) -> int:
    """Tell a version of the class from an excerpt.

    Returns:
        0 where `forward` is missing, and no base may define it; 1 where something is left out: by `...`, by a comment
        instead of a body, or by a `forward` that computes nothing; else 2, also where the text does not parse.
    """
    if isinstance(block.parsed, Problem):
        header = rf"^([ \t]*)(?:def[ \t]+forward|class[ \t]+{re.escape(name)})\b.*(?:\n[ \t]*)*"
        comments = r"\n[ \t]*#.*(?:\n[ \t]*(?:#.*)?)*(?=\n|\Z)(?!\n\1[ \t])"
        return 1 if re.search(header + comments, block.text, re.MULTILINE) else 2
    return max(map(_completeness_of_class, class_statements(block.parsed, name)))


def _completeness_of_class(node: ast.ClassDef) -> int:
    forward = [item for item in node.body if isinstance(item, ast.FunctionDef) and item.name == "forward"]
    bases = {base.attr if isinstance(base, ast.Attribute) else getattr(base, "id", "") for base in node.bases}
    if not forward and not bases - {"Module"}:
        return 0
    is_stub = any(all(map(_computes_nothing, function.body)) for function in forward)
    return 1 if is_stub or any(map(_is_left_out, ast.walk(node))) else 2


def _computes_nothing(node: ast.stmt) -> bool:
    """Return whether a statement may stand for a body that is left out."""
    match node:
        case ast.Pass() | ast.Raise() | ast.Expr(value=ast.Constant()) | ast.Return(value=None | ast.Constant()):
            return True
    return False


def _is_left_out(node: ast.AST) -> bool:
    """Return whether a node is the statement `...`."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and node.value.value is ...


def later_version(text: str, chosen: ast.Module, name: str, parser: BlockParser, *, own: bool) -> Problem | None:
    """Find what shows that the model went on to another version of the class, in a form that cannot be used.

    A version that could be used would have been chosen. This one does not parse, has code left out, is quoted,
    numbered, a diff or JSON, or has another name. An excerpt of the chosen version has no statement of its own.

    The text is what stands behind the chosen version. `own` is as of `extract`: behind a network that was given, any
    other class, function or layer is a version.

    Raises:
        TooComplexError: reading it takes too much work.
    """
    if own and name.lower() not in text.lower():
        return None
    plain, known = _undecorated(text, name), _statements(chosen)
    header = rf"^[ \t]*class[ \t]+{re.escape(name)}[ \t]*[(:]"
    for block in blocks_of(plain, parser):
        if isinstance(block.parsed, Problem):
            if re.search(header, block.text, re.MULTILINE) and completeness(block, name) == 2:
                return block.parsed
        elif any(not _statements(node) <= known for node in class_statements(block.parsed, name)):
            return Problem(Reason.no_class, f"expected the whole of class {name}; got a later version of it in part")
    bound = names_of(chosen.body).bound - {name}
    if any(_is_renamed(plain, name, bound)) or (not own and _goes_on(plain, bound)):
        return Problem(Reason.no_class, f"expected class {name} in Python; got a later version in another form")
    return None


def _undecorated(text: str, name: str) -> str:
    """Return a text without what marks its lines, if it marks the class; and its fences as if they had no language."""
    if re.search(rf"class[ \t]+{re.escape(name)}\b.*\\n", text):  # JSON
        text = text.replace("\\n", "\n").replace('\\"', '"')
    if re.search(rf"^{_DECORATION}[ \t]*class[ \t]+{re.escape(name)}\b", text, re.MULTILINE | re.IGNORECASE):
        text = re.sub(rf"^{_DECORATION}", "", text, flags=re.MULTILINE)
    return re.sub(_LANGUAGE, r"\1text", text, flags=re.MULTILINE)


def _is_renamed(text: str, name: str, bound: Collection[str]) -> Iterator[bool]:
    """Yield whether statements give the class's name, or one with it, to something else than a class of that name."""
    name = re.escape(name)
    # The name is looked for in each class's own: a pattern that looks for it there tries every place with every other.
    network = rf"^[ \t]*(class)[ \t]+(\w+)[ \t]*(?:\([^)\n]*(?:Module|{name})|:)"
    for word, other in re.findall(network, text, re.MULTILINE | re.IGNORECASE):
        if re.search(name, other, re.IGNORECASE):
            yield (word, other) != ("class", name) and other not in bound
    for form in (
        rf"^(?:def[ \t]+{name}[ \t]*\(|{name}[ \t]*=[^=])",
        rf"^(?![ \t]*#|@@).*\S[ \t]*\bclass[ \t]+{name}\b.*:\s*\n[ \t]+(?:def\b|[\"'])",
        rf"^([ \t]*)class[ \t]+{name}\b.*:\s*\n\1(?:def\b|super\b|#|[\"'])",
    ):
        yield re.search(form, text, re.MULTILINE) is not None


def _goes_on(text: str, bound: Collection[str]) -> bool:
    text = re.sub(rf"^{_DECORATION}", "", text, flags=re.MULTILINE)
    return any(other not in bound for other in re.findall(_HEADER, text, re.MULTILINE | re.IGNORECASE))


def _statements(tree: ast.AST) -> set[str]:
    """Collect what the statements of a text compute, without those that stand for code that is left out."""
    parts: list[ast.AST] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef) or not isinstance(node, ast.stmt):
            continue
        if hasattr(node, "body"):
            parts += [part for part in ast.iter_child_nodes(node) if isinstance(part, ast.expr)]
        elif not _computes_nothing(node):
            parts.append(node)
    return set(map(ast.dump, parts))
