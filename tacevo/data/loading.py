"""From a source to a finished data set, made once and then kept in a cache.

Promises: an entry of the cache is whole or absent, however many processes start at once and whenever one is
killed (what a kill leaves is a hidden folder that nobody reads); the number of workers cannot change a byte.
"""

import ctypes
import multiprocessing
import os
import shutil
import signal
import uuid
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tacevo.choices import Normalisation, TargetScaling
from tacevo.data import dataset as datasets
from tacevo.data.dataset import Dataset
from tacevo.data.protocol import input_statistics, split, target_scale
from tacevo.data.source import Catalogue, Picture, Source, refuse
from tacevo.errors import DataError
from tacevo.records import DataFacts, Kind
from tacevo.store import content_hash

#: Changes when the same description would give other files in the cache.
CACHE_SCHEMA = 1
MINIMUM_IMAGES = 10
#: Pictures that a worker makes between two reports of progress.
CHUNK = 32
#: Up to this many pictures are made in this process: starting others would take longer.
FEW_PICTURES = 1_000

#: Called with (pictures made, pictures in all).
Progress = Callable[[int, int], None]


def load(
    source: Source,
    *,
    split_seed: int,
    normalisation: Normalisation,
    target_scaling: TargetScaling,
    cache: Path,
    workers: int,
    progress: Progress | None = None,
) -> Dataset:
    """Load a data set from the cache, or make it and keep it there.

    Args:
        source: where images and labels come from.
        split_seed: seed of the 80/10/10 split.
        normalisation: how inputs are to be normalised; only its statistics are computed here.
        target_scaling: how regression targets are scaled; classification ignores it.
        cache: folder of all cached data sets; made where it is absent.
        workers: processes that make pictures; 1, or a small data set, makes them in this one.
        progress: told after every chunk of pictures, while they are being made.

    Returns:
        The data set, with its images in `cache`.

    Raises:
        DataError: the source is missing or broken, has fewer than 10 images or fewer than two classes.
    """
    protocol = {"split_seed": split_seed, "normalisation": normalisation, "target_scaling": target_scaling}
    content = {"schema": CACHE_SCHEMA, "source": source.describe(), **protocol}
    folder = cache / content_hash(content)
    if not folder.is_dir():
        catalogue = source.catalogue()
        _check(catalogue)
        with _staged(folder) as stage:
            images = _make_images(catalogue, stage / datasets.IMAGES, workers, progress)
            datasets.write(assemble(catalogue, images, split_seed, normalisation, target_scaling), stage)
    dataset = datasets.read(folder)
    if datasets.fingerprint(dataset) != dataset.facts.fingerprint:
        raise DataError(f"the cached data set {folder} was changed or damaged; delete that folder and run again")
    return dataset


