"""Regression from a CSV table: one row per image, with columns of measured values; every fault is named by its line."""

import math
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any, NamedTuple

import numpy as np

from tacevo.data.sensors import NONE_NAMED, Named, Sensors, taken
from tacevo.data.source import check_no_faults, chosen, listed, repeats, shortened
from tacevo.data.sources.csv_lines import Lines, in_words
from tacevo.data.sources.filenames import check_directory, check_file, folded, own_names
from tacevo.data.sources.image_files import FileSource, files_hash, groups_in, image_files, numbered
from tacevo.errors import DataError
from tacevo.parts.making import Given
from tacevo.parts.source import Catalogue
from tacevo.records import Json, Kind

_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", flags=re.ASCII)


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One row of a table, as it is written there."""

    #: The number of the line as an editor counts, the header being line 1.
    line: int
    name: str
    #: The image, links followed; `is_there` says whether it exists.
    path: Path
    #: The directory that the image was found in, as it is written: not where a link leads.
    directory: Path
    is_there: bool
    #: Whether the name leads out of every directory that it may be relative to, by `..` or as an absolute path.
    is_outside: bool
    #: The text of each target column, in their order.
    texts: tuple[str, ...]
    #: The texts of further columns: what names the group, the sensor and the part, as far as something does.
    named: tuple[str, ...] = ()

    @property
    def place(self) -> str:
        """The name of this row in messages."""
        return f"line {self.line} {shortened(self.name)}"

    @property
    def labels(self) -> tuple[float, ...]:
        """The values of the target columns, which `read_rows` has checked."""
        return tuple(map(float, self.texts))


class ReadTable(NamedTuple):
    """A table that was read and checked."""

    #: The rows in the table's order; the image of each exists and every label is finite.
    rows: list[Row]
    #: The number of rows that were left out, because their image is missing.
    skipped: int
    #: The lines that have separators and no value, as spreadsheets write them at the end.
    blank: list[int]


def from_settings(given: Given) -> "TableSource":
    """Make the source of a directory with a CSV table from the settings of `data`."""
    data = given.settings
    return TableSource(
        root=Path(data["root"] or ""),
        table=data["table"],
        image_column=data["image_column"],
        target_columns=tuple(data["target_columns"]),
        image_size=data["image_size"],
        skip_missing=data["skip_missing"],
        white_point=data["white_point"],
        group_column=data["group_column"],
        group_pattern=data["group_pattern"],
        sensors=Sensors.from_settings(given),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class TableSource(FileSource):
    """A directory with a CSV table; the first row holds the column names."""

    #: The table, relative to `root`, e.g. `labels.csv`.
    table: str
    #: The column with each image's path, relative to `root` or to the directory of the table.
    image_column: str
    #: The columns to regress, in the order of the outputs.
    target_columns: tuple[str, ...]
    #: Leave out rows whose image is missing, instead of refusing the table.
    skip_missing: bool = False
    #: The column whose value images of one press share; it goes before `group_pattern`.
    group_column: str | None = None
    #: The sensors and parts that are taken, where columns name them.
    sensors: Sensors = NONE_NAMED

    def describe(self) -> Json:
        """Name the bytes of the table and of every image that is taken."""
        rows = self._read().rows
        own, _ = self._taken(rows)
        return {
            **self.described(row.path for row in own),
            **chosen(self, "group_column"),
            **self.sensors.described(),
            "source": "table",
            "table": files_hash([self.root / self.table]),
            "lines": [row.line for row in rows],
            "image_column": self.image_column,
            "target_columns": list(self.target_columns),
        }

    def catalogue(self) -> Catalogue:
        """List labels and images in the order of the table."""
        read, skipped, blank = self._read()
        rows, fields = self._taken(read)
        return self.catalogue_of(
            [row.path for row in rows],
            [row.place for row in rows],
            [PurePath(row.name).as_posix() for row in rows],
            kind=Kind.regression,
            names=self.target_columns,
            labels=np.array([row.labels for row in rows], dtype=np.float64),
            skipped=skipped,
            blank=blank,
            ignored=unnamed_images(read),
            **fields,
        )

    def _taken(self, rows: Sequence[Row]) -> tuple[list[Row], dict[str, Any]]:
        """Take the rows of the chosen sensors; also return groups and split of these, as the catalogue has them."""
        columns = {name: [row.named[number] for row in rows] for number, name in enumerate(self._naming)}
        groups = self._groups(rows, columns.get("group_column"))
        if not self.sensors.are_named:
            return list(rows), groups
        places = [row.place for row in rows]
        named = Named(places, columns.get("sensor_column"), columns.get("split_column"), **groups)
        numbers, fields = taken(self.sensors, named)
        return [rows[number] for number in numbers], fields

    def _groups(self, rows: Sequence[Row], values: Sequence[str] | None) -> dict[str, Any]:
        """Return which images were recorded together, where a column or their paths say so."""
        if values is not None:
            return {"groups": numbered(values), "groups_chosen_by": "data.group_column"}
        if self.group_pattern is None:
            return {}
        paths = [PurePath(row.name).as_posix() for row in rows]
        return {"groups": groups_in(paths, self.group_pattern), "groups_chosen_by": "data.group_pattern"}

    @property
    def _naming(self) -> dict[str, str]:
        """The columns that name the group, the sensor and the part of an image, by their settings."""
        settings = {
            "group_column": self.group_column,
            "sensor_column": self.sensors.sensor_column,
            "split_column": self.sensors.split_column,
        }
        return {setting: column for setting, column in settings.items() if column is not None}

    def _read(self) -> ReadTable:
        check_directory(self.root, "data.root", f"the directory of the table {self.table}")
        table = self.root / self.table
        check_file(table, "data.table", "a table in the directory data.root")
        named = self._naming
        settings = listed(f"data.{name}" for name in ["image_column", *(named or ["group_column"])])
        return read_rows(
            table,
            image_column=self.image_column,
            target_columns=self.target_columns,
            remedy=f"set {settings} or data.target_columns to the names that are here",
            directories=(self.root, table.parent),
            skip_missing=self.skip_missing,
            naming=tuple(named.values()),
        )


def unnamed_images(rows: Sequence[Row]) -> list[Path]:
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
    remedy: str,
    directories: Sequence[Path],
    skip_missing: bool,
    naming: Sequence[str] = (),
) -> ReadTable:
    """Read and check a whole table.

    It is a CSV table in UTF-8 with a header. Outer spaces of column names do not matter, nor does their case where no
    column has exactly the asked name. The image column holds each image's path, relative to one of the directories,
    which are looked through in order; it does not lead out of these. Further columns (`naming`) hold what names the
    group, the sensor or the part of each image, and no row lacks it. `remedy` says what the user can do where a column
    is absent. With `skip_missing`, rows without their image are left out.

    A first line `sep=;`, by which spreadsheets name what stands between columns, is obeyed. Numbers may then have a
    decimal comma, if no label of the table has a point.

    Raises:
        DataError: the table cannot be used, or a row is faulty: all rows with the same fault are named at once.
    """
    asked = [image_column, *target_columns, *naming]
    lines = Lines(table)
    rows = _rows(table, asked, remedy, lines=lines, directories=directories, targets=len(target_columns))
    if not rows:
        raise DataError("a header without rows", place=table.name, expected="a row for each image")
    present = [row for row in rows if row.is_there]
    if not (present and skip_missing):
        _check_images_exist(table, rows, directories, skippable=bool(present))
    check_no_faults(
        f"{table.name} names images outside {directories[0]}",
        [row.place for row in present if row.is_outside],
        f"set data.root to a directory that holds all images (data.table may be below it), or copy them into "
        f"{directories[0]}, or put a link to them there",
    )
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
    for number, column in enumerate(naming):
        empty = [row.place for row in present if not row.named[number]]
        remedy = "write there what names the group, the sensor or the part of the image"
        check_no_faults(f"{table.name} has rows without a value in {column}", empty, remedy)
    return ReadTable(present, len(rows) - len(present), lines.blank)


def _check_images_exist(table: Path, rows: Sequence[Row], directories: Sequence[Path], *, skippable: bool) -> None:
    """Check that the image of each row exists."""
    missing = [row for row in rows if not row.is_there]
    own = own_names([row.name for row in missing], directories)
    faults = [f"{row.place} (there is {own[row.name]})" if row.name in own else row.place for row in missing]
    choice = ", or leave them out with data.skip_missing=true" if skippable else ""
    remedy = f"write names as they are on disk, with / and not \\, restore images, or remove these lines{choice}"
    check_no_faults(f"{table.name} names images that are not in {directories[0]}", faults, remedy)


def _rows(
    table: Path, asked: Sequence[str], remedy: str, *, lines: Lines, directories: Sequence[Path], targets: int
) -> list[Row]:
    """Read the rows of a table, with the asked columns only: the image's, so many targets, and perhaps others."""
    _, header = next(lines.values, (1, []))
    numbers = _columns(table, header, asked, remedy, lines.separator)
    picked, long = [], []
    for line, values in lines.values:
        if len(values) > len(header):  # a decimal comma would shift every label behind it
            long.append(f"line {line}")
        else:
            picked.append((line, [values[number] if number < len(values) else "" for number in numbers]))
    problem = f"{table.name} has lines with more values than its {len(header)} columns"
    check_no_faults(problem, long, "quote or correct them")
    has_commas = lines.separator != "," and not any(
        "." in text for _, texts in picked for text in texts[1 : targets + 1]
    )
    return [_row(line, texts, directories, targets, has_commas=has_commas) for line, texts in picked]


