"""Pictures of a data set for people: the sample figure of a paper, and a contact sheet.

Promises: text is text and images keep their own pixels in PDF and SVG; equal data give equal bytes under the same
Matplotlib, for nothing of the day or the machine is written; an interrupted save leaves no file.
"""

import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib import style
from matplotlib.figure import Figure

from tacevo.data.dataset import Dataset
from tacevo.data.labels import in_order, labels_of, texts_of
from tacevo.data.survey import split_of
from tacevo.errors import ConfigError
from tacevo.records import Kind
from tacevo.storage.files import write_durably
from tacevo.text import unbroken

#: The formats of a figure's file, with the notes that Matplotlib must leave out of it.
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

#: The height of a line of text in inches.
LINE = 0.105

#: Points.
FONT = 6.5

DOTS_PER_INCH = 300

#: The resolution on a screen, where two columns of a paper are then about 1,070 pixels wide.
SCREEN_DOTS_PER_INCH = 150

_STYLE: list[str | dict[str, Any]] = [
    "default",  # not the user's own matplotlibrc
    {"font.family": "DejaVu Sans", "font.size": FONT, "pdf.fonttype": 42, "svg.fonttype": "none"}
    | {"svg.hashsalt": "tacevo", "image.interpolation": "none"},
]


def sample_figure(dataset: Dataset, *, units: tuple[str, ...], width: str) -> Figure:
    """Draw a few samples in the order of their labels.

    One of each class or level; else training images at even steps from the smallest label to the largest (see
    `tacevo.data.labels.in_order`). Only images of the training split are shown.

    The width is `single` or `double`: columns of a paper (3.5 or 7.16 inches).
    """
    rows, texts = _samples(dataset, units), texts_of(dataset, units)
    return _draw(dataset, rows, [texts[row] for row in rows], width=width)


def contact_sheet(dataset: Dataset, *, units: tuple[str, ...], title: str) -> Figure:
    """Draw images at even steps through all rows in the order of their labels, each with its split and row."""
    texts, splits = texts_of(dataset, units), split_of(dataset)
    rows = _even(in_order(dataset, units), SHEET_IMAGES)
    return _draw(dataset, rows, [(*texts[row], f"{splits[row]} {row}") for row in rows], width="double", title=title)


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


class ShownFigure(Figure):
    """A figure of Matplotlib that shows itself where it is the value of a notebook's cell, without any backend."""

    def _repr_png_(self) -> bytes:
        """Return what IPython shows; the user's own matplotlibrc has no effect on it, as on a file."""
        buffer = io.BytesIO()
        with style.context("default"):
            self.savefig(buffer, format="png", dpi=SCREEN_DOTS_PER_INCH)
        return buffer.getvalue()


def encoded(figure: Figure, ending: str) -> bytes:
    """Return the content of a figure's file, in the style that is in force; the ending is one of `FORMATS`."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format=ending.removeprefix("."), dpi=DOTS_PER_INCH, metadata=FORMATS[ending])
    return buffer.getvalue()


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
    indices = np.linspace(0, len(rows) - 1, min(count, len(rows))).round().astype(np.int64)
    return [int(row) for row in rows[indices]]


def _draw(
    dataset: Dataset, rows: Sequence[int], texts: Sequence[Sequence[str]], *, width: str, title: str | None = None
) -> Figure:
    """Draw images, each above its lines of text, in rows of equal length as far as they go."""
    images: npt.NDArray[np.uint8] = np.load(dataset.images, mmap_mode="r")
    down = math.ceil(len(rows) / COLUMNS[width])
    across = math.ceil(len(rows) / down)
    lines = down * (1 + max(map(len, texts))) + (0 if title is None else 2)
    height = down * WIDTHS[width] / across + lines * LINE
    with style.context(_STYLE):
        figure = ShownFigure(figsize=(WIDTHS[width], height), layout="constrained")
        if title is not None:
            figure.suptitle(title, x=0.006, ha="left", fontsize=FONT, parse_math=False)
        grid = figure.subplots(down, across, squeeze=False)
        for axes in grid.flat:
            axes.set(xticks=[], yticks=[])
            axes.spines[:].set_visible(False)
        for axes, row, text in zip(grid.flat, rows, texts, strict=False):  # the last row may have fewer
            axes.imshow(images[row].transpose(1, 2, 0))
            axes.set_xlabel("\n".join(map(unbroken, text)).replace(" -", " \N{MINUS SIGN}"), parse_math=False)
    return figure
