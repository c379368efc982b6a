"""Tables as files, each written whole, and the removal of what is outdated."""

import re
from collections.abc import Collection, Iterable
from pathlib import Path

from analysis.table import Table
from analysis.tables.rendering import table_texts
from tacevo.results.study_directory import NAME
from tacevo.storage.files import write_durably


def write_tables(tables: Iterable[Table], directory: Path, *, prefix: str = "") -> None:
    """Write tables in every format, each file whole; older ones of the same names are replaced.

    The prefix is that of their labels in LaTeX.

    Raises:
        StoreError: a file cannot be written.
    """
    for table in tables:
        for name, text in table_texts(table, prefix=prefix).items():
            write_durably(directory / name, text)


def remove_outdated(directory: Path, names: Collection[str], *, task: str, endings: Collection[str]) -> list[str]:
    """Remove what an earlier command wrote there of studies that are missing or rejected now.

    Args:
        directory: of tables or of figures.
        names: of those that are current; other files than those of a study of this task are left alone.
        task: the run's.
        endings: of the files that the command writes.

    Returns:
        A remark on each removed file.
    """
    pattern = re.compile(rf".+_{re.escape(task)}_{NAME}")
    found = [path for path in sorted(directory.iterdir()) if path.suffix in endings and pattern.fullmatch(path.stem)]
    gone = [path for path in found if path.stem not in names]
    for path in gone:
        path.unlink()
    return [f"removed {path.name}: its study is missing or left out" for path in gone]
