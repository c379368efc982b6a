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
import re
import tokenize
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace

from tacevo.gate.blocks import BlockParser, CodeBlock
from tacevo.gate.joining import ParsedCode, class_statements, without
from tacevo.gate.names import names_of
from tacevo.gate.policy import allowed

_COMPILE = "torch.compile"
#: Where an edit begins and ends, as bytes of the text, and what stands there then.
_Edit = tuple[int, int, str]


def rewritten(blocks: Sequence[CodeBlock], name: str, parser: BlockParser) -> list[CodeBlock]:
    """Return the blocks of an answer in a form that the policy lets pass, each with what was changed in it.

    Raises:
        TooComplexError: parsing what results takes too much work.
    """
    aliases = _aliases(blocks, name)
    changed = [_with_name(_without_compile(block, parser), aliases, name, parser) for block in blocks]
    if not any(re.search(r"import[ \t]*\*", block.text) for block in changed):
        return changed
    lacked = {wanted for block in changed for wanted in _lacked(block)}
    return [_with_names_of_stars(block, lacked, parser) for block in changed]


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
    if not olds:
        return block
    text = without(ParsedCode(block.text, tree), statements)
    note = [f"{olds[-1]} was renamed to {name}, as an assignment says"] if classes else []
    renamed = _edited(text, _renaming(text, olds[-1], name))
    return replace(_changed(block, renamed, note, parser), was=olds[-1])


def _renaming(text: str, old: str, new: str) -> Iterator[_Edit]:
    """Yield what gives an identifier another name, wherever it is not an attribute."""
    starts = _starts(text)
    lines = text.split("\n")
    before = ""
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.NAME and token.string == old and before != ".":
            row, column = token.start
            first = starts[row - 1] + len(lines[row - 1][:column].encode())
            yield first, first + len(old.encode()), new
        before = token.string


def _without_compile(block: CodeBlock, parser: BlockParser) -> CodeBlock:
    """Leave `torch.compile` out where it decorates, and where it is called beside the classes."""
    tree = block.parsed
    if not isinstance(tree, ast.Module) or "compile" not in block.text:
        return block
    known = _names_of_compile(tree)
    starts = _starts(block.text)
    edits: list[_Edit] = []
    for node in (made for made in ast.walk(tree) if getattr(made, "decorator_list", ())):
        for decorator in getattr(node, "decorator_list", ()):
            if _is_compile(decorator.func if isinstance(decorator, ast.Call) else decorator, known):
                edits.append((starts[decorator.lineno - 1], starts[decorator.end_lineno or decorator.lineno], ""))
    for statement in (node for node in tree.body if not isinstance(node, ast.ClassDef)):
        edits += _uncompiled(statement, block.text, known, starts)
    if not edits:
        return block
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.ImportFrom)
            and node.module == "torch"
            and any(it.name == "compile" for it in node.names)
        ):
            kept = [alias for alias in node.names if alias.name != "compile"]
            edits.append(_instead(node, ast.unparse(ast.ImportFrom("torch", kept, 0)) if kept else "", block.text))
    return _changed(block, _edited(block.text, edits), [f"{_COMPILE} was left out"], parser)


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


def _uncompiled(statement: ast.stmt, text: str, known: Collection[str], starts: Sequence[int]) -> Iterator[_Edit]:
    """Yield what leaves `torch.compile` out of a statement, around what it is given; its calls are not nested."""
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
            case ast.Assign(targets=[ast.Name(id=target)], value=value) if value is node:
                if isinstance(models[0], ast.Name) and models[0].id == target:
                    yield _instead(statement, "", text)
                    return
        yield (*_span(node, starts), ast.get_source_segment(text, models[0]) or "")
        return


def _with_names_of_stars(block: CodeBlock, lacked: Collection[str], parser: BlockParser) -> CodeBlock:
    """Write out what star imports of modules on the allow-list bring of the names that an answer lacks."""
    tree = block.parsed
    stars = [node for node in ast.walk(tree) if _is_star(node)] if isinstance(tree, ast.Module) else []
    if not stars:
        return block
    left = set(lacked)
    edits: list[_Edit] = []
    # Python keeps what the last import brings. What has a list of its names comes before what has a pattern of them.
    for node in sorted(reversed(stars), key=lambda node: str(getattr(node, "module", "")) == "torch.nn"):
        assert isinstance(node, ast.ImportFrom)
        module = node.module or ""
        names = sorted(name for name in left if _brings(module, name))
        left -= set(names)
        edits.append(_instead(node, f"from {module} import {', '.join(names)}" if names else "", block.text))
    modules = ", ".join(str(getattr(node, "module", "")) for node in stars)
    return _changed(block, _edited(block.text, edits), [f"import * of {modules} was written out"], parser)


def _is_star(node: ast.AST) -> bool:
    """Return whether a node imports all names of a module on the allow-list."""
    return (
        isinstance(node, ast.ImportFrom)
        and node.level == 0
        and allowed.is_module(node.module or "")
        and [alias.name for alias in node.names] == ["*"]
    )


def _brings(module: str, name: str) -> bool:
    """Return whether a module has a name, as far as a process without torch can tell."""
    if allowed.is_module(f"{module}.{name}"):
        return True
    is_ours = module.startswith("torch")
    return allowed.is_allowed(module, name) and (is_ours or hasattr(importlib.import_module(module), name))


def _lacked(block: CodeBlock) -> Iterable[str]:
    """Return the names that a block lacks, and that Python and the sandbox do not provide."""
    if not isinstance(block.parsed, ast.Module):
        return ()
    return names_of(block.parsed.body).lacked - allowed.PROVIDED.keys() - set(dir(builtins))


def _changed(block: CodeBlock, text: str, notes: Sequence[str], parser: BlockParser) -> CodeBlock:
    return replace(block, text=text, parsed=parser.parse(text), notes=(*block.notes, *notes))


def _starts(text: str) -> list[int]:
    """Return the byte at which each line begins, and that behind the last one."""
    starts = [0]
    for line in text.split("\n"):
        starts.append(starts[-1] + len(line.encode()) + 1)
    return starts


def _span(node: ast.stmt | ast.expr, starts: Sequence[int]) -> tuple[int, int]:
    """Return the bytes at which a node begins and ends."""
    return starts[node.lineno - 1] + node.col_offset, starts[(node.end_lineno or 1) - 1] + (node.end_col_offset or 0)


def _instead(node: ast.stmt, written: str, text: str) -> _Edit:
    """Write something else in the place of a statement; with nothing, its lines go where nothing else holds them."""
    starts = _starts(text)
    first, last = _span(node, starts)
    line, end = starts[node.lineno - 1], starts[node.end_lineno or node.lineno]
    data = text.encode()
    is_alone = node.col_offset == 0 and re.fullmatch(rb"\s*(?:#.*)?\s*", data[last:end]) is not None
    if written or not is_alone:
        return first, last, written or "pass"
    return line, end, ""


def _edited(text: str, edits: Iterable[_Edit]) -> str:
    """Apply edits that do not overlap."""
    data = text.encode()
    for start, end, written in sorted(edits, reverse=True):
        data = data[:start] + written.encode() + data[end:]
    return data.decode()
