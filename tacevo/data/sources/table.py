"""Regression from a CSV table: one row per image, with columns of measured values."""

from dataclasses import dataclass
from pathlib import Path

from tacevo.data.source import Catalogue
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

    def describe(self) -> Json:
        """Name the content: the bytes of the table and of every image, not where they lie.

        Raises:
            DataError: the directory, the table or an image is missing, or the table is broken.
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
            DataError: the directory, the table or an image is missing, unreadable or of another size than the rest, or
                the table is broken.
        """
        rows, skipped = self._read()
        return row_catalogue(
            rows, skipped, self.image_size, names=self.target_columns, names_chosen_by="data.target_columns"
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
        )
