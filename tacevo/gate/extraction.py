"""From a model's raw answer to one source text, without running it.

The rules, in order:

1. An answer that is too long, refused, missing or blank is rejected before anything is parsed.
2. If the whole answer is Python that defines the class, it is the source.
3. Otherwise the blocks are its fenced blocks, if it has any that are Python, else the longest stretches of lines
   that parse.
4. The last block with the whole class is the source, because a model that shows two versions means the later one.
   Blocks that define a name which the source uses but does not define are put before it.
5. One text that defines the class twice is ambiguous, because Python would silently keep the last.

An answer cut off at its token limit counts only if its last block with the class was closed.
"""

import ast
import re
from collections.abc import Sequence
from dataclasses import dataclass

from tacevo.gate.blocks import Block, fenced_blocks, parsable_blocks
from tacevo.gate.policy.problems import Problem, parse
from tacevo.records import Completion, Contract, Reason, Rejection, Stage

#: Stop reasons of an answer that was cut off: by its token limit, or by the end of the model's context.
CUT_OFF = frozenset({"max_tokens", "model_context_window_exceeded"})

#: Stop reasons of what is not an answer.
_UNANSWERED = {
    "refusal": (Reason.refused, "the model refused to answer"),
    "invalid_request": (Reason.invalid_request, "the provider refused the request, e.g. because it is too long"),
}

#: What stands between blocks that are joined.
_BETWEEN = "\n\n"


@dataclass(frozen=True, slots=True)
class _Code:
    """A block that parses."""

    block: Block
    tree: ast.Module


def extract(completion: Completion, contract: Contract) -> str | Rejection:
    """Find the source text in an answer that `first_look` lets pass.

    Returns:
        Source that parses and defines the contract's class once: newlines normalised, dedented, ending with one
        newline; or a rejection at stage `extract`.
    """
    found = _choose(_normalised(completion.text), contract.class_name, completion.stop_reason in CUT_OFF)
    return _rejected(found.reason, found.detail) if isinstance(found, Problem) else found


def as_whole(text: str) -> str:
    """Return a text as `extract` does if it takes all of it for the source, and not a part."""
    return Block.of(_normalised(text), closed=False).text + "\n"


def first_look(completion: Completion, *, limit: int) -> Rejection | None:
    """Reject what needs no parsing; first what has more UTF-8 bytes than the limit, so that no more is done with it."""
    text, reason = completion.text, completion.stop_reason
    try:
        size = len(text) if len(text) > limit else len(text.encode())
    except UnicodeEncodeError as error:
        return _rejected(Reason.syntax, f"expected Unicode text; got a lone surrogate at character {error.start}")
    if size > limit:
        return _rejected(Reason.too_long, f"expected at most {limit} bytes; got {size} or more")
    if reason in _UNANSWERED:
        return _rejected(*_UNANSWERED[reason])
    if text.strip():
        return None
    cut_off = Reason.truncated, "the answer was cut off before its first word"
    return _rejected(*(cut_off if reason in CUT_OFF else (Reason.empty, "the answer is blank")))


def _rejected(reason: Reason, detail: str) -> Rejection:
    return Rejection(stage=Stage.extract, reason=reason, detail=detail)


def _normalised(text: str) -> str:
    """Use one line ending throughout and drop a byte order mark."""
    return text.removeprefix("\ufeff").replace("\r\n", "\n").replace("\r", "\n")


def _choose(text: str, name: str, cut_off: bool) -> str | Problem:
    """Pick the source among the blocks of an answer, as the module's rules say."""
    blocks = _blocks(text, name)
    codes = []
    for block in blocks:
        tree = parse(block.text)
        if isinstance(tree, ast.Module):
            codes.append(_Code(block, tree))
    mentioning = [block for block in blocks if _mentions(block.text, name)]
    if cut_off and not _is_closed(text, mentioning, name):
        return Problem(Reason.truncated, f"the answer was cut off before class {name} was complete")
    whole = [code for code in codes if _defines_whole(code.tree, name)]
    if not whole:
        return _explain(text, mentioning, codes, name)
    return _joined([*_helpers(whole[-1], codes, name), whole[-1]], name)


def _blocks(text: str, name: str) -> list[Block]:
    """Cut an answer into candidate blocks."""
    everything = Block.of(text, closed=False)
    tree = parse(everything.text)
    if isinstance(tree, ast.Module) and _class_definitions(tree, name):
        return [everything]
    fenced = fenced_blocks(text)
    if any(_mentions(block.text, name) for block in fenced):
        return fenced
    return parsable_blocks(text)


