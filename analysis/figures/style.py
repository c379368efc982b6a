"""How every figure looks, and how it becomes a file.

Promises: one or two columns of a paper wide, letters of 7 and 8 points; a marker, a dash or a hatching repeats what a
colour shows, and red and green never stand for a difference alone; text is text, with TrueType letters inside a PDF;
equal records give equal bytes under the same Matplotlib; no window system is needed, and no global state is changed.
"""

import contextlib
from collections.abc import Iterator
from typing import Any

from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tacevo.data.pictures import WIDTHS, ShownFigure, encoded

#: Okabe and Ito's palette, which people with any colour vision can distinguish (jfly.uni-koeln.de/color).
BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"

YELLOW, BLUE, VERMILLION, PURPLE = "#F0E442", "#0072B2", "#D55E00", "#CC79A7"

GREY, SHADE, PALE = "#767676", "#D0D0D0", "#F2F2F2"

#: Of quantities: dark to light, even in grey.
COLOUR_MAP = "cividis"

#: Of a marker that stands on others or on dark cells.
OUTLINED: dict[str, Any] = {"markeredgecolor": "white", "markeredgewidth": 0.5}

#: Points of letters: of a column of a paper; and of a page that shows a figure of two columns 720 pixels wide, where
#: they are 12 pixels.
PAPER, PAGE = 7.0, 8.6

_LETTERS = ("font.size", "axes.labelsize", "legend.fontsize", "xtick.labelsize", "ytick.labelsize")

_STYLE: list[str | dict[str, Any]] = [
    "default",  # not the user's own matplotlibrc
    {"font.family": "DejaVu Sans", "axes.titlesize": 8, "mathtext.fontset": "dejavusans"}
    | {"axes.linewidth": 0.6, "xtick.major.width": 0.6, "ytick.major.width": 0.6, "lines.linewidth": 1.1}
    | {"xtick.minor.width": 0.4, "ytick.minor.width": 0.4, "xtick.major.size": 2.5, "ytick.major.size": 2.5}
    | {"lines.markersize": 3.2, "patch.linewidth": 0.5, "hatch.linewidth": 0.5, "grid.linewidth": 0.4}
    | {"axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False, "legend.handlelength": 2.2}
    | {"pdf.fonttype": 42, "svg.fonttype": "none", "svg.hashsalt": "tacevo", "image.interpolation": "none"},
]


@contextlib.contextmanager
def house_style(letters: float = PAPER) -> Iterator[None]:
    """Draw in the style of this project, with letters of so many points; also a decorator."""
    with style.context([*_STYLE, dict.fromkeys(_LETTERS, letters)]):
        yield


def new_figure(width: str, height: float, *, rows: int = 1, columns: int = 1) -> tuple[Figure, list[Axes]]:
    """Begin a figure of even panels.

    Args:
        width: `single` or `double`, columns of a paper (3.5 or 7.16 inches).
        height: in inches.
        rows: panels below each other.
        columns: panels beside each other.

    Returns:
        The figure and its axes, row by row.
    """
    figure = ShownFigure(figsize=(WIDTHS[width], height), layout="constrained")
    return figure, list(figure.subplots(rows, columns, squeeze=False).flat)


@house_style()
def render(figure: Figure, ending: str) -> bytes:
    """Return the content of a figure's file.

    The ending is `.pdf`, `.svg` or `.png`.
    """
    return encoded(figure, ending)
