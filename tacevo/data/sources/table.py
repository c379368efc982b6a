"""Regression from a CSV table: one row per image, with columns of measured values."""

from dataclasses import dataclass
from pathlib import Path, PurePath

from tacevo.data.source import Catalogue, chosen
from tacevo.data.sources.groups import groups_in, numbered
from tacevo.data.sources.hints import check_directory, check_file
from tacevo.data.sources.images import DECODING, files_hash
from tacevo.data.sources.rows import Row, read_rows, row_catalogue
from tacevo.records import Json


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A directory with a CSV table; the first row holds the column names."""

    root: Path
    #: The table, relative to `root`, e.g. `labels.csv`.
    table: str
    #: The column with each image's path, relative to `root` or to the directory of the table.
    image_column: str
    #: The columns to regress, in the order of the outputs.
    target_columns: tuple[str, ...]
    #: Height and width that images are resized to, in pixels.
    image_size: int
    #: Leave out rows whose image is missing, instead of refusing the table.
    skip_missing: bool = False
    #: The stored value that becomes 255; None for the full range of the files.
    white_point: float | None = None
    #: What images of one press share: a column's value, or what an expression finds in an image's path; None: unknown.
    group_column: str | None = None
    group_pattern: str | None = None

    def describe(self) -> Json:
        """Name the content: the bytes of the table and of every image, not where they lie.

        Raises:
            DataError: the directory, the table or an image is missing, or the table is broken.
        """
        rows, _ = self._read()
        return {
            **chosen(self, "white_point", "group_column", "group_pattern"),
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
            DataError: the directory, the table or an image is missing, unreadable or of another size than the rest, or
                the table is broken.
        """
        rows, skipped = self._read()
        groups, chosen_by = None, None
        if self.group_column is not None:
            groups, chosen_by = numbered([row.group for row in rows]), "data.group_column"
        elif self.group_pattern is not None:
            names = [PurePath(row.name).as_posix() for row in rows]
            groups, chosen_by = groups_in(names, self.group_pattern), "data.group_pattern"
        return row_catalogue(
            rows,
            skipped,
            self.image_size,
            self.white_point,
            names=self.target_columns,
            names_chosen_by="data.target_columns",
            groups=groups,
            groups_chosen_by=chosen_by,
        )

    def _read(self) -> tuple[list[Row], int]:
        check_directory(self.root, "data.root", f"the directory of the table {self.table}")
        table = self.root / self.table
        check_file(table, "data.table", "a table in data.root")
        return read_rows(
            table,
            image_column=self.image_column,
            target_columns=self.target_columns,
            asked_by=("data.image_column", "data.target_columns"),
            remedy="set the names that are here, or rename a column",
            directories=(self.root, table.parent),
            skip_missing=self.skip_missing,
            group_column=self.group_column,
        )
