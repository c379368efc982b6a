"""Where a data set is not: what was looked for, what lies there instead, and what was probably meant."""

import difflib
import math
import os
import re
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from tacevo.data.source import listed
from tacevo.errors import DataError


def require_folder(root: Path, expected: str) -> None:
    """Refuse a `data.root` that is no folder.

    Args:
        root: the setting.
        expected: what the folder should hold, e.g. `the table labels.csv`.

    Raises:
        DataError: it is absent, or a file; the message says what lies beside it.
    """
    if root.is_dir():
        return
    found = f"It is a file in {root.parent}" if root.exists() else _instead(root)
    raise DataError(f"data.root is no folder: {root}; give the folder that holds {expected}. {found}")


def require_file(root: Path, suffix: str) -> None:
    """Refuse a `data.root` that is no file.

    Args:
        root: the setting.
        suffix: the ending of such files, e.g. `.npz`.

    Raises:
        DataError: it is absent, or a folder; the message says which such files are there.
    """
    if root.is_file():
        return
    if root.is_dir():
        found = glimpsed(root, suffix=suffix)
        there = f"{listed(found)}; set data.root={root / found[0]}" if found else "none that can be seen"
        raise DataError(f"data.root is a folder, not a {suffix} archive: {root}; it holds {there}")
    raise DataError(f"data.root is no file: {root}; give the {suffix} archive. {_instead(root)}")


def entries(folder: Path, *, suffix: str | None = None) -> list[str]:
    """List the folders in a folder, or its files of one ending, by name; hidden ones are left out."""
    found = (path for path in folder.iterdir() if not path.name.startswith("."))
    if suffix is None:
        return sorted(path.name for path in found if path.is_dir())
    return sorted(path.name for path in found if path.suffix.lower() == suffix and path.is_file())


def glimpsed(folder: Path, *, suffix: str | None = None) -> list[str]:
    """List `entries` for a hint: none where the folder may not be listed, so that the user reads the fault itself."""
    with suppress(OSError):
        return entries(folder, suffix=suffix)
    return []


def folders_in(folder: Path) -> str:
    """Name the folders in a folder for a message, the first few."""
    try:
        names = entries(folder)
    except OSError as error:
        return f"what cannot be listed ({error.strerror})"
    return listed(names) if names else "no folders"


def nearest(name: str, names: Sequence[str]) -> str | None:
    """Find the name that was probably meant; None where none is similar."""
    folded = {candidate.casefold(): candidate for candidate in names}
    found = difflib.get_close_matches(name.casefold(), folded, n=1)
    return folded[found[0]] if found else None


def holder(folder: Path, name: str) -> Path | None:
    """Find what holds a file or folder of a name: the folder above, or one just below; None where none does."""
    places = [folder.parent, *(folder / child for child in glimpsed(folder))]
    return next((place for place in places if os.path.exists(place / name)), None)  # False where it may not look


def _instead(path: Path) -> str:
    """Tell how far a path that does not exist leads, and what was probably meant."""
    if str(path).startswith("~"):
        return "Write your home folder in full: behind = the shell leaves ~ as it is"
    missing, there = path.absolute(), path.absolute().parent
    while not there.is_dir():
        missing, there = there, there.parent
    try:
        names = sorted(child.name for child in there.iterdir() if not child.name.startswith("."))
    except OSError as error:
        return f"{there} is there, but has no {missing.name}; what it holds cannot be listed ({error.strerror})"
    meant = nearest(missing.name, names)
    guess = "" if meant is None else f"; did you mean {there / meant}?"
    return f"{there} is there, but has no {missing.name}; it holds {listed(names) if names else 'nothing'}{guess}"


_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", flags=re.ASCII)


def number_in(text: str) -> float | None:
    """Read a finite number such as `12`, `-.5` or `1.5e-3`, outer spaces aside.

    `float` also takes `1_000`, digits of other scripts, `nan` and `infinity`: what a slip or another program's mark for
    a missing value looks like.

    Returns:
        The number; None for anything else, and for one beyond the range of a float.
    """
    number = float(text) if _NUMBER.fullmatch(text.strip()) else math.nan
    return number if math.isfinite(number) else None
