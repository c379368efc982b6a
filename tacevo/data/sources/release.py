"""The content of a whole download of the TacVerse release, and the files of it that are not there.

The figures are those of the authors' page and code (docs/references.bib, `tacverse`), and of the data set's own page at
revision 0bc27afe0d8f. Hashes of single files were not published, so a damaged image is found by decoding it alone.
"""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from tacevo.choices import RecordedTask
from tacevo.data.source import listed
from tacevo.data.sources.filenames import directories
from tacevo.data.sources.image_files import image_files
from tacevo.data.sources.tacverse import DIRECTORIES
from tacevo.text import counted

#: Images of each task, and the directories of its sensors.
Held = Mapping[RecordedTask, tuple[int, tuple[str, ...]]]

#: The content of the release; the misspelt directory is the authors'.
HELD: Held = {
    RecordedTask.force: (
        36_197,
        ("GelsightMarker", "GelsightNoMarker", "MagicGripper", "TacTip", "ViTac", "ViTacTip", "ViTacTip2"),
    ),
    RecordedTask.grating: (40_509, ("GelsightMarker", "GelsightNoMarker", "MagicGripper", "ViTacTip")),
    RecordedTask.shape: (
        30_094,
        ("GelsightMarker", "GelsigntNoMarker", "MagicGripper", "MagicTac", "TacTip", "ViTac", "ViTacTip"),
    ),
}

#: Archives that are downloaded, and their bytes together.
ARCHIVES, BYTES = 4, 29_404_983_381

#: The sizes of each pattern of gratings, in mm, and the number of shapes.
SIZES, SHAPES = tuple(round(0.3 + 0.05 * step, 2) for step in range(30)), 9


def compared(root: Path, held: Held = HELD) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Compare a directory with the whole release, by counts and names.

    Returns:
        A line for each task, and for archives that lie there; and those of the lines that tell of a difference. A task
        that is not there differs in nothing: a reader may want one only. Nor does one that has other sensors alone,
        which are the reader's own.
    """
    told, differing = [], []
    for task, (images, sensors) in held.items():
        directory = root / DIRECTORIES[task]
        if not directory.is_dir():
            told.append(f"{directory.name} is not there")
            continue
        own = directories(directory)
        is_nested = any((directory / name / sensor).is_dir() for name in own for sensor in sensors)
        if own and not is_nested and not set(own) & set(sensors):
            told.append(f"{directory.name}: sensors of your own ({listed(own)})")
            continue
        count = len(image_files(directory, "**/*"))
        faults = [] if count == images else [f"{count:,} images in place of {images:,}"]
        lacking = [sensor for sensor in sensors if not (directory / sensor).is_dir()]
        faults += [f"it lacks {listed(lacking)}"] if lacking else []
        faults += [fault for sensor in own for fault in _faults_of(task, directory / sensor)]
        told.append(
            f"{directory.name}: {listed(faults) or f'{images:,} images of {len(sensors)} sensors, as released'}"
        )
        differing += told[-1:] if faults else []
    archives = sorted(root.glob("*.zip"))
    if archives:
        size = sum(path.stat().st_size for path in archives)
        whole = (len(archives), size) == (ARCHIVES, BYTES)
        asked = "as released" if whole else f"in place of {ARCHIVES} of {BYTES:,} bytes"
        told.append(f"{counted(len(archives), 'archive')} of {size:,} bytes, {asked}")
        differing += [] if whole else told[-1:]
    return tuple(told), tuple(differing)


def _faults_of(task: RecordedTask, sensor: Path) -> Iterator[str]:
    """Name what a sensor's directory lacks."""
    if task is RecordedTask.force and not (sensor / f"{sensor.name}.csv").is_file():
        yield f"{sensor.name} lacks its table"
    if task is RecordedTask.shape and (count := len(directories(sensor))) != SHAPES:
        yield f"{sensor.name} has {counted(count, 'shape')} in place of {SHAPES}"
    if task is RecordedTask.grating:
        for pattern in directories(sensor):
            names = {path.name.partition("_")[0] for path in image_files(sensor / pattern, "*")}
            sizes = {float(name) for name in names if re.fullmatch(r"\d+(\.\d+)?", name, re.ASCII)}
            lacking = [f"{size:g}" for size in SIZES if size not in sizes]
            if lacking:
                yield f"{sensor.name}/{pattern} lacks {listed(lacking)} mm"
