"""Tables as Markdown, LaTeX and CSV, from the same record.

Markdown and LaTeX round by the rule of `analysis.rounding`; CSV never rounds. A number that is not finite is an error.
Of a table, Markdown and LaTeX may show a choice of columns and notes (`Shown`); CSV always has all columns.
"""

import re
import unicodedata
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import dropwhile

from analysis.rounding import shown
from analysis.table import Cell, Table
from tacevo.text import in_field, in_markdown, listed, on_a_line
from tacevo.text import table as markdown

#: Characters of a row that fit one and two columns of a paper in LaTeX's \\footnotesize.
NARROW, WIDE = 52, 112

#: Characters of a text that LaTeX sets in one line; an em is about two of them.
LONG = 40

#: What the space between two columns takes, in characters.
GAP = 2

_LATEX = str.maketrans(
    {
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        "<": "$<$",
        ">": "$>$",
        "|": "$|$",
        '"': "''",
        "\N{MINUS SIGN}": "$-$",
        "\N{EN DASH}": "--",
        "±": r"$\pm$",
        "\N{MULTIPLICATION SIGN}": r"$\times$",
        "·": r"$\cdot$",
        "≤": r"$\leq$",
        "≥": r"$\geq$",
        "²": r"\textsuperscript{2}",
    }
    | {special: f"\\{special}" for special in "{}$&#%_"}
)


class Notes(StrEnum):
    """Which notes stand below a table."""

    none = "none"
    #: The first sentence of each.
    short = "short"
    full = "full"


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """What Markdown and LaTeX show of a table."""

    #: Behind the first column, which names the rows; empty for all. A table that has none of them is whole.
    columns: tuple[str, ...] = ()
    notes: Notes = Notes.full

    def of(self, table: Table) -> Table:
        """Return what is shown of a table."""
        if self.notes is Notes.none:
            table = replace(table, notes=())
        if self.notes is Notes.short:
            table = replace(table, notes=tuple(re.split(r"(?<=[.?]) (?=[A-Z])", note)[0] for note in table.notes))
        places = [table.columns.index(name) for name in self.columns if name in table.columns]
        return taking(table, [0, *(place for place in places if place)]) if places else table


def taking(table: Table, places: Sequence[int]) -> Table:
    """Return a table with the columns at these places only."""
    rows = (tuple(row[place] for place in places) for row in table.rows)
    return replace(table, columns=tuple(table.columns[place] for place in places), rows=tuple(rows))


def as_markdown(table: Table) -> str:
    """Write a table as GitHub's Markdown: caption, aligned columns, notes."""
    header, *rows = ([_in_cell(cell) for cell in line] for line in (table.columns, *table.rows))
    right = [place for place, number in enumerate(numeric_columns(table)) if number]
    body = markdown(header, rows, right=right)
    return "\n\n".join([f"**{in_markdown(table.caption)}**", body, *map(in_markdown, table.notes)]) + "\n"


def as_text(table: Table) -> str:
    """Write a table for a log: caption, aligned columns and notes, without the marks of Markdown."""
    header, *rows = ([on_a_line(shown(cell)) for cell in line] for line in (table.columns, *table.rows))
    right = [place for place, number in enumerate(numeric_columns(table)) if number]
    caption, *notes = map(on_a_line, (table.caption, *table.notes))
    return "\n\n".join([caption, markdown(header, rows, right=right), *notes]) + "\n"


def _in_cell(cell: Cell) -> str:
    """Write a cell for Markdown; a number, such as `0.8 [0.6, 0.9]`, means nothing else there."""
    return in_markdown(cell) if isinstance(cell, str) else shown(cell)


def as_latex(table: Table, *, prefix: str = "") -> str:
    r"""Write a table for LaTeX; its first lines are comments that name the packages it needs.

    Text of more than `LONG` characters is broken into lines. The table spans both columns of a paper (`table*`) where a
    row has more than `NARROW` characters; where it has more than `WIDE`, its columns stand in two parts below each
    other, each of which begins with the first column. Where two are not enough, the table is turned, so that its
    columns become rows; and where that is too wide as well, the last columns are left out, and a note names them. Its
    label is `tab:`, the prefix, and its name.
    """
    table, columns, parts = _fitted(table)
    width = sum(column.width for column in columns) + GAP * (len(columns) - 1)
    floating = "table" if width <= NARROW else "table*"
    tabulars = "\n\\par\\medskip\n".join(_tabular([columns[place] for place in part]) for part in parts)
    notes = [rf"\par\smallskip\parbox{{\linewidth}}{{\raggedright {in_latex(note)}}}" for note in table.notes]
    packages = ["booktabs", *(["array"] if any(column.how.startswith(">") for column in columns) else [])]
    head = [rf"% \usepackage{{{name}}}" for name in packages]
    head += [rf"\begin{{{floating}}}[htbp]", r"\centering", rf"\caption{{{in_latex(table.caption)}}}"]
    label = rf"\label{{tab:{re.sub(r'[^A-Za-z0-9:/._-]', '-', prefix + table.name)}}}"
    return "\n".join([*head, label, r"\footnotesize", tabulars, *notes, rf"\end{{{floating}}}"]) + "\n"


