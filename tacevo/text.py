"""Text: counted nouns, lists and tables for a person, text made harmless for terminal and Markdown, Python parsed."""

import ast
import difflib
import json
import re
import threading
import warnings
from collections.abc import Collection, Iterable, Sequence

from tacevo.errors import escaped

#: Filters of warnings belong to all threads; and so does, in CPython up to 3.11, the depth that its parser counts (its
#: issue 106905): two threads that parse at once can end in a SystemError.
_PARSER = threading.Lock()

#: The marks of punctuation to which Markdown (CommonMark, and GitHub's tables, footnotes, formulas and addresses) gives
#: a meaning where they stand; each match ends in one. A mark that can mean nothing there, as in `val_loss`, `0.35 mm`
#: and `(N)`, is not among them, so that honest text stays as it is.
_MEANING = re.compile(
    r"""
      [\\`*\[\]{}|~$^@\#]                     # code, emphasis, links, footnotes, cells, formulas, headings
    | (?<![A-Za-z0-9])_ | _(?![A-Za-z0-9])    # emphasis, which does not begin or end within a word
    | <(?![\s\d=.]) | &(?=[\#A-Za-z]|$)       # HTML, addresses, entities
    | !(?=\[|$)                               # an image
    | :(?![\s\d]|$) | (?<=\b[Ww]{3})\.        # addresses
    | ^(?: [-+](?=[-+:\s]|$) | [=>:]          # lists, rules, underlines of headings, quotations, terms
         | [0-9]{1,9}[.)](?=\s|$) )
    """,
    re.VERBOSE,
)

#: Words that Hydra does not read as texts.
_NOT_TEXTS = frozenset({"null", "true", "false", "nan", "inf"})


def counted(number: int, noun: str) -> str:
    """Write a number, 0 or more, with its noun: `1 image`, `2 images`."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def plain(paragraph: str) -> str:
    """Return a paragraph of Markdown as plain text: no marks of emphasis and code, and links with their address."""
    from markdown_it import MarkdownIt  # takes time to import, and few texts are Markdown

    words: list[str] = []
    addresses: list[str] = []
    for token in MarkdownIt("commonmark").parseInline(paragraph)[0].children or []:
        if token.type == "link_open":
            addresses.append("" if token.info == "auto" else f" ({token.attrGet('href')})")
        words.append(addresses.pop() if token.type == "link_close" else token.content)
        if token.type in {"softbreak", "hardbreak"}:
            words.append(" ")
    return "".join(words)


def lasting(seconds: float) -> str:
    """Write a time in round figures: `about 40 seconds`, `about 25 minutes`, `about 3.4 hours`, `about 5 days`."""
    if seconds < 100:
        return f"about {seconds:.0f} seconds"
    hours = seconds / 3600
    if hours < 1:
        return f"about {60 * hours:.0f} minutes"
    return f"about {hours:.2g} hours" if hours < 48 else f"about {hours / 24:.0f} days"


def first_line(error: BaseException) -> str:
    """Return the first line of an error, or its class where it says nothing."""
    return next((line.strip() for line in str(error).splitlines() if line.strip()), type(error).__name__)


def nearest(name: str, names: Iterable[str], otherwise: str, *, before: str = "") -> str:
    """Ask whether the closest of these names was meant, written behind `before`; where none is, say something else."""
    close = difflib.get_close_matches(name, list(names), n=1)
    return f"did you mean {before}{close[0]}?" if close else otherwise


def listed(words: Iterable[str], nothing: str = "none", *, most: int | None = None) -> str:
    """Write words one after the other, at most so many: `probe, train, ...`; without words, write `nothing`."""
    items = list(words)
    more = ["..."] if most is not None and len(items) > most else []
    return ", ".join([*items[:most], *more]) or nothing


def printable(text: str) -> str:
    r"""Write control characters, and those that turn the direction of a line, as escapes such as `\x1b`.

    Line breaks and tabs stay.
    """
    return escaped(text, "\n\t")


def on_a_line(text: str) -> str:
    """Write a text on one line, with single spaces, and control characters as escapes (`printable`)."""
    return printable(" ".join(text.split()))


def unbroken(text: str) -> str:
    r"""Write a text so that it stays on its line: line breaks and tabs as `\n` and `\t`, the rest as of `printable`."""
    return escaped(text)


def in_field(text: str) -> str:
    r"""Write a text for a field of a CSV file: as of `unbroken`, but a tab, which is a letter as any there, stays."""
    return escaped(text, "\t")


def in_markdown(text: str) -> str:
    r"""Write a text so that Markdown shows it on one line and obeys none of it: `*a*` becomes `\*a\*`.

    It may stand anywhere in a line, in a cell of a table or in a heading; the line must not be broken within it.
    """
    return _MEANING.sub(lambda match: f"{match[0][:-1]}\\{match[0][-1]}", on_a_line(text))


def as_code(text: str) -> str:
    """Write a text as code within a line of Markdown: on one line, between more backticks than it has in a row.

    Within a cell of a table, `|` would end the cell.
    """
    line = on_a_line(text)
    marks = "`" * (1 + max(map(len, re.findall("`+", line)), default=0))
    space = " " if line.startswith("`") or line.endswith("`") or not line else ""
    return f"{marks}{space}{line}{space}{marks}"


def as_override(key: str, value: str) -> str:
    """Write a text as the value of a setting, as Hydra reads it: in quotes where it would be read as something else."""
    if re.fullmatch(r"[A-Za-z_/][\w/.-]*", value, re.ASCII) and value.lower() not in _NOT_TEXTS:
        return f"{key}={value}"
    plain = re.sub(r"(\\*)(\$\{)", r"\1\1\\\2", value)
    escaped = re.sub(r"(\\*)('|$)", lambda match: match[1] * 2 + match[2].replace("'", "\\'"), plain)
    return f"{key}='{escaped}'"


def assignments(settings: Sequence[tuple[str, object]]) -> list[str]:
    """Write settings and their values for a reader, each as `name=value`."""
    return [f"{name}={value}" for name, value in settings]


def as_overrides(settings: Sequence[tuple[str, object]]) -> list[str]:
    """Write settings and their values as a user types them; those of a GPU with what its driver needs."""
    words = [
        as_override(key, value) if isinstance(value, str) else f"{key}={json.dumps(value)}" for key, value in settings
    ]
    return [*words, "sandbox.require=none"] if ("training.device", "cuda") in settings else words


def table(header: Sequence[str], rows: Sequence[Sequence[str]], *, right: Collection[int] = ()) -> str:
    """Write a Markdown table whose columns line up in plain text, too; the columns in `right` stand flush right."""
    widths = [max(3, *map(len, column)) for column in zip(header, *rows, strict=True)]
    rule = ["-" * (width - 1) + (":" if column in right else "-") for column, width in enumerate(widths)]

    def padded(column: int, cell: str) -> str:
        return cell.rjust(widths[column]) if column in right else cell.ljust(widths[column])

    lines = [[padded(column, cell) for column, cell in enumerate(line)] for line in (header, rule, *rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def parse_python(source: str) -> ast.Module:
    """Parse source text, one thread at a time.

    Raises:
        SyntaxError, ValueError, RecursionError, MemoryError: as `ast.parse`.
    """
    with _PARSER, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # an invalid escape sequence in a docstring does not harm a network
        return ast.parse(source)
