"""The loading of a finished data set from a source: it is made once and then kept in a cache.

Promises: an entry of the cache is whole or absent, however many processes start at once and whenever one is
killed (`staging`); the number of workers cannot change a byte; faults of names, tables and image headers
are reported before any image is decoded.
"""

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from tacevo.choices import Normalisation, SplitRule, TargetScaling
from tacevo.data import dataset as datasets
from tacevo.data.agreement import check_catalogue, check_picture
from tacevo.data.dataset import Dataset
from tacevo.data.scaling import LARGEST_LABEL, input_statistics, target_scale
from tacevo.data.source import check_no_faults, check_readable
from tacevo.data.sources.image_files import warnings_as_errors
from tacevo.data.splitting import PARTS, TENTHS, check_balance, dealt
from tacevo.data.staging import remove_leftovers, reserve, staged
from tacevo.data.workers import Progress, each
from tacevo.errors import DataError
from tacevo.parts.source import Catalogue, Source, Split
from tacevo.records import DataFacts, Kind
from tacevo.storage.canonical import content_hash

#: Changes when the same description would give other files in the cache.
CACHE_SCHEMA = 2

MINIMUM_IMAGES = 10

WAITING = "data: another process makes this data set; waiting for it"


def load(
    source: Source,
    *,
    split_seed: int,
    normalisation: Normalisation,
    target_scaling: TargetScaling,
    cache: Path,
    workers: int,
    split: SplitRule = SplitRule.random,
    held_out: tuple[float, float] = TENTHS,
    accept: Callable[[Catalogue], None] | None = None,
    progress: Progress | None = None,
    say: Callable[[str], None] | None = None,
    catalogue: Catalogue | None = None,
) -> Dataset:
    """Load a data set from the cache, or make it and keep it there.

    A release's own split uses neither the seed nor the parts that are held out, but both still name the cache entry. Of
    the normalisation only the statistics are computed here; classification ignores the scaling of targets.

    `accept` is called with the catalogue before any picture is made, and raises where it does not suit; `progress`
    after every chunk of pictures; `say` with one line before they are made, or where another process makes the data set
    and this one waits. The source lists its catalogue where the caller does not have it already.

    Raises:
        DataError: the source is missing or broken, has fewer than 10 images or fewer than two classes, cannot be
            split as asked, or the cache has no room.
    """
    content = {
        "schema": CACHE_SCHEMA,
        "source": source.describe(),
        "split": split,
        "split_seed": split_seed,
        "normalisation": normalisation,
        "target_scaling": target_scaling,
    }
    if held_out != TENTHS:  # which was not a setting at first
        content["held_out"] = held_out
    directory = cache / content_hash(content)
    if not directory.is_dir():
        catalogue = source.catalogue() if catalogue is None else catalogue
        _check(catalogue)
        if accept is not None:
            accept(catalogue)
        parts = split_rows(catalogue, split, split_seed, held_out)
        targets = _targets(catalogue, parts.train, target_scaling)
        with staged(directory, partial(say, WAITING) if say is not None else None) as stage:
            if stage is not None:
                if say is not None:
                    say(f"data: preparing {len(catalogue.labels):,} images, of {catalogue.image_size} px")
                images = make_images(catalogue, stage / datasets.IMAGES, workers, progress)
                datasets.write(_assemble(catalogue, images, parts, targets, normalisation), stage)
    else:
        remove_leftovers(cache)
    dataset = datasets.read(directory)
    if datasets.fingerprint(dataset) != dataset.facts.fingerprint:
        raise DataError(
            "the cached data set was changed or damaged",
            place=str(directory),
            remedy="delete that directory and start again",
        )
    if not (directory / datasets.GROUPS).exists():  # an earlier release made it
        catalogue = source.catalogue() if catalogue is None else catalogue
        dataset = datasets.with_groups(dataset, _numbered(catalogue, dataset.test))
    return dataset


def split_rows(catalogue: Catalogue, rule: SplitRule, seed: int, held_out: tuple[float, float] = TENTHS) -> Split:
    """Split the rows of a catalogue as the rule says.

    Raises:
        DataError: the source has no split of its own or too few groups; or a part would be empty, or lack a class.
    """
    classes = catalogue.labels.astype(np.int64) if catalogue.kind is Kind.classification else None
    if catalogue.dealt is not None:
        parts = catalogue.dealt
    elif rule is SplitRule.random:
        parts = dealt(
            len(catalogue.labels),
            seed,
            held_out=held_out,
            groups=catalogue.groups,
            chosen_by=catalogue.groups_chosen_by,
            classes=classes,
        )
    elif catalogue.release is not None:
        parts = catalogue.release
    else:
        got = "release, and the source does not name a split"
        remedy = "set data.split=random, or data.split_column where the recording names the part of each image"
        raise DataError(got, place="data.split", remedy=remedy)
    if classes is not None:
        check_balance(parts, classes, catalogue.names)
    empty = [part for part in PARTS if len(getattr(parts, part)) == 0]
    check_no_faults("parts of the split have no images", empty, "take more images, or another split")
    return parts


