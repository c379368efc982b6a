"""Pictures of a data set for people: the sample figure of a paper, and a contact sheet.

Promises: text is text and images keep their own pixels in PDF and SVG; equal data give equal bytes under the same
Matplotlib, for nothing of the day or the machine is written; an interrupted save leaves no file.
"""

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from tacevo.data.dataset import Dataset
from tacevo.data.labels import in_order, labels_of, texts_of
from tacevo.data.source import Picture
from tacevo.data.survey import split_of
from tacevo.errors import ConfigError
from tacevo.records import Kind
from tacevo.storage.files import write_durably

#: What a figure can be saved as, with what else Matplotlib would note in the file.
FORMATS: dict[str, dict[str, Any]] = {
    ".png": {"Software": None},
    ".pdf": {"Creator": None, "Producer": None, "CreationDate": None},
    ".svg": {"Creator": None, "Date": None},
}

#: Widths of one and of two columns of a paper, in inches.
WIDTHS = {"single": 3.5, "double": 7.16}

#: Pictures in a row, at most.
COLUMNS = {"single": 4, "double": 8}

#: Samples of a regression whose labels are not a few levels.
SAMPLES = 8

#: Different labels up to which a regression counts as one of levels, each of which is shown.
LEVELS = 12

#: Images on a contact sheet.
SHEET_IMAGES = 64

#: Smaller pictures are not magnified: there is nothing more to see.
ZOOM_FROM = 96

ZOOM = 3

#: Vermillion of the Okabe-Ito palette, which people with any colour vision distinguish from grey.
ACCENT = "#D55E00"

#: The height of a line of text in inches.
LINE = 0.105

#: Points.
FONT = 6.5

DOTS_PER_INCH = 300

_STYLE: list[str | dict[str, Any]] = [
    "default",  # not the user's own matplotlibrc
    {"font.family": "DejaVu Sans", "font.size": FONT, "pdf.fonttype": 42, "svg.fonttype": "none"}
    | {"svg.hashsalt": "tacevo", "image.interpolation": "none"},
]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Panel:
    """One picture and the lines below it."""

    image: Picture
    lines: tuple[str, ...]


def sample_figure(dataset: Dataset, *, units: tuple[str, ...], width: str) -> Figure:
    """Draw a few samples in the order of their labels, with a magnified part each where that shows more.

    One of each class or level; else training images at even steps from the smallest label to the largest (see
    `tacevo.data.labels.in_order`). Only images of the training split are shown.

    The width is `single` or `double`: columns of a paper (3.5 or 7.16 inches).
    """
    images, texts = _images(dataset), texts_of(dataset, units)
    panels = [Panel(image=images[row], lines=_signs(texts[row])) for row in _samples(dataset, units)]
    return _draw(panels, width=width, zoom=dataset.facts.image_size >= ZOOM_FROM, title=None)


def contact_sheet(dataset: Dataset, *, units: tuple[str, ...], title: str) -> Figure:
    """Draw images at even steps through all rows in the order of their labels, each with its split and row."""
    images, texts, splits = _images(dataset), texts_of(dataset, units), split_of(dataset)
    panels = [
        Panel(image=images[row], lines=(*_signs(texts[row]), f"{splits[row]} {row}"))
        for row in _even(in_order(dataset, units), SHEET_IMAGES)
    ]
    return _draw(panels, width="double", zoom=False, title=title)


def format_of(path: Path) -> str:
    """Find the format of a picture by the end of its name.

    Raises:
        ConfigError: it is not one of `FORMATS`.
    """
    if path.suffix.lower() not in FORMATS:
        raise ConfigError(path.name, place="-o", expected=f"a file name that ends in one of {', '.join(FORMATS)}")
    return path.suffix.lower()


def save(figure: Figure, path: Path) -> None:
    """Write a figure, replacing an older one; the end of the name says the format.

    Raises:
        ConfigError: the format is unknown.
        StoreError: the file cannot be written.
    """
    ending = format_of(path)
    with style.context(_STYLE):
        content = encoded(figure, ending)
    write_durably(path, content)


