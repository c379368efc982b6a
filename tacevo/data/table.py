"""Regression from a CSV table: one row per image, with columns of measured values."""

import csv
import math
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from tacevo.data.photos import DECODING, common_size, decode, files_hash
from tacevo.data.source import Catalogue, Picture, refuse, repeats
from tacevo.errors import DataError
from tacevo.records import Json, Kind


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A folder with a CSV table; the first row holds the column names."""

    root: Path
    #: The table, relative to `root`, e.g. `labels.csv`.
    table: str
    #: The column with each image's path, relative to `root` or to the folder of the table.
    image_column: str
    #: The columns to regress, in the order of the outputs.
    target_columns: tuple[str, ...]
    #: Height and width that images are resized to, in pixels.
    image_size: int
    #: Leave out rows whose image is missing, instead of refusing the table.
    skip_missing: bool = False

    def describe(self) -> Json:
        """Name the content: the bytes of the table and of every image, not where they lie.

        Raises:
            DataError: the folder, the table or an image is missing, or the table is broken.
        """
        rows, _ = self._read()
        return {
            "source": "table",
            "decoding": DECODING,
            "table": files_hash([self.root / self.table]),
            "lines": [row.line for row in rows],
            "images": files_hash(row.path for row in rows),
            "image_column": self.image_column,
            "target_columns": list(self.target_columns),
            "image_size": self.image_size,
        }

    def catalogue(self) -> Catalogue:
        """List labels and images in the order of the table.

        Raises:
            DataError: the folder, the table or an image is missing, unreadable or of another size than the rest, or
                the table is broken.
        """
        rows, skipped = self._read()
        return Catalogue(
            kind=Kind.regression,
            names=self.target_columns,
            labels=np.array([row.labels for row in rows], dtype=np.float64),
            image_size=self.image_size,
            pictures=pictures(rows, self.image_size),
            recorded_size=common_size([(row.place, row.path) for row in rows]),
            files=[row.path for row in rows],
            skipped=skipped,
        )

    def _read(self) -> tuple[list["Row"], int]:
        if not self.root.is_dir():
            raise DataError(f"data.root is no folder: {self.root}; give the folder that holds the recording")
        table = self.root / self.table
        if not table.is_file():
            raise DataError(f"there is no table {self.table!r} in {self.root}; set data.table to its name")
        return read_rows(
            table,
            image_column=self.image_column,
            target_columns=self.target_columns,
            folders=(self.root, table.parent),
            skip_missing=self.skip_missing,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One row of a table, as it is written there."""

    #: As an editor counts, the header being line 1.
    line: int
    name: str
    #: The image; it need not exist.
    path: Path
    #: The text of each target column, in their order.
    texts: tuple[str, ...]

    @property
    def place(self) -> str:
        """What a message calls this row."""
        return f"line {self.line} {self.name!r}"

    @property
    def labels(self) -> tuple[float, ...]:
        """The values of the target columns; NaN for what is no number."""
        return tuple(_number(text) for text in self.texts)


def pictures(rows: Sequence[Row], image_size: int) -> tuple[Callable[[], Picture], ...]:
    """Offer the picture of each row, not yet decoded."""
    return tuple(partial(decode, row.path, image_size) for row in rows)


def read_rows(
    table: Path, *, image_column: str, target_columns: Sequence[str], folders: Sequence[Path], skip_missing: bool
) -> tuple[list[Row], int]:
    """Read and check a whole table.

    Outer spaces of column names do not matter, nor does their case where no column has exactly the asked name.

    Args:
        table: the file; a CSV table in UTF-8 with a header.
        image_column: holds each image's path, relative to one of the folders.
        target_columns: hold the labels.
        folders: where images are looked for, in this order.
        skip_missing: leave out rows whose image is missing, instead of refusing the table.

    Returns:
        The rows in the order of the table, of which every image exists and every label is finite; and how many were
        left out.

    Raises:
        DataError: the table is no such table, or a row is faulty: all rows with the same fault are named at once.
    """
    rows = list(_rows(table, (image_column, *target_columns), folders))
    if not rows:
        raise DataError(f"{table.name} has no rows below its header; give the table that holds the labels")
    present = [row for row in rows if os.path.isfile(row.path)]
    if not (present and skip_missing):
        absent = [row.place for row in rows if not os.path.isfile(row.path)]
        choice = ", or leave them out with data.skip_missing=true" if present else ""
        refuse(
            f"{table.name} names images that are not in {folders[0]}",
            absent,
            f"Restore them or remove these lines{choice}.",
        )
    # An image listed twice could stand in two parts of the split.
    twice = repeats((row.place, str(row.path).casefold()) for row in present)
    refuse(f"{table.name} lists images more than once", twice, "Keep one line per image; case alone tells none apart.")
    wrong = [
        f"line {row.line} {column} = {text!r}"
        for row in present
        for column, text in zip(target_columns, row.texts, strict=True)
        if not math.isfinite(_number(text))
    ]
    refuse(f"{table.name} has labels that are not finite numbers", wrong, "Correct or remove these lines.")
    return present, len(rows) - len(present)


def _rows(table: Path, names: Sequence[str], folders: Sequence[Path]) -> Iterator[Row]:
    """Read the rows of a table, with the asked columns only, the image's first."""
    lines = _lines(table)
    _, header = next(lines, (1, []))
    numbers = _columns(table, header, names)
    long = []
    for line, values in lines:
        if len(values) > len(header):  # a decimal comma would shift every label behind it
            long.append(f"line {line}")
            continue
        name, *texts = (values[number] if number < len(values) else "" for number in numbers)
        yield Row(line=line, name=name.strip(), path=_find(name.strip(), folders), texts=tuple(texts))
    refuse(f"{table.name} has lines with more values than its {len(header)} columns", long, "Quote or correct them.")


def _columns(table: Path, header: Sequence[str], names: Sequence[str]) -> list[int]:
    """Find the position of each asked column."""
    columns = [name.strip() for name in header]
    twice = sorted({repr(name) for name in columns if name and columns.count(name) > 1})
    refuse(f"{table.name} has several columns of one name", twice, "Rename all but one.")
    folded = [name.casefold() for name in columns]
    exact = {name: columns.index(name) for name in names if name in columns}
    loose = {name: folded.index(name.casefold()) for name in names if folded.count(name.casefold()) == 1}
    found = {**loose, **exact}
    absent = [repr(name) for name in names if name not in found]
    refuse(f"{table.name} lacks columns", absent, f"It has {columns}.")
    return [found[name] for name in names]


def _lines(table: Path) -> Iterator[tuple[int, list[str]]]:
    """Read the lines of a table that are not blank, with their numbers."""
    try:
        with table.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file, skipinitialspace=True)
            yield from ((reader.line_num, values) for values in reader if values)
    except (csv.Error, UnicodeDecodeError) as error:
        raise DataError(f"{table.name} is no CSV table in UTF-8 ({error}); save it again as such") from error
    except OSError as error:
        raise DataError(f"{table} cannot be read ({error.strerror}); see that you may read it") from error


def _find(name: str, folders: Sequence[Path]) -> Path:
    """Find an image in the first folder that has it; where none has, name the place where it should be."""
    found = (folder / name for folder in folders if os.path.isfile(folder / name))
    path = next(found, None)
    return folders[0] / name if path is None else path.resolve()


def _number(text: str) -> float:
    """Read a number; what is none becomes NaN, which the caller reports with its line."""
    try:
        return float(text)
    except ValueError:
        return math.nan
