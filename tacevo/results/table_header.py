"""The file that tells a table of a space from a bundle."""

from pathlib import Path

from tacevo.storage.zipfiles import names_in

#: The file in which a table describes itself.
HEADER = "table.json"


def is_table(path: Path) -> bool:
    """Answer whether a file is a zip file with the header of a table; it is not verified."""
    return HEADER in (names_in(path) or ())
