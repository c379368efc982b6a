"""A source that reads the logs of a robot: one NumPy archive for each time that it touched something."""

import hashlib
import zipfile
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from tacevo.errors import DataError
from tacevo.parts.source import Catalogue, Picture
from tacevo.records import Json, Kind

#: The arrays of a log, and their numbers of axes.
ARRAYS = {"images": 4, "wrench": 2, "timestamps": 1}

AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")

UNITS = ("N", "N", "N", "Nm", "Nm", "Nm")


@dataclass(frozen=True)
class RobotLogs:
    """Images of a tactile sensor, and the forces that a force sensor measured at that moment.

    Every file `*.npz` in the directory `root` is a log with the arrays `images` (uint8, of shape (N, H, W, 3), red,
    green and blue), `wrench` (float, of shape (N, 6): forces in N, torques in Nm) and `timestamps` (float, of shape
    (N,), in seconds, rising). The images of a log look alike, so a log is a group: a random split never cuts one.
    """

    root: Path
    image_size: int
    #: The first values of the wrench that a network must read: 3 are the forces.
    outputs: int = 3
    #: Each log is thinned to one image in so many.
    every: int = 1

    def __post_init__(self) -> None:
        """Refuse settings that leave nothing."""
        if not 1 <= self.outputs <= len(AXES) or self.every < 1:
            raise ValueError(f"expected outputs from 1 to {len(AXES)}, and every at least 1")

    def describe(self) -> Json:
        """Name the logs by their bytes, and what is taken of them."""
        return {
            "source": "robot_logs",
            "logs": {log.name: hashlib.sha256(log.read_bytes()).hexdigest() for log in self.logs()},
            "image_size": self.image_size,
            "outputs": self.outputs,
            "every": self.every,
        }

    def catalogue(self) -> Catalogue:
        """List the images of all logs."""
        labels, pictures, groups, places, sizes = [], [], [], [], set()
        for number, log in enumerate(self.logs()):
            arrays = read(log)
            sizes.add(arrays["images"].shape[2:0:-1])
            for row in range(0, len(arrays["images"]), self.every):
                labels.append(arrays["wrench"][row, : self.outputs])
                pictures.append(partial(resized, arrays["images"][row], self.image_size))
                groups.append(number)
                places.append(f"{log.name}, row {row}")
        if len(sizes) > 1:
            raise DataError(f"{sorted(sizes)}", place=f"data.root={self.root}", expected="images of one size")
        return Catalogue(
            kind=Kind.regression,
            names=AXES[: self.outputs],
            units=UNITS[: self.outputs],
            labels=np.array(labels, np.float64),
            image_size=self.image_size,
            pictures=pictures,
            groups=np.array(groups, np.int64),
            places=places,
            recorded_size=sizes.pop(),
        )

    def logs(self) -> list[Path]:
        """List the logs, in the order of their names."""
        logs = sorted(self.root.glob("*.npz"))
        if not logs:
            raise DataError("none", place=f"data.root={self.root}", expected="a directory with logs, *.npz")
        return logs


def read(log: Path) -> dict[str, np.ndarray[Any, Any]]:
    """Read a log; what is wrong with it is told with its name."""
    try:
        with np.load(log, allow_pickle=False) as file:
            arrays = {name: file[name] for name in ARRAYS}
    except (KeyError, OSError, ValueError, zipfile.BadZipFile) as error:
        raise DataError(str(error), place=str(log), expected=f"the arrays {', '.join(ARRAYS)}") from error
    images, wrench, timestamps = arrays.values()
    found = f"{images.dtype} {images.shape}, {wrench.dtype} {wrench.shape}, {timestamps.shape}"
    is_sound = (
        all(array.ndim == axes for array, axes in zip(arrays.values(), ARRAYS.values(), strict=True))
        and len({len(array) for array in arrays.values()}) == 1
        and images.dtype == np.uint8
        and images.shape[3] == 3
        and wrench.shape[1] == len(AXES)
        and bool(np.isfinite(wrench).all())
        and bool((np.diff(timestamps) > 0).all())
    )
    if not is_sound:
        expected = "images uint8 (N, H, W, 3), wrench (N, 6) of finite numbers, timestamps (N,), rising"
        raise DataError(found, place=str(log), expected=expected)
    return arrays


def resized(image: np.ndarray[Any, Any], size: int) -> Picture:
    """Return an image as a network takes it: uint8, of shape (3, size, size)."""
    square = Image.fromarray(image).resize((size, size), Image.Resampling.BILINEAR)
    return np.asarray(square, np.uint8).transpose(2, 0, 1)
