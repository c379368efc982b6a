"""The extraction of one source text from a model's raw answer, without running it.

The rules, in order:

1. An answer that is too long, refused, missing or blank is rejected before anything is parsed.
2. If the whole answer is Python that defines the class, it is the source.
3. Otherwise signs around its lines, JSON and notebooks are opened (`tacevo.gate.frames`), and its thoughts are left out
   (`tacevo.gate.tags`). A thought that is not closed leaves no answer.
4. The rest is cut into blocks: what stands between fences that are marked as Python or not marked at all
   (`tacevo.gate.fences`), and elsewhere the longest stretches of lines that start like code and parse
   (`tacevo.gate.blocks`). Tags, labels and sentences around code do not belong to it.
5. Some forms that mean the same are written in a form that the policy lets pass (`tacevo.gate.rewriting`); the source
   begins with a comment that says so.
6. The last block that has the class counts, whether it parses or not: a model that shows two versions means the later
   one. A copy of a network that the model was given does not count beside another version, nor does an excerpt beside a
   whole class. A later version in a form that cannot be used leaves no answer (`tacevo.gate.versions`).
7. Blocks that bind a name at their top level which the source uses but does not bind are put before it. Statements at
   the top level that consist of names are dropped (`tacevo.gate.joining`).
8. A text that binds the class's name twice is ambiguous, because Python would silently keep the last.
9. An answer that was cut off counts only if something after its last class statement shows that the class was finished.
10. An answer of more than 100 blocks, or one that takes more than 1,000,000 characters of parsing, is too complex.

Where an answer may be edits of a network that the model was given, `tacevo.gate.patches` comes first.
"""

import ast
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from tacevo.gate.blocks import BlockParser, CodeBlock, TooComplexError, blocks_of, trimmed
from tacevo.gate.fences import FenceKind, parts_of
from tacevo.gate.frames import unframed, without_here_documents
from tacevo.gate.joining import ParsedCode, class_statements, future_first, parts_of_network
from tacevo.gate.likeness import repeats
from tacevo.gate.lines import lines_of, names
from tacevo.gate.names import bound_by
from tacevo.gate.patches import patched
from tacevo.gate.policy.problems import Problem
from tacevo.gate.quoted import is_edited
from tacevo.gate.rewriting import rewritten, without_stars
from tacevo.gate.tags import mentions_thought, without_thoughts
from tacevo.gate.versions import Known, completeness, has_class, later_version
from tacevo.records import Completion, Contract, Reason, Rejection, Stage

#: Stop reasons of an answer that was cut off, by its token limit or the end of the model's context, or that may be.
CUT_OFF = frozenset({"max_tokens", "model_context_window_exceeded", "unknown"})

#: Stop reasons of what is not an answer.
_UNANSWERED = {
    "refusal": (Reason.refused, "the model refused to answer"),
    "key_repeated": (Reason.refused, "the answer repeats the API key, so its text was not recorded"),
    "invalid_request": (Reason.invalid_request, "the provider refused the request, e.g. because it is too long"),
}


@dataclass(frozen=True, slots=True)
class Extracted:
    """The candidate that an answer holds."""

    #: The source text. It parses and defines the class once: newlines normalised, dedented, ending with one newline.
    source: str
    #: The changes to the text, as a person would say them; the source begins with a comment for each.
    notes: tuple[str, ...] = ()


def extract(completion: Completion, contract: Contract, asked: str = "") -> str | Rejection:
    """Find the source text in an answer that `first_look` lets pass; see `extracted`."""
    found = extracted(completion, contract, asked)
    return found if isinstance(found, Rejection) else found.source


def extracted(completion: Completion, contract: Contract, asked: str = "") -> Extracted | Rejection:
    """Find the source text in an answer that `first_look` lets pass, and say what was changed in it.

    Args:
        completion: the answer.
        contract: names the class.
        asked: what the model was asked, with the networks that it was given; empty where that is not known. A copy of
            one of them does not count beside another version, and alone it is no answer where other code stands by it.

    Returns:
        The source; or a rejection at stage `extract`.
    """
    cut_off = completion.stop_reason in CUT_OFF
    try:
        found = _choose(_normalised(completion.text), contract.class_name, cut_off, _normalised(asked))
    except TooComplexError as error:
        return _rejected(Reason.too_complex, str(error))
    except RecursionError:  # no parser's, but of what compares statements that are nested a thousand deep
        return _rejected(Reason.too_complex, "expressions are nested too deeply to be compared; simplify them")
    return _rejected(found.reason, found.detail) if isinstance(found, Problem) else found


