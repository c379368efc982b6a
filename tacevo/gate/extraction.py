"""From a model's raw answer to one source text, without running it.

The rules, in order:

1. An answer that is too long, refused, missing or blank is rejected before anything is parsed.
2. If the whole answer is Python that defines the class, it is the source.
3. Otherwise its thoughts are left out first (`tacevo.gate.tags`). One that is not closed leaves no answer.
4. The rest is cut into blocks: what stands between fences that are marked as Python or not marked at all
   (`tacevo.gate.fences`), and elsewhere the longest stretches of lines that start like code and parse
   (`tacevo.gate.blocks`). Tags and marks around code do not belong to it.
5. The last block that has the class counts, whether it parses or not: a model that shows two versions means the later
   one. Where a whole class stands in the answer, an excerpt does not count. A later version in a form that cannot be
   used leaves no answer (`tacevo.gate.versions`).
6. Blocks that bind a name at their top level which the source uses but does not bind are put before it. Statements at
   the top level that consist of names are dropped (`tacevo.gate.joining`).
7. A text that binds the class's name twice is ambiguous, because Python would silently keep the last.
8. An answer that was cut off counts only if something after its last class statement shows that the class was finished.
9. An answer of more than 100 blocks, or one that takes more than 1,000,000 characters of parsing, is too complex.
"""

import ast
import re
from collections.abc import Sequence

from tacevo.gate.blocks import BlockParser, CodeBlock, TooComplexError, blocks_of, trimmed
from tacevo.gate.fences import FenceKind, parts_of
from tacevo.gate.joining import ParsedCode, class_statements, future_first, parts_of_network
from tacevo.gate.names import bound_by
from tacevo.gate.policy.problems import Problem
from tacevo.gate.tags import mentions_thought, without_thoughts
from tacevo.gate.versions import completeness, has_class, later_version
from tacevo.records import Completion, Contract, Reason, Rejection, Stage

#: Stop reasons of an answer that was cut off, by its token limit or the end of the model's context, or that may be.
CUT_OFF = frozenset({"max_tokens", "model_context_window_exceeded", "unknown"})

#: Stop reasons of what is not an answer.
_UNANSWERED = {
    "refusal": (Reason.refused, "the model refused to answer"),
    "key_repeated": (Reason.refused, "the answer repeats the API key, so its text was not recorded"),
    "invalid_request": (Reason.invalid_request, "the provider refused the request, e.g. because it is too long"),
}


def extract(completion: Completion, contract: Contract, *, own: bool = True) -> str | Rejection:
    """Find the source text in an answer that `first_look` lets pass.

    Args:
        completion: the answer.
        contract: names the class.
        own: whether the source would be the model's own; one that it was given is no answer where other code follows.

    Returns:
        Source that parses and defines the contract's class once: newlines normalised, dedented, ending with one
        newline; or a rejection at stage `extract`.
    """
    try:
        source = _choose(_normalised(completion.text), contract.class_name, completion.stop_reason in CUT_OFF, own)
    except TooComplexError as error:
        return _rejected(Reason.too_complex, str(error))
    except RecursionError:  # no parser's, but of what compares statements that are nested a thousand deep
        return _rejected(Reason.too_complex, "expressions are nested too deeply to be compared; simplify them")
    return _rejected(source.reason, source.detail) if isinstance(source, Problem) else source


def as_whole(text: str) -> str:
    """Return a text as `extract` does if it takes all of it for the source, and not a part."""
    return trimmed(_normalised(text)) + "\n"


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


def _choose(text: str, name: str, cut_off: bool, own: bool) -> str | Problem:
    """Pick the source among the blocks of an answer, as the module's rules say."""
    parser = BlockParser()
    answer, blocks = _read(text, name, parser)
    versions = [block for block in blocks if has_class(block, name)]
    if cut_off and not _is_closed(answer, versions, name):
        return Problem(Reason.truncated, f"the answer was cut off before class {name} was complete")
    shares = [completeness(block, name) for block in versions]
    if not any(shares):
        return _explain(answer, versions, blocks, name, parser)
    chosen = versions[max(range(len(versions)), key=lambda i: (shares[i], i))]
    source = _source(chosen, blocks, name, parser)
    if isinstance(source, Problem):
        return source
    return later_version(_behind(answer, chosen), source.tree, name, parser, own=own) or source.text


