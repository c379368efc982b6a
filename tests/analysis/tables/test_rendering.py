"""Promise: a table says the same in Markdown, LaTeX and CSV, is rounded by one rule, and breaks in no format."""

import csv
import io
import re
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest
from refusals import refused
from rendered import HOSTILE, skeleton
from syrupy.assertion import SnapshotAssertion

from analysis.report.writing import index_of, write_tables
from analysis.rounding import shown
from analysis.table import Cell, HalfInteger, Interval, Percent, PercentInterval, PValue, Table, interval_cell
from analysis.tables.rendering import LONG, NARROW, WIDE, Notes, Shown, as_csv, as_latex, as_markdown, table_texts
from tacevo.errors import StoreError

MINUS = "\N{MINUS SIGN}"

TABLE = Table(
    name="study_force",
    caption="Test MSE of 20 seeds & 5 networks",
    columns=("network", "median", "p", "A12", "trained", "parameters"),
    rows=(
        ("baseline", 0.0061234, None, None, Percent(0.96), 1_145_411),
        ("variant_1 | best", 0.00543219, PValue(0.00012), Interval(0.8125, 0.65, 0.9375), Percent(1.0), 512),
    ),
    notes=("Two-sided, p < 0.05; 100% of seeds.", "A12 with its 95 % interval."),
)


def of_width(characters: int) -> Table:
    """Make a table of three columns of numbers whose rows have so many characters."""
    return Table(name="t", caption="c", columns=("x", "y" * (characters - 15), "z" * 10), rows=((1, 2, 3),))


@pytest.mark.parametrize(
    ("cell", "text"),
    [
        (None, "\N{EN DASH}"),
        ("as_it | is", "as_it | is"),
        (0, "0"),
        (-1_234_567, f"{MINUS}1,234,567"),
        (0.0061234, "0.00612"),
        (0.5, "0.500"),
        (12.345, "12.3"),
        (9.996, "10.0"),
        (1234.5678, "1,235"),
        (-0.25, f"{MINUS}0.250"),
        (0.0, "0.00"),
        (0.00001234, "1.23e-05"),
        (-0.00001234, f"{MINUS}1.23e-05"),
        (PValue(0.0018), "0.0018"),
        (PValue(0.25), "0.25"),
        (PValue(1.0), "1.0"),
        (PValue(0.001), "0.0010"),
        (PValue(0.00099), "<0.001"),
        (PValue(0.0), "<0.001"),
        (HalfInteger(304.5), "304.5"),
        (HalfInteger(291.5), "291.5"),
        (HalfInteger(1282.0), "1,282.0"),
        (Percent(0.96), "96.0 %"),
        (Percent(-0.0123), f"{MINUS}1.2 %"),
        (Interval(0.8125, 0.65, 0.9375), "0.812 [0.650, 0.938]"),
        (Interval(-0.0007, -0.0012, 0.0), f"{MINUS}0.00070 [{MINUS}0.00120, 0.00000]"),
        (Interval(0.0, 0.0, 0.0), "0.00 [0.00, 0.00]"),
        (Interval(1e-8, -2.5e-9, 0.0), f"1.00e-08 [{MINUS}2.50e-09, 0.00]"),
        (PercentInterval(0.96, 0.9421, 0.971), "96.0 % [94.2, 97.1]"),
    ],
)
def test_cell_is_rounded_by_the_rule(cell: Cell, text: str) -> None:
    """Every kind of cell has its one form."""
    assert shown(cell) == text