def edited(completion: Completion, parent: str, name: str) -> Completion | Rejection:
    """Return an answer that is a parent after the edits that an answer has; the answer itself where it has none.

    The text stands between fences, so that it is read as a whole: no part of it stands for it where another cannot be
    parsed.

    Args:
        completion: the answer, which `first_look` lets pass.
        parent: the network that it may be edits of, as the model was given it.
        name: of its class.

    Returns:
        An answer that was not cut off, for `extract`; or a rejection at stage `extract`.
    """
    text = patched(_normalised(completion.text), _normalised(parent), name, cut_off=completion.stop_reason in CUT_OFF)
    if isinstance(text, Problem):
        return _rejected(text.reason, text.detail)
    if text is None:
        return completion
    if completion.stop_reason in CUT_OFF - {"unknown"}:
        return _rejected(Reason.truncated, "the answer was cut off, perhaps before its last edit")
    fence = "~" * (3 + max((len(run) for run in re.findall("~+", text)), default=0))
    return replace(completion, text=f"{fence}python\n{text}\n{fence}\n", stop_reason="end_turn")


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


@dataclass(frozen=True, slots=True)
class _Answer:
    """An answer that is read."""

    #: The answer without what stands around code and without thoughts.
    text: str
    blocks: Sequence[CodeBlock]
    #: The networks that the model was given.
    given: Sequence[ParsedCode]
    #: The name of the class.
    name: str
    parser: BlockParser


@dataclass(frozen=True, slots=True)
class _Source:
    """A source text with its tree, and what was changed in it."""

    text: str
    tree: ast.Module
    notes: tuple[str, ...]


def _choose(text: str, name: str, cut_off: bool, asked: str) -> Extracted | Problem:
    """Pick the source among the blocks of an answer, as the module's rules say."""
    answer = _answer(text, name, asked)
    versions = _versions(answer)
    if cut_off and not _is_closed(answer.text, versions, name):
        return Problem(Reason.truncated, f"the answer was cut off before class {name} was complete")
    copies = [block for block in versions if _is_copy(block.parsed, answer)]
    candidates = [block for block in versions if not any(block is copy for copy in copies)]
    if not any(completeness(block, name) == 2 for block in candidates):
        candidates = versions
    shares = [completeness(block, name) for block in candidates]
    if not any(shares):
        return _explain(answer, versions)
    chosen = candidates[max(range(len(shares)), key=lambda i: (shares[i], i))]
    source = _source(chosen, answer)
    if isinstance(source, Problem):
        return source
    problem = _other_version(answer, source, chosen, copies)
    said = "".join(f"# tacevo: {note}\n" for note in source.notes)
    return problem or Extracted(said + source.text, source.notes)


def _answer(text: str, name: str, asked: str) -> _Answer:
    """Read an answer, and the networks that were given."""
    parser = BlockParser()
    rest, read = _read(text, name, parser)
    blocks = rewritten(read, name, parser)
    return _Answer(rest, blocks, _given(asked, name), name, parser)


def _given(asked: str, name: str) -> list[ParsedCode]:
    """List the networks that a question gives; what takes too much work to read gives none."""
    if name not in asked:
        return []
    try:
        blocks = blocks_of(asked, BlockParser())
    except TooComplexError:
        return []
    codes = [ParsedCode(block.text, block.parsed) for block in blocks if isinstance(block.parsed, ast.Module)]
    return [code for code in codes if class_statements(code.tree, name)]


def _is_copy(parsed: ast.Module | Problem, answer: _Answer) -> bool:
    """Return whether a text is a copy of a network that was given."""
    return isinstance(parsed, ast.Module) and any(repeats(parsed, code.tree, answer.name) for code in answer.given)