def as_csv(table: Table) -> str:
    """Write a table as CSV (RFC 4180), unrounded: fractions as such, and an interval as three columns.

    Line breaks and characters that are not shown are escapes, as in the other forms; a text that a spreadsheet would
    compute as a formula has `'` before it.
    """
    rows = tuple(tuple(_inert(cell) if isinstance(cell, str) else cell for cell in row) for row in table.rows)
    safe = replace(table, columns=tuple(map(_inert, table.columns)), rows=rows)
    return str(safe.frame.to_csv(index=False, lineterminator="\r\n"))


def _inert(text: str) -> str:
    """Keep a text from being a formula; a mark alone, such as `-` for nothing, is none.

    Some spreadsheets read wide marks, such as U+FF1D, as the usual ones, and pass over what is not seen.
    """
    text = in_field(text)
    seen = "".join(dropwhile(_is_blank, unicodedata.normalize("NFKC", text)))
    return f"'{text}" if re.match(r"[=+@-].", seen, re.DOTALL) else text


def _is_blank(letter: str) -> bool:
    """Return whether a letter, as NFKC has it, shows nothing by itself; some fillers count as letters or signs."""
    return letter.isspace() or unicodedata.category(letter)[0] in "CMZ" or letter in "\u115f\u1160\u2800"


def numeric_columns(table: Table) -> list[bool]:
    """Return whether each column holds numbers, which stand flush right."""
    return [not any(isinstance(row[place], str) for row in table.rows) for place in range(len(table.columns))]


def in_latex(text: str) -> str:
    """Escape text, so that LaTeX sets it on one line and obeys none of it."""
    return on_a_line(text).translate(_LATEX)


#: All of a table.
ALL = Shown()

#: How each kind of file is written, by its ending.
WRITERS: dict[str, Callable[[Table], str]] = {".md": as_markdown, ".tex": as_latex, ".csv": as_csv}


def table_texts(table: Table, *, prefix: str = "", show: Shown = ALL) -> dict[str, str]:
    """Write a table in every format, by the ending of its file.

    The prefix is that of its label in LaTeX, so that tables of several runs may stand in one document; `show` says what
    Markdown and LaTeX have of it.

    Raises:
        ValueError: a cell is NaN or infinite.
    """
    seen = show.of(table)
    return {".md": as_markdown(seen), ".tex": as_latex(seen, prefix=prefix), ".csv": as_csv(table)}


@dataclass(frozen=True, slots=True, kw_only=True)
class _Column:
    """A column as LaTeX sets it."""

    #: Its name and its cells, escaped.
    cells: tuple[str, ...]
    #: In characters, at most.
    width: int
    #: For `tabular`: numbers flush right, long text in lines.
    how: str


def _fitted(table: Table) -> tuple[Table, list[_Column], list[list[int]]]:
    """Return a table that fits in at most two parts, its columns, and those of each part by their places."""
    columns = _columns(table)
    parts = _parts([column.width for column in columns])
    if len(parts) <= 2:
        return table, columns, parts
    turned = _columns(_turned(table), first=LONG // 2)
    if len(parts_of_turned := _parts([column.width for column in turned])) <= 2:
        return _turned(table), turned, parts_of_turned
    kept = sorted({place for part in parts[:2] for place in part})
    left = listed(name for place, name in enumerate(table.columns) if place not in kept)
    note = f"Left out here: {left}; the CSV has them, and tacevo tables --columns chooses."
    fitting = taking(replace(table, notes=(*table.notes, note)), kept)
    return fitting, _columns(fitting), parts[:2]


def _turned(table: Table) -> Table:
    """Return a table whose rows are the columns, as text."""
    head, *rows = zip(table.columns, *([shown(cell) for cell in row] for row in table.rows), strict=True)
    return replace(table, columns=tuple(head), rows=tuple(rows))


def _columns(table: Table, first: int = LONG) -> list[_Column]:
    """Measure columns; text of more than `LONG` characters is broken into lines, and in the first column of `first`."""
    columns = []
    for place, number in enumerate(numeric_columns(table)):
        texts = [table.columns[place], *(shown(row[place]) for row in table.rows)]
        width, how = max(map(len, texts)), "r" if number else "l"
        most = LONG if place else first
        if width > most and not number:
            width, how = most, rf">{{\raggedright\arraybackslash}}p{{{most // 2}em}}"
        columns.append(_Column(cells=tuple(map(in_latex, texts)), width=width, how=how))
    return columns


def _parts(widths: Sequence[int]) -> list[list[int]]:
    """Share columns out to parts of at most `WIDE` characters; each part begins with the first column."""
    parts, used = [[0]], widths[0]
    for place, width in enumerate(widths[1:], start=1):
        if used + GAP + width > WIDE and parts[-1] != [0]:
            parts.append([0])
            used = widths[0]
        parts[-1].append(place)
        used += GAP + width
    return parts


def _tabular(columns: Sequence[_Column]) -> str:
    names, *rows = zip(*(column.cells for column in columns), strict=True)
    return "\n".join(
        [
            rf"\begin{{tabular}}{{{''.join(column.how for column in columns)}}}",
            r"\toprule",
            f"{' & '.join(names)} \\\\",
            r"\midrule",
            *(f"{_begun(' & '.join(row))} \\\\" for row in rows),
            r"\bottomrule",
            r"\end{tabular}",
        ]
    )


def _begun(line: str) -> str:
    r"""Keep the `\\` of the line before from taking a bracket or a star for its option."""
    return f"{{}}{line}" if line.startswith(("[", "*")) else line
