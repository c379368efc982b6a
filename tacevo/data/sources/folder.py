"""Classification from a directory of directories: `<root>/<class>/**/*.png` (or any other of `names.SUFFIXES`).

Files with other endings, and files beside the class directories, are not part of the data set; the catalogue lists
them.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tacevo.data.source import Catalogue, check_no_faults, listed, repeats
from tacevo.data.sources.filenames import SUFFIXES, check_directory, content, directories, folded
from tacevo.data.sources.image_files import FileSource, check_links, image_files, images_passed_over, other_files
from tacevo.data.sources.table import number_in
from tacevo.errors import DataError
from tacevo.records import Json, Kind

#: What the parts of a split are called, in lower case: a root whose directories are these holds no classes.
_PARTS = frozenset({"train", "training", "val", "valid", "validation", "test", "testing"})


@dataclass(frozen=True, slots=True, kw_only=True)
class Folder(FileSource):
    """One directory per class, named after it; classes are in the order of their numbers, or of their names."""

    def describe(self) -> Json:
        """Name the classes, and the name and bytes of every image."""
        classes, images, names = self._read()
        return {
            **self.described(images),
            "source": "folder",
            "classes": {name: len(paths) for name, paths in classes.items()},
            "names": names,
        }

    def catalogue(self) -> Catalogue:
        """List labels and images, class by class, images in the order of their names."""
        classes, images, names = self._read()
        return self.catalogue_of(
            images,
            names,
            names,
            kind=Kind.classification,
            names=tuple(classes),
            labels=np.repeat(np.arange(len(classes), dtype=np.int64), list(map(len, classes.values()))),
            ignored=other_files(self.root, "**/*", images),
            passed_over=images_passed_over(self.root, "**/*"),
        )

    def _read(self) -> tuple[dict[str, list[Path]], list[Path], list[str]]:
        """Find every class and its images; all images; and their paths relative to the root."""
        classes = _classes(self.root)
        images = [path for paths in classes.values() for path in paths]
        return classes, images, [path.relative_to(self.root).as_posix() for path in images]


def _classes(root: Path) -> dict[str, list[Path]]:
    """Find every class and its images."""
    expected = "the directory that has one directory per class"
    check_directory(root, "data.root", expected)
    names = directories(root)
    if not names:
        raise DataError(str(root), place="data.root", expected=expected, remedy=content(root))
    alike = repeats((name, _key(name)) for name in _ordered(names))
    check_no_faults(f"classes in {root} are there twice", alike, "join or rename them: 0.5 is 0.50, and Wood is wood")
    classes = {name: _images(root / name) for name in _ordered(names)}
    _check_parts(root, [name for name, paths in classes.items() if paths])
    empty = [name for name, paths in classes.items() if not paths]
    check_no_faults(
        f"{root}, where directories have no images",
        empty,
        f"add {listed(sorted(SUFFIXES))} files or remove these directories",
        place="data.root",
        expected=f"{expected}, and images in each",
    )
    return classes


def _check_parts(root: Path, names: list[str]) -> None:
    """Refuse the parts of somebody's split where the classes should be: each part has all classes within."""
    if not names or not {name.casefold() for name in names} <= _PARTS:
        return
    raise DataError(
        f"{root}, which holds {listed(names)}: the parts of a split",
        place="data.root",
        expected="the directory that has one directory per class",
        remedy="put the images of each class into one directory, whatever part they were in (tacevo splits them), "
        "or set data.root to a part that has one directory per class",
    )


def _ordered(names: list[str]) -> list[str]:
    """Sort class names, as numbers where all are numbers, so that 2 comes before 10."""
    keys = {name: _key(name) for name in names}
    if all(isinstance(key, float) for key in keys.values()):
        return sorted(names, key=lambda name: (keys[name], name))
    return sorted(names)


def _key(name: str) -> float | str:
    """Return what two names of one class have in common: a finite number, or the text without case and Unicode form."""
    number = number_in(name)
    return folded(name) if number is None else number


def _images(directory: Path) -> list[Path]:
    """Find the images below a class directory, sorted by path."""
    check_links(directory, "**/*")
    paths = image_files(directory, "**/*")
    names = [path.relative_to(directory).as_posix() for path in paths]
    twice = repeats((name, folded(name)) for name in names)
    problem = f"images of class {directory.name} differ in the case or Unicode form of their names only"
    check_no_faults(problem, twice, "rename or remove them")
    return paths
