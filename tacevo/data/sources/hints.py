"""Errors about files that are not where a setting says: what is there instead, and the nearest name."""

import difflib
import math
import os
import re
from pathlib import Path

from tacevo.data.source import listed
from tacevo.data.sources.filenames import folded, is_passed_over, unseen_difference
from tacevo.errors import DataError


def check_directory(path: Path, place: str, expected: str) -> None:
    """Refuse a path that is not a directory; the place is the setting that names it, e.g. `data.root`.

    Raises:
        DataError: the path is absent, or a file; the remedy says what is there.
    """
    if not os.path.isdir(path):  # False where the user may not look
        raise _misplaced(path, place, expected)


def check_file(path: Path, place: str, expected: str) -> None:
    """Refuse a path that is not a file; arguments and errors are those of `check_directory`."""
    if not os.path.isfile(path):
        raise _misplaced(path, place, expected)


def content(directory: Path, name: str = "") -> str:
    """Return what a directory holds, and which entry a name probably means."""
    try:
        names = directories(directory) + [path.name for path in _visible(directory) if not path.is_dir()]
    except OSError as error:
        return f"{directory} cannot be listed ({error.strerror})"
    candidates = {folded(candidate): candidate for candidate in names}
    close = difflib.get_close_matches(folded(name), candidates, n=1)
    holds = f"{directory} holds: {listed(names) or 'nothing'}"
    if not close:
        return holds
    own = candidates[close[0]]
    return f"{holds}; did you mean {directory / own}{unseen_difference(name, own)}?"


def directories(directory: Path) -> list[str]:
    """List the directories in a directory by name; hidden ones are left out."""
    return [path.name for path in _visible(directory) if path.is_dir()]


def _visible(directory: Path) -> list[Path]:
    return sorted(path for path in directory.iterdir() if not is_passed_over(Path(path.name)))


def _misplaced(path: Path, place: str, expected: str) -> DataError:
    there, name = path.absolute(), ""
    while not os.path.isdir(there):
        there, name = there.parent, there.name
    return DataError(str(path), place=place, expected=expected, remedy=content(there, name))


_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", flags=re.ASCII)


def number_in(text: str) -> float | None:
    """Read a finite number such as `12`, `-.5` or `1.5e-3`, outer spaces aside.

    `float` also takes `1_000`, digits of other scripts, `nan` and `infinity`: what a slip or another program's mark for
    a missing value looks like.

    Returns:
        The number; None for anything else, and for a number beyond the range of a float.
    """
    number = float(text) if _NUMBER.fullmatch(text.strip()) else math.nan
    return number if math.isfinite(number) else None
