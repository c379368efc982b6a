"""Names of image files: which are passed over, and which are one name but for case, Unicode form or ending."""

import unicodedata
from collections.abc import Sequence
from itertools import islice
from pathlib import Path, PurePath

#: Endings of the image files that are looked for in directories, in lower case.
SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff"})

#: Endings of images that a table may name; a dot in another name, as in `press_0.5`, begins no ending.
_ENDINGS = SUFFIXES | {".bmp", ".gif", ".webp", ".pgm", ".ppm"}

#: What systems leave beside a user's files, as hidden files that are not called so.
_LITTER = frozenset({"__macosx", "thumbs.db", "desktop.ini"})

#: Entries of a directory that are looked through for a name: a root may be a whole disk.
_MOST = 100_000


def is_passed_over(path: PurePath) -> bool:
    """Answer whether a relative path is hidden, or lies in what is.

    Editors and systems put copies and stubs there, such as `.ipynb_checkpoints/1-checkpoint.png`, `._1.png` and all of
    `__MACOSX`.
    """
    return any(part.startswith(".") or part.casefold() in _LITTER for part in path.parts)


def folded(name: str) -> str:
    """Return what names have in common that differ in case or in Unicode form alone."""
    return unicodedata.normalize("NFC", name.casefold())


def own_names(asked: Sequence[str], directories: Sequence[Path]) -> dict[str, str]:
    """Find the files that are probably meant by names that no file has.

    A name is a path relative to a directory. The directories are looked through with all below them, in order; a file
    of another case or Unicode form goes before one of another ending.

    Returns:
        For each name with such a file, the file's own name and in what it differs, for a message.
    """
    alike: dict[str, str] = {}
    for directory in directories:
        found = islice(directory.glob("**/*"), _MOST)
        files = sorted(path.relative_to(directory) for path in found if path.is_file())
        for file in files:
            if not is_passed_over(file):
                alike.setdefault(folded(file.as_posix()), file.as_posix())
                alike.setdefault(folded(_parted(file.as_posix())[0]), file.as_posix())
    meant = {}
    for name in asked:
        plain = PurePath(name).as_posix()
        own = alike.get(folded(plain)) or alike.get(folded(_parted(plain)[0]))
        if own is not None:
            meant[name] = f"{own!r}, {difference(plain, own)}"
    return meant


def difference(asked: str, own: str) -> str:
    """Return in what the name of a file differs from the one that was asked for, which is alike."""
    (stem, ending), (own_stem, own_ending) = _parted(asked), _parted(own)
    found = []
    if ending.lower() != own_ending.lower():
        found.append("with another ending")
        ending = own_ending
    composed = [unicodedata.normalize("NFC", text) for text in (stem + ending, own_stem + own_ending)]
    if composed[0] != composed[1]:
        found.append("in another case")
    if _form(stem) != _form(own_stem):
        found.append(f"in Unicode form {_form(own_stem)}, not {_form(stem)}")
    return " and ".join(found)


def _parted(name: str) -> tuple[str, str]:
    """Part a name into what stands before its ending, and the ending, which may be empty."""
    suffix = PurePath(name).suffix
    return (name.removesuffix(suffix), suffix) if suffix.lower() in _ENDINGS else (name, "")


def _form(name: str) -> str:
    """Return the Unicode form that a name is in."""
    return next((form for form in ("NFC", "NFD") if unicodedata.is_normalized(form, name)), "of its own")
