"""The TacVerse release as its authors lay it out on disk.

    <root>/Force_Regression/<Sensor>/<Sensor>.csv             columns image_name, fx, fy, fz; images beside it
    <root>/Grating_Classification/<Sensor>/<Pattern>/<size>_<group>_<frame>.jpg   or <size>_<group>.jpg
    <root>/Shape_Classification/<Sensor>/<shape>/<...number>.jpg
    <root>/Hardness_Regression/<Sensor>/<Sensor>.csv          columns image_name, shore: an old export of ours

Sizes are in mm; a group is one press. The release's own split (arXiv:2606.25877 and its code) takes 60 % for training
and 20 % for validation: of the force images of a sensor in the order of their numbers, of each shape's images
likewise, and of each size's presses in the order of theirs, so that 25 presses give 1-15, 16-20 and 21-25. Its
protocols are made of these parts: `within` a sensor; `cross`, where another sensor is tested; `leave one sensor out`,
where all but the tested one train; and `few-shot`, where some training images of the tested one are added.
"""

import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from tacevo.choices import GratingClasses, RecordedTask
from tacevo.data.source import check_no_faults, listed, repeats
from tacevo.data.sources.filenames import SUFFIXES, check_directory, check_file, content, directories
from tacevo.data.sources.image_files import FileSource, check_links, image_files, other_files
from tacevo.data.sources.table import Row, read_rows, unnamed_images
from tacevo.data.splitting import PARTS, ordered_split
from tacevo.errors import DataError
from tacevo.parts.making import Given, task_among
from tacevo.parts.source import Catalogue, Split
from tacevo.randomness import stream
from tacevo.records import Json, Kind
from tacevo.storage.canonical import canonical

DIRECTORIES = {
    RecordedTask.force: "Force_Regression",
    RecordedTask.grating: "Grating_Classification",
    RecordedTask.hardness: "Hardness_Regression",
    RecordedTask.shape: "Shape_Classification",
}

IMAGE_COLUMN = "image_name"

#: Columns of the labels and the names of the outputs, in the same order.
COLUMNS = {RecordedTask.force: ("fx", "fy", "fz"), RecordedTask.hardness: ("shore",)}

OUTPUTS = {"force": ("Fx", "Fy", "Fz"), "hardness": ("shore",)}

#: Joins the names of several sensors or patterns.
AND = "+"


class _Image(NamedTuple):
    """One image; images are in the order of these fields."""

    sensor: str
    #: Gratings: the directory of the specimens.
    pattern: str
    #: The class within a directory that is split by itself: a size in mm or a shape; empty for values.
    kind: float | str
    #: Gratings: the number of the press. Else the image's place in the order of its number.
    press: int
    frame: int
    path: Path
    place: str
    #: Values, in the order of the outputs.
    values: tuple[float, ...] = ()
    #: The path below the directory of the task, as it is written.
    name: str = ""


class _Listing(NamedTuple):
    """The images that directories hold, as they were found."""

    images: list[_Image]
    #: Files that are not used.
    ignored: list[Path]
    #: The number of rows of tables that were left out, and the lines of tables that hold no value.
    skipped: int = 0
    blank: tuple[int, ...] = ()


