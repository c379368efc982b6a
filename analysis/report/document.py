"""The pages that hold all tables and figures of runs: a LaTeX document, and its PDF where LaTeX is installed."""

import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from analysis.report.figure_list import OnDrawn, Picture, write_pictures
from analysis.report.writing import place_of, write_tables
from analysis.table import Table
from analysis.tables.rendering import in_latex
from tacevo.errors import RunError
from tacevo.storage.files import write_durably

#: What makes a PDF of a document, in the order in which it is looked for; given as often as it needs.
ENGINES: tuple[tuple[tuple[str, ...], int], ...] = (
    (("latexmk", "-pdf", "-interaction=nonstopmode", "-halt-on-error"), 1),
    (("tectonic",), 1),
    (("pdflatex", "-interaction=nonstopmode", "-halt-on-error"), 2),
)

_HEAD = r"""\documentclass[10pt]{article}
\usepackage[letterpaper,textwidth=7.16in,textheight=9.6in]{geometry}
\usepackage[utf8]{inputenc}
\usepackage{array}
\usepackage{booktabs}
\usepackage{graphicx}
\setlength{\belowcaptionskip}{6pt}
\extrafloats{100}
\renewcommand{\topfraction}{0.95}
\renewcommand{\textfraction}{0.05}
\renewcommand{\floatpagefraction}{0.7}
\begin{document}
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Illustration:
    """A figure's PDF file."""

    #: Beside the document, e.g. `run1/lineage.pdf`.
    file: str
    caption: str
    #: For references, e.g. `fig:run1:lineage`.
    label: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Chapter:
    """What belongs together, on pages of its own."""

    title: str
    #: Files beside the document, e.g. `run1/gate.tex`.
    tables: tuple[str, ...]
    figures: tuple[Illustration, ...] = ()


def document(chapters: Sequence[Chapter]) -> str:
    """Write the LaTeX document."""
    return _HEAD + "\n".join(map(_chapter, chapters)) + "\\end{document}\n"


def make_pdf(source: Path, which: Callable[[str], str | None]) -> Path | None:
    """Make the PDF of a document with what is installed.

    Args:
        source: the document.
        which: finds a program, as `shutil.which` does.

    Returns:
        The PDF; None without LaTeX.

    Raises:
        RunError: LaTeX rejected the document; the message ends with its last words.
    """
    for (program, *options), times in ENGINES:
        found = which(program)
        if found is not None:
            for _ in range(times):
                _run([found, *options, source.name], source.parent)
            return source.with_suffix(".pdf")
    return None


def write_document(chapters: Sequence[Chapter], directory: Path) -> Path:
    """Write the document into a directory; return it."""
    path = directory / "paper.tex"
    write_durably(path, document(chapters))
    return path


def write_chapter(
    title: str,
    tables: Sequence[Table],
    pictures: Sequence[Picture],
    directory: Path,
    on_drawn: OnDrawn = lambda name: None,
) -> Chapter:
    """Write what a chapter holds into a directory of its own, beside the document; labels begin with its name.

    Raises:
        StoreError: a file cannot be written.
    """
    prefix = f"{directory.name}:"
    write_tables(tables, directory, prefix=prefix)
    write_pictures(pictures, directory, (".pdf",), on_drawn)
    return Chapter(
        title=title,
        tables=tuple(f"{directory.name}/{place_of(table)}.tex" for table in tables),
        figures=tuple(
            Illustration(
                file=f"{directory.name}/{picture.name}.pdf",
                caption=picture.caption,
                label=f"fig:{prefix}{picture.name}",
            )
            for picture in pictures
        ),
    )


def _run(command: list[str], directory: Path) -> None:
    done = subprocess.run(command, cwd=directory, stdin=subprocess.DEVNULL, capture_output=True, check=False)
    if done.returncode != 0:
        last = (done.stdout + done.stderr).decode(errors="replace").strip()[-600:]
        raise RunError(f"{command[0]} failed; it ended with\n{last}", place=str(directory / command[-1]))


def _chapter(chapter: Chapter) -> str:
    parts = [rf"\section*{{{in_latex(chapter.title)}}}", *map(_figure, chapter.figures)]
    parts += [rf"\input{{{file}}}" for file in chapter.tables]
    return "\n".join([*parts, r"\clearpage", ""])


def _figure(figure: Illustration) -> str:
    caption = rf"\caption{{{in_latex(figure.caption)}}}\label{{{figure.label}}}"
    return rf"\begin{{figure}}[htbp]\centering\includegraphics{{{figure.file}}}{caption}\end{{figure}}"
