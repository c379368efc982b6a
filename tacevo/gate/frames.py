"""The frames around every line of code, or around all of it: quotes, prompts, JSON, notebooks, other spaces."""

import contextlib
import json
import re
from collections.abc import Iterator, Sequence

from tacevo.gate.fences import STATEMENT

#: Spaces of Unicode that an editor shows as indentation, and Python does not read as such.
_SPACES = "\u00a0\u1680\u2000-\u200a\u202f\u205f\u3000"
_INDENTATION = re.compile(rf"^[ \t]*[{_SPACES}][ \t{_SPACES}]*", re.MULTILINE)
#: The prompts of Python and IPython; those of Python stand further in only in docstrings.
_FIRST_PROMPT = re.compile(r"(?: {0,3}>>>| *In \[\d+\]:)(?:[ \t]|$)")
_PROMPT = re.compile(rf"{_FIRST_PROMPT.pattern}|(?: {{0,3}}\.\.\.| *\.\.\.:)(?:[ \t]|$)")
_QUOTE = re.compile(r" {0,3}>")
_FENCE = re.compile(r"[ \t]*(`{3,}|~{3,})")
#: The place where JSON with a text in it may begin.
_JSON = re.compile(r"(?<!\w)(?=[{\[]\s*[\"{\[])")
#: The first line of a here-document, and the label that ends it.
_HERE = re.compile(
    r"[ \t]*(?:\$[ \t]*)?(?:sudo[ \t]+)?(?:cat|tee|python3?)\b[^\n]*<<-?[ \t]*([\"']?)(\w+)\1(?!\w)[^\n]*$"
)
#: The command of a notebook that writes the rest of its cell into a file.
_WRITES = re.compile(r"%%writefile\b.*")
#: The limits on how many times JSON is looked for, how deep its values are nested, and how often quotes are quoted.
_MOST_JSON, _DEEPEST, _MOST_QUOTES = 200, 12, 5


def unframed(text: str, name: str) -> str:
    """Return an answer without what stands around its code, where that is no fence and no tag.

    Spaces of Unicode become plain ones where they indent. Quoted lines (`> code`) and those of a session (`>>> code`)
    lose their signs, and a session its output. JSON with one text that has the class (a tool call) becomes that text, a
    notebook becomes its cells. The first line of a cell that writes a file (`%%writefile net.py`) is left out.
    """
    if name in text and ("{" in text or "[" in text):
        text = _without_json(text, name)
    if name in text and "%%writefile" in text:
        text = "\n".join("" if _WRITES.fullmatch(line) else line for line in text.split("\n"))
    text = _with_plain_indentation(text)
    if name in text:
        text = _with_plain_indentation(_without_prompts(_without_quotes(text), name))
    return text


def _with_plain_indentation(text: str) -> str:
    return _INDENTATION.sub(lambda match: re.sub(f"[{_SPACES}]", " ", match[0]), text)


def without_here_documents(text: str) -> str:
    """Put fences around the files that commands write or run, in the place of the commands' first and last lines."""
    if "<<" not in text:
        return text
    lines = text.split("\n")
    last = {line.strip(): at for at, line in enumerate(lines)}  # of each label, so that each is looked up once
    kept: list[str] = []
    fence = sign = ""  # the first line of the fence that is open, and its sign
    label = ""  # of the here-document that is open
    for at, line in enumerate(lines):
        found, border = _HERE.match(line), _FENCE.match(line)
        if label and line.strip() == label:
            kept += ["```", fence] if fence else ["```"]
            label = ""
        elif not label and found and last.get(found[2], 0) > at:
            kept += [sign, "```python"] if fence else ["```python"]
            label = found[2]
        else:
            kept.append(line)
            if not label and border and (not fence or border[1] == sign):
                fence, sign = ("", "") if fence else (line, border[1])
    return "\n".join(kept)


def _without_quotes(text: str, most: int = _MOST_QUOTES) -> str:
    """Take the signs off the lines that are quoted together, if they hold code or a fence."""
    lines = text.split("\n")
    kept: list[str] = []
    start = 0
    while start < len(lines):
        end = next((at for at in range(start, len(lines)) if not _goes_on_quoted(lines, at)), len(lines))
        inner = _unquoted(lines[start:end])
        if len(inner) > 1 and any(re.match(rf"[> ]*(?:{STATEMENT}|`{{3}}|~{{3}})", line) for line in inner):
            is_again = most > 1 and all(_is_quoted(line) or not line.strip() for line in inner)
            kept += _without_quotes("\n".join(inner), most - 1).split("\n") if is_again else inner
        else:
            kept += lines[start : max(end, start + 1)]
        start = max(end, start + 1)
    return "\n".join(kept)


def _unquoted(lines: Sequence[str]) -> list[str]:
    """Take a sign off each line, and the space behind it, where every line has one."""
    inner = [_QUOTE.sub("", line, count=1) for line in lines]
    return [line[1:] for line in inner] if all(line[:1] in ("", " ") for line in inner) else inner


def _is_quoted(line: str) -> bool:
    return _QUOTE.match(line) is not None and _FIRST_PROMPT.match(line) is None


def _goes_on_quoted(lines: Sequence[str], at: int) -> bool:
    """Return whether a line is quoted, or is the blank one between two that are."""
    is_between = 0 < at < len(lines) - 1 and not lines[at].strip()
    return all(map(_is_quoted, (lines[at - 1], lines[at + 1]) if is_between else (lines[at],)))