def _behind(answer: str, chosen: CodeBlock) -> str:
    """Return what of an answer stands behind a block and the fence around it."""
    lines = answer.split("\n")
    for part in parts_of(lines):
        last = part.first + len(part.lines)
        if chosen.end <= last:
            return "\n".join([*lines[chosen.end : last], *lines[part.end :]])
    return ""


def _read(text: str, name: str, parser: BlockParser) -> tuple[str, list[CodeBlock]]:
    """Return an answer without its thoughts, and its blocks: all of it, if that is Python and defines the class."""
    whole = trimmed(text)
    parsed = parser.parse(whole)
    if isinstance(parsed, ast.Module) and class_statements(parsed, name):
        return text, [CodeBlock(whole, parsed, closed=False, end=text.count("\n") + 1)]
    answer = without_thoughts(text, _lines_of_code(text, parser)) if mentions_thought(text) else text
    return answer, blocks_of(answer, parser)


def _lines_of_code(text: str, parser: BlockParser) -> set[int]:
    """Find the lines between fences that are Python, although they mention a thought."""
    numbers: set[int] = set()
    for part in parts_of(text.split("\n")):
        code = "\n".join(part.lines)
        if (
            part.kind is FenceKind.python
            and mentions_thought(code)
            and isinstance(parser.parse(trimmed(code)), ast.Module)
        ):
            numbers.update(range(part.first, part.first + len(part.lines)))
    return numbers


def _is_closed(answer: str, versions: Sequence[CodeBlock], name: str) -> bool:
    """Return whether the last class statement of an answer is in a block that the model finished."""
    if not versions or not versions[-1].closed:
        return False
    return not _mentions("\n".join(answer.split("\n")[versions[-1].end :]), name)


def _mentions(text: str, name: str) -> list[re.Match[str]]:
    """Find what may be class statements in text that need not parse."""
    return list(re.finditer(rf"^[ \t]*class[ \t]+{re.escape(name)}\b", text, re.MULTILINE))


def _source(chosen: CodeBlock, blocks: Sequence[CodeBlock], name: str, parser: BlockParser) -> ParsedCode | Problem:
    """Join a block with the class and those that it lacks, and check that they bind the class's name exactly once."""
    if isinstance(chosen.parsed, Problem):
        return chosen.parsed
    others = [block for block in blocks if block is not chosen]
    codes = [ParsedCode(block.text, block.parsed) for block in others if isinstance(block.parsed, ast.Module)]
    parts = parts_of_network(ParsedCode(chosen.text, chosen.parsed), codes, name)
    text = "\n\n".join(parts)
    tree = chosen.parsed if text == chosen.text else parser.parse(text)
    if isinstance(tree, Problem):
        return tree
    lines = [getattr(node, "lineno", 0) for node in ast.walk(tree) if bound_by(node) == name]
    if len(lines) > 1:
        where = ", ".join(map(str, lines))
        return Problem(Reason.ambiguous, f"expected one definition of {name}; got {len(lines)}, on lines {where}")
    return ParsedCode((text if len(parts) == 1 else future_first(ParsedCode(text, tree))) + "\n", tree)


def _explain(
    text: str, versions: Sequence[CodeBlock], blocks: Sequence[CodeBlock], name: str, parser: BlockParser
) -> Problem:
    """Return why no block has the whole class."""
    if versions:
        return Problem(Reason.no_class, f"expected class {name} with a forward method; got it without one")
    trees = [block.parsed for block in blocks if isinstance(block.parsed, ast.Module)]
    classes = sorted({node.name for tree in trees for node in tree.body if isinstance(node, ast.ClassDef)})
    if classes:
        return Problem(Reason.no_class, f"expected a class {name}; got {', '.join(classes)}")
    for mention in _mentions(text, name)[-1:]:
        parsed = parser.parse(trimmed(text[mention.start() :]))
        if isinstance(parsed, Problem):
            return parsed
    return Problem(Reason.no_class, f"expected a class {name}; got no Python class")