def _row(line: int, texts: Sequence[str], directories: Sequence[Path], targets: int, *, has_commas: bool) -> Row:
    """Find the image of a row; one within the directories goes before one that its name leads to elsewhere."""
    name, labels = texts[0].strip(), texts[1 : targets + 1]
    paths = [directory / name for directory in directories]
    there = [path for path in paths if os.path.isfile(path)]
    inside = [path for path in there if _stays(path, name, directories)]
    path = next(iter(inside or there), None)
    return Row(
        line=line,
        name=name,
        path=paths[0] if path is None else path.resolve(),
        directory=(path or paths[0]).parent,
        is_there=path is not None,
        is_outside=bool(there) and not inside,
        texts=tuple(_pointed(text) if has_commas else text for text in labels),
        named=tuple(text.strip() for text in texts[targets + 1 :]),
    )


def _stays(path: Path, name: str, directories: Sequence[Path]) -> bool:
    """Answer whether a name stays within the directories; links count only where the name itself turns back."""
    written, parts = PurePath(name), path.absolute().parts
    if not written.is_absolute() and ".." not in written.parts:
        return True
    behind = next((number for number in range(len(parts), 0, -1) if parts[number - 1] == ".."), 0)
    reached = Path(os.path.realpath(Path(*parts[:behind])) if behind else "/", *parts[behind:])
    return any(reached.is_relative_to(root) for one in directories for root in (os.path.realpath(one), one.absolute()))


