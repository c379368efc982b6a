"""Tables as Markdown, LaTeX and CSV, from the same record.

Markdown and LaTeX round by one rule; CSV never rounds:

    text                  as it is, escaped
    whole number          in full, thousands apart: 1,145,411
    number                three significant digits, all digits before the point: 0.00612, 12.3, 1,235;
                          below 0.0001 as 1.23e-05
    p-value               two significant digits, `<0.001` below that
    percentage            one decimal: 96.0 %
    estimate [low, high]  all three with the decimals that give the largest of them three significant digits
    nothing               an en dash

Halves go the way of the binary number, as Python's `format` rounds. What is no finite number is refused.
"""

import csv
import io
import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path

from analysis.tables import Between, Cell, Percent, PValue, Table
from tacevo.store import write_durably

#: Characters of a row that fit one and two columns of a paper in LaTeX's \\footnotesize.
NARROW, WIDE = 52, 112

#: Characters of a text that LaTeX sets in one line; an em is about two of them.
LONG = 40

_MINUS, _DASH = "\N{MINUS SIGN}", "\N{EN DASH}"
_SMALLEST = 1e-4
#: The sign of a number, not of an exponent.
_NEGATIVE = re.compile(r"(?<!e)-")

_MARKDOWN = str.maketrans({"\\": "\\\\", "|": "\\|", "*": "\\*", "`": "\\`", "\n": " "})
_LATEX = str.maketrans(
    {
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        "<": "$<$",
        ">": "$>$",
        "|": "$|$",
        '"': "''",
        "\n": " ",
        _MINUS: "$-$",
        _DASH: "--",
        "±": r"$\pm$",
        "\N{MULTIPLICATION SIGN}": r"$\times$",
        "·": r"$\cdot$",
        "≤": r"$\leq$",
        "≥": r"$\geq$",
        "²": r"\textsuperscript{2}",
    }
    | {special: f"\\{special}" for special in "{}$&#%_"}
)


def shown(cell: Cell) -> str:
    """Round a cell by the rule of this module, as plain text.

    Raises:
        ValueError: it is NaN or infinite.
    """
    match cell:
        case None | str():
            return _DASH if cell is None else cell
        case int():
            text = f"{cell:,}"
        case PValue(value):
            text = "<0.001" if _finite(value) < 0.001 else _significant(value, 2)
        case Percent(value):
            text = f"{_finite(value) * 100:.1f} %"
        case Between(estimate, low, high):
            text = _interval(estimate, low, high)
        case _:
            text = _significant(_finite(cell), 3)
    return _NEGATIVE.sub(_MINUS, text)


def as_markdown(table: Table) -> str:
    """Write a table as GitHub's Markdown: caption, aligned columns, notes."""
    lines = [_escaped(table.columns, _in_markdown), *(_escaped(row, _in_markdown) for row in table.rows)]
    right = numeric_columns(table)
    widths = [max(3, *map(len, column)) for column in zip(*lines, strict=True)]
    rule = ["-" * (width - 1) + (":" if number else "-") for width, number in zip(widths, right, strict=True)]
    rows = [_padded(lines[0], widths, right), rule, *(_padded(line, widths, right) for line in lines[1:])]
    body = "\n".join(f"| {' | '.join(row)} |" for row in rows)
    return "\n\n".join([f"**{_in_markdown(table.caption)}**", body, *map(_in_markdown, table.notes)]) + "\n"


def as_latex(table: Table) -> str:
    r"""Write a table for LaTeX, which needs `booktabs`, `array` and `graphicx`.

    Text of more than `LONG` characters is broken into lines. The table spans both columns of a paper (`table*`) where a
    row has more than `NARROW` characters, and is scaled down to them where it has more than `WIDE`. Its label is `tab:`
    and its name.
    """
    numeric, widths = numeric_columns(table), _widths(table)
    pairs = zip(numeric, widths, strict=True)
    width = sum(wide if number else min(wide, LONG) for number, wide in pairs) + 2 * (len(widths) - 1)
    floating = "table" if width <= NARROW else "table*"
    lines = [_escaped(row, in_latex) for row in table.rows]
    tabular = [
        rf"\begin{{tabular}}{{{''.join(map(_column, numeric, widths))}}}",
        r"\toprule",
        f"{' & '.join(_escaped(table.columns, in_latex))} \\\\",
        r"\midrule",
        *(f"{_begun(' & '.join(line))} \\\\" for line in lines),
        r"\bottomrule",
        r"\end{tabular}",
    ]
    if width > WIDE:
        tabular = [r"\resizebox{\linewidth}{!}{%", *tabular[:-1], tabular[-1] + "}"]
    notes = [rf"\par\smallskip\parbox{{\linewidth}}{{\raggedright {in_latex(note)}}}" for note in table.notes]
    head = [rf"\begin{{{floating}}}[tbp]", r"\centering", rf"\caption{{{in_latex(table.caption)}}}"]
    label = rf"\label{{tab:{table.name}}}"
    return "\n".join([*head, label, r"\footnotesize", *tabular, *notes, rf"\end{{{floating}}}"]) + "\n"


