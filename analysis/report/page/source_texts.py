"""Source texts for the page: which letters are what, and which lines a child kept of a parent."""

from difflib import SequenceMatcher
from functools import cache, lru_cache
from itertools import groupby
from typing import Any

from pygments.lexers.python import PythonLexer
from pygments.token import Comment, Keyword, Name, Number, Operator, String, _TokenType

from tacevo.gate.imports import with_imports

#: What the page colours, by the letter of its class; the rest is `t`.
CLASSES: dict[str, tuple[_TokenType, ...]] = {
    "c": (Comment, String.Doc),
    "s": (String,),
    "n": (Number,),
    "k": (Keyword, Operator.Word),
    "d": (Name.Function, Name.Class, Name.Decorator),
    "b": (Name.Builtin,),
}

#: Pairs of lines, as 1,000 have with 1,000. The gate admits sources of 50,000 lines, and to compare two whose lines
#: repeat takes hours; still minutes where difflib leaves out the frequent ones, if a hundred are equally frequent.
_COMPARED = 1_000_000

_LEXER = PythonLexer()


def source_contents(text: str) -> dict[str, Any]:
    """Return the text of an admitted source, what its parts are (`marked`), and what makes it a file that runs.

    `given` is where imports go, in UTF-16 units, and their text.
    """
    whole = with_imports(text)
    at = next((at for at, letter in enumerate(text) if letter != whole[at]), len(text))
    given = _units(text[:at]), whole[at : at + len(whole) - len(text)]
    return {"text": text, "marks": marked(text), "given": given}


@lru_cache(maxsize=4096)  # a page of a running search is made again after every generation
def marked(text: str) -> str:
    """Return the classes of a source's letters, whatever it holds: what is not Python is plain text.

    These are runs of letters in the order of the text, as `k3 t1 d7`: a class of `CLASSES` and a length in UTF-16
    units, which is how the page's script counts.
    """
    parts = ((_class_of(token), _units(part)) for _, token, part in _LEXER.get_tokens_unprocessed(text))
    runs = ((name, sum(units for _, units in group)) for name, group in groupby(parts, key=lambda part: part[0]))
    return " ".join(f"{name}{units}" for name, units in runs)


@lru_cache(maxsize=8192)
def kept_lines(parent: str, child: str) -> tuple[tuple[int, int, int], ...]:
    """Return which lines of a parent a child kept: (first line of the parent, first line of the child, number).

    None of sources with more than `_COMPARED` pairs of lines.
    """
    before, after = parent.split("\n"), child.split("\n")
    if len(before) * len(after) > _COMPARED:
        return ()
    matcher = SequenceMatcher(None, before, after, autojunk=False)
    return tuple((match.a, match.b, match.size) for match in matcher.get_matching_blocks() if match.size)


@cache
def _class_of(token: _TokenType) -> str:
    return next((name for name, kinds in CLASSES.items() if any(token in kind for kind in kinds)), "t")


def _units(part: str) -> int:
    """Count UTF-16 units; a lone surrogate, which a damaged file can hold, is one."""
    return len(part.encode("utf-16-le", "surrogatepass")) // 2
