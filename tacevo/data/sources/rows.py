"""The rows of a CSV table, one image each: read whole, checked, and every fault named by its line."""

import csv
import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tacevo.data.source import Catalogue, check_no_faults, listed, repeats, shortened
from tacevo.data.sources.filenames import folded, own_names
from tacevo.data.sources.hints import number_in
from tacevo.data.sources.images import file_catalogue, image_files
from tacevo.errors import DataError
from tacevo.records import Kind


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One row of a table, as it is written there."""

    #: As an editor counts, the header being line 1.
    line: int
    name: str
    #: The image, links followed; `is_there` says whether it exists.
    path: Path
    #: The directory that the image was found in, as it is written: not where a link leads.
    directory: Path
    is_there: bool
    #: The text of each target column, in their order.
    texts: tuple[str, ...]
    #: That of the column that names the groups; empty where none does.
    group: str

    @property
    def place(self) -> str:
        """What a message calls this row."""
        return f"line {self.line} {shortened(self.name)}"

    @property
    def labels(self) -> tuple[float, ...]:
        """The values of the target columns; NaN for what is not a number."""
        return tuple(math.nan if (number := number_in(text)) is None else number for text in self.texts)


def row_catalogue(
    rows: Sequence[Row], skipped: int, image_size: int, white_point: float | None, **fields: Any
) -> Catalogue:
    """List the images and values of a table's rows; `fields` are the other fields of the catalogue."""
    return file_catalogue(
        [row.path for row in rows],
        [row.place for row in rows],
        image_size,
        white_point,
        kind=Kind.regression,
        labels=np.array([row.labels for row in rows], dtype=np.float64),
        skipped=skipped,
        ignored=_unnamed_images(rows),
        **fields,
    )


def _unnamed_images(rows: Sequence[Row]) -> list[Path]:
    """Find the images that lie beside those of the rows, and that no row names."""
    named = {row.path for row in rows}
    directories = {row.directory.resolve(): row.directory for row in rows}  # a directory may be written in several ways
    return [
        path
        for directory in sorted(directories.values())
        for path in image_files(directory, "*")
        if path.resolve() not in named
    ]


def read_rows(
    table: Path,
    *,
    image_column: str,
    target_columns: Sequence[str],
    asked_by: tuple[str, str],
    remedy: str,
    directories: Sequence[Path],
    skip_missing: bool,
    group_column: str | None = None,
) -> tuple[list[Row], int]:
    """Read and check a whole table.

    It is a CSV table in UTF-8 with a header. Outer spaces of column names do not matter, nor does their case where no
    column has exactly the asked name. The image column holds each image's path, relative to one of the directories,
    which are looked through in order. The group column, where one is asked for, holds what images of one press share.
    `asked_by` names the settings of image and target columns, for messages, and `remedy` what the user can do where one
    is absent. With `skip_missing`, rows without their image are left out.

    Returns:
        The rows in the order of the table, of which every image exists and every label is finite; and how many were
        left out.

    Raises:
        DataError: the table cannot be used, or a row is faulty: all rows with the same fault are named at once.
    """
    asked = [(image_column, asked_by[0]), *((name, asked_by[1]) for name in target_columns)]
    asked += [] if group_column is None else [(group_column, "data.group_column")]
    rows = list(_rows(table, asked, remedy, directories, len(target_columns)))
    if not rows:
        raise DataError("a header without rows", place=table.name, expected="a row for each image")
    present = [row for row in rows if row.is_there]
    if not (present and skip_missing):
        _check_images_exist(table, rows, directories, skippable=bool(present))
    # An image listed twice could stand in two parts of the split.
    twice = repeats((row.place, folded(str(row.path))) for row in present)
    check_no_faults(
        f"{table.name} lists images more than once",
        twice,
        "keep one line per image; names that differ in case or Unicode form alone are equal",
    )
    wrong = [
        f"line {row.line} {column} = {shortened(text)}"
        for row in present
        for column, text in zip(target_columns, row.texts, strict=True)
        if number_in(text) is None
    ]
    check_no_faults(
        f"{table.name} has labels that are not finite numbers",
        wrong,
        "correct them, written as 12, -0.5 or 1.5e-3, or remove these lines",
    )
    if group_column is not None:
        empty = [row.place for row in present if not row.group]
        remedy = "write there what the images of one press share"
        check_no_faults(f"{table.name} has rows without a value in {group_column}", empty, remedy)
    return present, len(rows) - len(present)