#: Values, offset and scale of the targets, as `Dataset` has them.
_Targets = tuple[npt.NDArray[np.float32] | npt.NDArray[np.int64], tuple[float, ...], tuple[float, ...]]


def _targets(catalogue: Catalogue, train: npt.NDArray[np.int64], scaling: TargetScaling) -> _Targets:
    """Scale targets; class numbers stay as they are."""
    if catalogue.kind is Kind.classification:
        return catalogue.labels.astype(np.int64), (), ()
    labels = catalogue.labels.astype(np.float64)
    beyond = np.abs(labels) > LARGEST_LABEL
    _check_labels(catalogue, beyond, f"some labels are beyond {LARGEST_LABEL:g} in size", " or choose a larger unit")
    offset, scale = target_scale(labels, train, scaling, catalogue.names)
    with np.errstate(over="ignore", invalid="ignore"):  # refused below, by row
        targets = ((labels - np.array(offset)) / np.array(scale)).astype(np.float32)
    problem = "some labels are too far from those of the training split for the 32-bit numbers of a training"
    _check_labels(catalogue, ~np.isfinite(targets), problem)
    return targets, offset, scale


def _check_labels(catalogue: Catalogue, are_wrong: npt.NDArray[np.bool_], problem: str, choice: str = "") -> None:
    """Refuse labels, shape (N, K), of which some are wrong; each such row is named with its labels."""
    rows = np.flatnonzero(are_wrong.any(axis=1)).tolist()
    faults = [f"{_place(catalogue, row)} {catalogue.labels[row].tolist()}" for row in rows]
    check_no_faults(problem, faults, f"correct them{choice}")


def _place(catalogue: Catalogue, row: int) -> str:
    """Name a row as the user knows it."""
    return f"row {row}" if catalogue.places is None else catalogue.places[row]


def _numbered(catalogue: Catalogue, rows: npt.NDArray[np.int64]) -> tuple[int, ...]:
    """Number the groups of some rows from 0 as they come; nothing where no groups are known."""
    if catalogue.groups is None:
        return ()
    numbers: dict[int, int] = {}
    return tuple(numbers.setdefault(group, len(numbers)) for group in catalogue.groups[rows].tolist())


def _assemble(
    catalogue: Catalogue, images: Path, parts: Split, scaled: _Targets, normalisation: Normalisation
) -> Dataset:
    """Join finished images, split and targets; the inputs' statistics are the training split's."""
    pixels = np.load(images, mmap_mode="r")
    mean, deviation = input_statistics(pixels, parts.train, normalisation)
    targets, offset, scale = scaled
    unsigned = Dataset(
        facts=DataFacts(
            fingerprint="",
            kind=catalogue.kind,
            counts=(len(parts.train), len(parts.validation), len(parts.test)),
            in_channels=pixels.shape[1],
            image_size=catalogue.image_size,
            outputs=len(catalogue.names),
            names=catalogue.names,
            selected=catalogue.selected,
            groups=_numbered(catalogue, parts.test),
        ),
        images=images,
        targets=targets,
        train=parts.train,
        validation=parts.validation,
        test=parts.test,
        mean=mean,
        deviation=deviation,
        offset=offset,
        scale=scale,
    )
    return datasets.with_fingerprint(unsigned)


def _check(catalogue: Catalogue) -> None:
    """Refuse what is no catalogue, and what the protocol cannot split or learn."""
    check_catalogue(catalogue)
    if len(catalogue.labels) < MINIMUM_IMAGES:
        expected = f"at least {MINIMUM_IMAGES} images, so that each part of the split has one"
        raise DataError(str(len(catalogue.labels)), place="the data set", expected=expected)
    if catalogue.kind is Kind.classification and len(catalogue.names) < 2:
        raise DataError(
            str(list(catalogue.names)),
            place="the data set",
            expected="at least two classes",
            remedy="add others, or set data.root to the directory that holds the directories of all classes",
        )


def make_images(catalogue: Catalogue, path: Path, workers: int, progress: Progress | None = None) -> Path:
    """Make every picture and write them to one `.npy` file; return its path."""
    count = len(catalogue.pictures)
    _new_file(path, (count, 3, catalogue.image_size, catalogue.image_size))
    images = np.lib.format.open_memmap(path, mode="r+")
    errors: dict[int, DataError] = {}

    def make(row: int) -> None:
        try:
            picture = catalogue.pictures[row]()
            check_picture(picture, catalogue.image_size)  # NumPy would stretch or cast another one without a word
            images[row] = picture
        except DataError as error:
            errors[row] = error

    def tell(done: int, total: int) -> None:
        if progress is not None and not errors:  # "all images made" must be true
            progress(done, total)

    with warnings_as_errors():
        each(make, count, workers, tell)
    images.flush()
    check_readable([(_place(catalogue, row), errors[row]) for row in sorted(errors)])
    return path


def _new_file(path: Path, shape: tuple[int, ...]) -> None:
    """Make an `.npy` file of uint8 that has all its room on the disk."""
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "|u1", "fortran_order": False, "shape": shape})
        reserve(file, file.tell() + math.prod(shape))