@pytest.mark.parametrize(
    "cell",
    [
        float("nan"),
        PValue(float("inf")),
        HalfInteger(float("nan")),
        Percent(float("nan")),
        Interval(0, 0, float("inf")),
        PercentInterval(0, 0, float("nan")),
    ],
)
def test_what_is_no_number_is_refused_in_every_format(cell: Cell, tmp_path: Path) -> None:
    """A hole in the results never becomes `nan` in a paper; nothing is written."""
    table = Table(name="t", caption="c", columns=("x",), rows=((cell,),))
    for write in (as_markdown, as_latex, as_csv):
        with pytest.raises(ValueError, match=r"must be finite; got (nan|inf); use None for a missing value"):
            write(table)
    with pytest.raises(ValueError, match="must be finite"):
        write_tables([table], tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("ending", [".md", ".tex", ".csv"])
def test_written_tables_are_the_golden_ones(ending: str, recorded_text: SnapshotAssertion) -> None:
    """The three files of one table, letter by letter; the ends of lines of CSV are written out."""
    assert table_texts(TABLE)[ending].replace("\r\n", "\\r\\n\n") == recorded_text


@pytest.mark.parametrize("text", HOSTILE)
def test_text_of_a_stranger_is_text_in_markdown(text: str) -> None:
    """In every place of a table, and in the page that lists tables."""

    def said(words: str) -> str:
        table = Table(name=words, caption=words, columns=("name", words), rows=((words, 1.0),), notes=(words,))
        return f"{as_markdown(table)}\n{index_of([table], [words])}"

    kinds = [(kind, "" if kind == "link_open" else at) for kind, at in skeleton(said(f"x {text} y"))]
    assert kinds == [(kind, "" if kind == "link_open" else at) for kind, at in skeleton(said("word"))]


@pytest.mark.parametrize(
    "text",
    [
        *("=cmd|' /C calc'!A0", "+1+1", "-1+1", "@SUM(1)", "\t=1", " =1", "-=1"),
        *("\uff1d1+1", "\uff0b1", "\uff0d1", "\uff20SUM(1)", "\ufe66" + "1", "\u3164=1", "\u2800=1", "\u034f=1"),
    ],
)
def test_text_of_a_stranger_is_no_formula_in_csv(text: str) -> None:
    """A spreadsheet computes what begins so; numbers and the mark of nothing stay as they are."""
    table = Table(name="t", caption="c", columns=(text, "x"), rows=((text, -1.0), ("-", 2.0)))
    rows = list(csv.reader(io.StringIO(as_csv(table), newline="")))
    assert rows == [[f"'{text}", "x"], [f"'{text}", "-1.0"], ["-", "2.0"]]


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("\x1b[31m=1", "\\x1b[31m=1"),
        ("\u3000=1", "\\u3000=1"),
        ("\u202e=1", "\\u202e=1"),
        ("\u200b=1", "\\u200b=1"),
        ("\r=1", "\\r=1"),
        ("\n=1", "\\n=1"),
        ("-\n=1", "'-\\n=1"),
        ("a\u2066b\nc", "a\\u2066b\\nc"),
        ("größer\t2", "größer\t2"),
    ],
)
def test_what_is_not_shown_is_an_escape_in_csv(text: str, shown: str) -> None:
    """Controls, marks of direction and line breaks, as in the other forms of a table."""
    rows = list(csv.reader(io.StringIO(as_csv(Table(name="t", caption="c", columns=("x",), rows=((text,),))))))
    assert rows == [["x"], [shown]]


def test_latex_special_characters_are_escaped() -> None:
    """Whatever text comes, LaTeX sets it and obeys none of it."""
    text = f"\\input{{x}} $a$ & #1 100% a_b ~ ^ < > | {MINUS}1 ± 2 \N{MULTIPLICATION SIGN} R²"
    body = as_latex(Table(name="t", caption="c", columns=("x",), rows=((text,),))).splitlines()
    assert (
        r"\textbackslash{}input\{x\} \$a\$ \& \#1 100\% a\_b \textasciitilde{} \textasciicircum{} $<$ $>$ $|$ $-$1 "
        r"$\pm$ 2 $\times$ R\textsuperscript{2} \\"
    ) in body


def test_markdown_marks_in_text_are_escaped() -> None:
    """A cell cannot end its column, begin a tag or turn bold."""
    table = Table(name="t", caption="c", columns=("x",), rows=(("a|b *c* <b> `d`\ne \\",),))
    assert "| a\\|b \\*c\\* \\<b> \\`d\\` e \\\\ |" in as_markdown(table).splitlines()