def _without_prompts(text: str, name: str) -> str:
    """Turn sessions into the code that was typed, if one of them states a class at its beginning."""
    if not re.search(r"^(?: {0,3}>>>| *In \[\d+\]:)[ \t]+class\b", text, re.MULTILINE):
        return text
    kept: list[str] = []
    lines, at = text.split("\n"), 0
    while at < len(lines):
        if not _FIRST_PROMPT.match(lines[at]):
            kept.append(lines[at])
            at += 1
            continue
        end = next((i for i in range(at, len(lines)) if _ends_session(lines, i)), len(lines))
        for typed in _typed(lines[at:end]):
            is_example = re.search(rf"\b{re.escape(name)}\b", typed) and not _gives_class(typed, name)
            kept += [""] if is_example else [*typed.split("\n"), ""]
        at = end
    return "\n".join(kept)


def _ends_session(lines: Sequence[str], at: int) -> bool:
    """Return whether a line is a fence, or the blank one before a line without a prompt."""
    following = lines[at + 1] if at + 1 < len(lines) else ""
    return bool(_FENCE.match(lines[at])) or (not lines[at].strip() and not _PROMPT.match(following))


def _typed(lines: Sequence[str]) -> Iterator[str]:
    """Yield the statements of a session; a line without a prompt is output."""
    statement: list[str] = []
    for line in filter(_PROMPT.match, lines):
        code = _PROMPT.sub("", line, count=1)
        if _FIRST_PROMPT.match(line) and code[:1].strip() and not _is_open(statement):
            if statement:
                yield "\n".join(statement)
            statement = []
        statement.append(code)
    if statement:
        yield "\n".join(statement)


def _is_open(statement: Sequence[str]) -> bool:
    """Return whether a statement begins with a decorator and has nothing else yet."""
    return bool(statement) and all(line.startswith("@") for line in statement)


def _without_json(text: str, name: str) -> str:
    """Put the source in the place of JSON that holds it."""
    kept: list[str] = []
    decoder = json.JSONDecoder(strict=False)
    done = after = 0
    for _ in range(_MOST_JSON):
        found = _JSON.search(text, after)
        if found is None:
            break
        after = found.end() + 1
        try:
            value, after = decoder.raw_decode(text, found.end())
        except (ValueError, RecursionError):
            continue
        cells = _cells(value, name)
        if cells:
            before, behind, is_fenced = _around(text, found.end(), after)
            kept += [text[done:before], _written(cells, is_fenced=is_fenced)]
            done = after = behind
    return "".join([*kept, text[done:]])


def _around(text: str, start: int, end: int) -> tuple[int, int, bool]:
    """Return where a value and the fence around it alone begin and end, and whether it stands in another fence."""
    before = re.search(r"(?:^|\n)[ \t]*(`{3,}|~{3,})[^`\n]*\n\s*\Z", text[:start])
    behind = re.compile(r"\s*?\n[ \t]*(`{3,}|~{3,})[ \t]*(?=\n|\Z)").match(text, end)
    if before and behind and before[1] == behind[1]:
        return before.start(), behind.end(), False
    signs = sum(bool(_FENCE.match(line)) for line in text[:start].split("\n"))
    return start, end, signs % 2 == 1


def _written(cells: Sequence[str], *, is_fenced: bool) -> str:
    """Write sources as they would stand in an answer: between fences each, unless they have or stand in some."""
    plain = is_fenced or any(_FENCE.match(line) for cell in cells for line in cell.split("\n"))
    texts = cells if plain else [f"```python\n{cell}\n```" for cell in cells]
    return "\n\n" + "\n\n".join(texts) + "\n\n"


def _cells(value: object, name: str, depth: int = 0) -> list[str]:
    """Find the sources in a value of JSON; none where one object holds several texts with the class."""
    found: list[list[str]] = []
    match value:
        case _ if depth > _DEEPEST:
            pass
        case str():
            found = [_texts(value, name, depth)]
        case {"cells": [*cells]}:
            texts = [_joined(cell.get("source")) for cell in cells if isinstance(cell, dict) and _is_code(cell)]
            found = [texts] if any(_cells(text, name, depth + 1) for text in texts) else []
        case dict():
            found = [cells for part in value.values() if (cells := _cells(part, name, depth + 1))]
            found = found if len(found) == 1 else []
        case list() if value and all(isinstance(line, str) and "\n" not in line[:-1] for line in value):
            found = [_texts(_joined(value), name, depth)]
        case list():
            found = [_cells(part, name, depth + 1) for part in value]
    return [cell for cells in found for cell in cells]


def _gives_class(text: str, name: str) -> bool:
    """Return whether a text states the class, or gives its name to another one."""
    name = re.escape(name)
    forms = rf"class[ \t]+{name}\b.*\n|{name}[ \t]*(?::[^=\n]*)?=[ \t]*\w+[ \t]*$"
    return re.search(rf"^[ \t]*(?:{forms})", text, re.MULTILINE) is not None


def _texts(text: str, name: str, depth: int) -> list[str]:
    """Find the sources in a text of JSON: the text itself, or what it holds if it is JSON again."""
    if _gives_class(text, name):
        return [text.replace("\r\n", "\n")]
    if name not in text or text.lstrip()[:1] not in ("{", "["):
        return []
    with contextlib.suppress(ValueError, RecursionError):
        return _cells(json.loads(text, strict=False), name, depth + 1)
    return []


def _is_code(cell: dict[str, object]) -> bool:
    return cell.get("cell_type", "code") == "code"


def _joined(source: object) -> str:
    """Write the source of a cell, which is a text or a list of lines, as a text."""
    if not isinstance(source, list):
        return source if isinstance(source, str) else ""
    lines = [str(line) for line in source]
    return ("" if any(line.endswith("\n") for line in lines) else "\n").join(lines)
