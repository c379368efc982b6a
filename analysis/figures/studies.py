"""A study: every seed of every network, how each differs from the baseline, and what classifiers confuse."""

import math
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from analysis.figures.axes import beside, boxes, forest_axes, interval, spread
from analysis.figures.style import BLACK, BLUE, GREEN, GREY, ORANGE, SHADE, VERMILLION, house_style, new_figure
from analysis.rounding import p_in_words
from analysis.studies.comparison import Verdict, deciding_p
from analysis.studies.metric_names import SHARES, metric_name
from tacevo.records import Kind
from tacevo.results.study import LOWER_IS_BETTER, RecordedStudy
from tacevo.text import counted

#: An image of a test set is worth this many percentage points where a figure of accuracies says how many.
_COARSE = 0.5

#: In inches: the height of a network's row in a forest plot, and of what stands above and below all rows.
_ROW, _AROUND = 0.3, 1.15

#: How a verdict is drawn: colour, marker, whether it is filled.
_VERDICTS = {
    Verdict.better: (BLUE, "o", True),
    Verdict.worse: (VERMILLION, "s", True),
    Verdict.equivalent: (GREEN, "D", True),
    Verdict.undecided: (GREY, "o", False),
}

#: The longest line below matrices in one column, and in two; in characters.
_NOTE = {"single": 60, "double": 130}


@house_style()
def seed_boxes(study: RecordedStudy, words: Mapping[str, str], head: str = "") -> Figure:
    """Draw the primary metric of every network as a box of quartiles, with every seed as a point over it.

    Of fewer than six seeds there are the points and the median only. Whiskers end at the furthest seed within 1.5
    quartile ranges; seeds beyond are seen as points like all others. Where one test image makes a step that can be
    seen, the axis says how large it is.

    `words` are the lines above a network, by its name: its verdict and its p, say; `head` are those above the baseline,
    which say what the others are.
    """
    figure, (axes,) = new_figure("single", 2.6)
    factor, unit = _unit(study)
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
    axes.set_xticks(list(places), [network.whole_name.replace(" ", "\n", 1) for network in study.networks])
    axes.set_ylabel(f"test {metric_name(study.primary)}{unit}{_step(study)}")
    where: dict[str, Any] = {"transform": axes.get_xaxis_transform(), "va": "bottom"}
    for place, name in zip(places, names, strict=True):
        axes.text(place, 1.01, words.get(name, ""), ha="center", **where)
    axes.text(1.35, 1.01, head if words else "", ha="right", **where)
    return figure


def _unit(study: RecordedStudy) -> tuple[float, str]:
    """Return what the primary metric is multiplied by in figures, and its unit behind its name."""
    return (100.0, " (%)") if study.primary in SHARES else (1.0, "")


def _step(study: RecordedStudy) -> str:
    """Say how many points one test image is, where that is a step that can be seen; on a line of its own."""
    confusion = study.scores[0].confusion
    if confusion is None:
        return ""
    points = 100 / sum(map(sum, confusion))
    return f"\n1 image = {points:.1f} points" if points >= _COARSE else ""


@house_style()
def forest(study: RecordedStudy, comparisons: pd.DataFrame) -> Figure:
    """Draw how much every variant differs from the baseline, with the interval of the difference and p after Holm.

    Args:
        study: what was tested.
        comparisons: of the primary metric itself, one row or more (`analysis.studies.comparison.of_whole`). The band
            around no difference is the margin of equivalence.
    """
    figure, (axes,) = new_figure("single", _AROUND + _ROW * len(comparisons))
    factor, _ = _unit(study)
    names = {network.name: network.whole_name for network in study.networks}
    margin = factor * float(comparisons.margin.iloc[0])
    axes.axvspan(-margin, margin, color=SHADE, alpha=0.5, linewidth=0, zorder=0, label="margin of equivalence")
    for place, one in enumerate(comparisons.itertuples()):
        ends = factor * one.difference_low, factor * one.difference_high
        colour, marker, is_filled = _VERDICTS[Verdict(one.verdict)]
        interval(axes, place, factor * one.difference, ends, colour=colour, marker=marker, is_filled=is_filled)
        beside(axes, place, f"{one.verdict}, p {p_in_words(deciding_p(one))}")
    axes.set_yticks(range(len(comparisons)), [names[one] for one in comparisons.network], parse_math=False)
    where = "points of test accuracy" if study.primary in SHARES else f"test {metric_name(study.primary)}"
    better = ("better", "worse") if LOWER_IS_BETTER[study.primary] else ("worse", "better")
    forest_axes(axes, len(comparisons), f"difference to the baseline, {where}", better, "p after Holm")
    figure.legend(loc="outside lower center", handlelength=1.2)
    return figure


@house_style()
def confusion_matrices(study: RecordedStudy) -> Figure:
    """Draw the test images of every network by true and predicted class: counts, and per cent of the true class.

    Each network is shown at its `RecordedStudy.median_seed`; a line below says so, and what the numbers are.

    Raises:
        ValueError: it is the study of a regression.
    """
    if study.kind is not Kind.classification:
        raise ValueError(f"the study of {study.task}, a regression, has no confusion matrix")
    count = len(study.networks)
    columns = min(count, 3)
    rows = math.ceil(count / columns)
    width, height = ("single", 3.4) if columns == 1 else ("double", 7.8 / columns)
    figure, panels = new_figure(width, height * rows + 0.25, rows=rows, columns=columns)
    matrices = {(score.network, score.seed): score.confusion for score in study.scores}
    for place, network in enumerate(study.networks):
        seed = study.median_seed(network.name)
        _matrix(panels[place], np.array(matrices[network.name, seed]), study.names)
        panels[place].set_title(f"{network.whole_name}, seed {seed}", parse_math=False)
        if place % columns == 0:
            panels[place].set_ylabel("true class")
    for axes in panels[count:]:
        axes.remove()
    note = (
        "In a cell: test images, and below them per cent of the true class. "
        f"Of {counted(study.seeds, 'training seed')} the one of median accuracy is shown."
    )
    figure.supxlabel(textwrap.fill(note, _NOTE[width]), fontsize=7)
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