def as_csv(table: Table) -> str:
    """Write a table as CSV (RFC 4180), unrounded: fractions as such, and an interval as three columns."""
    buffer = io.StringIO()
    writer = csv.writer(buffer)
    spread = [any(isinstance(row[place], Between) for row in table.rows) for place in range(len(table.columns))]
    names = [[name, f"{name} low", f"{name} high"][: 3 if wide else 1] for name, wide in _pairs(table.columns, spread)]
    writer.writerow([name for group in names for name in group])
    for row in table.rows:
        writer.writerow([value for cell, wide in _pairs(row, spread) for value in _exact(cell, 3 if wide else 1)])
    return buffer.getvalue()


def numeric_columns(table: Table) -> list[bool]:
    """Say which columns hold numbers; they stand flush right."""
    return [not any(isinstance(row[place], str) for row in table.rows) for place in range(len(table.columns))]


def in_latex(text: str) -> str:
    """Escape text, so that LaTeX sets it and obeys none of it."""
    return text.translate(_LATEX)


#: How each kind of file is written, by its ending.
WRITERS: dict[str, Callable[[Table], str]] = {".md": as_markdown, ".tex": as_latex, ".csv": as_csv}


def write_table(table: Table, folder: Path) -> tuple[Path, ...]:
    """Write a table in every format, each file whole; older ones are replaced.

    Raises:
        StoreError: a file cannot be written.
        ValueError: a cell is NaN or infinite; nothing was written.
    """
    texts = {folder / f"{table.name}{ending}": write(table) for ending, write in WRITERS.items()}
    for path, text in texts.items():
        write_durably(path, text)
    return tuple(texts)


def _pairs(cells: Sequence[Cell], spread: Sequence[bool]) -> list[tuple[Cell, bool]]:
    return list(zip(cells, spread, strict=True))


def _exact(cell: Cell, places: int) -> list[str | int | float]:
    """Give a cell unrounded, filled up to its column's places."""
    match cell:
        case None:
            values: list[str | int | float] = [""]
        case Between(estimate, low, high):
            values = [estimate, low, high]
        case PValue(value) | Percent(value):
            values = [value]
        case _:
            values = [cell]
    for number in values:
        if not isinstance(number, str):
            _finite(number)
    return values + [""] * (places - len(values))


def _finite(value: float) -> float:
    if not math.isfinite(value):
        raise ValueError(f"a table's numbers must be finite; got {value}; where there is no value, give None")
    return value


def _significant(value: float, digits: int) -> str:
    """Write a number with so many significant digits, and all digits before its point."""
    if 0 < abs(value) < _SMALLEST:
        return f"{value:.{digits - 1}e}"
    return f"{value:,.{_decimals(value, digits)}f}"


def _decimals(value: float, digits: int) -> int:
    """Count the decimals that give a number so many significant digits, once it is rounded to them."""
    if value == 0:
        return digits - 1
    exponent = int(f"{abs(value):.{digits - 1}e}".partition("e")[2])  # of 9.996 as of 10.0
    return max(digits - 1 - exponent, 0)


def _interval(estimate: float, low: float, high: float) -> str:
    decimals = min(_decimals(max(abs(_finite(value)) for value in (estimate, low, high)), 3), 7)
    texts = [f"{value:,.{decimals}f}" for value in (estimate, low, high)]
    return f"{texts[0]} [{texts[1]}, {texts[2]}]"


def _escaped(cells: Sequence[Cell], escape: Callable[[str], str]) -> list[str]:
    return [escape(shown(cell)) for cell in cells]


def _padded(cells: Sequence[str], widths: Sequence[int], right: Sequence[bool]) -> list[str]:
    columns = zip(cells, widths, right, strict=True)
    return [cell.rjust(width) if number else cell.ljust(width) for cell, width, number in columns]


def _widths(table: Table) -> list[int]:
    """Count the characters of each column's widest cell."""
    lines = [table.columns, *([shown(cell) for cell in row] for row in table.rows)]
    return [max(map(len, column)) for column in zip(*lines, strict=True)]


def _column(number: bool, width: int) -> str:
    """Choose how LaTeX sets a column: numbers flush right, long text in lines."""
    if number:
        return "r"
    return rf">{{\raggedright\arraybackslash}}p{{{LONG // 2}em}}" if width > LONG else "l"


def _begun(line: str) -> str:
    r"""Keep the `\\` of the line before from taking a bracket or a star for its option."""
    return f"{{}}{line}" if line.startswith(("[", "*")) else line


def _in_markdown(text: str) -> str:
    return re.sub(r"<(?=[A-Za-z/!?])", r"\<", text.translate(_MARKDOWN))  # `<0.001` begins no tag