def from_settings(given: Given) -> "TacVerse":
    """Make the source of the release from the settings of `data`.

    Raises:
        ConfigError: it does not have the task.
    """
    data = given.settings
    return TacVerse(
        root=Path(data["root"] or ""),
        task=task_among(RecordedTask, given),
        sensor=data["sensor"],
        pattern=data["pattern"],
        image_size=data["image_size"],
        skip_missing=data["skip_missing"],
        white_point=data["white_point"],
        group_pattern=data["group_pattern"],
        spacings_mm=tuple(data["spacings_mm"]) if data["select"] else (),
        images=data["images"] if data["select"] else None,
        classes=data["classes"],
        test_sensor=data["test_sensor"],
        shots=data["shots"],
        seed=data["split_seed"],
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class TacVerse(FileSource):
    """One task of the release, of one or several sensors."""

    task: RecordedTask
    #: The directory of the sensor, e.g. `ViTacTip`; several are joined by `+`.
    sensor: str
    #: Gratings: the directory of the specimens, e.g. `Blackdot`; several are joined by `+`.
    pattern: str | None
    #: Tables: leave out rows whose image is missing, as the release's own code does, instead of refusing the table.
    skip_missing: bool = False
    #: Gratings: the sizes that are taken, in mm; () for all that every directory has.
    spacings_mm: tuple[float, ...] = ()
    #: The most images that are taken: of each class alike, at even steps of their order; None for all. They are counted
    #: after `test_sensor` has left parts out, and before `shots`, which come on top.
    images: int | None = None
    #: Gratings: what the classes are.
    classes: GratingClasses = GratingClasses.size
    #: The sensor that is tested, which then does not train; with the release's split only.
    test_sensor: str | None = None
    #: The amount of the tested sensor's training part that trains, too: presses of each grating, images of each shape,
    #: or images with forces, drawn by `seed`.
    shots: int = 0
    seed: int = 0

    @property
    def selected(self) -> tuple[str, ...]:
        """The settings that select images, or what they are for, as a user writes them; none where all is taken."""
        settings: dict[str, Json] = {
            "spacings_mm": list(self.spacings_mm),
            "images": self.images,
            "classes": None if self.classes is GratingClasses.size else self.classes.value,
            "test_sensor": self.test_sensor,
            "shots": self.shots,
        }
        return tuple(
            f"data.{name}={value if isinstance(value, str) else canonical(value)}"
            for name, value in settings.items()
            if value
        )

    def describe(self) -> Json:
        """Name the labels, and the bytes of every image."""
        images, release = self._taken(self._listing().images)
        described = {**self.described(image.path for image in images), "source": "tacverse", "task": self.task}
        described |= {"selected": list(self.selected)} if self.selected else {}
        if release is not None and (self.images is not None or self.test_sensor is not None):
            # What is left out says where the parts of the rest end.
            described["parts"] = [getattr(release, part).tolist() for part in PARTS]
        if len({image[:2] for image in images}) > 1:
            described["directories"] = [list(image[:2]) for image in images]
        if self.task in COLUMNS:
            described["labels"] = [[image.path.name, list(image.values)] for image in images]
        else:
            described["presses"] = [list(image[2:5]) for image in images]
        return described

    def catalogue(self) -> Catalogue:
        """List labels and images: by sensor and pattern, then by number, or by class, press and frame."""
        listing = self._listing()
        images, release = self._taken(listing.images)
        names, labels = self._labels(images)
        return self.catalogue_of(
            [image.path for image in images],
            [image.place for image in images],
            [image.name for image in images],
            kind=Kind.regression if self.task in COLUMNS else Kind.classification,
            names=names,
            labels=labels,
            release=release,
            skipped=listing.skipped,
            ignored=listing.ignored,
            blank=listing.blank,
            selected=self.selected,
            **self._groups(images),
        )

    def _labels(self, images: Sequence[_Image]) -> tuple[tuple[str, ...], npt.NDArray[Any]]:
        """Return names and values of the outputs, or names and numbers of the classes."""
        if self.task in COLUMNS:
            return OUTPUTS[self.task], np.array([image.values for image in images], dtype=np.float64)
        keys = list(map(self._class_of, images))
        classes = sorted(set(keys))
        names = tuple(" ".join(f"{part:g} mm" if isinstance(part, float) else part for part in key) for key in classes)
        numbers = {key: number for number, key in enumerate(classes)}
        return names, np.array([numbers[key] for key in keys], dtype=np.int64)

    def _class_of(self, image: _Image) -> tuple[Any, ...]:
        """Return the parts of a class's name: a size, a family of patterns, both, or a shape."""
        if self.task is RecordedTask.shape or self.classes is GratingClasses.size:
            return (image.kind,)
        family = "dot" if "dot" in image.pattern.lower() else "line"  # as the release's own code tells them apart
        return (family,) if self.classes is GratingClasses.pattern else (family, image.kind)

    def _groups(self, images: Sequence[_Image]) -> dict[str, Any]:
        """Return which images were recorded together, as far as the release says so."""
        if self.task is RecordedTask.grating:
            numbers = {press: number for number, press in enumerate(dict.fromkeys(image[:4] for image in images))}
            return {"groups": np.array([numbers[image[:4]] for image in images], dtype=np.int64)}
        return {}

    def _taken(self, images: Sequence[_Image]) -> tuple[list[_Image], Split | None]:
        """Take the sizes, the sensors and the number that are asked for, in the parts that the release has them in."""
        images = self._of_sizes(sorted(images))
        if self.task is RecordedTask.hardness:
            return self._capped(images), None
        part_of = dict(zip(images, _released(images), strict=True))
        kept = self._capped([image for image, part in part_of.items() if self._is_used(image, part)])
        taken = sorted([*kept, *self._shots(part_of)])
        parts = np.array([part_of[image] for image in taken])
        return taken, Split(**{part: np.flatnonzero(parts == part) for part in PARTS})

    def _is_used(self, image: _Image, part: str) -> bool:
        """Return whether a part is used where sensors differ: of the tested one its test part, of others all but it."""
        return self.test_sensor is None or (image.sensor == self.test_sensor) == (part == "test")

    def _capped(self, images: list[_Image]) -> list[_Image]:
        """Take `self.images`: of each class alike, of the first ones perhaps one more, each at even steps."""
        if self.images is None:
            return images
        of_class: defaultdict[tuple[Any, ...], list[int]] = defaultdict(list)
        for row, image in enumerate(images):
            of_class[() if self.task in COLUMNS else self._class_of(image)].append(row)
        each, more = divmod(self.images, len(of_class))
        taken: list[int] = []
        for number, rows in enumerate(of_class.values()):
            count = min(len(rows), each + (number < more))
            taken += [rows[step * len(rows) // count] for step in range(count)]
        return [images[row] for row in sorted(taken)]

    def _shots(self, part_of: Mapping[_Image, str]) -> list[_Image]:
        """Draw some presses of the tested sensor out of its training part, which train, too; return their images."""
        own = [image for image, part in part_of.items() if image.sensor == self.test_sensor and part == "train"]
        pools = defaultdict(set)
        for image in own:
            pools[image.pattern, image.kind].add(image.press)
        least = min(map(len, pools.values()), default=0)
        if self.shots > least:
            expected = f"at most {least}, which the training part of {self.test_sensor} has of each"
            raise DataError(str(self.shots), place="data.shots", expected=expected)
        drawn = set()
        for key, pool in pools.items():
            order = stream(self.seed, "shots", *map(str, key)).permutation(sorted(pool))
            drawn |= {(*key, press) for press in order[: self.shots].tolist()}
        return [image for image in own if image[1:4] in drawn]

    def _of_sizes(self, images: list[_Image]) -> list[_Image]:
        """Keep the gratings of the chosen sizes, or of those that each directory has."""
        if self.task is not RecordedTask.grating:
            return images
        sizes: defaultdict[tuple[str, str], set[Any]] = defaultdict(set)
        for image in images:
            sizes[image[:2]].add(image.kind)
        common = set.intersection(*sizes.values())
        absent = sorted(set(self.spacings_mm) - common)
        if absent or not common:
            everywhere = listed([f"{size:g}" for size in sorted(common)]) or "none"
            raise DataError(
                listed([f"{size:g}" for size in absent]) or "sizes that differ from directory to directory",
                place="data.spacings_mm",
                expected=f"sizes that {' and '.join('/'.join(key) for key in sizes)} have: {everywhere}",
            )
        wanted = set(self.spacings_mm) or common
        return [image for image in images if image.kind in wanted]

    def _listing(self) -> _Listing:
        """Find the images of all sensors that train or are tested."""
        named = self.sensor.split(AND)
        _check_named("data.sensor", named)
        sensors = {name: "data.sensor" for name in named if name != self.test_sensor}
        if not sensors:
            expected = f"another sensor than data.sensor={self.sensor}, or null"
            raise DataError(str(self.test_sensor), place="data.test_sensor", expected=expected)
        if self.test_sensor is not None:
            sensors[self.test_sensor] = "data.test_sensor"
        find: Callable[[str, str], _Listing] = self._rows if self.task in COLUMNS else self._presses
        images, ignored, skipped, blank = zip(*(find(*sensor) for sensor in sensors.items()), strict=True)
        return _Listing(list(chain(*images)), list(chain(*ignored)), sum(skipped), tuple(chain(*blank)))

    def _rows(self, sensor: str, setting: str) -> _Listing:
        """Read the table of a sensor in the order of the image numbers, which is that of time."""
        if self.task is RecordedTask.hardness:
            expected = f"an old export of ours with {DIRECTORIES[self.task]}: the release has no hardness"
            check_directory(self.root / DIRECTORIES[self.task], "data.root", expected)
        directory = _enter(self.root, {"data.root": DIRECTORIES[self.task], setting: sensor})
        table = directory / f"{sensor}.csv"
        check_file(table, "data.root", "a table beside the images, named after the sensor")
        rows, skipped, blank = read_rows(
            table,
            image_column=IMAGE_COLUMN,
            target_columns=COLUMNS[self.task],
            remedy="rename columns: the layout fixes their names",
            directories=(directory,),
            skip_missing=self.skip_missing,
        )
        check_no_faults(
            f"{table.name} names images without a number",
            [row.place for row in rows if not _number(row)],
            "end names with their number, as image_12.png",
        )
        ordered = sorted(rows, key=lambda row: (int(_number(row)), row.name))
        images = [
            _Image(sensor, "", "", number, 0, row.path, row.place, row.labels, f"{sensor}/{row.name}")
            for number, row in enumerate(ordered)
        ]
        return _Listing(images, unnamed_images(rows), skipped, tuple(blank))

    def _presses(self, sensor: str, setting: str) -> _Listing:
        """Find the images of all gratings or shapes of a sensor."""
        parent = _enter(self.root, {"data.root": DIRECTORIES[self.task], setting: sensor})
        if self.task is RecordedTask.shape:
            return _shapes(parent, sensor)
        if self.pattern is None:
            expected = "the directory of one pattern, for task=grating"
            raise DataError("null", place="data.pattern", expected=expected, remedy=content(parent))
        images, ignored = [], []
        _check_named("data.pattern", self.pattern.split(AND))
        for pattern in self.pattern.split(AND):
            directory = _enter(parent, {"data.pattern": pattern})
            own = _gratings(directory, sensor, pattern)
            images += own
            ignored += other_files(directory, "*", [image.path for image in own])
        return _Listing(images, ignored)


def _check_named(setting: str, names: Sequence[str]) -> None:
    """Refuse a list of directories that names one twice, or none."""
    faults = [name or "''" for name in names if names.count(name) > 1 or not name]
    remedy = f"name each directory once, as in A{AND}B"
    check_no_faults("directories are named twice, or names are empty", faults, remedy, place=setting)


def _gratings(directory: Path, sensor: str, pattern: str) -> list[_Image]:
    """Find the images of one pattern; each name says which press it is of."""
    check_links(directory, "*")
    paths = image_files(directory, "*")
    if not paths:
        expected = f"a directory with {listed(sorted(SUFFIXES))} files"
        raise DataError(str(directory), place="data.pattern", expected=expected, remedy=content(directory))
    images, unnamed = [], []
    for path in paths:
        parts = re.fullmatch(r"(\d+(?:\.\d+)?)_(\d+)(?:_(\d+))?", path.stem, flags=re.ASCII)
        if parts is None:
            unnamed.append(path.name)
        else:
            size, press, frame = float(parts[1]), int(parts[2]), int(parts[3] or 0)
            images.append(_Image(sensor, pattern, size, press, frame, path, path.name))
    check_no_faults(
        f"{directory} has images that are not named <size>_<group>_<frame>, e.g. 0.35_12_3.jpg",
        unnamed,
        "rename or remove them",
    )
    twice = repeats((image.place, image[:5]) for image in sorted(images))
    check_no_faults(f"{directory} has several images of one size, press and frame", twice, "keep one of each")
    return images


def _shapes(directory: Path, sensor: str) -> _Listing:
    """Find the images of each shape; as the release's own code, in the order of the last number in each name."""
    names = directories(directory)
    images, unnumbered, empty = [], [], []
    for name in names:
        check_links(directory / name, "*")
        paths = image_files(directory / name, "*")
        empty += [] if paths else [name]
        numbers = {path: re.findall(r"\d+", path.stem, flags=re.ASCII) for path in paths}
        unnumbered += [f"{name}/{path.name}" for path, digits in numbers.items() if not digits]
        ordered = sorted((int(digits[-1]), path) for path, digits in numbers.items() if digits)
        for number, (_, path) in enumerate(ordered):  # numbers may repeat: each image is one of its own
            relative = f"{name}/{path.name}"
            images.append(_Image(sensor, "", name, number, 0, path, relative, (), f"{sensor}/{relative}"))
    expected = "the directory that has one directory of images per shape"
    if not images:
        raise DataError(str(directory), place="data.sensor", expected=expected, remedy=content(directory))
    check_no_faults(f"{directory} has shapes without images", empty, "remove these directories", expected=expected)
    check_no_faults(f"{directory} has images without a number", unnumbered, "put one into each name, as ball_12.jpg")
    return _Listing(images, other_files(directory, "**/*", [image.path for image in images]))


def _released(images: Iterable[_Image]) -> list[str]:
    """Name the part of each image: presses of one sensor, pattern and kind are split in their order."""
    images = list(images)
    presses = defaultdict(set)
    for image in images:
        presses[image[:3]].add(image.press)
    part_of: dict[tuple[Any, ...], str] = {}
    for key, own in presses.items():
        split = ordered_split(np.array(sorted(own)))
        part_of |= {(*key, int(press)): part for part in PARTS for press in getattr(split, part)}
    return [part_of[image[:4]] for image in images]


def _number(row: Row) -> str:
    """Return the digits that an image's name ends in."""
    stem = Path(row.name).stem
    return stem[len(stem.rstrip("0123456789")) :]


def _enter(directory: Path, names: dict[str, str]) -> Path:
    """Enter nested directories, each of which a setting names."""
    check_directory(directory, next(iter(names)), f"the directory that holds {next(iter(names.values()))}")
    for key, name in names.items():
        if Path(name).is_absolute() or ".." in Path(name).parts:
            raise DataError(name, place=key, expected=f"the name of a directory below {directory}")
        check_directory(directory / name, key, "a directory")
        directory = directory / name
    return directory
