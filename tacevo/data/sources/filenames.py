"""Names of files: which are passed over, which are one but for case, Unicode form or ending, which are missing."""

import difflib
import os
import unicodedata
from collections.abc import Sequence
from itertools import islice
from pathlib import Path, PurePath

from tacevo.data.source import listed
from tacevo.errors import DataError

#: Endings of the image files that are looked for in directories, in lower case.
SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff"})

#: Endings of images that a table may name.
_ENDINGS = SUFFIXES | {".bmp", ".gif", ".webp", ".pgm", ".ppm"}

#: The names of files that systems, network drives and programs leave beside a user's files, as hidden ones that are not
#: called so.
_LITTER = frozenset(
    {
        *("__macosx", "icon\r", "network trash folder", "temporary items", "thevolumesettingsfolder"),
        *("thumbs.db", "ehthumbs.db", "ehthumbs_vista.db", "desktop.ini", "system volume information"),
        *("$recycle.bin", "lost+found", "__pycache__", "ipod photo cache"),
        *("@eadir", "@synoresource", "@tmp", "@trash", "#recycle", "#snapshot"),
        *("@recycle", "@recently-snapshot", "@__thumb", "@sharebin", "~snapshot", "recycle bin"),
    }
)

#: Entries of a directory that are looked through for a name: a root may be a whole disk.
_MOST = 100_000


def is_passed_over(path: PurePath) -> bool:
    """Answer whether a relative path is hidden, or lies in what is.

    Editors and systems put copies, previews and stubs there, such as `.ipynb_checkpoints/1-checkpoint.png`, `._1.png`
    and all of `__MACOSX` and `@eaDir`.
    """
    return hidden_part(path) is not None


def hidden_part(path: PurePath) -> str | None:
    """Return the first part of a relative path for which it is passed over; None where it is not."""
    return next((part for part in path.parts if part.startswith(".") or part.casefold() in _LITTER), None)


def folded(name: str) -> str:
    """Return what names have in common that differ in case or in Unicode form alone."""
    return unicodedata.normalize("NFC", name.casefold())


def own_names(asked: Sequence[str], directories: Sequence[Path]) -> dict[str, str]:
    """Find the files that are probably meant by names that no file has.

    A name is a path relative to a directory. The directories are looked through with all below them, in order; a file
    of another case or Unicode form goes before one of another ending.

    Returns:
        For each name with such a file, the file's own name, quoted for a message.
    """
    alike: dict[str, str] = {}
    for directory in directories:
        files = (path for path in islice(directory.glob("**/*"), _MOST) if path.is_file())
        for file in sorted(path.relative_to(directory) for path in files):
            if not is_passed_over(file):
                alike.setdefault(folded(file.as_posix()), file.as_posix())
                alike.setdefault(folded(_without_ending(file)), file.as_posix())
    meant = {}
    for name in asked:
        path = PurePath(name)
        own = alike.get(folded(path.as_posix())) or alike.get(folded(_without_ending(path)))
        if own is not None:
            meant[name] = f"{own!r}{unseen_difference(name, own)}"
    return meant


def unseen_difference(asked: str, own: str) -> str:
    """Return what a reader cannot see of two names: that they are of two Unicode forms; else nothing."""
    is_unseen = folded(asked) == folded(own) and asked.casefold() != own.casefold()
    return ", in another Unicode form" if is_unseen else ""


def _without_ending(path: PurePath) -> str:
    """Return a path without the ending of an image; a dot in another name, as in `press_0.5`, begins no ending."""
    is_image = path.suffix.lower() in _ENDINGS
    return (path.with_suffix("") if is_image else path).as_posix()


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
