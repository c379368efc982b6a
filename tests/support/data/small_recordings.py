"""Small recordings in every form that a loader reads, written for a test."""

import struct
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from _pytest.mark import ParameterSet
from PIL import Image

from tacevo.choices import LightScene, Normalisation, RecordedTask, SensorTask, SplitRule, TargetScaling
from tacevo.data.dataset import Dataset
from tacevo.data.loading import load
from tacevo.data.sources.arrays import Arrays
from tacevo.data.sources.folder import Folder
from tacevo.data.sources.table import TableSource
from tacevo.parts.source import Source

if TYPE_CHECKING:
    from tacevo.data.simulator.tasks import Simulated
    from tacevo.data.sources.tacverse import TacVerse

#: How data are loaded where a test says nothing else.
PROTOCOL: dict[str, Any] = {
    "split": SplitRule.random,
    "split_seed": 0,
    "normalisation": Normalisation.standardise,
    "target_scaling": TargetScaling.minmax,
    "workers": 1,
}


#: The room that each form of a source needs which is not of the core.
_ROOMS = {"simulated": "simulator", "tacverse": "tacverse", "forces": "tacverse", "gratings": "tacverse"}


def in_rooms(forms: Iterable[str]) -> list[ParameterSet]:
    """Return parameters of a test, each with the mark of the room that it needs."""
    rooms = {form: _ROOMS.get(form.split()[0]) for form in forms}
    return [pytest.param(form, marks=[pytest.mark.room(room)] if room else []) for form, room in rooms.items()]


def loaded(source: Source, cache: Path, **changes: Any) -> Dataset:
    """Load with the default protocol, but for what is named."""
    return load(source, cache=cache, **{**PROTOCOL, **changes})


def simulated(task: SensorTask = SensorTask.force, **changes: Any) -> "Simulated":
    """Describe a small simulation."""
    from tacevo.data.simulator.tasks import Simulated  # a room

    usual = {"images": 24, "image_size": 16, "seed": 3, "sensor_seed": 0, "light": LightScene.standard}
    return Simulated(task=task, **{**usual, "spacings_mm": (0.5, 1.0, 2.0), **changes})


def save_image(path: Path, value: int, size: tuple[int, int] = (8, 8)) -> None:
    """Save a picture of one colour; its red is the value."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", size, (value, 10, 20)).save(path)


def save_table(root: Path, rows: str, *, images: int = 3, header: str = "image_name, fx ,fz,note\n") -> TableSource:
    """Write a table and images named 0.png, 1.png, ... into a directory."""
    root.mkdir(parents=True, exist_ok=True)
    (root / "labels.csv").write_text(header + rows)
    for number in range(images):
        save_image(root / f"{number}.png", number)
    return TableSource(
        root=root, table="labels.csv", image_column="image_name", target_columns=("fz", "fx"), image_size=16
    )


def save_folder(root: Path, *files: str) -> Folder:
    """Save a picture under each name, which begins with its class."""
    for number, name in enumerate(files):
        save_image(root / name, number)
    return Folder(root=root, image_size=16)


def save_forces(root: Path, rows: str, *, images: int = 3, header: str = "image_name,fx,fy,fz\n") -> "TacVerse":
    """Write a force set of the release with images named image_0.png, image_1.png, ..."""
    from tacevo.data.sources.tacverse import TacVerse  # a room

    folder = root / "Force_Regression" / "ViTacTip"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "ViTacTip.csv").write_text(header + rows)
    for number in range(images):
        save_image(folder / f"image_{number}.png", number)
    return TacVerse(root=root, task=RecordedTask.force, sensor="ViTacTip", pattern=None, image_size=16)


def save_gratings(root: Path, *names: str) -> "TacVerse":
    """Write a grating set of the release."""
    from tacevo.data.sources.tacverse import TacVerse  # a room

    folder = root / "Grating_Classification" / "ViTacTip" / "Blackdot"
    folder.mkdir(parents=True, exist_ok=True)
    for number, name in enumerate(names):
        save_image(folder / name, number % 256)
    return TacVerse(root=root, task=RecordedTask.grating, sensor="ViTacTip", pattern="Blackdot", image_size=16)


def save_arrays(path: Path, **arrays: object) -> Arrays:
    """Write an archive; what is not given is a sound set of twelve images and one value for each."""
    path.parent.mkdir(parents=True, exist_ok=True)
    sound = {"images": np.arange(12 * 64, dtype=np.uint8).reshape(12, 8, 8), "labels": np.linspace(0, 1, 12)}
    chosen = {name: array for name, array in {**sound, **arrays}.items() if array is not None}
    np.savez(path, **chosen)  # type: ignore[arg-type]
    return Arrays(root=path, image_size=16)


def save_deep_colour(path: Path, value: int, size: int = 8) -> None:
    """Save a PNG file in colour of 16 bits a channel, which Pillow cannot write; every channel has the value."""
    rows = b"".join(b"\0" + struct.pack(">H", value) * 3 * size for _ in range(size))
    header = struct.pack(">IIBBBBB", size, size, 16, 2, 0, 0, 0)
    chunks = [(b"IHDR", header), (b"IDAT", zlib.compress(rows)), (b"IEND", b"")]
    parts = [
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data)) for name, data in chunks
    ]
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(parts))
