"""Axes that several figures share."""

import textwrap
from collections.abc import Iterable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from analysis.figures.style import BLACK, GREY, PALE
from tacevo.evolution.lines import TEMPERATURE
from tacevo.results.run import RecordedRun

#: The longest line of a title over a single column, in characters.
_TITLE = 40

#: Losses stand on a logarithmic axis where the largest is at least this many times the smallest.
LOG_FROM = 10.0

#: Half of what the seeds of one place are apart, as part of that place.
_SPREAD = 0.24

#: Boxes of quartiles, over which every value is drawn as a point.
BOXES: dict[str, Any] = {
    "showfliers": False,
    "patch_artist": True,
    "boxprops": {"facecolor": PALE, "edgecolor": GREY},
    "whiskerprops": {"color": GREY},
    "capprops": {"color": GREY},
    "medianprops": {"color": BLACK, "linewidth": 1.4},
}


def spread(place: float, count: int) -> NDArray[np.float64]:
    """Spread so many points evenly around a place, or one on it."""
    return place + (np.linspace(-_SPREAD, _SPREAD, count) if count > 1 else np.zeros(count))


def count_along(axes: Axes, label: str) -> None:
    """Name the level axis of whole numbers, e.g. of generations."""
    axes.set_xlabel(label)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))


def on_loss_axis(axes: Axes, losses: Iterable[float | None]) -> None:
    """Name and scale the upright axis of validation losses.

    A loss of None, where nothing was trained, is not drawn.
    """
    values = [loss for loss in losses if loss is not None]
    axes.set_ylabel("validation loss")
    if values and min(values) > 0 and max(values) >= LOG_FROM * min(values):
        axes.set_yscale("log")
    else:
        axes.set_ylim(bottom=0)


def title_unsent_temperatures(axes: Axes, run: RecordedRun) -> None:
    """Write above the axes of temperatures that they were not sent to the model, where that is so."""
    axes.set_title(textwrap.fill(run.not_sent.get(TEMPERATURE, ""), _TITLE))