def _mentions(text: str, name: str) -> list[re.Match[str]]:
    """Find the class statements in text that need not parse."""
    return list(re.finditer(rf"^[ \t]*class[ \t]+{re.escape(name)}\b", text, re.MULTILINE))


def _is_closed(text: str, mentioning: Sequence[Block], name: str) -> bool:
    """Return whether the last class statement of an answer is in a block that the model finished."""
    in_blocks = sum(len(_mentions(block.text, name)) for block in mentioning)
    return bool(mentioning) and mentioning[-1].closed and in_blocks == len(_mentions(text, name))


def _class_definitions(tree: ast.Module, name: str) -> list[ast.ClassDef]:
    return [node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == name]


def _defines_whole(tree: ast.Module, name: str) -> bool:
    """Tell a whole class from an excerpt: it defines `forward`, or has a base that may define it."""
    for node in _class_definitions(tree, name):
        methods = {item.name for item in node.body if isinstance(item, ast.FunctionDef)}
        bases = {base.attr if isinstance(base, ast.Attribute) else getattr(base, "id", "") for base in node.bases}
        if "forward" in methods or bases - {"Module"}:
            return True
    return False


def _helpers(chosen: _Code, codes: Sequence[_Code], name: str) -> list[_Code]:
    """Find the other blocks that define what the chosen one uses but lacks, and what these lack, in text order."""
    left = [code for code in codes if code is not chosen and not _class_definitions(code.tree, name)]
    taken: list[_Code] = []
    missing = _loaded(chosen.tree) - _bound(chosen.tree)
    while new := [code for code in left if code not in taken and missing & _defined(code.tree)]:
        taken += new
        for code in new:
            missing |= _loaded(code.tree) - _bound(code.tree)
    return [code for code in codes if code in taken]


def _loaded(tree: ast.Module) -> set[str]:
    return {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load)}


def _bound(tree: ast.Module) -> set[str]:
    """Collect every name that a text binds in any scope."""
    names = _defined(tree)
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
        elif isinstance(node, ast.arg):
            names.add(node.arg)
        elif isinstance(node, ast.alias):
            names.add(node.asname or node.name.split(".")[0])
    return names


def _defined(tree: ast.Module) -> set[str]:
    """Collect the classes, functions and constants that a text defines at its top level."""
    names = {node.name for node in tree.body if isinstance(node, ast.ClassDef | ast.FunctionDef)}
    for node in tree.body:
        if isinstance(node, ast.Assign):
            names |= {target.id for target in node.targets if isinstance(target, ast.Name)}
    return names


def _joined(parts: Sequence[_Code], name: str) -> str | Problem:
    """Join blocks, each of which parses, and check that together they bind the class's name exactly once."""
    joined, above = ast.Module(body=[], type_ignores=[]), 0
    for part in parts:
        joined.body += ast.increment_lineno(part.tree, above).body
        above += part.block.text.count("\n") + _BETWEEN.count("\n")
    lines = [getattr(node, "lineno", 0) for node in ast.walk(joined) if _binds(node, name)]
    if len(lines) > 1:
        where = ", ".join(str(line) for line in lines)
        return Problem(Reason.ambiguous, f"expected one definition of {name}; got {len(lines)}, on lines {where}")
    return _BETWEEN.join(part.block.text for part in parts).strip("\n") + "\n"


def _binds(node: ast.AST, name: str) -> bool:
    """Return whether a node binds the class's name."""
    match node:
        case ast.ClassDef() | ast.FunctionDef() | ast.AsyncFunctionDef():
            return node.name == name
        case ast.Name(ctx=ast.Store()):
            return node.id == name
        case ast.alias():
            return (node.asname or node.name) == name
    return False


def _explain(text: str, mentioning: Sequence[Block], codes: Sequence[_Code], name: str) -> Problem:
    """Return why no block has the whole class."""
    if mentioning:
        tree = parse(mentioning[-1].text)
        if isinstance(tree, Problem):
            return tree
        return Problem(Reason.no_class, f"expected class {name} with a forward method; got it without one")
    classes = sorted({node.name for code in codes for node in code.tree.body if isinstance(node, ast.ClassDef)})
    if classes:
        return Problem(Reason.no_class, f"expected a class {name}; got {', '.join(classes)}")
    for mention in _mentions(text, name)[-1:]:
        tree = parse(Block.of(text[mention.start() :], closed=False).text)
        if isinstance(tree, Problem):
            return tree
    return Problem(Reason.no_class, f"expected a class {name}; got no Python class")
