"""Regression from a CSV table: one row per image, with columns of measured values."""

import csv
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from tacevo.data.photos import DECODING, decode, files_hash
from tacevo.data.source import Catalogue, refuse
from tacevo.errors import DataError
from tacevo.records import Json, Kind


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A folder with a CSV table; the first row holds the column names, in which outer spaces do not matter."""

    root: Path
    #: The table, relative to `root`, e.g. `labels.csv`.
    table: str
    #: The column with each image's path, relative to `root` or to the folder of the table.
    image_column: str
    #: The columns to regress, in the order of the outputs.
    target_columns: tuple[str, ...]
    #: Height and width that images are resized to, in pixels.
    image_size: int

    def describe(self) -> Json:
        """Name the content: the bytes of the table and of every image, not where they lie.

        Raises:
            DataError: the folder, the table or an image is missing, or the table is broken.
        """
        rows = _rows(self)
        return {
            "source": "table",
            "decoding": DECODING,
            "table": files_hash([self.root / self.table]),
            "images": files_hash(row.path for row in rows),
            "image_column": self.image_column,
            "target_columns": list(self.target_columns),
            "image_size": self.image_size,
        }

    def catalogue(self) -> Catalogue:
        """List labels and images in the order of the table.

        Raises:
            DataError: the folder, the table or an image is missing, or the table is broken.
        """
        rows = _rows(self)
        return Catalogue(
            kind=Kind.regression,
            names=self.target_columns,
            labels=np.array([[_number(text) for text in row.labels.values()] for row in rows], dtype=np.float64),
            image_size=self.image_size,
            pictures=tuple(partial(decode, row.path, self.image_size) for row in rows),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Row:
    """One row of the table, as it is written there."""

    #: As an editor counts, the header being line 1.
    line: int
    name: str
    path: Path
    #: The text of each target column, in their order.
    labels: dict[str, str]


def _rows(source: Table) -> list[_Row]:
    """Read and check the whole table."""
    rows = [_row(source, line, record) for line, record in _lines(source)]
    absent = [f"line {row.line} {row.name!r}" for row in rows if not row.path.is_file()]
    refuse(f"{source.table} names images that are not in {source.root}", absent, "Restore them or remove these lines.")
    first: dict[Path, int] = {}  # an image listed twice could stand in two parts of the split
    twice = [f"line {row.line} {row.name!r}" for row in rows if first.setdefault(row.path, row.line) != row.line]
    refuse(f"{source.table} lists images more than once", twice, "Keep one line per image.")
    wrong = [
        f"line {row.line} {column} = {text!r}"
        for row in rows
        for column, text in row.labels.items()
        if not math.isfinite(_number(text))
    ]
    refuse(f"{source.table} has labels that are not finite numbers", wrong, "Correct or remove these lines.")
    return rows


def _row(source: Table, line: int, record: dict[str, str]) -> _Row:
    """Pick what is needed from a record; an image lies below the root or else beside the table."""
    name = record[source.image_column].strip()
    below_root = source.root / name
    path = below_root if below_root.is_file() else (source.root / source.table).parent / name
    labels = {column: record[column] for column in source.target_columns}
    return _Row(line=line, name=name, path=path.resolve(), labels=labels)


def _lines(source: Table) -> Iterator[tuple[int, dict[str, str]]]:
    """Read the table's records with their line numbers; a short record has empty values."""
    path = source.root / source.table
    if not source.root.is_dir():
        raise DataError(f"data.root is no folder: {source.root}; give the folder that holds the recording")
    if not path.is_file():
        raise DataError(f"there is no table {source.table!r} in {source.root}; set data.table to its name")
    with path.open(newline="", encoding="utf-8-sig") as file:
        reader = csv.DictReader(file, restval="", skipinitialspace=True)
        try:
            columns = [name.strip() for name in reader.fieldnames or []]
            reader.fieldnames = columns
            absent = [repr(name) for name in (source.image_column, *source.target_columns) if name not in columns]
            refuse(f"{source.table} lacks columns", absent, f"It has {columns}.")
            for record in reader:
                yield reader.line_num, record
        except (csv.Error, UnicodeDecodeError) as error:
            raise DataError(f"{source.table} is no CSV table in UTF-8 ({error}); save it again as such") from error


def _number(text: str) -> float:
    """Read a number; what is none becomes NaN, which the caller reports with its line."""
    try:
        return float(text)
    except ValueError:
        return math.nan
