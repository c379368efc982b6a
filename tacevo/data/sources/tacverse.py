"""The TacVerse release as its authors lay it out on disk.

    <root>/Force_Regression/<Sensor>/<Sensor>.csv             columns image_name, fx, fy, fz; images beside it
    <root>/Grating_Classification/<Sensor>/<Pattern>/<size>_<group>_<frame>.jpg   or <size>_<group>.jpg
    <root>/Hardness_Regression/<Sensor>/<Sensor>.csv          columns image_name, shore: an old export of ours

Sizes are in mm, one class each; a group is one press. The release's own split (arXiv:2606.25877 and its code) takes
60 % for training and 20 % for validation: of the force images in the order of their numbers, and of each size's
presses in the order of theirs, so that 25 presses give 1-15, 16-20 and 21-25.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from tacevo.choices import SensorTask
from tacevo.data.source import Catalogue, check_no_faults, chosen, listed, repeats
from tacevo.data.sources.filenames import SUFFIXES, check_directory, check_file, content
from tacevo.data.sources.images import DECODING, file_catalogue, files_hash, image_files, other_files
from tacevo.data.sources.table import Row, read_rows, row_catalogue
from tacevo.data.splitting import PARTS, Split, ordered_split
from tacevo.errors import DataError
from tacevo.records import Json, Kind

DIRECTORIES = {
    SensorTask.force: "Force_Regression",
    SensorTask.grating: "Grating_Classification",
    SensorTask.hardness: "Hardness_Regression",
}

IMAGE_COLUMN = "image_name"

#: Columns of the labels and the names of the outputs, in the same order.
COLUMNS = {SensorTask.force: ("fx", "fy", "fz"), SensorTask.hardness: ("shore",)}

OUTPUTS = {SensorTask.force: ("Fx", "Fy", "Fz"), SensorTask.hardness: ("shore",)}


class _Frame(NamedTuple):
    """One picture of one press onto a grating; pictures are in the order of these fields."""

    #: In mm.
    size: float
    group: int
    frame: int
    path: Path


@dataclass(frozen=True, slots=True, kw_only=True)
class TacVerse:
    """One task and one sensor of the release."""

    root: Path
    task: SensorTask
    #: The directory of the sensor, e.g. `ViTacTip`.
    sensor: str
    #: Gratings: the directory of the specimens, e.g. `Blackdot`.
    pattern: str | None
    #: Height and width that images are resized to, in pixels.
    image_size: int
    #: Tables: leave out rows whose image is missing, as the release's own code does, instead of refusing the table.
    skip_missing: bool = False
    #: The stored value that becomes 255; None for the full range of the files.
    white_point: float | None = None

    def describe(self) -> Json:
        """Name the labels, and the bytes of every image."""
        described: dict[str, Json] = {"source": "tacverse", "decoding": DECODING, "task": self.task}
        described |= {"image_size": self.image_size, **chosen(self, "white_point")}
        if self.task is SensorTask.grating:
            frames = self._frames()
            presses: Json = [list(frame[:3]) for frame in frames]
            return {**described, "presses": presses, "images": files_hash(frame.path for frame in frames)}
        rows, _ = self._rows()
        labels: Json = [[row.path.name, list(row.labels)] for row in rows]
        return {**described, "labels": labels, "images": files_hash(row.path for row in rows)}

    def catalogue(self) -> Catalogue:
        """List labels and images: by image number, or by size, press and frame."""
        return self._gratings() if self.task is SensorTask.grating else self._regression()

    def _regression(self) -> Catalogue:
        rows, skipped = self._rows()
        return row_catalogue(
            rows,
            skipped,
            self.image_size,
            self.white_point,
            names=OUTPUTS[self.task],
            release=ordered_split(np.arange(len(rows))) if self.task is SensorTask.force else None,
        )

    def _gratings(self) -> Catalogue:
        frames = self._frames()
        sizes = sorted({frame.size for frame in frames})
        presses = sorted({frame[:2] for frame in frames})
        numbers = {press: number for number, press in enumerate(presses)}
        groups = np.array([numbers[frame[:2]] for frame in frames], dtype=np.int64)
        files = [frame.path for frame in frames]
        return file_catalogue(
            files,
            [path.name for path in files],
            self.image_size,
            self.white_point,
            kind=Kind.classification,
            names=tuple(f"{size:g} mm" for size in sizes),
            labels=np.array([sizes.index(frame.size) for frame in frames], dtype=np.int64),
            groups=groups,
            release=_split_of_presses(presses, groups),
            ignored=other_files(files[0].parent, "*", files),
        )

    def _rows(self) -> tuple[list[Row], int]:
        """Read the table in the order of the image numbers, which is that of time."""
        directory = _enter(self.root, {"data.root": DIRECTORIES[self.task], "data.sensor": self.sensor})
        table = directory / f"{self.sensor}.csv"
        check_file(table, "data.root", "a table beside the images, named after the sensor")
        rows, skipped = read_rows(
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
        return sorted(rows, key=lambda row: (int(_number(row)), row.name)), skipped

    def _frames(self) -> list[_Frame]:
        """Find the images of all presses, ordered by size, press and frame."""
        parent = _enter(self.root, {"data.root": DIRECTORIES[self.task], "data.sensor": self.sensor})
        if self.pattern is None:
            expected = "the directory of one pattern, for task=grating"
            raise DataError("null", place="data.pattern", expected=expected, remedy=content(parent))
        directory = _enter(parent, {"data.pattern": self.pattern})
        paths = image_files(directory, "*")
        if not paths:
            expected = f"a directory with {listed(sorted(SUFFIXES))} files"
            raise DataError(str(directory), place="data.pattern", expected=expected, remedy=content(directory))
        frames = sorted(frame for path in paths if (frame := _frame(path)) is not None)
        named = {frame.path for frame in frames}
        check_no_faults(
            f"{directory} has images that are not named <size>_<group>_<frame>, e.g. 0.35_12_3.jpg",
            [path.name for path in paths if path not in named],
            "rename or remove them",
        )
        twice = repeats((frame.path.name, frame[:3]) for frame in frames)
        check_no_faults(f"{directory} has several images of one size, press and frame", twice, "keep one of each")
        return frames


def _frame(path: Path) -> _Frame | None:
    """Read a file name; None where it is not such a name."""
    parts = re.fullmatch(r"(\d+(?:\.\d+)?)_(\d+)(?:_(\d+))?", path.stem, flags=re.ASCII)
    if parts is None:
        return None
    return _Frame(size=float(parts[1]), group=int(parts[2]), frame=int(parts[3] or 0), path=path)


def _number(row: Row) -> str:
    """Return the digits that an image's name ends in."""
    stem = Path(row.name).stem
    return stem[len(stem.rstrip("0123456789")) :]


def _split_of_presses(presses: list[tuple[float, int]], groups: npt.NDArray[np.int64]) -> Split:
    """Split each size's presses in their order, and rows with them."""
    sizes = np.array([size for size, _ in presses])
    splits = [ordered_split(np.flatnonzero(sizes == size)) for size in np.unique(sizes)]
    taken = {part: np.concatenate([getattr(split, part) for split in splits]) for part in PARTS}
    return Split(**{part: np.flatnonzero(np.isin(groups, numbers)) for part, numbers in taken.items()})


def _enter(directory: Path, names: dict[str, str]) -> Path:
    """Enter nested directories, each of which a setting names."""
    check_directory(directory, next(iter(names)), f"the directory that holds {next(iter(names.values()))}")
    for key, name in names.items():
        check_directory(directory / name, key, "a directory")
        directory = directory / name
    return directory
