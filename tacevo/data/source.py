"""What every source of tactile images offers to `tacevo.data.loading`."""

from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePath
from typing import Protocol

import numpy as np
import numpy.typing as npt

import tacevo.text
from tacevo.data.splitting import Split
from tacevo.errors import DataError
from tacevo.records import Json, Kind

#: How many faults a message spells out before it only counts them.
SHOWN_FAULTS = 5

#: How many names of columns, files or directories a message lists, and how much of one text it shows.
SHOWN_NAMES, SHOWN_CHARACTERS = 10, 60

#: One picture: uint8, shape (3, image_size, image_size), channels in the order red, green, blue.
Picture = npt.NDArray[np.uint8]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Catalogue:
    """What a source holds, before any picture is made."""

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
    #: What a message calls each picture, e.g. `line 3 'a.png'`; None: its row.
    places: Sequence[str] | None = None
    #: The bits that each file has for a value; empty where the pictures come from no files of their own.
    depths: Sequence[int] = ()
    #: One call per picture: its largest stored value, and the value that becomes 255. Empty where pictures are drawn.
    extents: Sequence[Callable[[], tuple[float, float]]] = ()
    #: How many labelled rows were left out because their image is missing.
    skipped: int = 0
    #: Files that lie among the images and are not part of the data set.
    ignored: Sequence[Path] = ()
    #: Images among them that are hidden, or lie in what systems leave, such as `@eaDir`; relative to the directory.
    passed_over: Sequence[PurePath] = ()
    #: The lines of a table that have separators and no value.
    blank: Sequence[int] = ()
    #: What a message calls the images that lie outside the directory of the data set, where links lead.
    linked: Sequence[str] = ()
    #: The settings that select images of the recording, as a user writes them.
    selected: tuple[str, ...] = ()


class Source(Protocol):
    """Anything that images and labels can be read from.

    Both methods raise a `DataError` where files are missing, or names, tables or arrays are broken.
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


def chosen(source: object, *names: str) -> dict[str, Json]:
    """Return those of some settings that are set: they came later, and descriptions of earlier releases lack them."""
    return {name: value for name in names if (value := getattr(source, name)) is not None}


def check_no_faults(problem: str, faults: Sequence[str], remedy: str, *, place: str = "", expected: str = "") -> None:
    """Raise one error about all faults of one kind; do nothing without faults.

    The problem is, say, `labels.csv names images that do not exist`; of the faults, the first few are shown. Place and
    expected are those of the error.

    Raises:
        DataError: `faults` is not empty.
    """
    if not faults:
        return
    shown = ", ".join(faults[:SHOWN_FAULTS]) + (", ..." if len(faults) > SHOWN_FAULTS else "")
    raise DataError(f"{problem} ({len(faults)} found): {shown}", place=place, expected=expected, remedy=remedy)


def check_readable(errors: Sequence[tuple[str, DataError]]) -> None:
    """Raise one error about all images that cannot be read, each with what the user calls it.

    Raises:
        DataError: there are some; it has the remedies that they name.
    """
    remedies = sorted({error.remedy or "repair or remove them" for _, error in errors})
    faults = [f"{name} ({error.got})" for name, error in errors]
    check_no_faults("some images cannot be read", faults, ", or ".join(remedies))


def shortened(text: str) -> str:
    """Quote a text for a message, cut where it is long."""
    return repr(text if len(text) <= SHOWN_CHARACTERS else f"{text[: SHOWN_CHARACTERS - 3]}...")


#: Joins names for a message, the first few.
listed = partial(tacevo.text.listed, nothing="", most=SHOWN_NAMES)


def repeats(named: Iterable[tuple[str, Hashable]]) -> list[str]:
    """List the names of items whose key an earlier item has already."""
    seen: set[Hashable] = set()
    repeated = []
    for name, key in named:
        if key in seen:
            repeated.append(name)
        seen.add(key)
    return repeated
