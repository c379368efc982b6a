"""Classification from a directory of directories: `<root>/<class>/**/*.png` (or any other of `names.SUFFIXES`).

Other levels of directories may name the sensor and the part of each image: by `sensor_column=1` and `split_column=2`
they lie in `<root>/<sensor>/<part>/<class>/**/*.png`. The class is the first level that names nothing else.

Files with other endings, and files beside the class directories, are not part of the data set; the catalogue lists
them.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tacevo.data.sensors import NONE_NAMED, PART_NAMES, Named, Sensors, taken
from tacevo.data.source import check_no_faults, listed, repeats
from tacevo.data.sources.filenames import SUFFIXES, check_directory, content, directories, folded
from tacevo.data.sources.image_files import (
    FileSource,
    check_links,
    groups_in,
    image_files,
    images_passed_over,
    other_files,
)
from tacevo.data.sources.table import number_in
from tacevo.errors import DataError
from tacevo.parts.making import Given
from tacevo.parts.source import Catalogue
from tacevo.records import Json, Kind


def from_settings(given: Given) -> "Folder":
    """Make the source of a directory of classes from the settings of `data`."""
    data = given.settings
    return Folder(
        root=Path(data["root"] or ""),
        image_size=data["image_size"],
        white_point=data["white_point"],
        group_pattern=data["group_pattern"],
        sensors=Sensors.from_settings(given),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Folder(FileSource):
    """One directory per class, named after it; classes are in the order of their numbers, or of their names."""

    #: The sensors and parts that are taken, where levels of directories name them, counted from 1.
    sensors: Sensors = NONE_NAMED

    def describe(self) -> Json:
        """Name the classes, the name of every image, and the bytes of those that are taken."""
        classes, images, names = self._read()
        rows, _ = self._taken(classes, names)
        return {
            **self.described(images[row] for row in rows),
            **self.sensors.described(),
            "source": "folder",
            "classes": {name: len(paths) for name, paths in classes.items()},
            "names": names,
        }

    def catalogue(self) -> Catalogue:
        """List labels and images, class by class, images in the order of their names."""
        classes, images, names = self._read()
        rows, fields = self._taken(classes, names)
        own = [names[row] for row in rows]
        return self.catalogue_of(
            [images[row] for row in rows],
            own,
            own,
            kind=Kind.classification,
            names=tuple(classes),
            labels=_labels(classes)[rows],
            ignored=other_files(self.root, "**/*", images),
            passed_over=images_passed_over(self.root, "**/*"),
            **fields,
        )

    def _read(self) -> tuple[dict[str, list[Path]], list[Path], list[str]]:
        """Find every class and its images; all images; and their paths relative to the root."""
        levels = [int(column) for column in self.sensors.columns]
        classes = _classes_below(self.root, levels) if levels else _classes(self.root)
        images = [path for paths in classes.values() for path in paths]
        return classes, images, [path.relative_to(self.root).as_posix() for path in images]

    def _taken(self, classes: dict[str, list[Path]], names: list[str]) -> tuple[list[int], dict[str, Any]]:
        """Take the images of the chosen sensors; also return groups and split of these, as the catalogue has them."""
        if not self.sensors.are_named:
            return list(range(len(names))), {}
        groups: dict[str, Any] = {}
        if self.group_pattern is not None:
            groups = {"groups": groups_in(names, self.group_pattern), "groups_chosen_by": "data.group_pattern"}
        folders = [name.split("/") for name in names]
        sensor, split = (
            None if level is None else [parts[int(level) - 1] for parts in folders]
            for level in (self.sensors.sensor_column, self.sensors.split_column)
        )
        return taken(self.sensors, Named(names, sensor, split, _labels(classes), **groups))


def _labels(classes: dict[str, list[Path]]) -> npt.NDArray[np.int64]:
    """Number the images class by class."""
    return np.repeat(np.arange(len(classes), dtype=np.int64), list(map(len, classes.values())))


def _classes_below(root: Path, levels: list[int]) -> dict[str, list[Path]]:
    """Find every class and its images where levels of directories name something else, too."""
    own = next(level for level in range(1, len(levels) + 2) if level not in levels)
    check_directory(root, "data.root", "the directory that has the directories of sensors, parts and classes")
    folders: list[tuple[str, ...]] = [()]
    for level in range(1, max(*levels, own) + 1):
        folders = [(*parts, name) for parts in folders for name in directories(root.joinpath(*parts))]
        if not folders:
            expected = f"{level} levels of directories, of which level {own} names the class"
            raise DataError(str(root), place="data.root", expected=expected, remedy=content(root))
    depth = max(*levels, own)
    above = [path.relative_to(root).as_posix() for path in image_files(root, "*/**/*")]
    check_no_faults(
        f"{root} has images above level {depth}, which no directory names all of",
        [name for name in above if name.count("/") < depth],
        "move them into such directories",
        place="data.root",
        expected=f"images below {depth} levels of directories, of which level {own} names the class",
    )
    names = sorted({parts[own - 1] for parts in folders})
    _check_parts(root, names)
    alike = repeats((name, _key(name)) for name in _ordered(names))
    check_no_faults(f"classes in {root} are there twice", alike, "join or rename them: 0.5 is 0.50, and Wood is wood")
    classes: dict[str, list[Path]] = {name: [] for name in _ordered(names)}
    for parts in folders:
        classes[parts[own - 1]] += _images(root.joinpath(*parts))
    empty = [name for name, paths in classes.items() if not paths]
    check_no_faults(f"{root}, where classes have no images", empty, "add images or remove these directories")
    return classes


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
    if not names or not {name.casefold() for name in names} <= PART_NAMES.keys():
        return
    raise DataError(
        f"{root}, which holds {listed(names)}: the parts of a split",
        place="data.root",
        expected="the directory that has one directory per class",
        remedy="take these parts by data.split_column=1, put the images of each class into one directory, whatever "
        "part they were in (tacevo splits them), or set data.root to a part that has one directory per class",
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
