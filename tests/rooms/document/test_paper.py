"""Promise: the document holds every table and figure, and its PDF is made where LaTeX is, else nobody pretends."""

import os
import re
import shutil
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from refusals import refused

from analysis.report.document import ENGINES, make_pdf, write_chapter, write_document
from analysis.report.figure_list import Picture
from analysis.table import Interval, Percent, PValue, Table
from analysis.tables.rendering import as_latex
from tacevo.errors import RunError

CHAPTER = "A chapter."


def engine(folder: Path, name: str, script: str) -> Path:
    """Install a stand-in for LaTeX; it notes how it was called."""
    path = folder / name
    path.write_text(f'#!/bin/sh\necho "$@" >> calls.txt\n{script}\n')
    path.chmod(0o755)
    return path


def search_in(folder: Path, name: str) -> str | None:
    """Find a program in one directory only."""
    return shutil.which(name, path=os.fspath(folder))


def test_document_holds_everything_and_no_label_twice(tmp_path: Path) -> None:
    """Two runs have tables and figures of the same names; texts are escaped, and what is asked for lies beside it."""
    table = Table(name="gate", caption="c", columns=("x",), rows=((1,),))
    picture = Picture(name="lineage", caption="100 % of g01", draw=lambda: Figure(figsize=(3.5, 1)))
    chapters = [write_chapter("force_1 & more", [table], [picture], tmp_path / name) for name in ("run1", "run2")]
    text = write_document(chapters, tmp_path).read_text()
    assert r"\section*{force\_1 \& more}" in text
    assert r"\begin{figure}[htbp]\centering\includegraphics{run1/lineage.pdf}\caption{100 \% of g01}" in text
    asked = re.findall(r"\\(?:input|includegraphics)\{(.*?)\}", text)
    assert asked == ["run1/lineage.pdf", "run1/gate.tex", "run2/lineage.pdf", "run2/gate.tex"]
    labels = re.findall(r"\\label\{(.*?)\}", "".join([text, *((tmp_path / file).read_text() for file in asked[1::2])]))
    assert sorted(labels) == ["fig:run1:lineage", "fig:run2:lineage", "tab:run1:gate", "tab:run2:gate"]
    for word in ("begin", "end"):
        assert sorted(re.findall(rf"\\{word}\{{(.*?)\}}", text)) == ["document", "figure", "figure"]


def test_name_that_latex_would_obey_is_refused(tmp_path: Path) -> None:
    """A study bears the name of its directory, which may be a stranger's; a label has no such mark, either."""
    table = Table(name=r"x}\input{secret}/gate", caption="c", columns=("x",), rows=((1,),))
    with refused(RunError, got="secret", remedy="rename"):
        write_chapter("one", [table], [], tmp_path / "run1")
    assert not (tmp_path / "run1").exists()
    assert r"\input" not in as_latex(table)


@pytest.mark.skipif(not any(shutil.which(command[0]) for command, _ in ENGINES), reason="no LaTeX is installed")
def test_latex_sets_the_document(tmp_path: Path) -> None:
    """Every kind of cell and of character, a table in parts, a figure: the real thing makes a page of it."""
    every = "".join(map(chr, range(32, 127))) + "\N{MINUS SIGN}\N{EN DASH}±\N{MULTIPLICATION SIGN}·≤≥²"
    cells = ("text " * 20, 1, 0.5, PValue(0.0001), Percent(0.5), Interval(0.5, 0.4, 0.6), None, every)
    wide = Table(name="wide", caption=every, columns=tuple(f"column {place}" for place in range(8)), rows=(cells,))
    narrow = Table(name="narrow", caption="c", columns=("x",), rows=(("[1]",), ("*",)), notes=(every,))
    empty = Table(name="empty", caption="c", columns=("x",), rows=())
    picture = Picture(name="lineage", caption=every, draw=lambda: Figure(figsize=(3.5, 1)))
    tables = [wide, narrow, empty]
    chapters = [write_chapter(every, tables, [picture], tmp_path / name) for name in ("a", "b")]
    pdf = make_pdf(write_document(chapters, tmp_path), shutil.which)
    assert pdf is not None
    assert pdf.read_bytes().startswith(b"%PDF")
    log = pdf.with_suffix(".log")
    assert not log.exists() or "multiply defined" not in log.read_text(errors="replace")


def test_without_latex_there_is_no_pdf(tmp_path: Path) -> None:
    """The document stays, to be compiled elsewhere."""
    source = write_document([CHAPTER], tmp_path)
    assert make_pdf(source, lambda name: None) is None
    assert list(tmp_path.iterdir()) == [source]


@pytest.mark.parametrize(("name", "times"), [("latexmk", 1), ("tectonic", 1), ("pdflatex", 2)])
def test_pdf_is_made_with_what_is_there(name: str, times: int, tmp_path: Path) -> None:
    """Plain LaTeX needs two passes for its references."""
    tools, out = tmp_path / "tools", tmp_path / "out"
    tools.mkdir()
    engine(tools, name, "echo pdf > paper.pdf")
    source = write_document([CHAPTER], out)
    assert make_pdf(source, lambda program: search_in(tools, program)) == out / "paper.pdf"
    assert len((out / "calls.txt").read_text().splitlines()) == times


def test_document_that_latex_refuses_is_told_with_its_last_words(tmp_path: Path) -> None:
    """The reason stands at the end of what LaTeX says."""
    engine(tmp_path, "pdflatex", "echo '! Undefined control sequence.'; exit 1")
    source = write_document([CHAPTER], tmp_path)
    with refused(RunError, place="paper.tex", got="it ended with\n! Undefined control sequence"):
        make_pdf(source, lambda program: search_in(tmp_path, program))