def _other_version(answer: _Answer, source: _Source, chosen: CodeBlock, copies: Sequence[CodeBlock]) -> Problem | None:
    """Find what shows that the model meant another network: behind the source, and beside one that is a copy."""
    is_copy = _is_copy(source.tree, answer)
    text = _beside(answer.text, [chosen, *copies]) if is_copy else _behind(answer.text, chosen)
    if not is_copy and not names(text, answer.name):
        return None
    written = "\n".join(answer.text.split("\n")[chosen.start : chosen.end])
    known = Known.of([ParsedCode(source.text, source.tree), *answer.given], written=written, was=chosen.was)
    problem = later_version(text, known, answer.name, answer.parser)
    if problem is None and is_copy and is_edited(text, known, answer.name, answer.parser):
        return Problem(
            Reason.no_class, f"expected class {answer.name}; got one that was given, and other code beside it"
        )
    return problem


def _versions(answer: _Answer) -> list[CodeBlock]:
    """List the blocks that have the class."""
    versions: list[CodeBlock] = []
    known = set[str]().union(*(lines_of(code.text) for code in answer.given))
    for block in answer.blocks:
        if has_class(block, answer.name, known):
            versions.append(block)
            known |= lines_of(block.text) if isinstance(block.parsed, ast.Module) else set()
    return versions


def _beside(text: str, blocks: Sequence[CodeBlock]) -> str:
    """Return an answer without some of its blocks."""
    lines = text.split("\n")
    for block in blocks:
        lines[block.start : block.end] = [""] * (block.end - block.start)
    return "\n".join(lines)


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
    text = without_here_documents(text)
    whole = trimmed(text)
    parsed = parser.parse(whole)
    if isinstance(parsed, ast.Module) and class_statements(parsed, name):
        return text, [CodeBlock(whole, parsed, closed=False, start=0, end=text.count("\n") + 1)]
    text = unframed(text, name)
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


def _source(chosen: CodeBlock, answer: _Answer) -> _Source | Problem:
    """Join a block with the class and those that it lacks, and check that they bind the class's name exactly once."""
    if isinstance(chosen.parsed, Problem):
        return chosen.parsed
    others = [(block, block.parsed) for block in answer.blocks if block is not chosen]
    parsed = [(block, ParsedCode(block.text, tree)) for block, tree in others if isinstance(tree, ast.Module)]
    codes = [code for _, code in parsed]
    parts, indices = parts_of_network(ParsedCode(chosen.text, chosen.parsed), codes, answer.name)
    text = "\n\n".join(parts)
    tree = chosen.parsed if text == chosen.text else answer.parser.parse(text)
    if isinstance(tree, Problem):
        return tree
    lines = [getattr(node, "lineno", 0) for node in ast.walk(tree) if bound_by(node) == answer.name]
    if len(lines) > 1:
        detail = f"expected one definition of {answer.name}; got {len(lines)}, on lines {', '.join(map(str, lines))}"
        return Problem(Reason.ambiguous, detail)
    notes = [note for block in (*(parsed[index][0] for index in indices), chosen) for note in block.notes]
    spelt, changes = without_stars(ParsedCode(text, tree))
    tree = answer.parser.parse(spelt) if changes else tree
    if isinstance(tree, Problem):
        return tree
    joined = spelt if len(parts) == 1 else future_first(ParsedCode(spelt, tree))
    return _Source(joined + "\n", tree, tuple(dict.fromkeys([*notes, *changes])))


def _explain(answer: _Answer, versions: Sequence[CodeBlock]) -> Problem:
    """Return why no block has the whole class."""
    name = answer.name
    trees = [block.parsed for block in answer.blocks if isinstance(block.parsed, ast.Module)]
    classes = sorted({node.name for tree in trees for node in tree.body if isinstance(node, ast.ClassDef)})
    if versions or name in classes:
        return Problem(Reason.no_class, f"expected class {name} whole, with a forward method; got it in part")
    if classes:
        return Problem(Reason.no_class, f"expected a class {name}; got {', '.join(classes)}")
    for mention in _mentions(answer.text, name)[-1:]:
        parsed = answer.parser.parse(trimmed(answer.text[mention.start() :]))
        if isinstance(parsed, Problem):
            return parsed
    return Problem(Reason.no_class, f"expected a class {name}; got no Python class")