def encoded(figure: Figure, ending: str) -> bytes:
    """Return the content of a figure's file, in the style that is in force; the ending is one of `FORMATS`."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format=ending.removeprefix("."), dpi=DOTS_PER_INCH, metadata=FORMATS[ending])
    return buffer.getvalue()


def _images(dataset: Dataset) -> npt.NDArray[np.uint8]:
    return np.asarray(np.load(dataset.images, mmap_mode="r"))


def _samples(dataset: Dataset, units: tuple[str, ...]) -> list[int]:
    """Choose the training rows that a sample figure shows."""
    labels, order = labels_of(dataset), in_order(dataset, units)
    training = order[np.isin(order, dataset.train)]
    levels, first = np.unique(labels[training], axis=0, return_index=True)
    if dataset.facts.kind is Kind.classification or (labels.shape[1] == 1 and len(levels) <= LEVELS):
        return [int(row) for row in training[first]]
    return _even(training, SAMPLES)


def _even(rows: npt.NDArray[np.int64], count: int) -> list[int]:
    """Take `count` rows at even steps, the first and the last among them; all where there are fewer."""
    if len(rows) <= count:
        return [int(row) for row in rows]
    return [int(rows[index]) for index in np.linspace(0, len(rows) - 1, count).round().astype(np.int64)]


def _signs(lines: Sequence[str]) -> tuple[str, ...]:
    """Write minus signs as such, not as hyphens."""
    return tuple(line.replace(" -", " \N{MINUS SIGN}") for line in lines)


def _draw(panels: Sequence[Panel], *, width: str, zoom: bool, title: str | None) -> Figure:
    """Put panels into rows of equal length, as far as they go, each above its magnified part where there is one."""
    rows = math.ceil(len(panels) / COLUMNS[width])
    columns = math.ceil(len(panels) / rows)
    tall = 2 if zoom else 1
    lines = rows * (1 + max(len(panel.lines) for panel in panels)) + (0 if title is None else 2)
    height = rows * tall * WIDTHS[width] / columns + lines * LINE
    with style.context(_STYLE):
        figure = Figure(figsize=(WIDTHS[width], height), layout="constrained")
        if title is not None:
            figure.suptitle(title, x=0.006, ha="left", fontsize=FONT, parse_math=False)
        grid = figure.subplots(rows * tall, columns, squeeze=False)
        for axes in grid.flat:
            axes.set(xticks=[], yticks=[])
            axes.spines[:].set_visible(False)
        for number, panel in enumerate(panels):
            row, column = divmod(number, columns)
            pixels = panel.image.transpose(1, 2, 0)
            grid[row * tall, column].imshow(pixels)
            grid[row * tall + tall - 1, column].set_xlabel("\n".join(panel.lines), parse_math=False)
        for number, window in enumerate(_windows([panel.image for panel in panels]) if zoom else []):
            row, column = divmod(number, columns)
            _magnify(grid[row * tall, column], grid[row * tall + 1, column], window)
    return figure


def _magnify(whole: Axes, closer: Axes, window: tuple[int, int, int]) -> None:
    """Mark a square of a picture, and draw it again below."""
    across, down, size = window
    pixels = np.asarray(whole.images[0].get_array())
    whole.add_patch(Rectangle((across - 0.5, down - 0.5), size, size, fill=False, edgecolor=ACCENT, linewidth=0.7))
    closer.imshow(pixels[down : down + size, across : across + size])
    closer.spines[:].set(visible=True, edgecolor=ACCENT, linewidth=0.7)


def _windows(images: Sequence[Picture]) -> list[tuple[int, int, int]]:
    """Find the square of each image around where something touches the sensor: (left, top, side) in pixels.

    With a sensor that is the same in every image, this is where the image differs from their median and where they
    vary at all; the latter matters where all touch nearly the same place, so that the median shows a contact too.
    """
    from scipy.ndimage import gaussian_filter  # half a second to import, for large images only

    stack = np.stack(images).astype(np.float64)
    size = stack.shape[-1] // ZOOM
    varied = gaussian_filter(stack.std(axis=0).sum(axis=0), size / 4)
    found = []
    for difference in np.abs(stack - np.median(stack, axis=0)).sum(axis=1):
        touched = gaussian_filter(difference, size / 4) * varied
        middle = np.array(np.unravel_index(int(touched.argmax()), touched.shape))
        down, across = np.clip(middle - size // 2, 0, stack.shape[-1] - size)
        found.append((int(across), int(down), size))
    return found