@pytest.mark.parametrize(
    ("characters", "floating", "parts"),
    [(NARROW, "table", 1), (NARROW + 1, "table*", 1), (WIDE, "table*", 1), (WIDE + 1, "table*", 2)],
)
def test_latex_makes_room_for_a_wide_table(characters: int, floating: str, parts: int) -> None:
    """Too wide for a column it spans two, too wide for two it stands in parts; nothing is scaled down."""
    text = as_latex(of_width(characters))
    assert text.startswith(f"% \\usepackage{{booktabs}}\n\\begin{{{floating}}}[htbp]")
    assert text.endswith(f"\\end{{{floating}}}\n")
    assert text.count(r"\begin{tabular}") == text.count(r"\end{tabular}") == parts
    assert text.count("{") == text.count("}")


def tabulars(text: str) -> list[list[list[str]]]:
    """Read the tabulars of a table in LaTeX: lines of cells, the heads first; each has as many as it has columns."""
    bodies = []
    for columns, body in re.findall(r"\\begin{tabular}{([^\n]*)}\n(.*?)\\end{tabular}", text, re.DOTALL):
        lines = [line.removesuffix(r" \\").split(" & ") for line in body.splitlines() if line.endswith(r" \\")]
        assert {len(line) for line in lines} == {
            len(re.findall("[lr]|p{", re.sub("{.raggedright.arraybackslash}", "", columns)))
        }
        bodies.append(lines)
    return bodies


def test_each_part_of_a_wide_table_begins_with_its_first_column() -> None:
    """A number far from its row's name would be nobody's; no column is lost or comes twice."""
    names = tuple(f"{number:010}" for number in range(16))
    text = as_latex(Table(name="t", caption="c", columns=("who", *names), rows=(("me", *range(16)),)))
    (one, _), (other, _) = tabulars(text)
    assert (one[0], other[0]) == ("who", "who")
    assert one[1:] + other[1:] == list(names)
    assert all(sum(map(len, head)) + 2 * (len(head) - 1) <= WIDE for head in (one, other))


def test_table_that_is_too_wide_for_two_parts_is_turned() -> None:
    """Its columns are rows then; nothing is lost."""
    names = tuple(f"{number:010}" for number in range(40))
    (lines,) = tabulars(as_latex(Table(name="t", caption="c", columns=("who", *names), rows=(("me", *range(40)),))))
    assert lines == [["who", "me"], *([name, str(number)] for number, name in enumerate(names))]


def test_table_that_is_too_wide_either_way_names_what_it_leaves_out() -> None:
    """The first columns stand in two parts; a choice of columns shows the others; the CSV has all."""
    names = tuple(f"{number:010}" for number in range(40))
    table = Table(
        name="t", caption="c", columns=("who", *names), rows=tuple((f"{row:010}", *range(40)) for row in range(40))
    )
    text = as_latex(table)
    one, other = (part[0][1:] for part in tabulars(text))
    left = names[len(one + other) :]
    assert one + other == list(names[: -len(left)])
    assert f"Left out here: {', '.join(left)};" in text
    shown_ones = table_texts(table, show=Shown(columns=left[:3]))
    (lines,) = tabulars(shown_ones[".tex"])
    assert lines[0] == ["who", *left[:3]]
    assert "Left out" not in shown_ones[".tex"]
    assert shown_ones[".csv"] == as_csv(table)


@pytest.mark.parametrize(
    ("notes", "told"),
    [
        (
            Notes.full,
            ("Two-sided, p < 0.05; 100% of seeds.", "A12 with its 95 % interval. See Newcombe et al. (2006)."),
        ),
        (Notes.short, ("Two-sided, p < 0.05; 100% of seeds.", "A12 with its 95 % interval.")),
        (Notes.none, ()),
    ],
)
def test_notes_and_columns_can_be_chosen(notes: Notes, told: tuple[str, ...]) -> None:
    """The first column stays; a table that has none of the columns is whole; of a note, its first sentence is short."""
    table = replace(TABLE, notes=(TABLE.notes[0], f"{TABLE.notes[1]} See Newcombe et al. (2006)."))
    seen = Shown(columns=("p", "network", "median", "elsewhere"), notes=notes).of(table)
    assert seen.columns == ("network", "p", "median")
    assert [row[1:] for row in seen.rows] == [(None, 0.0061234), (PValue(0.00012), 0.00543219)]
    assert seen.notes == told
    assert Shown(columns=("elsewhere",)).of(table) == table


