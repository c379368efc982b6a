"""A simulated data set as files that everyone can read: images and a table of labels.

Promises: `data=csv` reads the same images and labels back, in the same order; the directory is whole or absent (a kill
leaves a hidden sibling, which is never read and may be deleted).
"""

import json
from pathlib import Path

import numpy as np
from PIL import Image

from tacevo.choices import SensorTask
from tacevo.data.simulator.tasks import Simulated
from tacevo.data.staging import new_directory
from tacevo.data.workers import Progress, each
from tacevo.errors import ConfigError, DataError
from tacevo.text import as_override

#: zlib's quickest: images with camera noise hardly get smaller with more, and take four times as long.
COMPRESSION = 1


def write_files(source: Simulated, out: Path, *, workers: int, progress: Progress | None = None) -> int:
    """Write a simulated data set into a new directory; return how many images.

    It holds `images/00001.png` and so on, `labels.csv`, and every parameter and the units in `simulation.json`.
    `progress` is called after every chunk of images.

    Raises:
        DataError: `out` exists.
        ConfigError: the labels are classes, which are not read from a table.
        OSError: the files cannot be written.
    """
    if source.task is SensorTask.grating:
        raise ConfigError(source.task, place="task", expected="force or hardness, whose labels make a table")
    if out.exists():
        raise DataError(f"{out}, which exists", place="out", expected="a new directory, e.g. out=simulated")
    catalogue = source.catalogue()
    names = [f"images/{number:05d}.png" for number in range(1, len(catalogue.labels) + 1)]
    with new_directory(out.resolve()) as stage:
        (stage / "images").mkdir()

        def write_image(number: int) -> None:
            pixels = np.ascontiguousarray(catalogue.pictures[number]().transpose(1, 2, 0))
            Image.fromarray(pixels).save(stage / names[number], compress_level=COMPRESSION)

        each(write_image, len(names), workers, progress)
        # As Python writes floats, so that every bit of a label survives.
        rows = [[name, *map(repr, labels)] for name, labels in zip(names, catalogue.labels.tolist(), strict=True)]
        table = "".join(f"{','.join(row)}\n" for row in [["image", *catalogue.names], *rows])
        (stage / "labels.csv").write_text(table, encoding="utf-8")
        parameters = {"data": source.describe(), "units": catalogue.units}
        (stage / "simulation.json").write_text(json.dumps(parameters, indent=2) + "\n", encoding="utf-8")
    return len(names)


def overrides_for(source: Simulated, out: Path) -> list[str]:
    """Name the settings with which `tacevo search` reads such a directory."""
    return [
        f"task={source.task}",
        "data=csv",
        as_override("data.root", str(out)),
        f"data.target_columns=[{','.join(source.names)}]",
        "data.split=random",
        f"data.image_size={source.image_size}",
    ]
