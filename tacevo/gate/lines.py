"""Lines of an answer that need not parse: whether they state a network, in whatever form."""

import re
import unicodedata
from collections.abc import Set

from tacevo.gate.blocks import is_code, is_sentence

#: The signs that quote, number or mark a line of code: `>`, `>>>`, `|`, `+` of a diff, a number, a key of JSON.
_DECORATION = r"[ \t]*(?:>+|\||\+|\.\.\.(?= )|\d+[.:|)]?|[{\[]?[ \t]*(?:\"\w+\"[ \t]*:[ \t]*)?\"(?=class\b))"
#: A statement that only the text of a network has, in the place where it stands.
_STATEMENT = re.compile(
    r"self\.\w[\w.\[\]]*[ \t]*(?:[-+*/@]|//)?=(?!=)|super\(|return\b.*\bself\.|\w[\w, .\[\]]*=(?!=).*\bself\."
    r"|\w[\w, .\[\]]*=[ \t]*(?:torch\.)?(?:nn|F)\.\w+\(|(?:for|if|while|with)\b.*\bself\."
)
_METHOD = re.compile(r"(?:async[ \t]+)?def[ \t]+\w+[ \t]*\(")
#: The beginning of a remark to a line of code: `x = 1 <- one`, `x = 1 | one`.
_REMARK = re.compile(r"[ \t]*(?:<[-=]|\u2190|->[ \t]*\w+[ \t]|\u2192|\u2014|\u2013|\||//|#|`|[ \t]{2,}\S|:[ \t]+\S)")
#: A row of a table, which has more than one cell.
_ROW = re.compile(r"[ \t]*\|[^|\n]*\|.*\|[ \t]*$")
#: The words and signs that no class statement of Python has.
FOREIGN = re.compile(r"[{<]|::|\bextends\b|\bimplements\b")


def lines_of(text: str) -> set[str]:
    """Return the lines of a version, in a form in which those of another one can be looked up."""
    return {_squeezed(line) for line in text.split("\n")}


def plain(text: str) -> str:
    """Return a text without signs that take no place, as a zero-width space is, and with plain spaces and brackets."""
    if text.isascii():
        return text
    kinds = {"Cf": "", "Zs": " "}
    text = "".join(kinds.get(unicodedata.category(letter), letter) for letter in text)
    return re.sub("[\uff01-\uff5e]", lambda letter: chr(ord(letter[0]) - 0xFEE0), text)


def names(text: str, name: str) -> bool:
    """Return whether a text has a name in any spelling: in lower case, with underscores or signs that take no place."""
    return _folded(name) in _folded(plain(text))


def _folded(text: str) -> str:
    return text.lower().replace("_", "")


def states_network(text: str, name: str, known: Set[str], *, methods: bool = False) -> bool:
    """Return whether a class statement, of the class's name or of one with it, has unknown statements below it.

    With `methods`, the unknown head of a method counts, too, where any statement stands below the class.
    """
    name = _folded(name)
    margin: int | None = None
    found: set[str] = set()
    for line in text.split("\n"):
        code, indentation = line.strip(), len(line) - len(line.lstrip())
        header = _class_header(line, name)
        if header is not None:
            margin, found = indentation, {"exact"} if header == name else set()
            continue
        if margin is None or not code:
            continue
        signs = _signs_of_network(code, known)
        uses_class = f"{name}(" in _folded(code)
        if code.startswith(("{", "```", "~~~")) or ("exact" not in found and uses_class):
            margin = None  # another language, another block, or what wraps the class
        elif not (signs or indentation > margin or code.startswith(("#", "@", '"', "'", "-"))):
            margin = None
        elif not uses_class:
            found |= signs
        is_new = "new statement" in found or (methods and {"new method", "statement"} <= found)
        if margin is not None and is_new and found & {"exact", "forward"}:
            return True
    return False


def is_all_code(text: str) -> bool:
    """Return whether a text has the `forward` and a statement of a network, and neither words nor remarks."""
    lines = [line.strip() for line in re.sub(r"(\"\"\"|''').*?\1", "", text, flags=re.DOTALL).split("\n")]
    has_forward = any(re.match(r"def[ \t]+forward\b", line) for line in lines)
    has_words = any(is_sentence(line) or re.search("<-|\u2190|\u2192|->(?!.*:$)", line) for line in lines)
    return has_forward and any(map(_STATEMENT.match, lines)) and not has_words


def undecorated(text: str, name: str) -> str:
    """Return a text without what marks its lines, and without tables."""
    if re.search(rf"class[ \t]+{re.escape(name)}\b.*\\n", text):  # JSON
        text = text.replace("\\n", "\n").replace('\\"', '"')
    lines = (line for line in text.split("\n") if not _ROW.match(line))
    return re.sub(rf"^{_DECORATION}", "", "\n".join(lines), flags=re.MULTILINE)


def _signs_of_network(code: str, known: Set[str]) -> set[str]:
    """Return what a line of code says: whether it is a statement of a network or the head of a method, and new."""
    is_new = "" if is_known(code, known) else "new "
    if not is_code(code):
        return set()
    if _METHOD.match(code):
        return {"method", f"{is_new}method"} | ({"forward"} if re.match(r"def[ \t]+forward\b", code) else set())
    return {"statement", f"{is_new}statement"} if _STATEMENT.match(code) else set()


def _class_header(line: str, name: str) -> str | None:
    """Return the name of the class that a line states and ends with, in lower case, if it has that name in its own."""
    found = re.search(r"\bclass[ \t]+(\w+)[ \t]*(?:[(\[].*|:.*)?$", line, re.IGNORECASE)
    if found is None or name not in _folded(found[1]) or FOREIGN.search(line[found.end(1) :]):
        return None
    rest = line[found.end(1) :].strip().rstrip("`")
    if re.search(r":\s*(?:[^\s\"'#].*)$", rest):  # words behind the colon
        return None
    return _folded(found[1])


def is_known(code: str, known: Set[str]) -> bool:
    """Return whether a line is one of those that are known, perhaps with a remark behind it."""
    if _squeezed(code) in known:
        return True
    remark = _REMARK.search(code.lstrip("`"))
    if remark is None:
        return False
    start = _squeezed(code.lstrip("`")[: remark.start()])
    return bool(start) and (start in known or f"{start}:" in known)


def _squeezed(line: str) -> str:
    return re.sub(r"\s+", "", line)