def test_long_text_is_broken_into_lines_in_latex() -> None:
    """A sentence makes no table too wide; numbers never break."""
    words = ("a" * LONG, "b" * (LONG + 1), 1)
    text = as_latex(Table(name="t", caption="c", columns=("x", "y", "z"), rows=(words,)))
    assert r"\begin{tabular}{l>{\raggedright\arraybackslash}p{20em}r}" in text
    assert text.startswith("% \\usepackage{booktabs}\n% \\usepackage{array}\n")


def test_latex_row_may_begin_with_a_bracket() -> None:
    """After the end of a line, LaTeX would read it as a length."""
    body = as_latex(Table(name="t", caption="c", columns=("x",), rows=(("a",), ("[64, 32]",), ("*",)))).splitlines()
    assert {r"{}[64, 32] \\", r"{}* \\"} <= set(body)


def test_csv_keeps_every_digit() -> None:
    """Numbers come back from the file as they were; intervals have three columns, nothing is an empty field."""
    names, baseline, variant = csv.reader(io.StringIO(as_csv(TABLE), newline=""))
    assert names == ["network", "median", "p", "A12", "A12 low", "A12 high", "trained", "parameters"]
    assert baseline[2:6] == ["", "", "", ""]
    assert [float(value) for value in variant[1:]] == [0.00543219, 0.00012, 0.8125, 0.65, 0.9375, 1.0, 512]


def test_row_of_another_length_is_a_mistake_of_ours() -> None:
    """It would shift every number behind the gap."""
    with pytest.raises(ValueError, match="row 2 of table t needs 2 cells; got 1"):
        Table(name="t", caption="c", columns=("x", "y"), rows=((1, 2), (3,)))


def test_table_without_rows_is_still_a_table() -> None:
    """Nothing found is a result, too."""
    table = Table(name="t", caption="c", columns=("one", "two"), rows=())
    assert as_markdown(table).splitlines()[2:] == ["| one | two |", "| --: | --: |"]
    assert as_csv(table) == "one,two\r\n"
    assert r"\midrule" + "\n" + r"\bottomrule" in as_latex(table)


def test_older_table_is_replaced_and_a_failed_one_stays(tmp_path: Path) -> None:
    """A second writing leaves just the new files; a directory in the way is named."""
    for _ in range(2):
        write_tables([TABLE], tmp_path)
        there = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.*")}
        assert there == {"index.md", *(f"more/study_force{ending}" for ending in table_texts(TABLE))}
    (tmp_path / "in_the_way").write_text("")
    with refused(StoreError, place="in_the_way"):
        write_tables([TABLE], tmp_path / "in_the_way")


def test_frame_has_the_rows_unrounded() -> None:
    """A missing cell is missing, an interval is three columns, and each column has the type of its cells."""
    frame = TABLE.frame
    assert list(frame) == ["network", "median", "p", "A12", "A12 low", "A12 high", "trained", "parameters"]
    assert [str(kind) for kind in frame.dtypes] == ["string", *["Float64"] * 6, "Int64"]
    assert frame.loc[0, ["p", "A12", "A12 low", "A12 high"]].isna().all()
    assert frame.loc[1, ["p", "A12", "A12 low", "trained"]].tolist() == [0.00012, 0.8125, 0.65, 1.0]


def test_table_is_laid_out_from_a_frame() -> None:
    """By columns and shapes of cells; a cell is empty where its first value is missing; a shape sees the others."""
    frame = pd.DataFrame({"name": ["a", None], "n": [1, None], "p": [0.5, None], "p_low": [None, 0.25]})
    table = Table.of(
        frame.astype({"n": "Int64", "name": "str"}),
        {"who": "name", "seeds": "n", "p": (PValue, "p"), "interval": (interval_cell, "p", "p_low", "p_low")},
        name="t",
        caption="c",
        last=[("trivial", None, None, None)],
    )
    assert table.columns == ("who", "seeds", "p", "interval")
    assert table.rows == (("a", 1, PValue(0.5), 0.5), (None,) * 4, ("trivial", None, None, None))
    assert type(table.rows[0][1]) is int