def _check_images_exist(table: Path, rows: Sequence[Row], directories: Sequence[Path], *, skippable: bool) -> None:
    """Check that the image of each row exists; the remedy fits the names."""
    missing = [row for row in rows if not row.is_there]
    own = own_names([row.name for row in missing], directories)
    faults = [f"{row.place} (there is {own[row.name]})" if row.name in own else row.place for row in missing]
    choice = ", or leave them out with data.skip_missing=true" if skippable else ""
    remedy = f"restore them or remove these lines{choice}"
    if all("\\" in row.name for row in missing):
        remedy = "write their paths with / instead of \\"
    elif own:
        rest = f"; as for others, {remedy}" if len(own) < len({row.name for row in missing}) else ""
        remedy = f"write the names of files as they are on disk{rest}"
    check_no_faults(f"{table.name} names images that are not in {directories[0]}", faults, remedy)


def _rows(
    table: Path, asked: Sequence[tuple[str, str]], remedy: str, directories: Sequence[Path], targets: int
) -> Iterator[Row]:
    """Read the rows of a table, with the asked columns only: the image's, so many targets, and perhaps the group's."""
    lines = _lines(table)
    _, header = next(lines, (1, []))
    numbers = _columns(table, header, asked, remedy)
    long = []
    for line, values in lines:
        if len(values) > len(header):  # a decimal comma would shift every label behind it
            long.append(f"line {line}")
            continue
        name, *texts = (values[number] if number < len(values) else "" for number in numbers)
        path, directory, is_there = _find(name.strip(), directories)
        yield Row(
            line=line,
            name=name.strip(),
            path=path,
            directory=directory,
            is_there=is_there,
            texts=tuple(texts[:targets]),
            group="".join(texts[targets:]).strip(),
        )
    check_no_faults(
        f"{table.name} has lines with more values than its {len(header)} columns", long, "quote or correct them"
    )


def _columns(table: Path, header: Sequence[str], asked: Sequence[tuple[str, str]], remedy: str) -> list[int]:
    """Find the position of each asked column; each comes with the setting that asks for it."""
    columns = [name.strip() for name in header]
    if not columns:
        raise DataError("nothing", place=table.name, expected="a first line that names the columns")
    twice = sorted({shortened(name) for name in columns if name and columns.count(name) > 1})
    check_no_faults(f"{table.name} has several columns of one name", twice, "rename all but one")
    folded = [name.casefold() for name in columns]
    names = [name for name, _ in asked]
    exact = {name: columns.index(name) for name in names if name in columns}
    loose = {name: folded.index(name.casefold()) for name in names if folded.count(name.casefold()) == 1}
    found = {**loose, **exact}
    absent = [f"{name!r} ({setting})" for name, setting in asked if name not in found]
    if absent:
        raise DataError(
            listed(list(map(shortened, columns))),
            place=f"the columns of {table.name}",
            expected=listed(absent),
            remedy=_hint(columns) or remedy,
        )
    return [found[name] for name in names]


def _hint(columns: Sequence[str]) -> str | None:
    """Return how to mend what is not a header of a CSV table; None where it may be one."""
    for mark, name in ((";", "semicolons"), ("\t", "tabs"), ("|", "bars")):
        if len(columns) == 1 and mark in columns[0]:
            return f"save the table with commas between the columns, not {name}"
    if any(number_in(name) is not None for name in columns):
        return "add a first line that names the columns, not values"
    return None


def _lines(table: Path) -> Iterator[tuple[int, list[str]]]:
    """Read the lines of a table that are not blank, with their numbers."""
    line = 0
    try:
        with table.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file, skipinitialspace=True, strict=True)
            for values in reader:
                line += 1
                if reader.line_num != line:  # a stray quote would swallow the rows up to the next one
                    raise _open_quote(table, line)
                if values:
                    yield line, values
    except csv.Error as error:
        raise _open_quote(table, line + 1) from error
    except UnicodeDecodeError as error:
        byte = error.object[error.start]
        raise DataError(f"byte 0x{byte:02x}", place=table.name, expected="a CSV table in UTF-8") from error
    except OSError as error:
        raise DataError(f"a file that cannot be read ({error.strerror})", place=str(table)) from error


def _open_quote(table: Path, line: int) -> DataError:
    return DataError(
        'a quote (") that does not end one value within the line',
        place=f"{table.name}, line {line}",
        remedy="remove it, or write the whole value in one line and double the quotes inside it",
    )


def _find(name: str, directories: Sequence[Path]) -> tuple[Path, Path, bool]:
    """Find an image in the first directory that has it; else name the place where it should be.

    Returns:
        Where the image is, links followed; the directory that it was found in, as written; and whether it is there.
    """
    found = (directory / name for directory in directories if os.path.isfile(directory / name))
    path = next(found, None)
    return (directories[0] / name, directories[0], False) if path is None else (path.resolve(), path.parent, True)
