"""A study: every seed of every network, and what its classifiers confuse."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from analysis.figures.axes import boxes, spread
from analysis.figures.style import BLACK, BLUE, ORANGE, VERMILLION, house_style, new_figure
from analysis.studies.metric_names import SHARES, metric_name
from tacevo.records import Kind
from tacevo.results.study import RecordedStudy

#: From this many networks on, `variant 1` has two lines, since one would run into the next.
_NARROW = 6


@house_style()
def seed_boxes(study: RecordedStudy, words: Mapping[str, str]) -> Figure:
    """Draw the primary metric of every network as a box of quartiles, with every seed as a point over it.

    Of fewer than six seeds there are the points and the median only. Whiskers end at the furthest seed within 1.5
    quartile ranges; seeds beyond are seen as points like all others.

    `words` stand above a network, by its name: its verdict, say.
    """
    figure, (axes,) = new_figure("single", 2.6)
    factor, unit = (100.0, " (%)") if study.primary in SHARES else (1.0, "")
    names = [network.name for network in study.networks]
    values = [factor * study.values(name, study.primary) for name in names]
    places = range(1, len(names) + 1)
    drawn = boxes(axes, values, places, widths=0.62)
    if drawn:
        drawn[0].set_hatch("////")
    for place, seeds in zip(places, values, strict=True):
        colour, marker = (ORANGE, "s") if place == 1 else (BLUE, "o")
        axes.plot(
            spread(place, len(seeds)), seeds, marker, color=colour, markersize=2.6, mec="white", mew=0.3, zorder=3
        )
    axes.axhline(float(np.median(values[0])), color=VERMILLION, linestyle=":", linewidth=0.8, zorder=0)
    gap = "\n" if len(names) >= _NARROW else " "
    axes.set_xticks(list(places), [name.replace(" ", gap) for name in names])
    axes.set_ylabel(f"test {metric_name(study.primary)}{unit}")
    for place, name in zip(places, names, strict=True):
        where = axes.get_xaxis_transform()
        axes.text(place, 1.01, words.get(name, ""), transform=where, ha="center", va="bottom", linespacing=1.1)
    return figure


@house_style()
def confusion_matrices(study: RecordedStudy) -> Figure:
    """Draw the test images of every network by true and predicted class: counts, and per cent of the true class.

    Each network is shown at its `RecordedStudy.median_seed`.

    Raises:
        ValueError: it is the study of a regression.
    """
    if study.kind is not Kind.classification:
        raise ValueError(f"the study of {study.task}, a regression, has no confusion matrix")
    names = [network.name for network in study.networks]
    columns = min(len(names), 3)
    rows = math.ceil(len(names) / columns)
    width, height = ("single", 3.4) if columns == 1 else ("double", 7.8 / columns)
    figure, panels = new_figure(width, height * rows, rows=rows, columns=columns)
    matrices = {(score.network, score.seed): score.confusion for score in study.scores}
    for place, name in enumerate(names):
        seed = study.median_seed(name)
        _matrix(panels[place], np.array(matrices[name, seed]), study.names)
        panels[place].set_title(f"{name}, seed {seed}")
        if place % columns == 0:
            panels[place].set_ylabel("true class")
    for axes in panels[len(names) :]:
        axes.remove()
    return figure


def _matrix(axes: Axes, counts: NDArray[np.int64], names: Sequence[str]) -> None:
    """Draw one matrix, coloured by the share of its row; a class without images stays pale."""
    totals = counts.sum(axis=1, keepdims=True)
    shares = 100 * counts / np.maximum(totals, 1)
    places = range(len(names))
    axes.pcolormesh(places, places, shares, shading="nearest", cmap="Blues", vmin=0, vmax=100)  # imshow draws pixels
    axes.invert_yaxis()
    axes.set_aspect("equal")
    for (row, column), count in np.ndenumerate(counts):
        if count:
            colour = "white" if shares[row, column] > 55 else BLACK
            text = f"{count}\n{shares[row, column]:.0f}"
            axes.text(column, row, text, color=colour, ha="center", va="center", linespacing=1.05)
    axes.set_xticks(places, names, rotation=45, ha="right", rotation_mode="anchor", parse_math=False)
    axes.set_yticks(places, names, parse_math=False)
    axes.set_xlabel("predicted class")
    axes.spines[:].set_visible(True)
