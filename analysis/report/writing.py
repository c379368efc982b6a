"""Tables and pictures as files, each written whole."""

import re
from collections.abc import Callable, Collection, Iterable, Sequence
from pathlib import Path

from analysis.figures.style import render
from analysis.report.document import Chapter, Illustration
from analysis.report.figure_list import Picture
from analysis.table import Table
from analysis.tables.rendering import table_texts
from tacevo.storage.files import write_durably
from tacevo.studies.directory import NAME

#: Is called with the name of a picture once its files are written.
OnDrawn = Callable[[str], object]


def write_tables(tables: Iterable[Table], directory: Path, *, prefix: str = "") -> None:
    """Write tables in every format, each file whole; older ones of the same names are replaced.

    Args:
        tables: what to write.
        directory: where to.
        prefix: of their labels in LaTeX.

    Raises:
        StoreError: a file cannot be written.
    """
    for table in tables:
        for name, text in table_texts(table, prefix=prefix).items():
            write_durably(directory / name, text)


def write_pictures(pictures: Iterable[Picture], directory: Path, endings: Sequence[str], on_drawn: OnDrawn) -> None:
    """Draw pictures into files; older ones of the same names are replaced.

    Args:
        pictures: what to draw.
        directory: where to.
        endings: `.pdf`, `.svg`, `.png`: the formats.
        on_drawn: called after each picture.

    Raises:
        StoreError: a file cannot be written.
    """
    for picture in pictures:
        figure = picture.draw()
        for ending in endings:
            write_durably(directory / f"{picture.name}{ending}", render(figure, ending))
        on_drawn(picture.name)


def remove_outdated(directory: Path, names: Collection[str], *, task: str, endings: Collection[str]) -> list[str]:
    """Remove what an earlier command wrote there of studies that are missing or rejected now.

    Args:
        directory: of tables or of figures.
        names: of those that are current; other files than those of a study of this task are left alone.
        task: the run's.
        endings: of the files that the command writes.

    Returns:
        The names of the removed files.
    """
    pattern = re.compile(rf".+_{re.escape(task)}_{NAME}")
    found = [path for path in sorted(directory.iterdir()) if path.suffix in endings and pattern.fullmatch(path.stem)]
    gone = [path for path in found if path.stem not in names]
    for path in gone:
        path.unlink()
    return [path.name for path in gone]


def write_chapter(
    title: str, tables: Sequence[Table], pictures: Sequence[Picture], directory: Path, on_drawn: OnDrawn
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
        tables=tuple(f"{directory.name}/{table.name}.tex" for table in tables),
        figures=tuple(
            Illustration(
                file=f"{directory.name}/{picture.name}.pdf",
                caption=picture.caption,
                label=f"fig:{prefix}{picture.name}",
            )
            for picture in pictures
        ),
    )
