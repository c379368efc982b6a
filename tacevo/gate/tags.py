"""The marks that models and their chat templates write around code: tags, marks and thoughts."""

import re
from collections.abc import Container

#: A tag such as `<code>` or `</answer>`, a mark of a chat template such as `<|im_end|>` or `</s>`, a border of CDATA.
_TAG = r"(?:</?[A-Za-z][^<>\n]*>|<[|\uff5c][^<>\n]*[|\uff5c]>|<!\[(?i:CDATA)\[|\]\]>)"  # DeepSeek's bars are wide ones
#: A label such as `[PYTHON]`; only before code, because behind it `[WIDTH]` is an index.
_LABEL = r"\[/?(?:[A-Z]{2}[A-Z_ ]*|python|code)\]"
#: Indentation and the tags and labels behind it.
LEADING = rf"([ \t]*)(?:(?:{_TAG}|{_LABEL})[ \t]*)*"
_THOUGHT = r"(?:\w+:)?(?:think|thinking|thoughts?|reasoning|reflection)"
#: The signs of a tag: `<think>`, the same written for HTML, Mistral's `[THINK]` and Kimi's `\u25c1think\u25b7`.
_LEFT, _RIGHT = r"(?:<|&lt;|\u25c1)", r"(?:>|&gt;|\u25b7)"

#: The tag that opens or closes a thought, unless it is inline code in backticks. In OpenAI's harmony format each
#: channel but `final` is a thought.
_BORDER = re.compile(
    rf"(?P<first>^[ \t]*)?(?:"
    rf"(?P<opens>(?<!(?<!`)`)(?:{_LEFT}[ \t]*(?P<name>{_THOUGHT})(?:\s[^<>&]*)?(?<!/){_RIGHT}(?:\s*<(?P=name)>)*"
    rf"|(?-i:\[THINK\])|<\|(?:begin|start)_(?:of_)?{_THOUGHT}\|>|<\|channel\|>[ \t]*(?:analysis|commentary)\b))"
    rf"|(?P<final><\|channel\|>[ \t]*final\b)"
    rf"|(?:{_LEFT}[ \t]*/[ \t]*{_THOUGHT}[ \t]*{_RIGHT}|(?-i:\[/THINK\])|<\|end_(?:of_)?{_THOUGHT}\|>)"
    rf"(?!`(?!`))(?P<last>[ \t]*(?=$|```|<))?)",
    re.MULTILINE | re.IGNORECASE,
)


def code_after_tags(line: str) -> str:
    """Return a line without the tags at its beginning; it keeps its indentation."""
    return re.sub(LEADING, r"\1", line, count=1)


def code_before_tags(line: str) -> str:
    """Return a line without the tags at its end, and without the spaces before these."""
    end = len(line)
    for tag in reversed(list(re.finditer(_TAG, line))):
        if line[tag.end() : end].strip():
            break
        end = tag.start()
    return line if end == len(line) else line[:end].rstrip()


def is_tagged(line: str) -> bool:
    """Return whether a line begins or ends with a tag."""
    return code_after_tags(line) != line or code_before_tags(line) != line


def mentions_thought(text: str) -> bool:
    """Return whether a text has a tag that may open or close a thought."""
    return _BORDER.search(text) is not None


def without_thoughts(text: str, code: Container[int]) -> str:
    """Return what of an answer is not a thought; nothing where the last thought is not closed.

    What stands before a closing tag without an opening one is a thought, too: the chat template opened it. A thought is
    nested in another where its tag begins a line; elsewhere the thought only mentions the tag. No tag counts in a line
    that is code, by its number from 0, or indented as code is, unless it closes a thought at the end of that code.
    """
    kept: list[str] = []
    depth, line, seen, after = 0, 0, 0, 0
    indented = {number for number, words in enumerate(text.split("\n")) if words.startswith(("    ", "\t"))}
    for border in _BORDER.finditer(text):
        line, seen = line + text.count("\n", seen, border.start()), border.start()
        is_behind_code = border["first"] is None and border["last"] is not None
        if line in code or (line in indented and border["final"] is None and not is_behind_code):
            continue
        if border["opens"] is None:
            if depth == 0 or border["final"] is not None:
                kept.clear()
            depth = 0 if border["final"] is not None else max(depth - 1, 0)
            after = border.end()
        elif depth == 0 or border["first"] is not None:
            if depth == 0:
                kept.append(text[after : border.start()])
            depth += 1
    return "" if depth else "\n".join([*kept, text[after:]])