def _pointed(text: str) -> str:
    """Write a number with a decimal comma as one with a point."""
    return text.replace(",", ".") if text.count(",") == 1 else text


def _columns(table: Path, header: Sequence[str], asked: Sequence[str], remedy: str, separator: str) -> list[int]:
    """Find the position of each asked column."""
    columns = [name.strip() for name in header]
    if not columns:
        raise DataError("nothing", place=table.name, expected="a first line that names the columns")
    twice = sorted({shortened(name) for name in columns if name and columns.count(name) > 1})
    check_no_faults(f"{table.name} has several columns of one name", twice, "rename all but one")
    caseless = [name.casefold() for name in columns]
    exact = {name: columns.index(name) for name in asked if name in columns}
    loose = {name: caseless.index(name.casefold()) for name in asked if caseless.count(name.casefold()) == 1}
    position = {**loose, **exact}
    absent = [repr(name) for name in asked if name not in position]
    if absent:
        raise DataError(
            listed(list(map(shortened, columns))),
            place=f"the columns of {table.name}",
            expected=listed(absent),
            remedy=f"{remedy}; the first line names the columns, with {in_words(columns, separator)}",
        )
    return [position[name] for name in asked]


def number_in(text: str) -> float | None:
    """Read a finite number such as `12`, `-.5` or `1.5e-3`, outer spaces aside.

    `float` also takes `1_000`, digits of other scripts, `nan` and `infinity`: what a slip or another program's mark for
    a missing value looks like.

    Returns:
        The number; None for anything else, and for a number beyond the range of a float.
    """
    number = float(text) if _NUMBER.fullmatch(text.strip()) else math.nan
    return number if math.isfinite(number) else None