def assemble(
    catalogue: Catalogue, images: Path, split_seed: int, normalisation: Normalisation, target_scaling: TargetScaling
) -> Dataset:
    """Apply the protocol to labels and finished images.

    Args:
        catalogue: labels and names; its pictures are not used.
        images: `.npy` file, uint8, shape (N, C, S, S), in the order of the labels.
        split_seed: seed of the split.
        normalisation: of the inputs.
        target_scaling: of regression targets.

    Raises:
        DataError: a target is constant over the training split.
    """
    pixels = np.load(images, mmap_mode="r")
    parts = split(len(pixels), split_seed)
    mean, deviation = input_statistics(pixels, parts.train, normalisation)
    targets, offset, scale = _targets(catalogue, parts.train, target_scaling)
    facts = DataFacts(
        fingerprint="",
        kind=catalogue.kind,
        counts=(len(parts.train), len(parts.validation), len(parts.test)),
        in_channels=pixels.shape[1],
        image_size=catalogue.image_size,
        outputs=len(catalogue.names),
        names=catalogue.names,
    )
    unsigned = Dataset(
        facts=facts,
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


def _targets(
    catalogue: Catalogue, train: npt.NDArray[np.int64], scaling: TargetScaling
) -> tuple[npt.NDArray[np.float32] | npt.NDArray[np.int64], tuple[float, ...], tuple[float, ...]]:
    """Scaled targets with their offset and scale; class numbers stay as they are."""
    if catalogue.kind is Kind.classification:
        return catalogue.labels.astype(np.int64), (), ()
    labels = catalogue.labels.astype(np.float64)
    offset, scale = target_scale(labels, train, scaling, catalogue.names)
    return ((labels - np.array(offset)) / np.array(scale)).astype(np.float32), offset, scale


def _check(catalogue: Catalogue) -> None:
    """Refuse what the protocol cannot split or learn."""
    if len(catalogue.labels) < MINIMUM_IMAGES:
        raise DataError(
            f"a data set needs at least {MINIMUM_IMAGES} images, so that each part of the split has one; "
            f"got {len(catalogue.labels)}"
        )
    if catalogue.kind is Kind.classification and len(catalogue.names) < 2:
        raise DataError(f"classification needs at least two classes; got only {list(catalogue.names)}")


@contextmanager
def _staged(folder: Path) -> Iterator[Path]:
    """Offer a hidden sibling to fill; on success it becomes `folder` in one step, else it is removed."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    stage = folder.with_name(f".{folder.name[:12]}-{uuid.uuid4().hex}")
    stage.mkdir()
    try:
        yield stage
        for file in stage.iterdir():
            _sync(file)
        _sync(stage)
        try:
            stage.rename(folder)  # atomic: a reader sees the whole entry or none
        except OSError:
            if not folder.is_dir():  # otherwise another process was first, with the same bytes
                raise
        _sync(folder.parent)
    finally:
        shutil.rmtree(stage, ignore_errors=True)


def _sync(path: Path) -> None:
    """Wait until a file or folder is on the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _make_images(catalogue: Catalogue, path: Path, workers: int, progress: Progress | None) -> Path:
    """Make every picture and write them to one `.npy` file; return its path."""
    pictures = catalogue.pictures
    shape = (len(pictures), 3, catalogue.image_size, catalogue.image_size)
    np.lib.format.open_memmap(path, mode="w+", dtype=np.uint8, shape=shape).flush()
    starts = range(0, len(pictures), CHUNK)
    chunks = [pictures[start : start + CHUNK] for start in starts]
    faults: list[str] = []
    with _mapper(workers if len(pictures) > FEW_PICTURES else 1) as mapper:
        for done, found in enumerate(mapper(partial(_make_chunk, path), starts, chunks), start=1):
            faults.extend(found)
            if progress is not None:
                progress(min(done * CHUNK, len(pictures)), len(pictures))
    refuse("some images cannot be read", faults, "Repair or remove them.")
    return path


@contextmanager
def _mapper(workers: int) -> Iterator[Callable[..., Iterator[list[str]]]]:
    """Offer `map`: the plain one, or one over fresh processes (spawned, so that they share no state with us)."""
    if workers <= 1:
        yield map
        return
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, context, initializer=_follow_parent, initargs=(os.getpid(),))

    def submit(*arguments: Any) -> Iterator[list[str]]:
        resource_tracker.ensure_running()  # else the pool would start it, which unblocks the signal again
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # workers inherit it: Ctrl-C is ours alone
        try:
            return pool.map(*arguments)  # starts the workers
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)

    try:
        yield submit
    finally:
        pool.shutdown(cancel_futures=True)  # an interrupted search does not wait for the other pictures


def _follow_parent(parent: int) -> None:
    """End with the parent, even where it was killed (prctl's PR_SET_PDEATHSIG is 1)."""
    ctypes.CDLL(None).prctl(1, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent:  # it was killed before the line above
        os._exit(1)


def _make_chunk(path: Path, start: int, pictures: Sequence[Callable[[], Picture]]) -> list[str]:
    """Make consecutive pictures into their rows of the file; return the faults of those that cannot be made."""
    images = np.lib.format.open_memmap(path, mode="r+")
    faults = []
    for row, picture in enumerate(pictures, start):
        try:
            images[row] = picture()
        except DataError as error:
            faults.append(str(error))
    images.flush()
    return faults
