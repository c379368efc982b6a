"""Markdown as its readers render it: CommonMark with HTML, tables and strikethrough, as on GitHub."""

import re
from collections.abc import Iterable, Iterator

from markdown_it import MarkdownIt
from markdown_it.token import Token

#: One text each that Markdown, or a renderer with more than CommonMark, would obey.
HOSTILE = (
    "[link](https://example.org)",
    "![image](https://example.org/a.png)",
    "[reference]: https://example.org 'title'",
    "<https://example.org>",
    "<img src=x onerror=alert(1)>",
    "<!-- comment",
    "</table><script>alert(1)</script>",
    "&lt;b&gt; &#60;b&#62; &#x3C; &copy;",
    "*emphasis* _emphasis_ **strong** __strong__ ~~struck~~",
    "`code` ``code`` ```code",
    "```\nfence",
    "~~~\nfence",
    "    code",
    "# heading",
    "heading\n===",
    "heading\n---",
    "- item",
    "+ item",
    "* item",
    "1. item",
    "1) item",
    "> quotation",
    "---",
    "* * *",
    "a | b\n--|--\nc | d",
    "a\n:-:\nb",
    "| cell |",
    "tail |",
    "[^1] [^1]: footnote",
    "$x$ $$x$$",
    "https://example.org www.example.org someone@example.org",
    "hard  \nbreak",
    "hard\\\nbreak",
    "back\\slash \\* \\",
    "- [x] task",
    "> [!WARNING]\n> alert",
    ": definition",
    "{{ template }} {: .class }",
    "!",
    "a\r\n\r\n# b\u2028# c\x0b# d",
    "turned \u202e round \x1b[2J \x00 \u200b",
    "\n",
    "---\nlicense: other\n---\n",
)

_PARSER = MarkdownIt("commonmark", {"html": True}).enable(["table", "strikethrough"])


def skeleton(page: str) -> list[tuple[str, str]]:
    """List what a page is made of: the kinds of its elements, and where they lead; texts without their words."""
    kinds: list[tuple[str, str]] = []
    for token in _tokens(_PARSER.parse(page)):
        kind = (token.type, str(token.attrs or ""))
        if kind[0] == "text" and kinds and kinds[-1] == kind:
            continue
        kinds.append(kind)
    return kinds


def words(page: str) -> str:
    """Return all that a page shows, on one line."""
    shown = (token.content for token in _tokens(_PARSER.parse(page)) if token.type in {"text", "code_inline", "fence"})
    return " ".join("".join(shown).split())


def meant(page: str) -> str:
    """Return the marks of a page that are not escaped, of those that other renderers give a meaning."""
    return "".join(re.findall(r"[$^@]|www\.|://", re.sub(r"\\[!-/:-@\[-`{-~]", "", page)))


def _tokens(tokens: Iterable[Token]) -> Iterator[Token]:
    for token in tokens:
        if token.type == "inline":
            yield from _tokens(token.children or [])
        else:
            yield token
