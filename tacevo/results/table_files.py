"""Where the table of a space lies in which a run looked its evaluations up: it is known by its digest, not its path."""

from collections.abc import Collection, Iterator
from pathlib import Path

from tacevo.config.conf_folder import conf_root
from tacevo.errors import DataError, TacevoError
from tacevo.results.space_table import read_table
from tacevo.results.table_header import is_table

#: Where tables lie below a working directory, or a checkout.
TABLES = Path("cache", "tables")


def find_table(recorded: Path, digest: str, beside: Path, named: Path | None = None, *, option: str = "") -> Path:
    """Find the table of a digest.

    Args:
        recorded: where the run had it; of a published run the file's name alone.
        digest: which the run recorded as the fingerprint of its data.
        beside: the directory of a run or a sweep, or the file of a bundle; tables lie beside it.
        named: the file that a user names; no other one is then looked at.
        option: how a user of this command can name it, such as `--table FILE`; empty where it cannot be named.

    Raises:
        DataError: there is none; the message names the file, its digest, and where it was looked for.
        BundleError: what is named is damaged, or is not a table.
    """
    if named is not None:
        if (got := read_table(named).digest) == digest:
            return named
        raise DataError(
            f"one of the digest {got[:12]}",
            place=f"--table {named}",
            expected=f"the table of the digest {digest[:12]}, in which the evaluations were looked up",
        )
    folder = next((parent for parent in Path(str(beside)).parents if parent.is_dir()), Path())
    folders = dict.fromkeys((folder, TABLES, conf_root().parent / TABLES))
    for path in _tables(recorded, folders):
        if _digest_of(path) == digest:
            return path
    looked = f"{recorded}, beside {beside} and in {TABLES}"
    raise DataError(
        f"none, where it was looked for: {looked}",
        place=f"the table {recorded.name}",
        expected=f"the table of the digest {digest}, in which the evaluations were looked up",
        remedy=f"put its file there, under any name that ends in .zip{f', or give {option}' if option else ''}",
    )


def _tables(recorded: Path, folders: Collection[Path]) -> Iterator[Path]:
    """List the files that may be the table, those of its name first."""
    yield from (path for path in (recorded, *(folder / recorded.name for folder in folders)) if path.is_file())
    for folder in folders:
        yield from (path for path in sorted(folder.glob("*.zip")) if path.is_file() and is_table(path))


def _digest_of(path: Path) -> str | None:
    """Return the digest of a table; None of a file that cannot be read as one, which is then not the one."""
    try:
        return read_table(path).digest
    except TacevoError:
        return None
