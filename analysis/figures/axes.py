"""Axes that several figures share."""

import textwrap
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import PathPatch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from analysis.figures.style import BLACK, GREY, PALE
from tacevo.evolution.lines import TEMPERATURE
from tacevo.results.run import RecordedRun

#: The longest line of a title over a single column, in characters.
_TITLE = 40

#: Lines that lie on each other, of which the names are written.
_NAMED = 3

#: Losses stand on a logarithmic axis where the largest is at least this many times the smallest.
LOG_FROM = 10.0

#: Half of what the seeds of one place are apart, as part of that place.
_SPREAD = 0.24

#: From this many values on, a box of quartiles lies under them; of fewer it would show what they do not.
BOXED = 6

_BOXES: dict[str, Any] = {
    "showfliers": False,
    "patch_artist": True,
    "boxprops": {"facecolor": PALE, "edgecolor": GREY},
    "whiskerprops": {"color": GREY},
    "capprops": {"color": GREY},
    "medianprops": {"color": BLACK, "linewidth": 1.4},
}


def boxes(axes: Axes, samples: Sequence[NDArray[np.float64]], places: Sequence[int], **how: Any) -> list[PathPatch]:
    """Draw a box of quartiles for each sample of `BOXED` values or more, over which every value is to stand as a point.

    Of a smaller sample only the median is drawn. `how` is as of `Axes.boxplot`.

    Returns:
        The boxes, in the order of the samples; none of a small sample.
    """
    large = [place for place, values in zip(places, samples, strict=True) if len(values) >= BOXED]
    drawn: list[PathPatch] = []
    if large:
        boxed = [values for values in samples if len(values) >= BOXED]
        drawn = list(axes.boxplot(boxed, positions=large, **{**_BOXES, **how})["boxes"])
    for place, values in zip(places, samples, strict=True):
        if 0 < len(values) < BOXED:
            across = [place - how["widths"] / 2, place + how["widths"] / 2], [float(np.median(values))] * 2
            axes.plot(
                *(reversed(across) if how.get("orientation") == "horizontal" else across), **_BOXES["medianprops"]
            )
    return drawn


def name_coinciding(axes: Axes) -> None:
    """Write above the axes which of its lines lie on each other, since only the last one is seen."""
    lines: dict[bytes, list[str]] = {}
    for line in axes.lines:
        points = np.asarray(line.get_xydata(), dtype=np.float64)
        if not str(line.get_label()).startswith("_") and np.isfinite(points).all(axis=1).any():
            lines.setdefault(points.tobytes(), []).append(str(line.get_label()))
    twins = [names for names in lines.values() if len(names) > 1]
    told = [" = ".join(names[:_NAMED]) + (" = ..." if len(names) > _NAMED else "") for names in twins]
    if told:
        axes.set_title(textwrap.fill("; ".join(told), _TITLE), parse_math=False)


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
