"""Sources of images: what `data.source` chooses."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Protocol

import numpy as np
import numpy.typing as npt

from tacevo.records import Json, Kind

#: One picture: uint8, shape (3, image_size, image_size), channels in the order red, green, blue.
Picture = npt.NDArray[np.uint8]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Split:
    """Row numbers of the three parts, int64, each in ascending order, disjoint and complete."""

    train: npt.NDArray[np.int64]
    validation: npt.NDArray[np.int64]
    test: npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Catalogue:
    """The catalogue of a source: what it holds, before any picture is made."""

    kind: Kind
    #: Names of the regressed values or of the classes, in the order of the outputs.
    names: tuple[str, ...]
    #: Regression: float64 (N, len(names)), in the units of the recording. Classification: int64 (N,).
    labels: npt.NDArray[np.float64] | npt.NDArray[np.int64]
    #: Height and width of every picture, in pixels.
    image_size: int
    #: One call per picture, in the order of the labels, which any thread may make.
    pictures: Sequence[Callable[[], Picture]]
    #: Regression: the unit of every output, e.g. `N`; None where the source does not state it. Never guessed.
    units: tuple[str, ...] | None = None
    #: int64 (N,): rows with the same number were recorded together and share a part of a random split; None: no two.
    groups: npt.NDArray[np.int64] | None = None
    #: The setting that names the groups; None where the source itself has them.
    groups_chosen_by: str | None = None
    #: The split that the authors of the recording name; None where they do not name one.
    release: Split | None = None
    #: The split of a source that has dealt it itself, because it names sensors or parts; whatever rule is asked for.
    dealt: Split | None = None
    #: Width and height of the images before they are resized, in pixels; None where they are drawn to size.
    recorded_size: tuple[int, int] | None = None
    #: The file of every picture; None where they come from no files of their own.
    files: Sequence[Path] | None = None
    #: The name of each picture in messages, e.g. `line 3 'a.png'`; None: its row.
    places: Sequence[str] | None = None
    #: The bits that each file has for a value; empty where the pictures come from no files of their own.
    depths: Sequence[int] = ()
    #: One call per picture: its largest stored value, and the value that becomes 255. Empty where pictures are drawn.
    extents: Sequence[Callable[[], tuple[float, float]]] = ()
    #: The number of labelled rows that were left out because their image is missing.
    skipped: int = 0
    #: Files that lie among the images and are not part of the data set.
    ignored: Sequence[Path] = ()
    #: Images among them that are hidden, or lie in what systems leave, such as `@eaDir`; relative to the directory.
    passed_over: Sequence[PurePath] = ()
    #: The lines of a table that have separators and no value.
    blank: Sequence[int] = ()
    #: The names in messages of the images that lie outside the directory of the data set, where links lead.
    linked: Sequence[str] = ()
    #: The settings that select images of the recording, as a user writes them.
    selected: tuple[str, ...] = ()


class Source(Protocol):
    """Anything that images and labels can be read from: what `data.source=NAME` stands for.

    A source of your own is a frozen dataclass. A field that has the name of a setting of `data` (`root`, `image_size`,
    `split_column`, ...) gets that setting, a field `task` the name of the task; each other field is a setting of the
    source's own, `parts.NAME.FIELD`.

    Both methods raise a `tacevo.errors.DataError` where files are missing, or names, tables or arrays are broken.
    Nothing that they return may depend on a clock, on a generator without a seed, or on the order of a directory.
    """

    def describe(self) -> Json:
        """Name everything that determines the images, labels and groups: the source's part of the cache key.

        What is read from files is named by its bytes, and not by where it lies.
        """
        ...

    def catalogue(self) -> Catalogue:
        """List labels and pictures without making any picture; refuse every fault that can be seen so.

        Raises:
            DataError: the header of an image shows that it cannot be read, or is of another size than the rest.
        """
        ...
