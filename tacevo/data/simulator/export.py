"""A simulated data set as files that everyone can read: images and a table of labels.

Promises: `data=csv` reads the same images and labels back, in the same order; the directory is whole or absent (a kill
leaves a hidden sibling, which is never read and may be deleted).
"""

import json
import shlex
import shutil
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL import Image

from tacevo.choices import SensorTask
from tacevo.data.simulator.tasks import Simulated
from tacevo.data.source import Catalogue, Picture
from tacevo.data.workers import CHUNK, Progress, mapper
from tacevo.errors import ConfigError, DataError
from tacevo.text import as_override

#: zlib's quickest: images with camera noise hardly get smaller with more, and take four times as long.
COMPRESSION = 1

_README = """\
# Simulated tactile images

{images} images of the task `{task}`, {size} x {size} pixels, computed by TacEvo's simulated ViTacTip, and `labels.csv`
with {labels} of each. Nothing here was recorded with a real sensor. `simulation.json` holds every parameter; the same
parameters give the same files under the same version of the simulator. TacEvo's licence is Apache-2.0.

To search on it, with the same split as on the simulation itself:

    tacevo search {overrides}
"""


def export(source: Simulated, out: Path, *, workers: int, progress: Progress | None = None) -> int:
    """Write a simulated data set as PNG images and labels into a new or empty directory; return how many images.

    With one worker, or a small data set, this process draws. `progress` is called after every chunk of images.

    Raises:
        DataError: `out` exists and is not empty, or is the current directory.
        ConfigError: the labels are classes, which are not read from a table.
        OSError: the files cannot be written.
    """
    if source.task is SensorTask.grating:
        raise ConfigError(source.task, place="task", expected="force or hardness, whose labels make a table")
    catalogue = source.catalogue()
    names = [f"images/{number:05d}.png" for number in range(1, len(catalogue.labels) + 1)]
    with _staged(_vacant(out)) as stage:
        (stage / "images").mkdir()
        _write_images(catalogue, [stage / name for name in names], workers, progress)
        # As Python writes floats, so that every bit of a label survives.
        rows = [[name, *map(repr, labels)] for name, labels in zip(names, catalogue.labels.tolist(), strict=True)]
        table = "".join(f"{','.join(row)}\n" for row in [["image", *catalogue.names], *rows])
        (stage / "labels.csv").write_text(table, encoding="utf-8")
        (stage / "simulation.json").write_text(json.dumps(source.describe(), indent=2) + "\n", encoding="utf-8")
        labels = ", ".join(
            f"{name} in {unit}" for name, unit in zip(catalogue.names, catalogue.units or (), strict=True)
        )
        overrides = shlex.join(overrides_for(source, Path(out.name)))
        text = _README.format(
            images=len(names), task=source.task, size=source.image_size, labels=labels, overrides=overrides
        )
        (stage / "README.md").write_text(text, encoding="utf-8")
    return len(names)


def overrides_for(source: Simulated, out: Path) -> list[str]:
    """Name the settings with which `tacevo search` reads an exported directory."""
    return [
        f"task={source.task}",
        "data=csv",
        as_override("data.root", str(out)),
        f"data.target_columns=[{','.join(source.names)}]",
        "data.split=random",
        f"data.image_size={source.image_size}",
    ]


def _vacant(out: Path) -> Path:
    """Find where a new directory is to stand, links and dots resolved; refuse what could not be replaced."""
    place = out.resolve()
    if place == Path.cwd():
        raise DataError(f"{out}, the current directory", place="out", expected="a new directory, e.g. out=simulated")
    if place.exists() and not (place.is_dir() and not any(place.iterdir())):
        raise DataError(f"{out}, which is not empty", place="out", expected="a new directory, e.g. out=simulated")
    return place


@contextmanager
def _staged(out: Path) -> Iterator[Path]:
    """Offer a hidden sibling to fill; on success it becomes `out` in one step, else it is removed.

    Unlike the cache's, no lock file stays behind: this is the user's own directory.
    """
    stage = out.with_name(f".{out.name}-{uuid.uuid4().hex[:12]}")
    stage.mkdir(parents=True)
    try:
        yield stage
        stage.rename(out)  # atomic, and refused by the system where `out` has been filled in the meantime
    finally:
        shutil.rmtree(stage, ignore_errors=True)


def _write_images(catalogue: Catalogue, paths: Sequence[Path], workers: int, progress: Progress | None) -> None:
    """Draw and write every image."""
    count = len(paths)
    starts = range(0, count, CHUNK)
    pictures = [catalogue.pictures[start : start + CHUNK] for start in starts]
    places = [paths[start : start + CHUNK] for start in starts]
    with mapper(workers, count) as run:
        for done, _ in enumerate(run(_write_chunk, places, pictures), start=1):
            if progress is not None:
                progress(min(done * CHUNK, count), count)


def _write_chunk(paths: Sequence[Path], pictures: Sequence[Callable[[], Picture]]) -> None:
    """Draw and write some images."""
    for path, picture in zip(paths, pictures, strict=True):
        pixels = np.ascontiguousarray(picture().transpose(1, 2, 0))
        Image.fromarray(pixels).save(path, compress_level=COMPRESSION)
