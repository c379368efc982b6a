"""The pages that hold all tables and figures of runs: a LaTeX document, and its PDF where LaTeX is installed."""

import re
import subprocess
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from analysis.report.figure_list import OnDrawn, Picture, write_pictures
from analysis.report.outputs import Say, unsaid
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

#: What LaTeX reads as it is.
_PLACE = re.compile(r"[A-Za-z0-9._/-]+")

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


def make_pdf(source: Path, which: Callable[[str], str | None]) -> Path | None:
    """Make the PDF of a document with what is installed, and return it; None without LaTeX.

    `which` finds a program, as `shutil.which` does.

    Raises:
        RunError: LaTeX rejected the document; the message ends with its last words.
    """
    for (program, *options), times in ENGINES:
        path = which(program)
        if path is not None:
            for _ in range(times):
                _run([path, *options, source.name], source.parent)
            return source.with_suffix(".pdf")
    return None


def write_document(chapters: Iterable[str], directory: Path) -> Path:
    """Write the document of chapters (`write_chapter`) into a directory; return it."""
    path = directory / "paper.tex"
    write_durably(path, _HEAD + "\n".join(chapters) + "\\end{document}\n")
    return path


def write_chapter(
    title: str,
    tables: Sequence[Table],
    pictures: Sequence[Picture],
    directory: Path,
    *,
    on_drawn: OnDrawn = lambda name: None,
    say: Say = unsaid,
) -> str:
    """Write what belongs together, on pages of its own, into a directory beside the document.

    `on_drawn` and `say` are as of `write_pictures`.

    Returns:
        What the document has of it; labels begin with the name of the directory.

    Raises:
        RunError: the name of a study is none that LaTeX reads as a name of a file.
        StoreError: a file cannot be written.
    """
    name = directory.name
    for place in [*map(place_of, tables), *(picture.name for picture in pictures)]:
        if not _PLACE.fullmatch(place):
            remedy = "rename the directory of that study"
            raise RunError(place, expected="a name of letters, digits, '.', '_' and '-'", remedy=remedy)
    write_tables(tables, directory, prefix=f"{name}:")
    written = write_pictures(pictures, directory, (".pdf",), on_drawn, say)
    figures = [
        rf"\begin{{figure}}[htbp]\centering\includegraphics{{{name}/{picture.name}.pdf}}"
        rf"\caption{{{in_latex(picture.caption)}}}\label{{fig:{name}:{picture.name}}}\end{{figure}}"
        for picture in written
    ]
    inputs = [rf"\input{{{name}/{place_of(table)}.tex}}" for table in tables]
    return "\n".join([rf"\section*{{{in_latex(title)}}}", *figures, *inputs, r"\clearpage", ""])


def _run(command: list[str], directory: Path) -> None:
    done = subprocess.run(command, cwd=directory, stdin=subprocess.DEVNULL, capture_output=True, check=False)
    if done.returncode != 0:
        last = (done.stdout + done.stderr).decode(errors="replace").strip()[-600:]
        raise RunError(f"{command[0]} failed; it ended with\n{last}", place=str(directory / command[-1]))
