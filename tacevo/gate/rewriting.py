"""Forms of a class that mean the same in a form that the policy lets pass; each change is said.

The text that results is the one that is checked, kept and run:

- `ImageRegressionCNN = TactileNet` gives the class the name that was asked for.
- `@torch.compile` is left out, and so is `torch.compile(...)` around what is made beside the classes: it changes how
  fast a network runs, and compiles code.
- `from torch.nn import *` becomes an import of the names that the text lacks.
"""

import ast
import builtins
import importlib
import io
import tokenize
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace

from tacevo.gate.blocks import BlockParser, CodeBlock
from tacevo.gate.edits import Edit, Lines
from tacevo.gate.joining import ParsedCode, class_statements, without
from tacevo.gate.names import names_of
from tacevo.gate.policy import allowed

_COMPILE = "torch.compile"
#: Modules of which the allow-list has the form of the names only.
_BY_PATTERN = frozenset({"torch.nn", "torch.nn.modules", "torch.nn.init"})
#: The depth to which calls of `torch.compile` in each other are left out.
_MOST_CALLS = 10


def rewritten(blocks: Sequence[CodeBlock], name: str, parser: BlockParser) -> list[CodeBlock]:
    """Return the blocks of an answer in a form that the policy lets pass, each with what was changed in it.

    Raises:
        TooComplexError: parsing what results takes too much work.
    """
    aliases = _aliases(blocks, name)
    return [_with_name(_without_compile(block, parser), aliases, name, parser) for block in blocks]


def _aliases(blocks: Sequence[CodeBlock], name: str) -> frozenset[str]:
    """Collect the names of classes that assignments at the top level give the class's name to."""
    trees = [block.parsed for block in blocks if isinstance(block.parsed, ast.Module)]
    classes = {node.name for tree in trees for node in tree.body if isinstance(node, ast.ClassDef)}
    return frozenset(other for tree in trees for node in tree.body if (other := _other(node, name)) in classes)


def _other(node: ast.stmt, name: str) -> str:
    """Return the name that a statement gives the class's name to; empty where it is no such statement."""
    match node:
        case (
            ast.Assign(targets=[ast.Name(id=target)], value=ast.Name(id=other))
            | ast.AnnAssign(target=ast.Name(id=target), value=ast.Name(id=other))
        ) if target == name != other:
            return other
    return ""


def _with_name(block: CodeBlock, aliases: Collection[str], name: str, parser: BlockParser) -> CodeBlock:
    """Give a class the name that an assignment gives it, and leave the assignment out."""
    tree = block.parsed
    if not aliases or not isinstance(tree, ast.Module) or class_statements(tree, name):
        return block
    statements = [node for node in tree.body if _other(node, name) in aliases]
    classes = [node.name for node in tree.body if isinstance(node, ast.ClassDef) and node.name in aliases]
    olds = [_other(node, name) for node in statements] or classes
    # Pythons before 3.12 see no names in an f-string, and others do; a source may not depend on that.
    formatted = [part for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in ast.walk(node)]
    if not olds or any(isinstance(part, ast.Name) and part.id == olds[-1] for part in formatted):
        return block
    text = without(ParsedCode(block.text, tree), statements)
    note = [f"{olds[-1]} was renamed to {name}, as an assignment says"] if classes else []
    return replace(_changed(block, _renamed(text, olds[-1], name), note, parser), was=olds[-1])


def _renamed(text: str, old: str, new: str) -> str:
    """Give an identifier another name, wherever it is not an attribute."""
    lines = text.split("\n")
    before = ""
    edits: dict[int, list[int]] = {}
    try:
        tokens = list(tokenize.generate_tokens(io.StringIO(text).readline))
    except (tokenize.TokenError, SyntaxError):  # the tokenizer of a Python may refuse what its parser takes
        return text
    for token in tokens:
        if token.type == tokenize.NAME and token.string == old and before != ".":
            edits.setdefault(token.start[0] - 1, []).append(token.start[1])
        before = token.string
    for row, columns in edits.items():
        line = lines[row]
        ends = [0, *(column + len(old) for column in columns)]
        parts = [line[end:column] for end, column in zip(ends, [*columns, len(line)], strict=True)]
        lines[row] = new.join(parts)
    return "\n".join(lines)


def _without_compile(block: CodeBlock, parser: BlockParser) -> CodeBlock:
    """Leave `torch.compile` out where it decorates, and where it is called beside the classes."""
    if not isinstance(block.parsed, ast.Module) or "compile" not in block.text:
        return block
    known = _names_of_compile(block.parsed)
    changed = block
    for _ in range(_MOST_CALLS):  # what is wrapped may wrap, too
        edits = list(_edits_of_compile(changed, known))
        if not edits:
            break
        changed = _changed(changed, Lines(changed.text).edited(edits), [], parser)
    if changed is block:
        return block
    imports = list(_edits_of_imports(changed))
    return _changed(changed, Lines(changed.text).edited(imports), [f"{_COMPILE} was left out"], parser)


