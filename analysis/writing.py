"""Tables and pictures as files, each written whole."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from analysis.gallery import Picture
from analysis.paper import Chapter, Illustration
from analysis.rendering import write_table
from analysis.style import render
from analysis.tables import Table
from tacevo.store import write_durably

#: Is told that the file or files of a name are there.
Told = Callable[[str], object]


def write_tables(tables: Iterable[Table], folder: Path) -> None:
    """Write tables in every format; older ones of the same names are replaced.

    Raises:
        StoreError: a file cannot be written.
    """
    for table in tables:
        write_table(table, folder)


def write_pictures(pictures: Iterable[Picture], folder: Path, endings: Sequence[str], told: Told) -> None:
    """Draw pictures into files; older ones of the same names are replaced.

    Args:
        pictures: what to draw.
        folder: where to.
        endings: `.pdf`, `.svg`, `.png`: the formats.
        told: told after each picture.

    Raises:
        StoreError: a file cannot be written.
    """
    for picture in pictures:
        figure = picture.draw()
        for ending in endings:
            write_durably(folder / f"{picture.name}{ending}", render(figure, ending))
        told(picture.name)


def write_chapter(
    title: str, tables: Sequence[Table], pictures: Sequence[Picture], folder: Path, told: Told
) -> Chapter:
    """Write what a chapter holds into a folder of its own, beside the document.

    Raises:
        StoreError: a file cannot be written.
    """
    write_tables(tables, folder)
    write_pictures(pictures, folder, (".pdf",), told)
    return Chapter(
        title=title,
        tables=tuple(f"{folder.name}/{table.name}.tex" for table in tables),
        figures=tuple(
            Illustration(file=f"{folder.name}/{picture.name}.pdf", caption=picture.caption) for picture in pictures
        ),
    )