def _edits_of_compile(block: CodeBlock, known: Collection[str]) -> Iterator[Edit]:
    """Yield what leaves decorators out, and the outermost calls of each statement."""
    if not isinstance(block.parsed, ast.Module):
        return
    lines = Lines(block.text)
    for node in ast.walk(block.parsed):
        for decorator in getattr(node, "decorator_list", ()):
            if any(_is_compile(part, known) for part in _called(decorator)):
                yield *lines.whole_lines(decorator), ""
    for statement in block.parsed.body:
        if not isinstance(statement, ast.ClassDef):
            yield from _uncompiled(statement, lines, known)


def _edits_of_imports(block: CodeBlock) -> Iterator[Edit]:
    """Yield what leaves `compile` out of the names that are imported."""
    lines = Lines(block.text)
    for node in ast.walk(block.parsed) if isinstance(block.parsed, ast.Module) else ():
        if isinstance(node, ast.ImportFrom) and node.module == "torch":
            kept = [alias for alias in node.names if alias.name != "compile"]
            if kept != node.names:
                yield lines.instead(node, ast.unparse(ast.ImportFrom("torch", kept, 0)) if kept else "")


def _names_of_compile(tree: ast.Module) -> frozenset[str]:
    """Collect what a text calls `torch.compile` by."""
    known = {_COMPILE}
    for node in ast.walk(tree):
        match node:
            case ast.Import(names=aliases):
                known |= {f"{alias.asname}.compile" for alias in aliases if alias.name == "torch" and alias.asname}
            case ast.ImportFrom(module="torch", names=aliases):
                known |= {alias.asname or "compile" for alias in aliases if alias.name == "compile"}
    return frozenset(known)


def _is_compile(node: ast.expr, known: Collection[str]) -> bool:
    return isinstance(node, ast.Name | ast.Attribute) and ast.unparse(node) in known


def _called(decorator: ast.expr) -> list[ast.expr]:
    """Return what a decorator is, or what makes it: `compile`, `compile(...)` or `partial(compile, ...)`."""
    match decorator:
        case ast.Call(func=ast.Name(id="partial") | ast.Attribute(attr="partial"), args=[first, *_]):
            return [first]
        case ast.Call(func=function):
            return [function]
    return [decorator]


def _uncompiled(statement: ast.stmt, lines: Lines, known: Collection[str]) -> Iterator[Edit]:
    """Yield what leaves the first call of `torch.compile` out of a statement, around what it is given."""
    for node in ast.walk(statement):
        match node:
            case ast.Call(func=function, args=arguments, keywords=keywords) if _is_compile(function, known):
                models = [*arguments[:1], *(word.value for word in keywords if word.arg == "model")]
            case ast.Call(func=ast.Call(func=function, args=[]), args=[model]) if _is_compile(function, known):
                models = [model]
            case _:
                continue
        if not models:
            continue
        match statement:
            case ast.Assign(targets=[target], value=value) if value is node:
                if ast.unparse(target) == ast.unparse(models[0]):
                    yield lines.instead(statement, "")
                    return
        yield *lines.span(node), lines.source(models[0])
        return


def without_stars(code: ParsedCode) -> tuple[str, list[str]]:
    """Write out what star imports of modules on the allow-list bring of the names that a text lacks.

    Returns:
        The text, and what was changed in it.
    """
    stars = [node for node in ast.walk(code.tree) if isinstance(node, ast.ImportFrom) and _is_star(node)]
    if not stars:
        return code.text, []
    lacked = names_of(code.tree.body).lacked - allowed.PROVIDED.keys() - set(dir(builtins))
    lines = Lines(code.text)
    edits: list[Edit] = []
    # Python keeps what the last import brings. What has a list of its names comes before what has a pattern of them.
    for node in sorted(reversed(stars), key=lambda node: node.module in _BY_PATTERN):
        module = node.module or ""
        names = sorted(name for name in lacked if _brings(module, name))
        lacked = lacked - {*names}
        edits.append(lines.instead(node, f"from {module} import {', '.join(names)}" if names else ""))
    modules = dict.fromkeys(str(node.module) for node in stars)
    return lines.edited(edits).strip("\n"), [f"from {module} import * was written out" for module in modules]


def _is_star(node: ast.ImportFrom) -> bool:
    """Return whether a statement imports all names of a module on the allow-list."""
    is_star = [alias.name for alias in node.names] == ["*"]
    return is_star and node.level == 0 and allowed.is_module(node.module or "")


def _brings(module: str, name: str) -> bool:
    """Return whether a module has a name, as far as a process without torch can tell."""
    if allowed.is_module(f"{module}.{name}"):
        return True
    is_ours = module.startswith("torch")
    return allowed.is_allowed(module, name) and (is_ours or hasattr(importlib.import_module(module), name))


def _changed(block: CodeBlock, text: str, notes: Sequence[str], parser: BlockParser) -> CodeBlock:
    return replace(block, text=text, parsed=parser.parse(text), notes=(*block.notes, *notes))
